// Images that lie far apart, of a fast flight or a slow camera.
#include "dense_fusion/image_spacing.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "air_ground_common/statistics.h"
#include "straight_flight.h"

namespace dense_fusion {
namespace {

using air_ground_common::quantile;
using testing::boxScene;
using testing::lookDown;
using testing::smallCamera;
using testing::smallSettings;

constexpr double kFinest = 0.05;  // [m] between images

Eigen::Isometry3d poseAt(int i) { return lookDown({-1.8 + kFinest * i, 0, 2}, 0.02, 0.01, 0.1); }

/// Rendered once for all tests: 3.6 m at 2 m above the boxes.
const std::vector<cv::Mat>& images() {
  static const std::vector<cv::Mat> rendered = [] {
    std::vector<cv::Mat> result;
    for (int i = 0; i <= 72; ++i) result.push_back(boxScene().render(smallCamera(), poseAt(i), 1, -i * 0.2));
    return result;
  }();
  return rendered;
}

struct Result {
  MapperCounters counters;
  std::vector<DepthMap> depth_maps;
  std::vector<double> depth_errors, point_errors;  ///< absolute [m]
  std::string why_poor;
};

/// Every `step`-th image, all lengths given in a unit of `unit` metres.
Result flyWithEvery(int step, double unit = 1) {
  MapperSettings settings = smallSettings();
  DenseMapper mapper(settings);
  Result result;
  mapper.onDepthMap([&](const DepthMap& map) {
    result.depth_maps.push_back(map);
    Eigen::Isometry3d T = map.T_map_camera;
    T.translation() *= unit / mapper.unit();
    for (int v = 0; v < map.depth.rows; ++v)
      for (int u = 0; u < map.depth.cols; ++u) {
        const Eigen::Vector3d ray = T.linear() * map.camera.unproject(Eigen::Vector2d(u, v)).homogeneous();
        const double d = map.depth.at<float>(v, u) * unit / mapper.unit();
        if (!std::isnan(d)) result.depth_errors.push_back(std::abs(d - boxScene().hit(T.translation(), ray)));
      }
  });
  const auto note = [&](const std::optional<FusedMap>& fused) {
    if (!fused) return;
    for (const SurfacePoint& p : fused->points)
      if (const Eigen::Vector3d q = unit * p.position.cast<double>(); p.normal.z() > 0.9)
        result.point_errors.push_back(std::abs(q.z() - boxScene().heightAt(q.x(), q.y())));
  };
  for (int i = 0; i < static_cast<int>(images().size()); i += step) {
    Eigen::Isometry3d T = poseAt(i);
    T.translation() /= unit;
    if (unit != 1) mapper.followDistance(1.6 / unit);
    note(mapper.add(images()[static_cast<std::size_t>(i)], smallCamera(), std::int64_t{i} * 50000000, T, 1.3 / unit,
                    2.05 / unit));
  }
  result.why_poor = mapper.whyPoor(" m");
  note(mapper.flush());
  result.counters = mapper.counters();
  return result;
}

TEST(ImageSpacing, IsTheMedianOfTheNewest) {
  ImageSpacing spacing;
  EXPECT_EQ(spacing.typical(), 0);
  for (int i = 0; i < 20; ++i) spacing.add(0.1);
  spacing.add(3);  // a gap
  EXPECT_DOUBLE_EQ(spacing.typical(), 0.1);
  for (int i = 0; i < 9; ++i) spacing.add(0.2);
  EXPECT_DOUBLE_EQ(spacing.typical(), 0.2);
  spacing.clear();
  EXPECT_EQ(spacing.typical(), 0);
}

TEST(ImageSpacing, TheReachGrowsOnlyWhereImagesAreFarApart) {
  for (const double spacing : {0.0, 0.02, 0.03, 0.04, 0.047}) {
    EXPECT_EQ(sweepReach(0.12, spacing, 0.3).radius, 0.12) << spacing;
    EXPECT_FALSE(sweepReach(0.12, spacing, 0.3).few) << spacing;
  }
  EXPECT_DOUBLE_EQ(sweepReach(0.12, 0.06, 0.3).radius, 0.21);
  EXPECT_FALSE(sweepReach(0.12, 0.06, 0.3).few);
  EXPECT_DOUBLE_EQ(sweepReach(0.12, 0.1, 0.3).radius, 0.3);
  EXPECT_FALSE(sweepReach(0.12, 0.1, 0.3).few);
  EXPECT_DOUBLE_EQ(sweepReach(0.12, 0.2, 0.3).radius, 0.3);
  EXPECT_TRUE(sweepReach(0.12, 0.2, 0.3).few);
  EXPECT_DOUBLE_EQ(sweepReach(0.12, 0.2, 0).radius, 0.12) << "as set";
  EXPECT_TRUE(sweepReach(0.12, 0.2, 0).few);
}

TEST(ImageSpacing, ImagesFarApartGiveDepthAndPoints) {
  struct Bound {
    int step;
    double depth_median, point_median, point_worst;  // [m]; worst: of 95 %
  };
  for (const Bound& bound : {Bound{1, 0.02, 0.012, 0.06}, Bound{2, 0.02, 0.012, 0.06}, Bound{4, 0.02, 0.015, 0.08}}) {
    const Result r = flyWithEvery(bound.step);
    const double spacing = bound.step * kFinest;
    std::printf(
        "%.2f m apart: %zu depth maps (%zu poor), median %.4f 95%% %.4f m; %zu points, median %.4f 95%% %.4f m\n",
        spacing, r.counters.depth_maps, r.counters.poor_depth_maps, quantile(r.depth_errors, 0.5),
        quantile(r.depth_errors, 0.95), r.point_errors.size(), quantile(r.point_errors, 0.5),
        quantile(r.point_errors, 0.95));
    EXPECT_GE(r.counters.depth_maps, 6u) << spacing;
    EXPECT_LE(r.counters.poor_depth_maps, 2u) << spacing << ": the first, and where the flight ends";
    EXPECT_GE(r.counters.fused, 1u) << spacing;
    EXPECT_LT(quantile(r.depth_errors, 0.5), bound.depth_median) << spacing;
    ASSERT_GT(r.point_errors.size(), 4000u) << spacing;
    EXPECT_LT(quantile(r.point_errors, 0.5), bound.point_median) << spacing;
    EXPECT_LT(quantile(r.point_errors, 0.95), bound.point_worst) << spacing;
  }
}

TEST(ImageSpacing, HoldsInAnyUnit) {
  const Result r = flyWithEvery(2, 0.4);
  EXPECT_LE(r.counters.poor_depth_maps, 2u);
  ASSERT_GT(r.point_errors.size(), 4000u);
  EXPECT_LT(quantile(r.point_errors, 0.5), 0.015);
}

TEST(ImageSpacing, SaysWhenImagesAreTooFarApart) {
  const Result r = flyWithEvery(8);
  EXPECT_EQ(r.counters.depth_maps, 0u);
  EXPECT_EQ(
      r.why_poor,
      "images are 0.4 m apart, of a scene 1.63 m away: too far to tell its depth; fly slower or raise the frame rate");
  EXPECT_EQ(flyWithEvery(1).why_poor, "of a scene 1.63 m away: too little texture or parallax, or poses that are off");
}

// The ordinary flight's images are 0.03 m apart.
TEST(ImageSpacing, NothingChangesWhereImagesAreClose) {
  const auto depthMaps = [](double max_baseline) {
    MapperSettings settings = smallSettings();
    settings.max_baseline = max_baseline;
    DenseMapper mapper(settings);
    std::vector<DepthMap> maps;
    mapper.onDepthMap([&](const DepthMap& map) { maps.push_back(map); });
    testing::fly(&mapper);
    return maps;
  };
  const auto grown = depthMaps(0.15), as_set = depthMaps(0);
  ASSERT_EQ(grown.size(), as_set.size());
  for (std::size_t i = 0; i < grown.size(); ++i) {
    EXPECT_EQ(grown[i].frames, as_set[i].frames) << i;
    EXPECT_TRUE(std::equal(grown[i].depth.begin<float>(), grown[i].depth.end<float>(), as_set[i].depth.begin<float>(),
                           [](float a, float b) { return a == b || (std::isnan(a) && std::isnan(b)); }))
        << i;
  }
}

}  // namespace
}  // namespace dense_fusion
