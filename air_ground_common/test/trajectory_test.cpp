#include "air_ground_common/trajectory.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <stdexcept>

namespace air_ground_common {
namespace {

Trajectory helix() {
  Trajectory trajectory;
  for (int i = 0; i < 200; ++i) {
    const double t = 0.05 * i;
    StampedPose p;
    p.stamp = 100 + t;
    p.T_map_body = yawPose(t, {std::cos(t), std::sin(t), 0.2 * t});
    trajectory.push_back(p);
  }
  return trajectory;
}

Trajectory transformed(const Trajectory& in, const Pose& T, double scale) {
  Trajectory out = in;
  for (auto& p : out) {
    p.T_map_body.linear() = T.linear() * p.T_map_body.linear();
    p.T_map_body.translation() = T * (scale * p.T_map_body.translation());
  }
  return out;
}

TEST(Trajectory, TumFileRoundTrip) {
  const std::string path = testing::TempDir() + "trajectory_test.tum";
  const Trajectory written = helix();
  writeTum(path, written);
  const Trajectory read = readTum(path);
  ASSERT_EQ(read.size(), written.size());
  for (std::size_t i = 0; i < read.size(); ++i) {
    EXPECT_NEAR(read[i].stamp, written[i].stamp, 1e-9);
    EXPECT_LT((read[i].T_map_body.matrix() - written[i].T_map_body.matrix()).norm(), 1e-7);
  }
  std::remove(path.c_str());
}

TEST(Trajectory, AFileSaysWhereItIsNotInMetres) {
  const std::string path = testing::TempDir() + "trajectory_unit_test.tum";
  const auto firstLine = [&path] {
    std::string line;
    std::ifstream file(path);
    std::getline(file, line);
    return line;
  };
  writeTum(path, helix(), "the map's own");
  EXPECT_EQ(firstLine(), "# unit: the map's own");
  EXPECT_EQ(readTum(path).size(), helix().size());
  writeTum(path, helix(), "the map's own");  // each over each
  writeTum(path, helix());
  EXPECT_EQ(firstLine(), "# stamp[s] tx ty tz[m] qx qy qz qw");
  writeTum(path, helix(), "the map's own");
  EXPECT_EQ(firstLine(), "# unit: the map's own");
  std::ofstream(path) << "# a script\n";
  EXPECT_THROW(writeTum(path, helix(), "the map's own"), std::runtime_error);
  std::remove(path.c_str());
}

TEST(Trajectory, BrokenFilesAreNamedWithTheLine) {
  const std::string path = testing::TempDir() + "trajectory_broken.tum";
  const auto messageFor = [&](const std::string& content) -> std::string {
    std::ofstream(path) << content;
    try {
      readTum(path);
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_NE(messageFor("# c\n1 0 0 0 0 0 0 1\n2 0 0\n").find(":3:"), std::string::npos);
  EXPECT_NE(messageFor("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n").find("increase"), std::string::npos);
  EXPECT_NE(messageFor("1 0 0 0 0 0 0 0\n").find("quaternion"), std::string::npos);
  std::remove(path.c_str());
  EXPECT_THROW(readTum(path), std::runtime_error);
}

TEST(Trajectory, AlignmentRecoversTheTransform) {
  const Trajectory reference = helix();
  const Pose T = yawPose(0.7, {1, -2, 3});
  const Trajectory estimate = transformed(reference, T, 1.0);
  for (const auto a : {Alignment::kYawTranslation, Alignment::kRigid, Alignment::kSimilarity})
    EXPECT_LT(absoluteTrajectoryError(reference, estimate, a).rmse, 1e-9);
  EXPECT_GT(absoluteTrajectoryError(reference, estimate, Alignment::kNone).rmse, 1.0);
  const auto error = absoluteTrajectoryError(reference, estimate, Alignment::kRigid);
  EXPECT_LT((error.reference_from_estimate.R - T.linear().transpose()).norm(), 1e-9);
}

TEST(Trajectory, ScaleErrorIsSeenByRigidAndTakenBySimilarity) {
  const Trajectory reference = helix();
  const Trajectory estimate = transformed(reference, Pose::Identity(), 1.1);
  EXPECT_GT(absoluteTrajectoryError(reference, estimate, Alignment::kRigid).rmse, 0.05);
  const auto error = absoluteTrajectoryError(reference, estimate, Alignment::kSimilarity);
  EXPECT_LT(error.rmse, 1e-9);
  EXPECT_NEAR(error.reference_from_estimate.scale, 1 / 1.1, 1e-9);
}

TEST(Trajectory, YawAlignmentDoesNotHideATilt) {
  const Trajectory reference = helix();
  Pose tilt = Pose::Identity();
  tilt.linear() = Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitX()).toRotationMatrix();
  const Trajectory estimate = transformed(reference, tilt, 1.0);
  EXPECT_GT(absoluteTrajectoryError(reference, estimate, Alignment::kYawTranslation).rmse, 0.1);
}

TEST(Trajectory, PoseAtInterpolatesAndRefusesGaps) {
  Trajectory t(2);
  t[1].stamp = 0.4;
  t[1].T_map_body.translation().x() = 1;
  EXPECT_NEAR(poseAt(t, 0.1)->translation().x(), 0.25, 1e-12);
  EXPECT_FALSE(poseAt(t, 0.5));
  EXPECT_FALSE(poseAt(t, 0.1, 0.3));
  EXPECT_NEAR(pathLength(t), 1.0, 1e-12);
}

}  // namespace
}  // namespace air_ground_common
