// Depth that was taken beside its colour image: carried to where the camera was, against rendered truth of that place.
#include "../src/depth_carrier.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>
#include <random>

#include "../src/camera_motion.h"
#include "../src/depth_lookup.h"
#include "air_ground_common/statistics.h"
#include "rgbd_slam/depth_model.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

namespace synthetic = simulated::synthetic;
using air_ground_common::expSO3;
using simulated::Drive;
using simulated::Robot;
using synthetic::Plane;

constexpr double kDelay = 0.015;  // [s]

/// Looks into a corner of a room from 0.8 m above the floor, 17 degrees down.
Pose standing() {
  Pose T = Pose::Identity();
  T.linear() = (Eigen::AngleAxisd(1.3, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()))
                   .toRotationMatrix() *
               air_ground_common::opticalFromForwardBody().transpose();
  T.translation().z() = 0.8;
  return T;
}

/// After `delay` [s] of 0.45 m/s and 0.53 rad/s.
Pose later(const Pose& T, double delay) {
  Pose moved = T;
  moved.translation() += delay * Eigen::Vector3d(0.4, -0.2, 0.05);
  moved.linear() = expSO3(delay * Eigen::Vector3d(0.1, -0.15, 0.5)) * T.linear();
  return moved;
}

cv::Mat depthOf(const CameraModel& camera, const Pose& T_world_camera, const std::vector<Plane>& planes) {
  cv::Mat depth(camera.height, camera.width, CV_32F);
  for (int v = 0; v < camera.height; ++v)
    for (int u = 0; u < camera.width; ++u)
      depth.at<float>(v, u) = static_cast<float>(synthetic::depthOfPlanes(planes, camera, T_world_camera, {u, v}));
  return depth;
}

std::vector<Plane> corner() {
  return {{Eigen::Vector3d::UnitZ(), 0}, {Eigen::Vector3d(0.8, 0.6, 0), 2.9}, {Eigen::Vector3d(-0.6, 0.8, 0), 2.4}};
}

/// Root mean square over the image but for its border, as far as it is known [m].
double error(const cv::Mat& depth, const cv::Mat& truth) {
  constexpr int kBorder = 12;
  const cv::Rect inside(kBorder, kBorder, depth.cols - 2 * kBorder, depth.rows - 2 * kBorder);
  cv::Mat difference = depth(inside) - truth(inside);
  const cv::Mat known = difference == difference;
  return cv::norm(difference, cv::NORM_L2, known) / std::sqrt(cv::countNonZero(known));
}

TEST(DepthLookup, ManyPlacesAreAsOneByOne) {
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN(), kInfinity = std::numeric_limits<float>::infinity();
  std::mt19937 random(3);
  std::uniform_real_distribution<float> anywhere(-3, 44), depths(1, 1.06f);
  std::vector<float> image(40 * 30), x(1000), y(1000), found(1000);
  for (std::size_t i = 0; i < image.size(); ++i)
    image[i] = i % 7 ? depths(random) : std::array{0.F, kNaN, kInfinity, 3.F}[i / 7 % 4];
  for (std::size_t i = 0; i < x.size(); ++i) {
    x[i] = i % 100 ? anywhere(random) : kNaN;
    y[i] = i % 90 ? anywhere(random) : 29;
  }
  const DepthImage depth{image.data(), 37, 30, 40};
  depthsAt(depth, x.data(), y.data(), 1000, found.data());
  int known = 0, unknown = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const float z = depthAt(depth, x[i], y[i]);
    if (std::isnan(z)) {
      EXPECT_TRUE(std::isnan(found[i])) << x[i] << " " << y[i];
    } else if (std::isinf(z)) {
      EXPECT_EQ(found[i], z);
    } else {
      EXPECT_NEAR(found[i], z, 1e-5) << x[i] << " " << y[i];
    }
    (std::isfinite(z) && z > 0 ? known : unknown) += 1;
  }
  EXPECT_GT(known, 300);
  EXPECT_GT(unknown, 100);
}

TEST(DepthCarrier, ShowsWhatTheCameraSawAtTheImagesTime) {
  for (const bool distorted : {false, true}) {
    const CameraModel camera = synthetic::camera(distorted);
    for (const double delay : {kDelay, -kDelay}) {
      const Pose T = standing(), T_depth = later(T, delay);
      const cv::Mat truth = depthOf(camera, T, corner()), late = depthOf(camera, T_depth, corner());
      DepthCarrier carrier(camera);
      const cv::Mat carried = carrier.carry(late, T.inverse() * T_depth);
      EXPECT_GT(error(late, truth), 0.010);
      EXPECT_LT(error(carried, truth), 0.0005);
      EXPECT_GT(error(carrier.carry(late, T_depth.inverse() * T), truth), 0.02) << "the wrong way";
      EXPECT_EQ(cv::countNonZero(carried(cv::Rect(12, 12, 616, 456)) > 0), 616 * 456) << "no cracks";
      // Depth as it is read at features.
      for (int v = 20; v < 460; v += 37) {
        for (int u = 20; u < 620; u += 41) {
          const auto z = sampleDepth(carried, Eigen::Vector2d(u, v), {});
          if (z) {
            EXPECT_NEAR(*z, truth.at<float>(v, u), 0.003) << u << " " << v;
          }
        }
      }
    }
  }
}

// A plate 1 m before the camera, a wall at 3 m, and the camera has gone 20 mm to the right: f 20 mm / z = 10.5, 3.5 px.
TEST(DepthCarrier, KeepsEdgesAndKnowsNothingOfWhatWasHidden) {
  CameraModel camera = synthetic::camera(false);
  cv::Mat late(camera.height, camera.width, CV_32F, cv::Scalar(3));
  late(cv::Rect(200, 100, 100, 80)) = 1;
  late(cv::Rect(400, 100, 20, 20)) = std::numeric_limits<float>::quiet_NaN();
  late(cv::Rect(400, 200, 20, 20)) = 0;
  late(cv::Rect(400, 300, 20, 20)) = std::numeric_limits<float>::infinity();
  Pose T_image_depth = Pose::Identity();
  T_image_depth.translation().x() = 0.02;
  const cv::Mat carried = DepthCarrier(camera).carry(late, T_image_depth);
  for (const int row : {110, 140, 170}) {
    const float* z = carried.ptr<float>(row);
    for (int u = 212; u < 302; ++u) EXPECT_EQ(z[u], 1) << u;
    for (int u = 20; u < 200; ++u) EXPECT_EQ(z[u], 3) << u;
    for (int u = 312; u < 400; ++u) EXPECT_EQ(z[u], 3) << u;
    for (int u = 205; u < 210; ++u) EXPECT_TRUE(std::isnan(z[u])) << u << ": the plate hid it";
  }
  for (const int row : {110, 210, 310})
    for (int u = 405; u < 422; ++u) EXPECT_TRUE(std::isnan(carried.at<float>(row, u))) << row << " " << u;
  EXPECT_EQ(cv::countNonZero((carried > 1.01f) & (carried < 2.99f)), 0);
  Pose forward = Pose::Identity();  // depth was taken 20 mm nearer to what it shows
  forward.translation().z() = 0.02;
  EXPECT_NEAR(DepthCarrier(camera).carry(late, forward).at<float>(140, 250), 1.02, 1e-5);
}

TEST(DepthCarrier, LeavesDepthAsItIsWhereLittleMoves) {
  const CameraModel camera = synthetic::camera(true);
  DepthCarrier carrier(camera);
  const cv::Mat depth(camera.height, camera.width, CV_32F, cv::Scalar(2)),
      nothing(camera.height, camera.width, CV_32F, cv::Scalar(std::numeric_limits<float>::quiet_NaN()));
  const auto moved = [&](double turn, double way, const cv::Mat& image) {
    Pose T = Pose::Identity();
    T.linear() = expSO3({0, turn, 0});
    T.translation().x() = way;
    return carrier.carry(image, T).data != image.data;
  };
  EXPECT_FALSE(moved(0, 0, depth));
  EXPECT_FALSE(moved(0.3 / 525, 0, depth));
  EXPECT_FALSE(moved(0, 2 * 0.4 / 525, depth));
  EXPECT_TRUE(moved(1.0 / 525, 0, depth));
  EXPECT_TRUE(moved(0, 2 * 1.0 / 525, depth));
  EXPECT_FALSE(moved(0.1, 0, nothing));
}

TEST(CameraMotion, MovesDuringDepthsDelayAsGyroAndLastStepSay) {
  const Robot robot;
  const Eigen::Vector3d rate(0.3, -0.2, 0.5);  // of the base, own axes [rad/s]
  const auto fed = [&](double initial_bias) {
    SlamSettings settings;
    settings.inertial.initial_gyro_bias = initial_bias;
    CameraMotion motion(robot.camera, robot.mounting, settings);
    for (int i = 0; i <= 110; ++i)
      motion.addImu({0.005 * i, robot.mounting.R_base_imu->transpose() * rate, {0, 0, visual_frontend::kGravity}});
    return motion;
  };
  CameraMotion motion = fed(0.01);
  const Pose before = robot.base(3) * robot.mounting.T_base_camera, now = later(before, 0.1);
  const Eigen::Matrix3d felt =
      expSO3(Eigen::Vector3d(robot.mounting.T_base_camera.linear().transpose() * rate * kDelay));
  const double early = -std::numeric_limits<double>::infinity();
  const Pose first = motion.movedBy(early, Pose::Identity(), 0.5, kDelay);
  EXPECT_LT(air_ground_common::rotationAngle(first.linear(), felt), 1e-6);
  EXPECT_EQ(first.translation().norm(), 0) << "not known yet";
  motion.update(0.1, before, now);
  for (const double sign : {1.0, -1.0}) {
    const Pose T = motion.movedBy(0.4, now, 0.5, sign * kDelay);
    EXPECT_LT(air_ground_common::rotationAngle(T.linear(), sign > 0 ? felt : Eigen::Matrix3d(felt.transpose())), 1e-6);
    bool from_gyro = false;
    const Eigen::Vector3d in_map = motion.predict(0.4, now, 0.5, &from_gyro).linear() * T.translation();
    EXPECT_LT((in_map - sign * kDelay * (now.translation() - before.translation()) / 0.1).norm(), 1e-9);
  }
  EXPECT_EQ(motion.movedBy(early, now, 0.5, kDelay).translation().norm(), 0) << "that was long ago";
  // A gyro that may be off by more than half a pixel in that time: the last step goes on.
  CameraMotion doubtful = fed(0.1);
  doubtful.update(0.1, before, now);
  const Eigen::Matrix3d step = (before.inverse() * later(before, kDelay)).linear();
  EXPECT_LT(air_ground_common::rotationAngle(doubtful.movedBy(0.4, now, 0.5, kDelay).linear(), step), 1e-5);
  EXPECT_TRUE(fed(0.1).movedBy(early, now, 0.5, kDelay).isApprox(Pose::Identity(), 0)) << "nothing is known";
}

struct Errors {
  double trajectory;        ///< after rigid alignment: root mean square [m]
  double landmarks, cloud;  ///< distance from the true surfaces: root mean square, and 95 % [m]
  int carried;
};

/// A robot that turns at 0.6 rad/s in a room; its depth is 15 ms late.
Errors errors(bool imu, double told_delay, double seconds = 4.5) {
  Robot robot;
  robot.walls = true;
  robot.speed = 0.6;
  robot.tilt.setZero();
  robot.depth_delay = kDelay;
  robot.told_delay = told_delay;
  SlamSettings settings;
  settings.readout_time_stddev = 0;
  robot.mounting.T_base_camera.linear() = Eigen::AngleAxisd(0.6, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                                          air_ground_common::opticalFromForwardBody().transpose();
  if (!imu) robot.mounting.R_base_imu.reset();
  Slam slam(robot.camera, robot.mounting, settings);
  const Drive run = simulated::drive(robot, slam, 0, seconds, imu);
  auto planes = Robot::wallPlanes();
  planes.emplace_back(Eigen::Vector3d::UnitZ(), 0);
  const Pose T_world_map = robot.base(0) * robot.mapped(0).inverse();
  const auto aligned =
      air_ground_common::absoluteTrajectoryError(run.truth, slam.trajectory(), air_ground_common::Alignment::kRigid);
  const auto distance = [&](const Eigen::Vector3d& p_map) {
    double nearest = 1;
    for (const auto& [n, d] : planes)
      nearest = std::min(nearest, std::abs(n.dot(T_world_map * (aligned.reference_from_estimate * p_map)) - d));
    return nearest;
  };
  double squares = 0;
  for (const auto& [id, landmark] : slam.map().landmarks()) squares += std::pow(distance(landmark.position), 2);
  std::vector<double> cloud;
  for (const CloudPoint& p : fusePoints(slam.posedPoints(), settings.cloud))
    cloud.push_back(distance(p.position.cast<double>()));
  EXPECT_EQ(slam.counters().lost_frames, 0);
  return {aligned.rmse, std::sqrt(squares / slam.map().landmarkCount()), air_ground_common::quantile(cloud, 0.95),
          slam.counters().depth_carried};
}

TEST(Slam, DepthThatIsLateMakesTheMapItWouldMakeInTime) {
  for (const bool imu : {true, false}) {
    const Errors untold = errors(imu, 0), told = errors(imu, kDelay), wrong_way = errors(imu, -kDelay);
    EXPECT_GT(told.carried, 20);
    EXPECT_LT(told.trajectory, 0.0008);
    EXPECT_GT(wrong_way.trajectory, 0.0011);
    EXPECT_LT(told.landmarks, untold.landmarks);
    EXPECT_GT(wrong_way.landmarks, untold.landmarks);
    EXPECT_LT(told.cloud, 0.006);
    EXPECT_GT(untold.cloud, 0.008);
    EXPECT_GT(wrong_way.cloud, 0.012);
    EXPECT_EQ(untold.carried, 0);
  }
}

TEST(Slam, TakesDepthAsItIsWhereItsStampCannotBeTrue) {
  const Errors untold = errors(false, 0, 2);
  for (const double told : {0.2, -1e9, std::numeric_limits<double>::quiet_NaN(), 0.0009}) {
    const Errors e = errors(false, told, 2);
    EXPECT_EQ(e.carried, 0);
    EXPECT_EQ(e.trajectory, untold.trajectory);
    EXPECT_EQ(e.cloud, untold.cloud);
  }
}

}  // namespace
}  // namespace rgbd_slam
