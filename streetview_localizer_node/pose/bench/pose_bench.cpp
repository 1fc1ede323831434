// P3P a thousand times against OpenGV's, the paper's Monte Carlo, and a whole pose with its verdict.
#include <benchmark/benchmark.h>

#include <chrono>
#include <functional>
#include <opengv/absolute_pose/CentralAbsoluteAdapter.hpp>
#include <opengv/absolute_pose/methods.hpp>

#include "../test/facade.h"
#include "visual_frontend/pose_solver.h"

using namespace streetview_localizer;

namespace {

constexpr int kSamples = 1000;

struct Samples {
  Samples() {
    simulation::Random random(1);
    simulation::FacadeSettings settings;
    settings.outliers = 0;
    const simulation::Scene s = simulation::facadeScene(random, settings);
    for (int k = 0; k < kSamples; ++k) {
      Eigen::Matrix3d p, r;
      for (int i = 0; i < 3; ++i) {
        const auto& c = s.matches[static_cast<std::size_t>(random.uniform(0, 20)) + 20 * i];
        p.col(i) = c.p_world;
        r.col(i) = s.camera.ray(c.pixel);
      }
      points.push_back(p);
      rays.push_back(r);
    }
  }
  std::vector<Eigen::Matrix3d> points, rays;
};

double seconds(const std::function<void()>& f) {
  const auto start = std::chrono::steady_clock::now();
  f();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

void p3pThousand(benchmark::State& state) {
  const Samples samples;
  opengv::bearingVectors_t rays;
  opengv::points_t points;
  std::vector<std::vector<int>> indices;
  for (int k = 0; k < kSamples; ++k) {
    for (int i = 0; i < 3; ++i) {
      rays.push_back(samples.rays[k].col(i));
      points.push_back(samples.points[k].col(i));
    }
    indices.push_back({3 * k, 3 * k + 1, 3 * k + 2});
  }
  opengv::absolute_pose::CentralAbsoluteAdapter adapter(rays, points);
  double ours = 0, opengvs = 0;
  for (auto _ : state) {
    ours += seconds([&] {
      for (int k = 0; k < kSamples; ++k)
        benchmark::DoNotOptimize(visual_frontend::solveP3PFixed(samples.points[k], samples.rays[k]));
    });
    opengvs += seconds([&] {
      for (int k = 0; k < kSamples; ++k)
        benchmark::DoNotOptimize(opengv::absolute_pose::p3p_kneip(adapter, indices[k]));
    });
  }
  const double n = static_cast<double>(state.iterations());
  state.counters["ours_ms"] = 1e3 * ours / n;
  state.counters["OpenGV_ms"] = 1e3 * opengvs / n;
  state.counters["OpenGV/ours"] = opengvs / ours;
}
BENCHMARK(p3pThousand)->Unit(benchmark::kMillisecond)->Iterations(200);

void wholePose(benchmark::State& state) {
  simulation::Random random(2);
  simulation::FacadeSettings settings;
  settings.inliers = static_cast<int>(state.range(0));
  settings.outliers = static_cast<int>(state.range(1));
  settings.relief = 0.2;
  const simulation::Scene s = simulation::facadeScene(random, settings);
  PoseSettings pose;
  pose.monte_carlo_samples = static_cast<int>(state.range(2));
  for (auto _ : state) {
    const PoseResult r = estimatePose(s.matches, s.camera, s.source, {}, pose);
    benchmark::DoNotOptimize(judge(r, s.matches, s.camera, s.source, pose, {}));
  }
}
BENCHMARK(wholePose)
    ->ArgNames({"inliers", "outliers", "monte_carlo"})
    ->Args({60, 30, 0})
    ->Args({60, 30, 1000})
    ->Args({60, 240, 0})
    ->Args({400, 200, 0})
    ->Unit(benchmark::kMillisecond);

}  // namespace
