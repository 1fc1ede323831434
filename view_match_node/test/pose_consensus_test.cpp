// The similarity between two maps from cameras known in both: exact, with noise, with wrong ones, and where nothing
// fixes it.
#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "view_match/pose_consensus.h"

namespace view_match {
namespace {

using air_ground_common::expSO3;
using air_ground_common::Vector6d;

class PoseConsensus : public testing::Test {
 protected:
  std::mt19937 random{7};
  Similarity truth{1.7, expSO3({0.2, -0.1, 2.1}), {3, -4, 0.5}};  // T_a_b
  ScaleKnowledge no_scale;

  void SetUp() override { no_scale.stddev = std::numeric_limits<double>::infinity(); }

  double normal() { return std::normal_distribution<double>()(random); }
  Eigen::Vector3d vector() { return {normal(), normal(), normal()}; }

  /// A camera somewhere in b, recognised in a with errors of so many metres and radians.
  CameraInBoth camera(double sigma, double sigma_angle) {
    CameraInBoth out;
    out.T_b_camera.linear() = expSO3(vector());
    out.T_b_camera.translation() = vector();
    out.T_a_camera.linear() = expSO3(sigma_angle * vector()) * truth.R * out.T_b_camera.linear();
    out.T_a_camera.translation() = truth * out.T_b_camera.translation() + sigma * vector();
    out.scene = out.T_a_camera * Eigen::Vector3d(0, 0, 3);
    out.covariance.setZero();
    out.covariance.diagonal() << Eigen::Vector3d::Constant(sigma * sigma + 1e-12),
        Eigen::Vector3d::Constant(sigma_angle * sigma_angle + 1e-12);
    return out;
  }
  std::vector<CameraInBoth> cameras(int count, double sigma, double sigma_angle) {
    std::vector<CameraInBoth> out;
    for (int i = 0; i < count; ++i) out.push_back(camera(sigma, sigma_angle));
    return out;
  }
  /// Error about the consensus' centre: translation, rotation, relative scale.
  Vector7d errorOf(const Consensus& found) const {
    const Eigen::Vector3d p_b = truth.R.transpose() * (found.centre - truth.t) / truth.scale;
    Vector7d out;
    out << found.T_a_b * p_b - found.centre, air_ground_common::logSO3(found.T_a_b.R * truth.R.transpose()),
        std::log(found.T_a_b.scale / truth.scale);
    return out;
  }
};

TEST_F(PoseConsensus, ExactCamerasGiveTheSimilarity) {
  const Consensus found = consensusOf(cameras(5, 0, 0), no_scale);
  ASSERT_TRUE(found.found) << found.reason;
  EXPECT_EQ(found.agreeing.size(), 5u);
  EXPECT_LT(errorOf(found).norm(), 1e-5);
}

TEST_F(PoseConsensus, AKnownScaleNeedsOneCamera) {
  ScaleKnowledge scale;
  scale.mean = truth.scale;
  const Consensus found = consensusOf(cameras(1, 0, 0), scale);
  ASSERT_TRUE(found.found) << found.reason;
  EXPECT_LT(errorOf(found).norm(), 1e-6);
}

TEST_F(PoseConsensus, CamerasAtOnePlaceTellNoScale) {
  std::vector<CameraInBoth> same(6, camera(0.02, 0.01));
  for (auto& c : same) c.T_a_camera.translation() += 0.01 * vector();
  const Consensus found = consensusOf(same, no_scale);
  EXPECT_FALSE(found.found);
  EXPECT_NE(found.reason.find("scale"), std::string::npos) << found.reason;
}

TEST_F(PoseConsensus, NothingComesOfNoCameras) {
  EXPECT_FALSE(consensusOf({}, no_scale).found);
  EXPECT_FALSE(consensusOf({}, {}).found);
}

TEST_F(PoseConsensus, WrongCamerasAreOutvoted) {
  for (int k = 0; k < 20; ++k) {
    std::vector<CameraInBoth> mixed = cameras(8, 0.02, 0.01);
    for (int i = 0; i < 6; ++i) {
      CameraInBoth wrong = camera(0.02, 0.01);
      wrong.T_a_camera.translation() += 2 * vector();
      wrong.T_a_camera.linear() = expSO3(vector()) * wrong.T_a_camera.linear();
      mixed.insert(mixed.begin() + i, wrong);
    }
    const Consensus found = consensusOf(mixed, no_scale);
    ASSERT_TRUE(found.found) << found.reason;
    EXPECT_LE(found.agreeing.size(), 9u);
    EXPECT_GE(found.agreeing.front(), 5);
    EXPECT_LT(errorOf(found).head<3>().norm(), 0.08);
  }
}

// Normalised errors squared have the mean that seven degrees of freedom give; the bounds are 5 sigma of that mean.
TEST_F(PoseConsensus, ErrorsAreWhatTheCovarianceSays) {
  constexpr int kTrials = 400;
  double sum = 0;
  for (int k = 0; k < kTrials; ++k) {
    const Consensus found = consensusOf(cameras(8, 0.03, 0.01), no_scale);
    ASSERT_TRUE(found.found) << found.reason;
    const Vector7d e = errorOf(found);
    sum += e.dot(found.covariance.ldlt().solve(e));
  }
  const double bound = 5 * std::sqrt(2 * 7.0 / kTrials);
  // max(1, chi^2 per degree of freedom) inflates: by 7 % with 41 degrees of freedom.
  EXPECT_LT(sum / kTrials, 7 + bound);
  EXPECT_GT(sum / kTrials, 7 / 1.12 - bound);
}

}  // namespace
}  // namespace view_match
