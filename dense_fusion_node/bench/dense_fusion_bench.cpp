// Fast kernels beside their plain references, in one run: times_faster is the ratio of their processor times, *_ms are
// processor times of all threads together.
#include <benchmark/benchmark.h>

#include <ctime>
#include <functional>
#include <random>

#include "../test/synthetic_scene.h"
#include "dense_fusion/cost_kernels.h"
#include "dense_fusion/dense_mapper.h"
#include "dense_fusion/distance_field.h"

namespace dense_fusion {
namespace {

// Processor time of all threads: ratios then hold on a machine that is busy with other things, too.
double seconds(const std::function<void()>& f) {
  const std::clock_t start = std::clock();
  f();
  return static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
}

Frame randomFrame(const air_ground_common::CameraModel& camera, const Eigen::Isometry3d& T, unsigned seed) {
  std::mt19937 random(seed);
  Frame frame;
  frame.T_map_camera = T;
  frame.intensity = cv::Mat(camera.height, camera.width, CV_8U);
  for (int i = 0; i < frame.intensity.rows * frame.intensity.cols; ++i)
    frame.intensity.data[i] = static_cast<std::uint8_t>(random() & 255);
  frame.normalized = frame.intensity;
  return frame;
}

// Table I, "Add frame to depth map": 376x240 pixels, 200 hypotheses. Costs are summed when the depth map is asked for:
// what ten more frames add to it.
void BM_AddFrame(benchmark::State& state) {
  const auto camera = testing::wideCamera().undistorted().scaled(0.5);
  PlaneSweepSettings settings;
  settings.threads = static_cast<int>(state.range(0));
  PlaneSweep sweep(camera, settings);
  const Frame reference = randomFrame(camera, testing::lookDown({0, 0, 2}), 1);
  const Frame frame = randomFrame(camera, testing::lookDown({0.08, 0.03, 2}, 0.01, 0, 0.02), 2);
  const auto secondsWith = [&](int frames) {
    return seconds([&] {
      sweep.start(reference, 1, 3);
      for (int i = 0; i < frames; ++i) sweep.add(frame);
      benchmark::DoNotOptimize(sweep.depthMap());
    });
  };
  double spent = 0;
  std::size_t frames = 0;
  for (auto _ : state) {
    spent += secondsWith(11) - secondsWith(1);
    frames += 10;
  }
  // The plain loop on one row in the middle, scaled to the image.
  const int w = camera.width, D = settings.hypotheses;
  std::vector<std::uint16_t> cost(static_cast<std::size_t>(w) * D);
  std::vector<float> rho(D);
  for (int d = 0; d < D; ++d) rho[d] = static_cast<float>(sweep.inverseDepth(d));
  const kernels::RowOfFrame row{{20, 100, 1}, {0.9f, 0.01f, 0}, {18, 6, 0}};
  const double plain = camera.height * seconds([&] {
                         kernels::addRowReference(reference.normalized.ptr(100), 5, w - 5, row, rho.data(), D,
                                                  frame.normalized.ptr(), w, cost.data(), w);
                       });
  state.counters["plain_ms"] = 1e3 * plain;
  state.counters["fast_ms"] = 1e3 * spent / static_cast<double>(frames);
  state.counters["times_faster"] = plain / (spent / static_cast<double>(frames));
}
BENCHMARK(BM_AddFrame)->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond)->UseRealTime();

void BM_DepthMap(benchmark::State& state) {
  const auto camera = testing::wideCamera().undistorted().scaled(0.5);
  PlaneSweep sweep(camera);
  sweep.start(randomFrame(camera, testing::lookDown({0, 0, 2}), 1), 1, 3);
  sweep.add(randomFrame(camera, testing::lookDown({0.1, 0, 2}), 2));
  for (auto _ : state) benchmark::DoNotOptimize(sweep.depthMap());
}
BENCHMARK(BM_DepthMap)->Unit(benchmark::kMillisecond)->UseRealTime();

void BM_Rectify(benchmark::State& state) {
  const Rectifier rectifier(testing::wideCamera());
  const cv::Mat image = randomFrame(testing::wideCamera(), Eigen::Isometry3d::Identity(), 3).intensity;
  for (auto _ : state) benchmark::DoNotOptimize(rectifier.rectify(image, 0, Eigen::Isometry3d::Identity()));
}
BENCHMARK(BM_Rectify)->Unit(benchmark::kMillisecond)->UseRealTime();

DepthMap floorMap() {
  DepthMap map;
  map.camera = testing::wideCamera().undistorted().scaled(0.5);
  map.T_map_camera = testing::lookDown({0, 0, 2}, 0.02, 0.03);
  map.intensity = testing::boxScene().render(map.camera, map.T_map_camera, 1, 0, &map.depth);
  map.confidence = cv::Mat::ones(map.depth.size(), CV_32F);
  return map;
}

// Table I, "Compute distance field from depth map": 376x240x150 voxels.
void BM_DistanceField(benchmark::State& state) {
  const DepthMap map = floorMap();
  VoxelGrid grid;
  grid.voxel_size = 0.01;
  grid.origin = {-1.88, -1.2, -0.4};
  grid.nx = 376;
  grid.ny = 240;
  grid.nz = 150;
  Histograms<std::uint8_t> votes;
  votes.resize(grid.nx, grid.ny, grid.nz);
  double spent = 0;
  std::size_t rounds = 0;
  for (auto _ : state) {
    spent += seconds([&] { addVotes(map, grid, {0.04, 0.08}, 2, &votes); });
    ++rounds;
  }
  const double plain = seconds([&] { addVotesReference(map, grid, {0.04, 0.08}, &votes); });
  state.counters["plain_ms"] = 1e3 * plain;
  state.counters["fast_ms"] = 1e3 * spent / static_cast<double>(rounds);
  state.counters["times_faster"] = plain / (spent / static_cast<double>(rounds));
}
BENCHMARK(BM_DistanceField)->Unit(benchmark::kMillisecond)->UseRealTime();

// Table I, "Depth map fusion (8 iterations)": 376x240x150 voxels. Argument: coarse levels of the start.
void BM_Fusion(benchmark::State& state) {
  Histograms<std::uint8_t> votes;
  votes.resize(376, 240, 150);
  std::mt19937 random(5);
  for (int z = 0; z < votes.nz; ++z)
    for (int y = 0; y < votes.ny; ++y)
      for (int x = 0; x < votes.nx; ++x)
        for (int m = 0; m < 6; ++m) {
          const int bin = (z - 60) + static_cast<int>(random() % 3);
          if (bin >= 0) ++votes.row(y, z)[static_cast<std::size_t>(std::min(bin, 7)) * votes.nx + x];
        }
  TvL1Settings settings;
  settings.coarse_levels = static_cast<int>(state.range(0));
  benchmark::DoNotOptimize(solveTvL1(votes, settings));  // memory that nobody had before is slow to get
  double spent = 0;
  std::size_t rounds = 0;
  for (auto _ : state) {
    spent += seconds([&] { benchmark::DoNotOptimize(solveTvL1(votes, settings)); });
    ++rounds;
  }
  TvL1Solution plain_solution;
  plain_solution.reset(votes.nx, votes.ny, votes.nz);
  const double plain = 8 * seconds([&] { iterateTvL1Reference(votes, settings.lambda, 1, &plain_solution); });
  state.counters["plain_8_iterations_ms"] = 1e3 * plain;
  state.counters["fast_ms"] = 1e3 * spent / static_cast<double>(rounds);
  state.counters["times_faster"] = plain / (spent / static_cast<double>(rounds));
}
BENCHMARK(BM_Fusion)->Arg(0)->Arg(2)->Unit(benchmark::kMillisecond)->UseRealTime();

// Everything that happens when a group of depth maps is complete.
void BM_FuseSevenDepthMaps(benchmark::State& state) {
  std::vector<DepthMap> maps;
  for (int i = 0; i < 7; ++i) {
    DepthMap map = floorMap();
    map.T_map_camera = testing::lookDown({0.11 * i, 0, 2});
    testing::boxScene().render(map.camera, map.T_map_camera, 1, 0, &map.depth);
    maps.push_back(std::move(map));
  }
  FusionTimings t = fuseDepthMaps(maps, 3, FusionSettings{})->timings;
  for (auto _ : state) t = fuseDepthMaps(maps, 3, FusionSettings{})->timings;
  state.counters["votes_ms"] = 1e3 * t.votes;
  state.counters["minimisation_ms"] = 1e3 * t.minimisation;
  state.counters["surface_ms"] = 1e3 * t.surface;
}
BENCHMARK(BM_FuseSevenDepthMaps)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace dense_fusion
