#include "dense_fusion/dense_mapper.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <new>
#include <stdexcept>
#include <thread>

#include "air_ground_common/first_exception.h"
#include "dense_fusion/guarded.h"
#include "dense_fusion/point_map.h"
#include "straight_flight.h"

namespace dense_fusion {
namespace {

using testing::boxScene;
using testing::flight;
using testing::flightPose;
using testing::fly;
using testing::lookDown;
using testing::smallCamera;
using testing::smallSettings;

// Rows that come later see further along the way: untold, the baseline between two images is wrong, and so is depth, by
// the share v f readout / (z height) = 0.6 * 150 * 0.03 / (2 * 160).
TEST(DenseMapper, KnowsTheTimesOfRows) {
  RowMotion motion;
  motion.readout_time = 0.03;
  motion.velocity = flightPose(0).linear().transpose() * Eigen::Vector3d(0.6, 0, 0);
  std::vector<cv::Mat> images;
  for (int i = 0; i < 30; ++i)
    images.push_back(testing::renderRows(testing::Scene(), smallCamera(), flightPose(i), motion));
  const auto bias = [&](double readout_time) {
    DenseMapper mapper(smallSettings());
    std::vector<float> errors;
    mapper.onDepthMap([&](const DepthMap& map) {
      const Eigen::Isometry3d T = map.T_map_camera;
      for (int v = 0; v < map.depth.rows; ++v)
        for (int u = 0; u < map.depth.cols; ++u) {
          const Eigen::Vector3d ray = T.linear() * map.camera.unproject(Eigen::Vector2d(u, v)).homogeneous();
          const float d = map.depth.at<float>(v, u);
          if (!std::isnan(d)) errors.push_back(d - static_cast<float>(testing::Scene().hit(T.translation(), ray)));
        }
    });
    for (int i = 0; i < 30; ++i)
      mapper.add(images[i], smallCamera(), std::int64_t{i} * 50000000, flightPose(i), 1.3, 2.05, readout_time);
    mapper.flush();
    EXPECT_GT(errors.size(), 10000u);
    std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
    return std::abs(errors[errors.size() / 2]);
  };
  const double told = bias(motion.readout_time), untold = bias(0);
  std::printf("floor at 2 m, median error: %.4f m told, %.4f m untold\n", told, untold);
  EXPECT_LT(told, 0.004);
  EXPECT_NEAR(untold, 0.0084 * 2, 0.005);
}

TEST(DenseMapper, WorksInAnyUnit) {
  DenseMapper metric(smallSettings());
  const auto truth = fly(&metric);
  ASSERT_GE(truth.size(), 1u);
  for (const double unit : {0.37, 5.0}) {  // [m] of a length 1 in the poses
    DenseMapper mapper(smallSettings());
    std::vector<FusedMap> maps;
    for (std::size_t i = 0; i < flight().size(); ++i) {
      Eigen::Isometry3d T = flightPose(static_cast<int>(i));
      T.translation() /= unit;
      EXPECT_FALSE(mapper.followDistance((1.9 + 0.002 * static_cast<double>(i)) / unit)) << "the unit stays";
      if (auto fused = mapper.add(flight()[i], smallCamera(), static_cast<std::int64_t>(i) * 50000000, T, 1.3 / unit,
                                  2.05 / unit))
        maps.push_back(std::move(*fused));
    }
    EXPECT_NEAR(mapper.unit(), 2.0 / 1.9 * unit, 1e-9);
    if (auto fused = mapper.flush()) maps.push_back(std::move(*fused));
    ASSERT_GE(maps.size(), 1u) << unit;
    std::vector<double> errors;
    for (const FusedMap& map : maps)
      for (const SurfacePoint& p : map.points)
        if (p.normal.z() > 0.9)
          errors.push_back(
              std::abs(unit * p.position.z() - boxScene().heightAt(unit * p.position.x(), unit * p.position.y())));
    ASSERT_GT(errors.size(), 1000u) << unit;
    std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2), errors.end());
    EXPECT_LT(errors[errors.size() / 2], 0.02) << unit;
    EXPECT_NEAR(maps.front().grid.voxel_size * unit, 0.03 * 1.9 / 2.0, 1e-6) << unit;
    // Four times as high: what there is is fused, and all lengths grow with the distance.
    mapper.followDistance(8.0 / unit);
    EXPECT_NEAR(mapper.unit(), 0.25 * unit, 1e-9);
    mapper.reset();
    EXPECT_EQ(mapper.unit(), 1);
  }
}

TEST(DenseMapper, EmitsAMapEachTimeItHasMovedOn) {
  DenseMapper mapper(smallSettings());
  int depth_maps = 0;
  mapper.onDepthMap([&](const DepthMap& map) {
    ++depth_maps;
    EXPECT_GT(map.frames, 4);
  });
  const auto maps = fly(&mapper);
  // 1.7 m at 0.70 m a map: two complete ones and what flush() finds.
  EXPECT_GE(maps.size(), 2u);
  EXPECT_LE(maps.size(), 3u);
  EXPECT_EQ(mapper.counters().fused, maps.size());
  EXPECT_EQ(static_cast<int>(mapper.counters().depth_maps), depth_maps);
  std::vector<double> errors;
  double highest = 0;
  for (const FusedMap& map : maps) {
    EXPECT_EQ(map.depth_map.stamp % 50000000, 0);
    for (const SurfacePoint& p : map.points) {
      ASSERT_TRUE(p.position.allFinite());
      highest = std::max(highest, double(p.position.z()));
      if (p.normal.z() > 0.9)
        errors.push_back(std::abs(p.position.z() - boxScene().heightAt(p.position.x(), p.position.y())));
    }
  }
  ASSERT_GT(errors.size(), 3000u);
  std::sort(errors.begin(), errors.end());
  std::printf("heights: median %.4f 90%% %.4f m\n", errors[errors.size() / 2], errors[errors.size() * 9 / 10]);
  EXPECT_LT(errors[errors.size() / 2], 0.012);
  EXPECT_LT(errors[errors.size() * 9 / 10], 0.05);
  EXPECT_NEAR(highest, 0.8, 0.06);  // the top of the tallest box is there
}

TEST(DenseMapper, RepeatsItselfExactly) {
  DenseMapper a(smallSettings()), b(smallSettings());
  const auto first = fly(&a), second = fly(&b);
  ASSERT_EQ(first.size(), second.size());
  for (std::size_t k = 0; k < first.size(); ++k) {
    ASSERT_EQ(first[k].points.size(), second[k].points.size());
    for (std::size_t i = 0; i < first[k].points.size(); ++i)
      ASSERT_EQ(first[k].points[i].position, second[k].points[i].position);
  }
}

TEST(DenseMapper, HoveringAndFlushingTwiceGiveNothing) {
  DenseMapper mapper(smallSettings());
  for (int i = 0; i < 30; ++i) EXPECT_FALSE(mapper.add(flight()[20], smallCamera(), i, flightPose(20), 1.3, 2.05));
  EXPECT_FALSE(mapper.flush());
  EXPECT_EQ(mapper.counters().redundant, 29u);
  EXPECT_FALSE(fly(&mapper).empty());
  EXPECT_FALSE(mapper.flush());
}

// Forth and back over half a metre, as in an inspection: the fusion's radius is never left.
TEST(DenseMapper, WanderingWithinTheRadiusGivesMapsToo) {
  DenseMapper mapper(smallSettings());
  constexpr int kFirst = 20, kLast = 36;
  std::size_t maps = 0;
  int i = kFirst, step = 1;
  for (int k = 0; k < 240; ++k, i += step) {
    maps += mapper.add(flight()[i], smallCamera(), std::int64_t{k} * 50000000, flightPose(i), 1.3, 2.05).has_value();
    if (i + step < kFirst || i + step > kLast) step = -step;
  }
  EXPECT_GE(mapper.counters().depth_maps, 30u);
  EXPECT_GE(maps, 1u);
}

// A MAV that hovers about a place never leaves the sweep's radius either.
TEST(DenseMapper, HoveringAboutAPlaceGivesMapsToo) {
  MapperSettings settings = smallSettings();
  settings.sweep.max_frames = 12;
  settings.fusion.voxel_size = 0.06;
  DenseMapper mapper(settings);
  std::vector<std::int64_t> references;
  mapper.onDepthMap([&](const DepthMap& map) { references.push_back(map.stamp); });
  constexpr int kFirst = 26, kLast = 29;  // 0.09 m
  std::size_t maps = 0;
  int i = kFirst, step = 1;
  for (int k = 0; k < 250; ++k, i += step) {
    maps += mapper.add(flight()[i], smallCamera(), std::int64_t{k} * 50000000, flightPose(i), 1.3, 2.05).has_value();
    if (i + step < kFirst || i + step > kLast) step = -step;
  }
  EXPECT_GE(maps, 1u);
  ASSERT_GE(references.size(), 30u);
  for (std::size_t k = 1; k < references.size(); ++k)
    EXPECT_GE(references[k] - references[k - 1], std::int64_t{settings.sweep.max_frames / 2} * 50000000)
        << "half of a depth map's images are new";
}

// It has landed, and its camera goes on: what was flown last is not kept back.
TEST(DenseMapper, AStandingCameraFusesWhatThereIs) {
  DenseMapper mapper(smallSettings());
  std::int64_t stamp = 0;
  const auto add = [&](int i) {
    return mapper.add(flight()[i], smallCamera(), stamp += 50000000, flightPose(i), 1.3, 2.05);
  };
  const auto stand = [&](int at, double seconds) {
    std::size_t maps = 0;
    for (const std::int64_t end = stamp + static_cast<std::int64_t>(1e9 * seconds); stamp < end;)
      maps += add(at).has_value();
    return maps;
  };
  // Too little for a map: it is kept for what comes.
  for (int i = 0; i < 9; ++i) ASSERT_FALSE(add(i));
  EXPECT_EQ(stand(8, 10), 0u);
  for (int i = 9; i < 20; ++i) ASSERT_FALSE(add(i));
  EXPECT_EQ(stand(19, 2), 0u) << "it may fly on";
  EXPECT_EQ(stand(19, 10), 1u) << "once";
  EXPECT_EQ(mapper.counters().small_groups, 0u);
}

TEST(DenseMapper, ResetForgetsTheMap) {
  DenseMapper mapper(smallSettings());
  for (int i = 0; i < 20; ++i) mapper.add(flight()[i], smallCamera(), i, flightPose(i), 1.3, 2.05);
  mapper.reset();
  EXPECT_FALSE(mapper.flush());
  EXPECT_FALSE(fly(&mapper).empty());
}

TEST(DenseMapper, RefusesWhatItCannotUse) {
  MapperSettings bad = smallSettings();
  bad.overlap = 2;
  EXPECT_THROW(DenseMapper{bad}, std::invalid_argument);
  DenseMapper mapper(smallSettings());
  Eigen::Isometry3d T = flightPose(0);
  T.translation().x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(mapper.add(flight()[0], smallCamera(), 0, T, 1, 2), std::invalid_argument);
  auto camera = smallCamera();
  camera.fx = 0;
  EXPECT_THROW(mapper.add(flight()[0], camera, 0, flightPose(0), 1, 2), std::invalid_argument);
  EXPECT_THROW(mapper.add(cv::Mat(), smallCamera(), 0, flightPose(0), 1, 2), std::invalid_argument);
  // A depth whose inverse is no number; the next image begins a depth map of its own.
  EXPECT_THROW(mapper.add(flight()[0], smallCamera(), 0, flightPose(0), 1e-45, 2), std::invalid_argument);
  EXPECT_NO_THROW(mapper.add(flight()[1], smallCamera(), 1, flightPose(1), 1, 2));
  mapper.reset();
  // An unknown depth range falls back to the default one.
  EXPECT_NO_THROW(
      mapper.add(flight()[0], smallCamera(), 0, flightPose(0), 0, std::numeric_limits<double>::quiet_NaN()));
  EXPECT_FALSE(fly(&mapper).empty());
}

// To and fro over the same place: carried views then lie nearer to the middle of a group than new ones.
TEST(DenseMapper, StampsRiseWithOverlap) {
  MapperSettings settings = smallSettings();
  settings.fusion_radius = 0.35;
  settings.overlap = 0.3;
  settings.fusion.voxel_size = 0.06;
  DenseMapper mapper(settings);
  std::vector<std::int64_t> stamps;
  const auto note = [&](const std::optional<FusedMap>& fused) {
    if (fused) stamps.push_back(fused->depth_map.stamp);
  };
  constexpr int kTurn = 24;
  std::int64_t stamp = 0;
  for (int pass = 0; pass < 3; ++pass)
    for (int i = 0; i < kTurn; ++i) {
      const int k = pass % 2 ? kTurn - 1 - i : i;
      note(mapper.add(flight()[k], smallCamera(), stamp += 50000000, flightPose(k), 1.3, 2.05));
    }
  note(mapper.flush());
  ASSERT_GE(stamps.size(), 3u);
  for (std::size_t i = 1; i < stamps.size(); ++i) EXPECT_GT(stamps[i], stamps[i - 1]) << "fused map " << i;
}

// Not one depth map later, nor one image, and by the stamp of what it was made of.
TEST(DenseMapper, FusesAsSoonAsTheCameraLeaves) {
  MapperSettings settings = smallSettings();
  settings.fusion_radius = 0.5;
  settings.fusion.voxel_size = 0.06;
  DenseMapper mapper(settings);
  std::vector<Eigen::Isometry3d> references;
  mapper.onDepthMap([&](const DepthMap& map) { references.push_back(map.T_map_camera); });
  std::size_t groups = 0, first = 0;
  for (std::size_t i = 0; i < flight().size(); ++i) {
    const Eigen::Isometry3d T = flightPose(static_cast<int>(i));
    const auto fused = mapper.add(flight()[i], smallCamera(), static_cast<std::int64_t>(i) * 50000000, T, 1.3, 2.05);
    if (!fused) continue;
    ++groups;
    const double way = (T.translation() - references.at(first).translation()).norm();
    constexpr double kStep = 0.03;  // of the flight: the next image will be outside
    EXPECT_GT(way + kStep, settings.fusion_radius);
    EXPECT_LT(way, settings.fusion_radius + settings.sweep_radius + 0.01);
    EXPECT_EQ(fused->newest_image, static_cast<std::int64_t>(i) * 50000000);
    first = references.size();
  }
  EXPECT_GE(groups, 2u);
}

// A fused map goes out before the next depth map is begun, which must not cost that one its frames.
TEST(DenseMapper, FusingChangesNoDepthMap) {
  const auto depthMaps = [](double fusion_radius, int* groups) {
    MapperSettings settings = smallSettings();
    settings.fusion_radius = fusion_radius;
    settings.fusion.voxel_size = 0.06;
    DenseMapper mapper(settings);
    std::vector<DepthMap> maps;
    mapper.onDepthMap([&](const DepthMap& map) { maps.push_back(map); });
    for (std::size_t i = 0; i < flight().size(); ++i)
      *groups += mapper
                     .add(flight()[i], smallCamera(), static_cast<std::int64_t>(i) * 50000000,
                          flightPose(static_cast<int>(i)), 1.3, 2.05)
                     .has_value();
    mapper.flush();
    return maps;
  };
  int groups = 0, none = 0;
  const auto fused = depthMaps(0.5, &groups), apart = depthMaps(100, &none);
  EXPECT_GE(groups, 2);
  EXPECT_EQ(none, 0);
  ASSERT_EQ(fused.size(), apart.size());
  for (std::size_t i = 0; i < fused.size(); ++i) {
    EXPECT_EQ(fused[i].frames, apart[i].frames) << i;
    EXPECT_EQ(fused[i].stamp, apart[i].stamp) << i;
    EXPECT_TRUE(std::equal(fused[i].depth.begin<float>(), fused[i].depth.end<float>(), apart[i].depth.begin<float>(),
                           [](float a, float b) { return a == b || (std::isnan(a) && std::isnan(b)); }))
        << i;
  }
}

// A worker as the node's: its thread outlives whatever a job throws, and says why the job failed.
TEST(Guarded, AThrowingJobDoesNotEndTheWorker) {
  std::vector<std::string> reasons;
  int done = 0;
  std::thread worker([&] {
    for (int job = 0; job < 4; ++job)
      runGuarded(
          [&] {
            if (job == 0) throw std::runtime_error("no room for 9 voxels");
            if (job == 1) throw std::bad_alloc();
            if (job == 2) throw 7;
            ++done;
          },
          [&](const std::string& reason) { reasons.push_back(reason); });
  });
  worker.join();
  EXPECT_EQ(done, 1);
  ASSERT_EQ(reasons.size(), 3u);
  EXPECT_EQ(reasons[0], "no room for 9 voxels");
  EXPECT_EQ(reasons[2], "for an unknown reason");
}

TEST(Guarded, ParallelLoopsThrowAfterTheirEnd) {
  air_ground_common::FirstException first;
  int done = 0;
#pragma omp parallel for num_threads(2) reduction(+ : done)
  for (int i = 0; i < 100; ++i)
    first.guard([&] {
      if (i % 10 == 3) throw std::bad_alloc();
      ++done;
    });
  EXPECT_EQ(done, 90);
  EXPECT_THROW(first.rethrow(), std::bad_alloc);
}

TEST(PointMap, KeepsTheBetterSupportedPointOfACell) {
  PointMap map(0.02);
  SurfacePoint a, b;
  a.position = {-0.005f, 0.011f, 1.001f};
  a.support = 5;
  b.position = {-0.006f, 0.012f, 1.002f};
  b.support = 3;
  map.add({a});
  map.add({b});
  ASSERT_EQ(map.size(), 1u);
  EXPECT_EQ(map.points()[0].support, 5);
  b.position.x() = 0.005f;  // the neighbouring cell across zero
  map.add({b});
  EXPECT_EQ(map.size(), 2u);
  EXPECT_THROW(PointMap(0), std::invalid_argument);
  EXPECT_THROW(PointMap(0.02, 7), std::invalid_argument);
}

TEST(PointMap, LeavesOutWhatHasNoCell) {
  PointMap map(0.02);
  std::vector<SurfacePoint> points(5);
  points[0].position.setZero();
  points[1].position = {0, std::numeric_limits<float>::quiet_NaN(), 0};
  points[2].position = {0, 0, std::numeric_limits<float>::infinity()};
  points[3].position = {-1e30f, 0, 0};
  points[4].position = {3e4f, 0, 0};  // would wrap around to another place
  EXPECT_EQ(map.add(points), 4u);
  EXPECT_EQ(map.size(), 1u);
}

TEST(PointMap, CellsDoubleWhenItIsFull) {
  PointMap map(0.02, 1000);
  std::vector<SurfacePoint> points(5000);
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i].position = {0.03f * (i % 100), 0.03f * (i / 100), 0};
    points[i].support = static_cast<int>(i % 7);
  }
  EXPECT_EQ(map.add(points), 0u);
  EXPECT_LE(map.size(), 1000u);
  EXPECT_GT(map.size(), 200u);
  EXPECT_DOUBLE_EQ(map.cell(), 0.08);
  map.clear();
  EXPECT_DOUBLE_EQ(map.cell(), 0.02);
  EXPECT_EQ(map.size(), 0u);
}

}  // namespace
}  // namespace dense_fusion
