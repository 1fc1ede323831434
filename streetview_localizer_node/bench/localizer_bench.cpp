// Time of a whole query, step by step as in the paper's figure 4 (3.2 s for steps 1, 4 and 5 on 8 cores there). Columns
// are seconds an image; the label names the slowest step. `all` tries the image alone first, `with_views` always makes
// the virtual views.
#include <benchmark/benchmark.h>

#include <array>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "../test/castle.h"
#include "../test/tiny_city.h"
#include "streetview_localizer/localizer.h"

namespace streetview_localizer {
namespace {

struct Query {
  cv::Mat image;
  CameraModel camera;
  PosePrior prior;
};

const char* const kCounters[kSteps] = {"1_features", "2_search", "3_voting", "4_pairwise", "5_kvld", "6_pose"};

void run(benchmark::State& state, const std::shared_ptr<const StreetviewDatabase>& database,
         const std::vector<Query>& queries, bool quick) {
  StreetviewLocalizerSettings settings;
  if (!quick) settings.quick_inliers = 0;
  const StreetviewLocalizer localizer(database, settings);
  std::array<double, kSteps> sums{};
  std::size_t next = 0, accepted = 0;
  for (auto _ : state) {
    const Query& q = queries[next++ % queries.size()];
    const LocalizerResult r = localizer.localize(q.image, q.camera, q.prior);
    for (std::size_t i = 0; i < sums.size(); ++i) sums[i] += r.times[i];
    accepted += r.accepted();
  }
  const double n = static_cast<double>(state.iterations());
  std::size_t slowest = 0;
  for (std::size_t i = 0; i < sums.size(); ++i) {
    state.counters[kCounters[i]] = sums[i] / n;
    if (sums[i] > sums[slowest]) slowest = i;
  }
  state.counters["steps_1_4_5"] = (sums[0] + sums[3] + sums[4]) / n;
  state.counters["located"] = static_cast<double>(accepted) / n;
  state.SetLabel(std::string("slowest: ") + kCounters[slowest]);
}

void paintedCourtyard(benchmark::State& state, bool quick, bool prior) {
  const test::TinyCity city(1);
  std::vector<Query> queries;
  for (int i = 0; i < 4; ++i) {
    const Pose T = test::TinyCity::look({-4.0 + 2 * i, 0.5, 3.0 + i}, M_PI / 2 * (i % 2 ? -1 : 1), 0.05);
    Query q{city.photograph(test::TinyCity::camera(), T), test::TinyCity::camera(), {}};
    if (prior) q.prior.T_world_camera = T;
    queries.push_back(q);
  }
  run(state, city.database(), queries, quick);
}

void castle(benchmark::State& state, bool quick) {
  const test::Castle castle = test::makeCastle(0);
  std::vector<Query> queries;
  for (std::size_t i = 1; i < castle.photos.size(); i += 4) {
    const cv::Mat image = castle.image(i);
    queries.push_back({image, test::cameraOf(castle.photos[i], image), {}});
  }
  run(state, castle.database, queries, quick);
}

BENCHMARK_CAPTURE(paintedCourtyard, 640x480 / all, true, false)
    ->Unit(benchmark::kMillisecond)
    ->Iterations(8)
    ->UseRealTime();
BENCHMARK_CAPTURE(paintedCourtyard, 640x480 / prior, true, true)
    ->Unit(benchmark::kMillisecond)
    ->Iterations(8)
    ->UseRealTime();
BENCHMARK_CAPTURE(paintedCourtyard, 640x480 / with_views, false, false)
    ->Unit(benchmark::kMillisecond)
    ->Iterations(4)
    ->UseRealTime();

const bool castle_registered = [] {
  if (!test::castleAvailable()) {
    std::cerr << "castle is left out: no photographs of castle-P30 below " << test::strechaFolder() << "\n";
    return false;
  }
  for (const bool quick : {true, false})
    benchmark::RegisterBenchmark(quick ? "castle/960x640 / all" : "castle/960x640 / with_views", castle, quick)
        ->Unit(benchmark::kMillisecond)
        ->Iterations(quick ? 8 : 4)
        ->UseRealTime();
  return true;
}();

}  // namespace
}  // namespace streetview_localizer
