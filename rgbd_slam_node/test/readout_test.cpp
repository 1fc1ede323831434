#include "rgbd_slam/readout_estimator.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>

#include "simulated_robot.h"
#include "visual_frontend/self_calibration.h"

namespace rgbd_slam {
namespace {

using simulated::Drive;
using simulated::drive;
using simulated::Robot;
using simulated::worst;
using simulated::worstTurn;
using visual_frontend::synthetic::Random;

/// A camera that swings and walks among points in space, and what a rolling shutter of it sees of them.
struct Recording {
  double readout_time = 0.02;  ///< [s]
  double focal = 1;            ///< the camera's over what its calibration says
  double centre = 0;           ///< principal point, normalised
  double radial = 0;           ///< k1
  double ray_noise = 0.3 / 525, depth_noise = 0.004;
  bool pose_known = true;  ///< else it is off, as a map's is

  Pose camera(double t) const {
    Pose T = Pose::Identity();
    T.linear() = air_ground_common::expSO3({0.2 * std::sin(1.1 * t), 0.5 * std::sin(0.9 * t), 0.1 * std::sin(1.7 * t)});
    T.translation() = Eigen::Vector3d(0.4 * std::sin(0.6 * t), 0.1 * std::sin(1.3 * t), 0.3 * std::sin(0.5 * t));
    return T;
  }

  std::vector<RowPoint> see(const std::vector<Eigen::Vector3d>& points, double t, Random& random) const {
    std::vector<RowPoint> seen;
    for (std::size_t i = 0; i < points.size(); ++i) {
      double row = 0;
      Eigen::Vector3d p = Eigen::Vector3d::Zero();
      Eigen::Vector2d ray = Eigen::Vector2d::Zero();
      for (int round = 0; round < 5; ++round) {  // the row decides when, and that where
        p = camera(t + row * readout_time).inverse() * points[i];
        const Eigen::Vector2d x = p.hnormalized();
        ray = focal * (1 + radial * x.squaredNorm()) * x + Eigen::Vector2d::Constant(centre);
        row = ray.y() / 0.9;
      }
      if (p.z() < 0.5 || std::abs(row) > 0.5 || std::abs(ray.x()) > 0.6) continue;
      ray += Eigen::Vector2d(random.gauss(ray_noise), random.gauss(ray_noise));
      const double z = p.z() + random.gauss(depth_noise);
      seen.push_back({static_cast<visual_frontend::TrackId>(i), z * ray.homogeneous(), depth_noise, row});
    }
    return seen;
  }

  /// After so many seconds of 15 images each.
  ReadoutEstimator run(double seconds, double given = 0) const {
    Random random(3);
    std::vector<Eigen::Vector3d> points;
    for (int i = 0; i < 400; ++i)
      points.emplace_back(random.uniform(-3, 3), random.uniform(-2, 2), random.uniform(1.5, 5));
    ReadoutEstimator estimator(given, 0.02, 0.7 / 525);
    for (double t = 0; t < seconds; t += 1.0 / 15) {
      Pose T = camera(t);
      if (!pose_known) T = T * Pose(air_ground_common::expSO3(random.gaussVector(0.001)));
      estimator.add(t, T, see(points, t, random));
    }
    return estimator;
  }
};

TEST(ReadoutEstimator, FindsWhatRowsAreLate) {
  for (const double truth : {0.0, 0.02, 0.033, -0.015}) {
    Recording recording;
    recording.readout_time = truth;
    const ReadoutEstimator estimator = recording.run(10);
    EXPECT_NEAR(estimator.readoutTime(), truth, 1e-3);
    EXPECT_LT(estimator.stddev(), 2e-3);
    recording.pose_known = false;
    EXPECT_NEAR(recording.run(10).readoutTime(), truth, 2e-3);
  }
}

TEST(ReadoutEstimator, ACalibrationThatIsOffIsNoRollingShutter) {
  for (const double truth : {0.0, 0.02}) {
    for (int wrong = 0; wrong < 3; ++wrong) {
      Recording recording;
      recording.readout_time = truth;
      if (wrong == 0) recording.focal = 1.02;
      if (wrong == 1) recording.centre = 0.015;
      if (wrong == 2) recording.radial = 0.05;
      EXPECT_NEAR(recording.run(10).readoutTime(), truth, 2e-3) << wrong;
    }
  }
}

TEST(ReadoutEstimator, KnowsWhatItDoesNotKnow) {
  Recording recording;
  EXPECT_EQ(recording.run(0.05).stddev(), 0.02);
  const ReadoutEstimator one_second = recording.run(1), ten = recording.run(10);
  EXPECT_GT(one_second.stddev(), 2 * ten.stddev());
  ReadoutEstimator doubted = ten;
  doubted.distrust();
  EXPECT_GT(doubted.stddev(), ten.stddev());
  doubted.reset();
  EXPECT_EQ(doubted.readoutTime(), 0);
  EXPECT_EQ(doubted.stddev(), 0.02);
  EXPECT_DOUBLE_EQ(recording.run(0.05, 0.03).readoutTime(), 0.03);
  EXPECT_THROW(ReadoutEstimator(0, 0, 1e-3), std::invalid_argument);
  EXPECT_THROW(ReadoutEstimator(0, 0.02, 0), std::invalid_argument);
  EXPECT_THROW(ReadoutEstimator(NAN, 0.02, 1e-3), std::invalid_argument);
}

TEST(ReadoutEstimator, TakesNoMotionAcrossAGap) {
  // The camera is somewhere else after each: no two images may be taken for one motion.
  const Recording recording;
  Random random(3);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 400; ++i)
    points.emplace_back(random.uniform(-3, 3), random.uniform(-2, 2), random.uniform(1.5, 5));
  ReadoutEstimator gaps(0, 0.02, 0.7 / 525), told(0, 0.02, 0.7 / 525);
  for (int i = 0; i < 40; ++i) {
    const double t = 0.5 * i;
    EXPECT_FALSE(gaps.add(t, recording.camera(t), recording.see(points, t, random)));
    told.interrupt();
    EXPECT_FALSE(told.add(0.1 * i, recording.camera(0.1 * i), recording.see(points, 0.1 * i, random)));
  }
  EXPECT_EQ(gaps.readoutTime(), 0);
  EXPECT_EQ(told.readoutTime(), 0);
}

TEST(Slam, RollingShutter) {
  Robot robot;
  robot.readout_time = 0.03;
  robot.sway = 0.05;
  robot.sway_rate = 2.5;
  robot.tilt.setZero();
  robot.speed = 0.6;
  SlamSettings told, not_estimated;
  told.readout_time = robot.readout_time;
  not_estimated.readout_time_stddev = 0;
  Slam corrected(robot.camera, robot.mounting, told), untold(robot.camera, robot.mounting, not_estimated);
  const Drive with = drive(robot, corrected, 0, 4), without = drive(robot, untold, 0, 4);
  EXPECT_EQ(corrected.counters().lost_frames, 0);
  EXPECT_LT(worst(with, corrected.trajectory()), 0.5 * worst(without, untold.trajectory()));
  EXPECT_LT(worstTurn(robot, with, 1.5), 0.012);
}

TEST(Slam, FindsTheReadoutTimeAndPutsTheMapRight) {
  Robot robot;
  robot.readout_time = 0.03;
  robot.sway = 0.15;
  robot.sway_rate = 2;
  robot.floor = 18;
  SlamSettings not_estimated;
  not_estimated.readout_time_stddev = 0;
  Slam slam(robot.camera, robot.mounting, {}), without(robot.camera, robot.mounting, not_estimated);
  const Drive run = drive(robot, slam, 0, 16), run_without = drive(robot, without, 0, 16);
  EXPECT_NEAR(slam.readoutTime(), 0.03, 0.004);
  EXPECT_EQ(without.readoutTime(), 0);
  EXPECT_EQ(slam.counters().maps, 1);
  EXPECT_EQ(slam.counters().lost_frames, 0);
  ASSERT_EQ(slam.camera().k1, robot.camera.k1);
  const auto of_keyframes = [](const SlamResult& r) { return r.recalibrated; };
  EXPECT_TRUE(std::any_of(run.results.begin(), run.results.end(), of_keyframes)) << "what they saw lies elsewhere";
  // Poses of before it was known, too.
  EXPECT_LT(worst(run, slam.trajectory()), 0.5 * worst(run_without, without.trajectory()));
  // The floor is flat.
  const auto thickness = [](const Slam& of) {
    const std::vector<CloudPoint> cloud = fusePoints(of.posedPoints(), {});
    Eigen::MatrixXd points(cloud.size(), 3);
    for (std::size_t i = 0; i < cloud.size(); ++i) points.row(i) = cloud[i].position.cast<double>().transpose();
    const Eigen::MatrixXd centred = points.rowwise() - points.colwise().mean();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> plane(centred.transpose() * centred / points.rows());
    return std::sqrt(plane.eigenvalues()(0));
  };
  EXPECT_LT(thickness(slam), 0.7 * thickness(without));
  slam.reset();
  EXPECT_EQ(slam.readoutTime(), 0);

  Robot global;
  Slam straight(global.camera, global.mounting, {});
  drive(global, straight, 0, 12);
  EXPECT_EQ(straight.readoutTime(), 0);
  EXPECT_GT(straight.readoutTimeStddev(), 0);
}

// k1 of the colour camera is 0.06 less than its calibration says.
TEST(Slam, FindsThatTheCalibrationIsOff) {
  Robot robot;
  robot.sway = 0.15;
  robot.sway_rate = 2;
  robot.floor = 18;
  const CameraModel told = visual_frontend::withRadial(robot.camera, 0.06);
  SlamSettings believing;
  believing.radial_stddev = 0;
  Slam slam(told, robot.mounting, {}), believer(told, robot.mounting, believing);
  const Drive found = drive(robot, slam, 0, 16), believed = drive(robot, believer, 0, 16);
  std::printf("k1 off by %.4f instead of 0.06; worst pose %.4f m instead of %.4f m\n",
              slam.camera().k1 - robot.camera.k1, worst(found, slam.trajectory()),
              worst(believed, believer.trajectory()));
  EXPECT_EQ(believer.camera().k1, told.k1);
  EXPECT_NEAR(slam.camera().k1, robot.camera.k1, 0.015);
  EXPECT_LT(worst(found, slam.trajectory()), 0.6 * worst(believed, believer.trajectory()));
  slam.reset();
  EXPECT_EQ(slam.camera().k1, told.k1);
  // A recording that begins again, as it did the first time: dense points lie where their pixels are by what is told.
  drive(robot, slam, 0, 0.2);
  double off = 0;
  const auto posed = slam.posedPoints();
  for (const auto& point : *posed.at(0).points) {
    const Eigen::Vector2d pixel = *told.project(point.position.cast<double>());
    off = std::max(off, (pixel - pixel.array().round().matrix()).norm());
  }
  EXPECT_LT(off, 0.05);

  Slam right(robot.camera, robot.mounting, {});
  drive(robot, right, 0, 16);
  EXPECT_EQ(right.camera().k1, robot.camera.k1);
}

}  // namespace
}  // namespace rgbd_slam
