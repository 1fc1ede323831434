#pragma once
// Flights over rendered plates, run through the whole odometry.
#include <gtest/gtest.h>

#include <functional>

#include "air_ground_common/trajectory.h"
#include "mav_vo/odometry.h"
#include "synthetic_camera.h"
#include "visual_frontend/self_calibration.h"

namespace mav_vo {

struct Options {
  double begin = 0, end = 12;
  double period = 0.05;  ///< from image to image [s]
  bool imu = true;
  ImuBias bias{{0.008, -0.012, 0.005}, {0.05, -0.04, 0.06}};
  double accel_scale = 1;  ///< by which the accelerometer reads too much
  std::function<bool(double)> drop_image = [](double) { return false; };
  std::function<double(double)> gain = [](double) { return 1.0; };
  std::function<bool(double)> black = [](double) { return false; };
  double black_noise = 0;  ///< standard deviation of black images [grey levels]
  std::function<double(double)> contrast = [](double) { return 1.0; };
  std::function<bool(double)> elsewhere = [](double) { return false; };  ///< the camera sees another world
  std::function<bool(double)> nan_imu = [](double) { return false; };
  std::function<bool(double)> silent_imu = [](double) { return false; };
  std::function<void(ImuSample&)> spoil_imu = [](ImuSample&) {};  ///< what becomes of a sample
  Eigen::Matrix3d R_base_body = Eigen::Matrix3d::Identity();      ///< of base_link's axes: z of some points forwards
  synthetic::Flight flight;
  double imu_shift = 0;  ///< added to the IMU's stamps [s]
  /// The IMU's axes against those that the odometry is told.
  Eigen::Matrix3d R_given_imu = Eigen::Matrix3d::Identity();
  double readout = 0;  ///< of a rolling shutter [s]
  /// Of the camera, towards where its image's top looks; else it looks straight down. With a rolling shutter, without
  /// gain [rad].
  double tilt = 0;
  bool told = false;   ///< the odometry is told of it
  double radial = 0;   ///< by which the calibration that it is told is larger than the camera's k1
  double replay = 0;   ///< added to all stamps: the recording is played again, time going on [s]
  unsigned seed = 11;  ///< of the IMU's noise
  int grain = 5;       ///< of the images' noise
};

struct Outcome {
  air_ground_common::Trajectory truth, online, final_poses;  // of the camera
  std::vector<VoResult> frames;
  double metric_at = -1;
  CameraModel camera;  ///< as the odometry knows it at the end
};

inline Pose T_imu_camera(const Options& options) {
  return synthetic::T_imu_camera() * Pose(Eigen::AngleAxisd(options.tilt, Eigen::Vector3d::UnitX()));
}

/// Strips of a few rows, each from where the camera is when they are read.
inline cv::Mat renderRows(const synthetic::PlateWorld& world, const Options& options, double t, cv::RNG* grain) {
  constexpr int kRows = 8;
  const auto camera = synthetic::camera();
  static const std::vector<Eigen::Vector3d> rays = synthetic::PlateWorld::raysOf(camera);
  cv::Mat image(camera.height, camera.width, CV_8U);
  for (int row = 0; row < camera.height; row += kRows) {
    auto strip = camera;
    strip.height = std::min(kRows, camera.height - row);
    strip.cy -= row;
    const double at = t + ((row + 0.5 * strip.height) / camera.height - 0.5) * options.readout;
    const Pose T = options.flight.T_world_imu(at) * T_imu_camera(options);
    const auto first = rays.begin() + static_cast<std::ptrdiff_t>(row) * camera.width;
    const cv::Mat rows = options.tilt == 0
                             ? world.render(strip, T, options.gain(t), grain)
                             : world.renderByRays(strip, {first, first + strip.height * camera.width}, T, grain);
    rows.copyTo(image.rowRange(row, row + strip.height));
  }
  return image;
}

inline Outcome fly(const Options& options, OdometrySettings settings = {}, Odometry* given = nullptr) {
  static const synthetic::PlateWorld here(3), elsewhere(77);
  settings.use_imu = options.imu;
  if (options.told) settings.readout_time = options.readout;
  std::unique_ptr<Odometry> own;
  if (!given) {
    own = std::make_unique<Odometry>(visual_frontend::withRadial(synthetic::camera(), options.radial),
                                     Pose(options.R_base_body) * T_imu_camera(options), Pose(options.R_base_body),
                                     settings);
    given = own.get();
  }
  std::mt19937 random(options.seed);
  cv::RNG grain(options.grain);
  const ImuNoise noise{1.7e-4, 2.9e-3, 2e-5, 6e-4};
  auto samples = options.flight.imuSamples(options.begin - 0.2, options.end + 0.1, 200, noise, options.bias, random);
  for (ImuSample& sample : samples) {
    sample.stamp += options.imu_shift + options.replay;
    sample.specific_force *= options.accel_scale;
    sample = visual_frontend::turned(options.R_given_imu.transpose(), sample);
  }
  std::size_t next = 0;
  Outcome outcome;
  for (int i = 1; options.begin + options.period * i <= options.end; ++i) {
    const double t = options.begin + options.period * i;
    for (; options.imu && next < samples.size() && samples[next].stamp <= given->imuNeededAt(t + options.replay) + 1e-9;
         ++next) {
      ImuSample sample = samples[next];
      if (options.nan_imu(sample.stamp)) sample.angular_velocity.x() = std::nan("");
      if (options.silent_imu(sample.stamp)) continue;
      options.spoil_imu(sample);
      given->addImu(sample);
    }
    const Pose T = options.flight.T_world_imu(t) * T_imu_camera(options);
    outcome.truth.push_back({t, T});
    if (options.drop_image(t)) continue;
    const synthetic::PlateWorld& world = options.elsewhere(t) ? elsewhere : here;
    cv::Mat image = options.readout == 0 ? world.render(synthetic::camera(), T, options.gain(t), &grain)
                                         : renderRows(world, options, t, &grain);
    if (options.black(t)) image.setTo(options.black_noise > 0 ? 15 : 3);
    if (options.black(t) && options.black_noise > 0) {
      cv::Mat noise(image.size(), CV_8S);
      grain.fill(noise, cv::RNG::NORMAL, 0, options.black_noise);
      cv::add(image, noise, image, cv::noArray(), CV_8U);
    }
    if (const double contrast = options.contrast(t); contrast != 1) image.convertTo(image, CV_8U, contrast, 30);
    const VoResult r = given->process(t + options.replay, image);
    EXPECT_TRUE(!r.pose_valid || (r.T_map_base.matrix().allFinite() && r.covariance.allFinite()));
    EXPECT_TRUE(!r.metric || options.imu);
    if (r.metric && outcome.metric_at < 0) outcome.metric_at = t;
    if (r.metric && r.pose_valid) outcome.online.push_back({t, r.T_map_camera});
    outcome.frames.push_back(r);
  }
  outcome.final_poses = given->trajectory();
  outcome.camera = given->camera();
  return outcome;
}

/// What no choice of unit, position and attitude of the map explains [m].
inline double shapeError(const Outcome& o) {
  return air_ground_common::absoluteTrajectoryError(o.truth, o.final_poses, air_ground_common::Alignment::kSimilarity)
      .rmse;
}

inline double ate(const Outcome& o, const air_ground_common::Trajectory& estimate, double* scale_error = nullptr) {
  if (scale_error)
    *scale_error =
        air_ground_common::absoluteTrajectoryError(o.truth, estimate, air_ground_common::Alignment::kSimilarity)
            .reference_from_estimate.scale -
        1;
  return air_ground_common::absoluteTrajectoryError(o.truth, estimate, air_ground_common::Alignment::kYawTranslation)
      .rmse;
}

}  // namespace mav_vo
