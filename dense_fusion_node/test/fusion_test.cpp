#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <opencv2/core.hpp>
#include <random>

#include "air_ground_common/statistics.h"
#include "dense_fusion/depth_fusion.h"
#include "dense_fusion/distance_field.h"
#include "dense_fusion/fusion_kernels.h"
#include "synthetic_scene.h"

namespace dense_fusion {
namespace {

using testing::boxScene;
using testing::lookDown;
using testing::Scene;

DepthMap exactDepth(const Scene& scene, const Eigen::Isometry3d& T, int width = 188, int height = 120) {
  DepthMap map;
  map.camera.width = width;
  map.camera.height = height;
  map.camera.fx = map.camera.fy = 0.55 * width;
  map.camera.cx = 0.5 * (width - 1);
  map.camera.cy = 0.5 * (height - 1);
  map.T_map_camera = T;
  map.intensity = scene.render(map.camera, T, 1, 0, &map.depth);
  map.confidence = cv::Mat::ones(height, width, CV_32F);
  map.frames = 10;
  return map;
}

TEST(DistanceField, PositiveInFreeSpaceAndUnknownBehind) {
  const DepthMap map = exactDepth(Scene{}, lookDown({0, 0, 2}));
  const VoteBand band{0.06, 0.1};
  EXPECT_FLOAT_EQ(distanceAt(map, {0, 0, 1}, band), 1.f);
  EXPECT_NEAR(distanceAt(map, {0.2, 0.1, 0.03}, band), 0.5, 0.01);
  EXPECT_NEAR(distanceAt(map, {0, 0, 0}, band), 0.0, 0.01);
  EXPECT_NEAR(distanceAt(map, {0, 0, -0.03}, band), -0.5, 0.01);
  EXPECT_FLOAT_EQ(distanceAt(map, {0, 0, -0.15}, band), -1.f);
  EXPECT_TRUE(std::isnan(distanceAt(map, {0, 0, -0.17}, band)));
  EXPECT_TRUE(std::isnan(distanceAt(map, {9, 0, 0}, band)));
  EXPECT_TRUE(std::isnan(distanceAt(map, {0, 0, 3}, band)));
}

TEST(DistanceField, FastVotesMatchTheReference) {
  DepthMap map = exactDepth(boxScene(), lookDown({0.1, -0.05, 2.1}, 0.1, -0.08, 0.7));
  map.depth(cv::Rect(20, 20, 30, 15)).setTo(std::numeric_limits<float>::quiet_NaN());
  const VoxelGrid grid = fitGrid({-1.5, -1, -0.1}, {1.5, 1, 1}, 0.04, 1000000);
  Histograms<std::uint8_t> fast, plain;
  fast.resize(grid.nx, grid.ny, grid.nz);
  plain.resize(grid.nx, grid.ny, grid.nz);
  addVotes(map, grid, {0.16, 0.3}, 2, &fast);
  addVotesReference(map, grid, {0.16, 0.3}, &plain);
  std::size_t differ = 0, total = 0;
  for (std::size_t i = 0; i < fast.counts.size(); ++i) {
    differ += fast.counts[i] != plain.counts[i];
    total += plain.counts[i];
  }
  EXPECT_GT(total, grid.voxels() / 3);
  // Rounding at the edge of a pixel or a bin may go either way.
  EXPECT_LT(differ, total / 1000);
}

TEST(DistanceField, CountsSaturate) {
  std::vector<std::uint8_t> bin = {0, 7, 255, 3}, counts(4 * kBins, 0);
  counts[0] = 255;
  kernels::countRow(bin.data(), 4, counts.data(), 4);
  EXPECT_EQ(counts[0], 255);
  EXPECT_EQ(counts[7 * 4 + 1], 1);
  EXPECT_EQ(counts[3 * 4 + 3], 1);
  EXPECT_EQ(std::accumulate(counts.begin() + 1, counts.end(), 0), 2);
}

TEST(SurfaceKernels, RowsAreThoseOfPlainLoops) {
  std::mt19937 random(9);
  for (const int n : {1, 7, 64, 150}) {
    std::vector<std::uint8_t> counts(n * kBins), support(n), changes(n);
    for (auto& c : counts) c = static_cast<std::uint8_t>(random() % 60);
    kernels::supportRow(counts.data(), n, n, support.data());
    std::vector<float> u(n), y(n), z(n);
    for (auto* row : {&u, &y, &z})
      for (float& value : *row) value = 0.5f * static_cast<float>(static_cast<int>(random() % 5) - 2);  // zeros, too
    std::vector<float> least = y;
    kernels::signChanges(u.data(), y.data(), z.data(), n, changes.data());
    kernels::lowerTo(u.data(), n, least.data());
    for (int x = 0; x < n; ++x) {
      int sum = 0;
      for (int k = 1; k + 1 < kBins; ++k) sum += counts[k * n + x];
      ASSERT_EQ(support[x], std::min(sum, 255));
      const bool here = u[x] > 0;
      ASSERT_EQ(changes[x] & 1, x + 1 < n && here != (u[x + 1] > 0)) << x;
      ASSERT_EQ(changes[x] >> 1 & 1, here != (y[x] > 0)) << x;
      ASSERT_EQ(changes[x] >> 2, here != (z[x] > 0)) << x;
      ASSERT_EQ(least[x], std::min(y[x], u[x]));
    }
  }
}

TEST(VoxelGrid, GrowsVoxelsToStayWithinTheBound) {
  const VoxelGrid grid = fitGrid({0, 0, 0}, {10, 10, 2}, 0.01, 2000000);
  EXPECT_LE(grid.voxels(), 2000000u);
  EXPECT_GT(grid.voxels(), 1000000u);
  EXPECT_GE(grid.center(grid.nx - 1, grid.ny - 1, grid.nz - 1).x(), 10.0);
  EXPECT_DOUBLE_EQ(fitGrid({0, 0, 0}, {1, 1, 1}, 0.02, 2000000).voxel_size, 0.02);
  EXPECT_THROW(fitGrid({0, 0, 0}, {0, 1, 1}, 0.02, 2000000), std::invalid_argument);
}

// Field of an analytic shape: phi = clamp(distance / truncation).
template <typename Distance>
Field<float> analyticField(const VoxelGrid& grid, double truncation, Distance distance) {
  Field<float> phi(grid.voxels());
  for (int z = 0; z < grid.nz; ++z)
    for (int y = 0; y < grid.ny; ++y)
      for (int x = 0; x < grid.nx; ++x)
        phi[grid.index(x, y, z)] =
            static_cast<float>(std::clamp(distance(grid.center(x, y, z)) / truncation, -1.0, 1.0));
  return phi;
}

TEST(RayCasting, SphereAndPlaneAreHitWhereTheyAre) {
  const VoxelGrid grid = fitGrid({-1, -1, -0.2}, {1, 1, 1}, 0.02, 10000000);
  const Eigen::Vector3d centre(0.1, -0.05, 0.2);
  const double radius = 0.5;
  const auto phi = analyticField(
      grid, 0.08, [&](const Eigen::Vector3d& p) { return std::min((p - centre).norm() - radius, p.z()); });
  const Field<std::uint8_t> support(grid.voxels(), 2);
  const SurfaceField field{grid, phi, support, 2};
  const DepthMap view = exactDepth(Scene{}, lookDown({0.2, 0.1, 2}, 0.15, -0.1, 0.5));
  cv::Mat normals;
  const cv::Mat depth = castRays(field, view.camera, view.T_map_camera, 2, &normals);
  int hits = 0;
  double worst_depth = 0, worst_normal = 0;
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) {
      const float z = depth.at<float>(v, u);
      if (std::isnan(z)) continue;
      const Eigen::Vector3d p = view.T_map_camera * (z * Eigen::Vector3d((u - view.camera.cx) / view.camera.fx,
                                                                         (v - view.camera.cy) / view.camera.fy, 1));
      const double to_sphere = (p - centre).norm() - radius;
      const cv::Vec3f n = normals.at<cv::Vec3f>(v, u);
      worst_depth = std::max(worst_depth, std::min(std::abs(to_sphere), std::abs(p.z())));
      if (to_sphere < p.z() - 0.05) {
        const double along = Eigen::Vector3d(n[0], n[1], n[2]).dot((p - centre).normalized());
        worst_normal = std::max(worst_normal, std::acos(std::min(1.0, along)));
        ++hits;
      }
    }
  EXPECT_GT(hits, 1000);
  EXPECT_LT(worst_depth, 0.005);
  EXPECT_LT(worst_normal, 0.1);

  const auto points = extractSurface(field, 2);
  EXPECT_GT(points.size(), 8000u);
  for (const SurfacePoint& point : points) {
    const Eigen::Vector3d p = point.position.cast<double>();
    ASSERT_LT(std::min(std::abs((p - centre).norm() - radius), std::abs(p.z())), 0.005);
  }
}

TEST(RayCasting, UnsupportedSurfacesAreNotReported) {
  const VoxelGrid grid = fitGrid({-1, -1, -0.2}, {1, 1, 0.4}, 0.04, 1000000);
  const auto phi = analyticField(grid, 0.16, [](const Eigen::Vector3d& p) { return p.z(); });
  const Field<std::uint8_t> support(grid.voxels(), 1);
  const SurfaceField field{grid, phi, support, 2};
  const DepthMap view = exactDepth(Scene{}, lookDown({0, 0, 2}));
  EXPECT_EQ(cv::countNonZero(castRays(field, view.camera, view.T_map_camera, 2) > 0), 0);
  EXPECT_TRUE(extractSurface(field, 2).empty());
}

// Three flat maps above one another's place: what they say about a point can be counted by hand.
TEST(DepthMapViews, PointsNeedMapsThatAgree) {
  std::vector<DepthMap> maps;
  for (const float z : {2.f, 2.01f, 2.07f}) {
    DepthMap map = exactDepth(Scene{}, lookDown({0, 0, 2}));
    map.depth.setTo(z);
    map.confidence.setTo(1);
    map.intensity.setTo(40 + 10 * static_cast<int>(maps.size()));
    maps.push_back(std::move(map));
  }
  const DepthMapViews views(maps, 1, {0.08, 0.06, 0.02, 0.02});
  const auto opinion = views.ask({0.1f, 0.1f, 0.f});  // depth 2 m
  EXPECT_EQ(opinion.voices, 3);
  EXPECT_EQ(opinion.agreeing, 2);
  EXPECT_EQ(opinion.seen_past, 0);
  EXPECT_EQ(opinion.intensity, 50);  // of map 1, where the count begins
  // Residuals 0, 0.01 and 0.07 m; the last is beyond the radius, the others weigh 1 and (1 - 1/36)^2.
  const double weight = std::pow(1 - 1.0 / 36, 2);
  EXPECT_NEAR(opinion.shift, 0.01 * weight / (1 + weight), 1e-5);
  EXPECT_NEAR(opinion.deviation, 1.2533 * 0.005 * std::sqrt(2), 1e-4);

  const auto floating = views.ask({0.1f, 0.1f, 0.1f});
  EXPECT_EQ(floating.voices, 0);
  EXPECT_EQ(floating.seen_past, 3);
  EXPECT_EQ(views.ask({9.f, 0.f, 0.f}).voices, 0);
  EXPECT_EQ(views.ask({0.f, 0.f, 3.f}).seen_past, 0) << "behind the cameras";
}

// A nearer surface spills over its edge in the images: in each map by another way, so that no two maps agree there.
TEST(DepthFusion, WhatNoSecondMapAgreesWithIsDropped) {
  std::vector<DepthMap> maps;
  for (int i = 0; i < 5; ++i) {
    DepthMap map = exactDepth(Scene{}, lookDown({0.05 * i, 0, 2}));
    // A stripe of the floor that map i believes 5 + i * 2 cm too near: all within the truncation of 8 cm of each other.
    for (int v = 0; v < map.depth.rows; ++v)
      for (int u = 0; u < map.depth.cols; ++u) {
        const double x = (map.T_map_camera *
                          (map.depth.at<float>(v, u) * map.camera.unproject({double(u), double(v)}).homogeneous()))
                             .x();
        if (x > 0.2 && x < 0.5) map.depth.at<float>(v, u) -= 0.05f + 0.045f * static_cast<float>(i);
      }
    maps.push_back(std::move(map));
  }
  FusionSettings settings;
  const auto wrong = [&](const FusionSettings& s) {
    const auto fused = fuseDepthMaps(maps, 2, s);
    std::size_t count = 0;
    for (const SurfacePoint& p : fused->points) count += std::abs(p.position.z()) > 0.03;
    return std::make_pair(count, fused->points.size());
  };
  const auto strict = wrong(settings);
  settings.min_agreeing = 0;
  const auto all = wrong(settings);
  EXPECT_GT(all.first, 500u);
  EXPECT_LT(strict.first, all.first / 10);
  EXPECT_GT(strict.second, (all.second - all.first) * 9 / 10) << "the floor beside the stripe stays";
}

// Depth maps of a flight over the boxes with noise and a share of gross outliers.
std::vector<DepthMap> noisyMaps(const Scene& scene, int count, double sigma, double outliers, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> noise(0, 1);
  std::uniform_real_distribution<float> uniform(0, 1);
  std::vector<DepthMap> maps;
  for (int i = 0; i < count; ++i) {
    DepthMap map = exactDepth(
        scene, lookDown({0.12 * (i - count / 2), 0.03 * i, 2}, 0.02 * i, -0.01 * i, 0.3 + 0.01 * i), 376, 240);
    for (int v = 0; v < map.depth.rows; ++v)
      for (int u = 0; u < map.depth.cols; ++u) {
        float& z = map.depth.at<float>(v, u);
        z += static_cast<float>(sigma) * noise(random);
        if (uniform(random) < outliers) z = 0.9f + 1.7f * uniform(random);
      }
    maps.push_back(std::move(map));
  }
  return maps;
}

// From high above, depths scatter by more than a voxel: that is no disagreement.
TEST(DepthFusion, NoiseIsNoDisagreement) {
  const auto maps = noisyMaps(Scene{}, 5, 0.03, 0, 9);
  FusionSettings settings;
  settings.agreement = 0.3;  // 6 mm
  const auto strict = fuseDepthMaps(maps, 2, settings);
  settings.min_agreeing = 0;
  const auto all = fuseDepthMaps(maps, 2, settings);
  ASSERT_TRUE(strict && all);
  EXPECT_GT(strict->points.size(), all->points.size() * 8 / 10);
}

TEST(DepthFusion, RejectsTwelvePercentOutliers) {
  const Scene scene = boxScene();
  const auto maps = noisyMaps(scene, 7, 0.015, 0.12, 11);
  FusionSettings settings;
  const auto fused = fuseDepthMaps(maps, 3, settings);
  ASSERT_TRUE(fused);
  std::vector<double> errors;
  cv::Mat truth;
  scene.render(maps[3].camera, maps[3].T_map_camera, 1, 0, &truth);
  std::size_t gross = 0, valid = 0;
  for (int v = 0; v < truth.rows; ++v)
    for (int u = 0; u < truth.cols; ++u) {
      const float z = fused->depth_map.depth.at<float>(v, u);
      if (std::isnan(z)) {
        ASSERT_EQ(fused->depth_map.confidence.at<float>(v, u), 0);
        continue;
      }
      errors.push_back(std::abs(z - truth.at<float>(v, u)));
      ++valid;
      gross += errors.back() > 0.10;
    }
  std::sort(errors.begin(), errors.end());
  std::printf(
      "fused: valid %.2f median %.4f p95 %.4f m, gross %.2f %%, grid %dx%dx%d, %zu points, %.0f + %.0f + %.0f ms\n",
      double(valid) / truth.total(), errors[errors.size() / 2], errors[errors.size() * 95 / 100], 100.0 * gross / valid,
      fused->grid.nx, fused->grid.ny, fused->grid.nz, fused->points.size(), 1e3 * fused->timings.votes,
      1e3 * fused->timings.minimisation, 1e3 * fused->timings.surface);
  EXPECT_GT(double(valid) / truth.total(), 0.9);
  EXPECT_LT(errors[errors.size() / 2], 0.006);
  EXPECT_LT(errors[errors.size() * 95 / 100], 0.03);
  EXPECT_LT(double(gross) / valid, 0.02);  // 12 % went in; what is left lies at the boxes' edges
  // Seen from above, the whole cloud lies on the scene's surfaces: heights of points away from box edges.
  std::size_t floating = 0;
  for (const SurfacePoint& p : fused->points) {
    bool near_surface = std::abs(p.position.z() - scene.heightAt(p.position.x(), p.position.y())) < 0.05;
    for (const testing::Box& b : scene.boxes) {
      const Eigen::Array3d q = p.position.cast<double>();
      near_surface = near_surface || ((q > b.lower.array() - 0.05).all() && (q < b.upper.array() + 0.05).all());
    }
    floating += !near_surface;
  }
  EXPECT_LT(double(floating) / fused->points.size(), 0.01);
}

TEST(DepthFusion, ThreadsDoNotChangeTheResult) {
  const auto maps = noisyMaps(boxScene(), 3, 0.01, 0.05, 4);
  FusionSettings one, three;
  one.threads = 1;
  three.threads = 3;
  one.voxel_size = three.voxel_size = 0.03;
  const auto a = fuseDepthMaps(maps, 0, one), b = fuseDepthMaps(maps, 0, three);
  ASSERT_TRUE(a && b);
  ASSERT_EQ(a->points.size(), b->points.size());
  for (std::size_t i = 0; i < a->points.size(); ++i) ASSERT_EQ(a->points[i].position, b->points[i].position);
}

// Points every 5 cm of x and y, at heights that alternate between the ends of the box.
std::vector<Eigen::Vector3f> pointsIn(const Eigen::Vector3f& lower, const Eigen::Vector3f& upper) {
  std::vector<Eigen::Vector3f> points;
  for (float x = lower.x(); x <= upper.x(); x += 0.05f)
    for (float y = lower.y(); y <= upper.y(); y += 0.05f)
      points.push_back({x, y, points.size() % 2 ? upper.z() : lower.z()});
  return points;
}

TEST(DepthFusion, SparsePointsInViewBoundTheGrid) {
  const auto maps = noisyMaps(boxScene(), 3, 0.01, 0.05, 4);
  FusionSettings settings;
  settings.sparse_margin = 0.1;
  const double band = (settings.truncation_voxels + 1) * settings.voxel_size, slack = 0.03;
  const auto whole = gridFor(maps, settings, {});
  auto points = pointsIn({-0.3f, -0.2f, 0.f}, {0.4f, 0.3f, 0.3f});
  const auto cut = gridFor(maps, settings, points);
  ASSERT_TRUE(whole && cut);
  const auto upperEnd = [](const VoxelGrid& g) { return g.center(g.nx - 1, g.ny - 1, g.nz - 1); };
  const Eigen::Vector3d expected_lower = Eigen::Vector3d(-0.4, -0.3, -0.1).array() - band;
  const Eigen::Vector3d expected_upper = Eigen::Vector3d(0.5, 0.4, 0.4).array() + band;
  EXPECT_LT((cut->origin - expected_lower.cwiseMax(whole->origin)).cwiseAbs().maxCoeff(), slack);
  EXPECT_LT((upperEnd(*cut) - expected_upper.cwiseMin(upperEnd(*whole))).cwiseAbs().maxCoeff(), slack);
  EXPECT_LT(cut->voxels(), whole->voxels() / 2);

  // What other views saw, or what is behind the cameras, says nothing about this one.
  const auto elsewhere = pointsIn({8, 8, -3}, {10, 10, 3}), above = pointsIn({-0.3f, -0.2f, 3}, {0.4f, 0.3f, 4});
  points.insert(points.end(), elsewhere.begin(), elsewhere.end());
  points.insert(points.end(), above.begin(), above.end());
  points.push_back({std::numeric_limits<float>::quiet_NaN(), 0, 0});
  const auto same = gridFor(maps, settings, points);
  ASSERT_TRUE(same);
  EXPECT_EQ(same->origin, cut->origin);
  EXPECT_EQ(same->voxels(), cut->voxels());
  const auto few = gridFor(maps, settings, {points.begin(), points.begin() + settings.min_sparse_points - 1});
  ASSERT_TRUE(few);
  EXPECT_EQ(few->voxels(), whole->voxels());
  EXPECT_FALSE(gridFor(maps, settings, pointsIn({-0.3f, -0.2f, 1.5f}, {0.4f, 0.3f, 1.6f}))) << "no depth is near these";
}

TEST(DepthFusion, VoxelsAreNoFinerThanPixelsOnWhatTheySee) {
  const auto maps = noisyMaps(boxScene(), 3, 0, 0, 4);
  std::vector<double> footprints;
  for (const DepthMap& map : maps)
    for (int v = 0; v < map.depth.rows; ++v)
      for (int u = 0; u < map.depth.cols; ++u)
        if (const float z = map.depth.at<float>(v, u); !std::isnan(z)) footprints.push_back(z / map.camera.fx);
  const double footprint = air_ground_common::median(footprints);
  FusionSettings settings;
  settings.max_voxels = 200000000;
  const auto sizeWhere = [&](double set, double pixels) {
    settings.voxel_size = set;
    settings.voxel_pixels = pixels;
    const auto grid = gridFor(maps, settings, {});
    return grid ? grid->voxel_size : 0;
  };
  EXPECT_NEAR(sizeWhere(0.5 * footprint, 2), 2 * footprint, 0.02 * footprint);
  EXPECT_DOUBLE_EQ(sizeWhere(3 * footprint, 2), 3 * footprint);
  EXPECT_DOUBLE_EQ(sizeWhere(0.5 * footprint, 0), 0.5 * footprint);
}

TEST(DepthFusion, TheBandFitsAroundTheBoxWhenVoxelsGrow) {
  const auto maps = noisyMaps(boxScene(), 3, 0, 0, 4);
  FusionSettings settings;
  const auto fine = gridFor(maps, settings, {});
  settings.max_voxels = 20000;
  const auto coarse = gridFor(maps, settings, {});
  ASSERT_TRUE(fine && coarse);
  EXPECT_LE(coarse->voxels(), 20000u);
  ASSERT_GT(coarse->voxel_size, 2 * fine->voxel_size);
  const double wider = (settings.truncation_voxels + 1) * (coarse->voxel_size - fine->voxel_size);
  EXPECT_LT((coarse->origin.array() + wider - fine->origin.array()).abs().maxCoeff(), 0.1 * wider);
  settings.truncation_voxels = 50;  // more than max_voxels can hold, however large the voxels
  settings.max_voxels = 1000;
  const auto hopeless = gridFor(maps, settings, {});
  ASSERT_TRUE(hopeless);
  EXPECT_LE(hopeless->voxels(), 1000u);
}

TEST(DepthFusion, EmptyMapsGiveNothing) {
  const auto maps = noisyMaps(boxScene(), 3, 0.01, 0.05, 4);
  FusionSettings settings;
  auto empty = maps;
  for (DepthMap& map : empty) map.depth.setTo(std::numeric_limits<float>::quiet_NaN());
  EXPECT_FALSE(fuseDepthMaps(empty, 0, settings));
  EXPECT_THROW(fuseDepthMaps(maps, 3, settings), std::invalid_argument);
}

}  // namespace
}  // namespace dense_fusion
