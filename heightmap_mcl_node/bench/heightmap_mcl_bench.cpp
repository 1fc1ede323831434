// Full search of one heading, 200 particles and the heading search: fast kernels against the plain reference.
#include <benchmark/benchmark.h>

#include <cmath>
#include <random>

#include "heightmap_mcl/global_search.h"

using namespace heightmap_mcl;

namespace {

/// 50 cells a metre, blocks on a floor, 15 % holes.
HeightMap makeMap(int width, int height, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<float> uniform(0, 1);
  HeightMap map;
  map.width = width;
  map.height = height;
  map.heights.assign(static_cast<std::size_t>(width) * height, 0.f);
  for (int block = 0; block < width * height / 3000; ++block) {
    const int c0 = static_cast<int>(uniform(random) * width), r0 = static_cast<int>(uniform(random) * height);
    const float h = uniform(random);
    for (int r = r0; r < std::min(r0 + 25, height); ++r) {
      for (int c = c0; c < std::min(c0 + 20, width); ++c) map.at(r, c) = h;
    }
  }
  for (float& h : map.heights) {
    h += 0.02f * uniform(random);
    if (uniform(random) < 0.15f) h = kHole;
  }
  return map;
}

const HeightMap& ground() {
  static const HeightMap map = makeMap(300, 250, 1);
  return map;
}
const HeightMap& air() {
  static const HeightMap map = makeMap(150, 120, 2);
  return map;
}

std::vector<PlanarPose> particles() {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> x(1, 4), y(1, 3), yaw(-M_PI, M_PI);
  std::vector<PlanarPose> poses;
  for (int i = 0; i < 200; ++i) poses.push_back({x(random), y(random), yaw(random)});
  return poses;
}

void fullSearchReference(benchmark::State& state) {
  // Every 16th offset along each axis; the items counter makes the rates comparable.
  const CostSettings settings;
  std::int64_t offsets = 0;
  for (auto _ : state) {
    for (int v = -60; v < 190; v += 16) {
      for (int u = -75; u < 225; u += 16, ++offsets) {
        benchmark::DoNotOptimize(zmssdReference(air(), ground(), {0, 0}, {u * 0.02, v * 0.02, 0}, settings));
      }
    }
  }
  state.SetItemsProcessed(offsets);
}
BENCHMARK(fullSearchReference)->Unit(benchmark::kMillisecond);

void fullSearchFft(benchmark::State& state) {
  const FftCost fft(ground());
  std::int64_t offsets = 0;
  for (auto _ : state) offsets += static_cast<std::int64_t>(fft(air(), 0, {}).cost.size());
  state.SetItemsProcessed(offsets);
}
BENCHMARK(fullSearchFft)->Unit(benchmark::kMillisecond);

void headingSearch(benchmark::State& state) {
  const int factor = static_cast<int>(state.range(0));
  const HeightMap coarse = downsample(air(), factor);
  const FftCost fft(downsample(ground(), factor));
  const auto headings = searchHeadings(72, {});
  for (auto _ : state) benchmark::DoNotOptimize(computeCostVolume(fft, coarse, headings, true, {}));
}
BENCHMARK(headingSearch)->Arg(1)->Arg(2)->Arg(4)->Unit(benchmark::kMillisecond)->UseRealTime();

/// All headings and the sixteen lowest places at full resolution.
void searchAndRefine(benchmark::State& state) {
  const HeightMap coarse = downsample(air(), 4);
  const FftCost fft(downsample(ground(), 4));
  const DirectCost cost(ground());
  const auto cells = aerialCells(air(), centerOf(coarse));
  const auto headings = searchHeadings(72, {});
  for (auto _ : state) {
    const CostVolume volume = computeCostVolume(fft, coarse, headings, true, {});
    for (const PlanarPose& start : findLocalMinima(volume, 16, 0.4, 0.26))
      benchmark::DoNotOptimize(descend(cost, cells, start, 0.08, M_PI / 72, {}));
  }
}
BENCHMARK(searchAndRefine)->Unit(benchmark::kMillisecond)->UseRealTime();

void particlesReference(benchmark::State& state) {
  const auto poses = particles();
  for (auto _ : state) {
    for (const auto& p : poses) benchmark::DoNotOptimize(zmssdReference(air(), ground(), {1.5, 1.2}, p, {}));
  }
}
BENCHMARK(particlesReference)->Unit(benchmark::kMillisecond);

void particlesKernel(benchmark::State& state) {
  const auto poses = particles();
  const auto cells = aerialCells(air(), {1.5, 1.2});
  const DirectCost cost(ground());
  for (auto _ : state) benchmark::DoNotOptimize(cost(cells, poses, CostSettings()));
}
BENCHMARK(particlesKernel)->Unit(benchmark::kMillisecond)->UseRealTime();

void agreementOfParticlesReference(benchmark::State& state) {
  const auto poses = particles();
  for (auto _ : state) {
    for (const auto& p : poses)
      benchmark::DoNotOptimize(agreementReference(air(), ground(), {1.5, 1.2}, p, 0, CostSettings()));
  }
}
BENCHMARK(agreementOfParticlesReference)->Unit(benchmark::kMillisecond);

void agreementOfParticlesKernel(benchmark::State& state) {
  const auto poses = particles();
  const auto cells = aerialCells(air(), {1.5, 1.2});
  const DirectCost cost(ground());
  for (auto _ : state) {
    for (const auto& p : poses) benchmark::DoNotOptimize(cost.agreement(cells, p, 0, CostSettings()));
  }
}
BENCHMARK(agreementOfParticlesKernel)->Unit(benchmark::kMillisecond);

}  // namespace
