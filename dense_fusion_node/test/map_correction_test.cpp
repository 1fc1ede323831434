// What was made of a map follows its corrections, and depth takes its scale from the landmarks.
#include <gtest/gtest.h>

#include <random>

#include "../src/sparse_depth.h"
#include "air_ground_common/followed_clouds.h"
#include "air_ground_common/statistics.h"
#include "straight_flight.h"

namespace dense_fusion {
namespace {

using air_ground_common::PosesByStamp;
using air_ground_common::Similarity;
using testing::boxScene;
using testing::flight;
using testing::flightPose;
using testing::smallCamera;
using testing::smallSettings;

constexpr std::int64_t kStep = 50000000;  // [ns]

/// T_wrong_true of a map before it was corrected.
Similarity wrongMap() { return {1.02, air_ground_common::expSO3({0.01, 0, 0.05}), {0.1, -0.05, 0.03}}; }

Eigen::Isometry3d wrongPose(int i) {
  Eigen::Isometry3d T = flightPose(i);
  T.linear() = wrongMap().R * T.linear();
  T.translation() = wrongMap() * flightPose(i).translation();
  return T;
}

/// Of the images up to `last`.
PosesByStamp truePoses(int last) {
  PosesByStamp poses;
  for (int i = 0; i <= last; ++i) poses[i * kStep + 100] = flightPose(i);  // stamps that were seconds
  return poses;
}

std::optional<FusedMap> add(DenseMapper* mapper, int i, const Eigen::Isometry3d& T) {
  return mapper->add(flight()[static_cast<std::size_t>(i)], smallCamera(), i * kStep, T, 1.3, 2.05);
}

/// Median error in height of what lies level.
double heightError(const std::vector<SurfacePoint>& points) {
  std::vector<double> errors;
  for (const SurfacePoint& p : points)
    if (p.normal.z() > 0.9)
      errors.push_back(std::abs(p.position.z() - boxScene().heightAt(p.position.x(), p.position.y())));
  EXPECT_GT(errors.size(), 1000u);
  return air_ground_common::median(errors);
}

TEST(DenseMapper, FusedMapsFollowACorrection) {
  DenseMapper mapper(smallSettings());
  std::optional<FusedMap> before;
  int i = 0;
  for (; !before; ++i) before = add(&mapper, i, wrongPose(i));
  for (const int end = i + 5; i < end; ++i) ASSERT_FALSE(add(&mapper, i, wrongPose(i)));
  const auto corrections = mapper.correct(truePoses(i - 1));
  ASSERT_EQ(corrections.count(before->depth_map.stamp), 1u);
  const auto S = corrections.at(before->depth_map.stamp);
  ASSERT_TRUE(S);
  EXPECT_NEAR(S->scale, 1 / wrongMap().scale, 5e-4) << "a little less than all of it";
  EXPECT_GT(heightError(before->points), 0.03);
  air_ground_common::moveBy(*S, &before->points);
  EXPECT_LT(heightError(before->points), 0.012);
  EXPECT_EQ(mapper.corrections().at(before->depth_map.stamp)->scale, S->scale);

  // What was begun in the map as it was ends in the map as it is.
  std::optional<FusedMap> after;
  for (; i < static_cast<int>(flight().size()) && !after; ++i) after = add(&mapper, i, flightPose(i));
  if (!after) after = mapper.flush();
  ASSERT_TRUE(after);
  EXPECT_LT(heightError(after->points), 0.012);

  // Another correction comes on top of the first.
  PosesByStamp shifted = truePoses(i - 1);
  for (auto& [stamp, T] : shifted) T.translation().z() += 0.5;
  mapper.correct(shifted);
  const Eigen::Vector3d p(0, 0, 1);
  EXPECT_LT((*mapper.corrections().at(before->depth_map.stamp) * p - (*S * p + Eigen::Vector3d(0, 0, 0.5))).norm(),
            1e-3);
  EXPECT_NEAR((*mapper.corrections().at(after->depth_map.stamp) * p).z(), 1.5, 1e-3);
}

TEST(DenseMapper, ImagesThatWaitedAreWhereTheCorrectionHasThem) {
  DenseMapper mapper(smallSettings());
  mapper.correct(truePoses(static_cast<int>(flight().size()) - 1));
  std::optional<FusedMap> fused;
  for (int i = 0; i < static_cast<int>(flight().size()) && !fused; ++i) fused = add(&mapper, i, wrongPose(i));
  ASSERT_TRUE(fused);
  EXPECT_LT(heightError(fused->points), 0.012);
}

TEST(DenseMapper, WhereTheMapHasBentFusedMapsAreGivenUpForNewerOnes) {
  MapperSettings settings = smallSettings();
  settings.fusion_radius = 0.3;
  settings.sweep_radius = 0.08;
  settings.min_depth_maps = 2;
  DenseMapper mapper(settings);
  std::vector<std::int64_t> stamps;
  int i = 0;
  const auto fly = [&](std::size_t maps) {
    for (; stamps.size() < maps && i < static_cast<int>(flight().size()); ++i)
      if (const auto fused = add(&mapper, i, flightPose(i))) stamps.push_back(fused->depth_map.stamp);
    ASSERT_EQ(stamps.size(), maps);
  };
  fly(1);
  PosesByStamp bent = truePoses(i - 1);
  std::mt19937 rng(1);
  std::normal_distribution<double> noise(0, 0.004);
  for (auto& [stamp, T] : bent) T.translation() += Eigen::Vector3d(noise(rng), noise(rng), noise(rng));
  EXPECT_TRUE(mapper.correct(bent).at(stamps[0])) << "better than none";
  fly(4);
  const auto corrections = mapper.correct(truePoses(i - 1));
  EXPECT_FALSE(corrections.at(stamps[0]));
  EXPECT_TRUE(corrections.at(stamps[3]));
  EXPECT_FALSE(mapper.corrections().at(stamps[0])) << "for good";
}

TEST(DenseMapper, DepthTakesItsScaleFromTheSparsePoints) {
  std::vector<Eigen::Vector3f> landmarks;
  for (int v = 5; v < 160; v += 10)
    for (int u = 5; u < 240; u += 10) {
      const Eigen::Isometry3d T = flightPose(10);
      const Eigen::Vector3d ray = T.linear() * smallCamera().unproject(Eigen::Vector2d(u, v)).homogeneous();
      landmarks.push_back((T.translation() + boxScene().hit(T.translation(), ray) * ray).cast<float>());
    }
  const auto error = [&](bool sparse) {
    DenseMapper mapper(smallSettings());
    if (sparse) mapper.setSparsePoints(landmarks);
    std::vector<double> ratios;
    mapper.onDepthMap([&](const DepthMap& map) {
      const int i = static_cast<int>(map.stamp / kStep);
      for (int v = 0; v < map.depth.rows; v += 4)
        for (int u = 0; u < map.depth.cols; u += 4) {
          const Eigen::Vector3d ray =
              flightPose(i).linear() * map.camera.unproject(Eigen::Vector2d(u, v)).homogeneous();
          if (const float d = map.depth.at<float>(v, u); !std::isnan(d))
            ratios.push_back(d / boxScene().hit(flightPose(i).translation(), ray));
        }
    });
    for (int i = 5; i < 16; ++i) {
      // The camera has flown less far than the odometry thinks, all around image 10.
      Eigen::Isometry3d T = flightPose(i);
      T.translation() = flightPose(10).translation() + 1.03 * (T.translation() - flightPose(10).translation());
      add(&mapper, i, T);
    }
    mapper.flush();
    EXPECT_GT(ratios.size(), 1000u);
    return air_ground_common::median(ratios) - 1;
  };
  EXPECT_NEAR(error(false), 0.03, 0.005);
  EXPECT_LT(std::abs(error(true)), 0.006);
}

class SparseDepth : public ::testing::Test {
 protected:
  SparseDepth() {
    map.camera = smallCamera();
    map.T_map_camera = flightPose(3);
    map.depth = cv::Mat(map.camera.height, map.camera.width, CV_32F, cv::Scalar(2));
  }

  void addPoints(int count, double depth, double noise) {
    std::uniform_real_distribution<double> u(1, map.camera.width - 2), v(1, map.camera.height - 2);
    std::normal_distribution<double> error(0, noise);
    for (int i = 0; i < count; ++i) {
      const Eigen::Vector2d pixel(u(rng), v(rng));
      points.push_back(
          (map.T_map_camera * (depth * (1 + error(rng)) * map.camera.unproject(pixel).homogeneous())).cast<float>());
    }
  }

  DepthMap map;
  std::mt19937 rng{7};
  std::vector<Eigen::Vector3f> points;
};

TEST_F(SparseDepth, IsTheRatioOfWhatLiesOnTheSurface) {
  addPoints(200, 2 * 0.985, 0.01);
  addPoints(60, 2 * 1.06, 0.01);  // behind it, just so
  addPoints(60, 3.5, 0.01);       // far behind
  addPoints(20, -1, 0);
  const auto ratio = sparseDepthRatio(map, points);
  ASSERT_TRUE(ratio);
  EXPECT_NEAR(*ratio, 0.985, 0.003);
}

TEST_F(SparseDepth, FewPointsOrNoisyOnesTellNothing) {
  addPoints(29, 2, 0.001);
  EXPECT_FALSE(sparseDepthRatio(map, points));
  addPoints(1, 2, 0.001);
  EXPECT_TRUE(sparseDepthRatio(map, points));
  points.clear();
  addPoints(40, 2, 0.03);
  EXPECT_FALSE(sparseDepthRatio(map, points));
  map.depth = std::numeric_limits<float>::quiet_NaN();
  addPoints(200, 2, 0.001);
  EXPECT_FALSE(sparseDepthRatio(map, points));
}

// Ten times as far: what was made from on high is judged by the lengths of then, wherever the camera is by now.
TEST(DenseMapper, ALandingKeepsWhatWasMadeAtAltitude) {
  static constexpr double kFactor = 10;
  MapperSettings s = smallSettings();
  s.fusion_radius = 0.3;
  s.sweep_radius = 0.08;
  s.min_depth_maps = 2;
  DenseMapper mapper(s);
  const auto pose = [](std::size_t i) {
    Eigen::Isometry3d T = flightPose(static_cast<int>(i));
    T.translation() *= kFactor;
    return T;
  };
  int clouds = 0;
  for (std::size_t i = 0; i < flight().size(); ++i) {
    clouds += mapper.followMetricDistance(std::sqrt(1.3 * 2.05) * kFactor).has_value();
    clouds += mapper
                  .add(flight()[i], smallCamera(), static_cast<std::int64_t>(i) * kStep, pose(i), 1.3 * kFactor,
                       2.05 * kFactor)
                  .has_value();
  }
  clouds += mapper.followMetricDistance(2.0).has_value();
  ASSERT_GE(clouds, 4);
  PosesByStamp now;
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 0.004);
  for (std::size_t i = 0; i < flight().size(); ++i) {
    Eigen::Isometry3d& T = now[static_cast<std::int64_t>(i) * kStep] = pose(i);
    T.translation() += Eigen::Vector3d(normal(random), normal(random), normal(random));
  }
  for (const auto& [stamp, S] : mapper.correct(now)) EXPECT_TRUE(S) << stamp;
  EXPECT_EQ(mapper.counters().given_up, 0u);
}

}  // namespace
}  // namespace dense_fusion
