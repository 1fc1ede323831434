// What the tracker costs. The bar: an update below 0.1 ms.
#include <benchmark/benchmark.h>

#include "../test/simulation.h"

namespace ekf_tracker {
namespace {

Simulation flight() {
  SimulationSettings s;
  s.seed = 4;
  s.duration = 40;
  return simulate(s, FilterSettings());
}

void odometryStep(benchmark::State& state) {
  const Simulation sim = flight();
  PoseFilter filter;
  filter.correct(sim.fixes[0]);
  std::size_t i = 0;
  for (auto _ : state) {
    filter.predict(sim.odometry[i]);
    benchmark::DoNotOptimize(filter.state().x);
    i = (i + 1) % sim.odometry.size();
  }
}
BENCHMARK(odometryStep)->Unit(benchmark::kMicrosecond);

void updateByAFix(benchmark::State& state) {
  const Simulation sim = flight();
  PoseFilter started;
  started.correct(sim.fixes[0]);
  for (int i = 0; i < 65; ++i) started.predict(sim.odometry[static_cast<std::size_t>(i)]);
  for (auto _ : state) {
    PoseFilter filter = started;
    benchmark::DoNotOptimize(filter.correct(sim.fixes[1]));
  }
}
BENCHMARK(updateByAFix)->Unit(benchmark::kMicrosecond);

// A fix that comes state.range(0) ms late, with the odometry at 20 Hz since replayed.
void updateByALateFix(benchmark::State& state) {
  const Simulation sim = flight();
  Tracker base;
  base.addMeasurement(sim.fixes[0]);
  for (std::size_t i = 0; i < 600; ++i) base.addIncrement(sim.odometry[i]);
  Measurement fix = sim.fixes[0];
  fix.stamp = sim.odometry[599].stamp - 1e-3 * static_cast<double>(state.range(0));
  fix.value = sim.truth[600 - static_cast<std::size_t>(state.range(0)) / 50];
  Tracker tracker;
  for (auto _ : state) {
    state.PauseTiming();
    tracker = base;
    state.ResumeTiming();
    tracker.addMeasurement(fix);
    benchmark::DoNotOptimize(tracker.latest());
  }
}
BENCHMARK(updateByALateFix)->Arg(0)->Arg(1000)->Arg(3200)->Unit(benchmark::kMicrosecond)->Iterations(300);

}  // namespace
}  // namespace ekf_tracker
