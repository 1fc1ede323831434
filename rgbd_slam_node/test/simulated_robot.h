// A ground robot over a textured floor with exact truth: colour, depth with a Kinect's noise, and IMU.
#pragma once

#include <algorithm>
#include <functional>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "rgbd_slam/slam.h"
#include "synthetic.h"  // of the visual front end

namespace rgbd_slam::simulated {

using visual_frontend::ImuSample;
namespace synthetic = visual_frontend::synthetic;

struct Robot {
  Robot() : camera(synthetic::camera(false)), texture(synthetic::texture(1800, 3)) {
    texture.convertTo(texture, -1, 1.8, -102);
    // 1.2 m up, looking to the right and lying on its side: floor in a part of the image, up to the horizon.
    mounting.T_base_camera.linear() = Eigen::AngleAxisd(1.05, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                                      air_ground_common::opticalFromForwardBody();
    mounting.T_base_camera.translation() = Eigen::Vector3d(0.1, 0.03, 1.2);
    mounting.R_base_imu = Eigen::AngleAxisd(1.3, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  }

  CameraModel camera;
  cv::Mat texture;
  double floor = 9.0;  ///< width of the texture [m]
  Mounting mounting;
  double radius = 1.0, speed = 0.3, rest = 0.8;  ///< circle [m], [m/s], standstill at the start [s]
  bool spin = false;                             ///< turn on the spot instead
  bool walls = false;                            ///< bare ones, without texture, about the floor
  Eigen::Vector3d tilt{0.03, -0.02, 0};          ///< the base is not level [rad]
  Eigen::Vector3d gyro_bias{0.01, -0.02, 0.015};
  Eigen::Matrix3d gyro_matrix = Eigen::Matrix3d::Identity();   ///< what the gyro makes of a turn rate
  Eigen::Matrix3d accel_matrix = Eigen::Matrix3d::Identity();  ///< and the accelerometer of a force
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();
  double imu_step = 0.005;  ///< between samples [s]
  double start = 0;         ///< when the map begins [s]
  double readout_time = 0;  ///< of a rolling shutter [s]
  double depth_delay = 0;   ///< depth is taken so long after the image [s]
  double told_delay = 0;    ///< what SLAM hears of that [s]
  double sway = 0;          ///< roll and pitch swing by this while it drives, as on uneven ground [rad]
  double sway_rate = 1;     ///< how fast, over 2.1 and 1.7 rad/s

  /// T_world_base; the world's z is up, the floor at z = 0.
  Pose base(double t) const {
    const double s = std::max(0.0, t - rest);
    // Sets off smoothly over a second.
    const double way = speed * (s < 1 ? 0.5 * s * s : s - 0.5), angle = way / radius;
    Pose T = Pose::Identity();
    const Eigen::Vector3d swing =
        sway * Eigen::Vector3d(std::sin(2.1 * sway_rate * s), std::sin(1.7 * sway_rate * s), 0);
    T.linear() = Eigen::AngleAxisd(angle + 0.7, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
                 air_ground_common::expSO3(tilt + swing);
    if (!spin) T.translation() = Eigen::Vector3d(radius * std::sin(angle), radius * (1 - std::cos(angle)), 0);
    return T;
  }

  /// Pose of the base in the map that SLAM should build: origin at the first base, level, yaw 0 there.
  Pose mapped(double t) const {
    const Pose first = base(start);
    return air_ground_common::yawPose(air_ground_common::yawOf(first.linear()), first.translation()).inverse() *
           base(t);
  }

  struct Frame {
    cv::Mat gray, depth;
  };
  /// Without noise.
  Frame render(double t) const {
    Frame f;
    const auto cameraOf = [&](int row) {
      return Pose(base(t + (static_cast<double>(row) / camera.height - 0.5) * readout_time) * mounting.T_base_camera);
    };
    f.gray = readout_time == 0
                 ? synthetic::renderPlane(camera, base(t) * mounting.T_base_camera, texture, floor, &f.depth)
                 : synthetic::renderPlaneByRows(camera, cameraOf, texture, floor, &f.depth);
    if (walls) addWalls(base(t) * mounting.T_base_camera, &f);
    return f;
  }
  Frame frame(double t, synthetic::Random& random) const {
    Frame f = render(t);
    if (depth_delay != 0) f.depth = render(t + depth_delay).depth;
    cv::Mat noise(f.gray.size(), CV_16S), noisy;
    cv::RNG rng(static_cast<std::uint64_t>(t * 1000) + 5);
    rng.fill(noise, cv::RNG::NORMAL, 0, 2);
    f.gray.convertTo(noisy, CV_16S);
    cv::Mat(noisy + noise).convertTo(f.gray, CV_8U);
    const DepthModel model;
    for (int v = 0; v < f.depth.rows; ++v) {
      for (int u = 0; u < f.depth.cols; ++u) {
        float& z = f.depth.at<float>(v, u);
        z = z > 0 ? static_cast<float>(std::round(1000 * (z + random.gauss(0.7 * model.sigma(z)))) / 1000) : NAN;
      }
    }
    return f;
  }

  /// Of a room with eight sides about the circle that is driven.
  static std::vector<synthetic::Plane> wallPlanes() {
    std::vector<synthetic::Plane> planes;
    for (int i = 0; i < 8; ++i)
      planes.emplace_back(Eigen::AngleAxisd(0.4 + M_PI / 4 * i, Eigen::Vector3d::UnitZ()) * Eigen::Vector3d::UnitX(),
                          2.2 + 0.2 * (i % 3));
    return planes;
  }
  void addWalls(const Pose& T_world_camera, Frame* f) const {
    const std::vector<synthetic::Plane> planes = wallPlanes();
    for (int v = 0; v < camera.height; ++v) {
      for (int u = 0; u < camera.width; ++u) {
        const double z = synthetic::depthOfPlanes(planes, camera, T_world_camera, {u, v});
        float& depth = f->depth.at<float>(v, u);
        if (!std::isfinite(z) || (depth > 0 && depth < z)) continue;
        depth = static_cast<float>(z);
        f->gray.at<std::uint8_t>(v, u) = 120;
      }
    }
  }

  ImuSample imu(double t, synthetic::Random& random) const {
    constexpr double h = 1e-3;
    const Pose before = base(t - h), now = base(t), after = base(t + h);
    const Eigen::Vector3d rate = air_ground_common::logSO3(before.linear().transpose() * after.linear()) / (2 * h);
    const Eigen::Vector3d acceleration = (before.translation() + after.translation() - 2 * now.translation()) / (h * h);
    const Eigen::Matrix3d R_imu_world = mounting.R_base_imu->transpose() * now.linear().transpose();
    ImuSample s;
    s.stamp = t;
    s.angular_velocity = gyro_matrix * mounting.R_base_imu->transpose() * rate + gyro_bias + random.gaussVector(0.003);
    s.specific_force = accel_matrix * R_imu_world * (acceleration + Eigen::Vector3d(0, 0, 9.81)) + accel_bias +
                       random.gaussVector(0.04);
    return s;
  }
};

struct Drive {
  std::vector<SlamResult> results;
  std::vector<double> stamps;
  air_ground_common::Trajectory truth;  ///< camera in the map
};

/// Drives SLAM from t0 to t1 at 10 Hz. `blind(t)`: the lens is covered.
inline Drive drive(const Robot& robot, Slam& slam, double t0, double t1, bool imu = true,
                   const std::function<bool(double)>& blind = {}) {
  Drive run;
  synthetic::Random random(11);
  double next_imu = t0;
  for (int i = 0; t0 + 0.1 * i <= t1; ++i) {
    const double t = t0 + 0.1 * i;
    for (; imu && next_imu <= t + 0.005; next_imu += robot.imu_step) slam.addImu(robot.imu(next_imu, random));
    auto frame = robot.frame(t, random);
    if (blind && blind(t)) frame.gray.setTo(15);
    run.results.push_back(slam.process(t, frame.gray, cv::Mat(), frame.depth, robot.told_delay));
    run.stamps.push_back(t);
    run.truth.push_back({t, robot.mapped(t) * robot.mounting.T_base_camera});
  }
  return run;
}

/// Largest distance of an estimate from the truth [m].
inline double worst(const Drive& run, const air_ground_common::Trajectory& estimate) {
  double largest = 0;
  for (const auto& pose : estimate) {
    const auto truth = air_ground_common::poseAt(run.truth, pose.stamp);
    if (truth) largest = std::max(largest, (truth->translation() - pose.T_map_body.translation()).norm());
  }
  return largest;
}

/// Largest angle by which the orientation differs from the truth.
inline double worstTurn(const Robot& robot, const Drive& run, double from) {
  double largest = 0;
  for (std::size_t i = 0; i < run.results.size(); ++i) {
    if (run.results[i].state != State::kTracking || run.stamps[i] < from) continue;
    largest = std::max(largest, air_ground_common::rotationAngle(run.results[i].T_map_base.linear(),
                                                                 robot.mapped(run.stamps[i]).linear()));
  }
  return largest;
}

}  // namespace rgbd_slam::simulated
