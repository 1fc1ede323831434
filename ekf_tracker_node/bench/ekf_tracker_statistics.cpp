// How often is the tracker sure and wrong? Flights drawn at random, with wrong fixes among the right ones; counts those
// in which a wrong fix entered the state, and those in which the stated covariance excludes the truth.
#include <omp.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <map>
#include <string>

#include "../test/simulation.h"
#include "air_ground_common/linear_algebra.h"

namespace ek = ekf_tracker;

namespace {

struct Options {
  int runs = 10000, first_seed = 1;
  double outliers = -1;  // share of the fixes; negative: drawn from 0 to 0.4
  bool repeated = false;
  double gap = 0;  // the camera sees nothing for so long, in mid-flight [s]
  double max_false_start = ek::FilterSettings().max_false_start;
  double places = 0;        // way along which fixes rest on one panorama [m]
  double common = 0;        // share of a fix's variance that is common to those of a panorama
  bool unnamed = false;     // the tracker is not told the panoramas
  double fix_interval = 0;  // [s]; 0: drawn
};

/// What one flight showed.
struct Trial {
  int fixes = 0, wrong = 0, wrong_used = 0, right_refused = 0;
  int looks = 0, started = 0;
  double largest = 0;    ///< squared Mahalanobis distance of the truth
  double error = 0;      ///< position, at the end [m]; NaN: never started
  double first_lie = 0;  ///< when the covariance first excluded the truth [s]
  bool metric = false;
  double started_after = 0;    ///< time of the first pose since take-off [s]; NaN: never
  double distances = 0;        ///< sum over the looks of the squared Mahalanobis distance
  std::vector<double> errors;  ///< position, at the looks [m]
  double sure_after = 0;       ///< from the end of the gap until the pose is sure again [s]; NaN: never
};

constexpr double kGapBegin = 130, kSure = 5;  ///< stamp [s]; largest standard deviation of a sure position [m]

/// Of the squared distance; a right filter passes it once in a million looks.
double bound() {
  static const double bound = ek::chiSquareQuantile(4, 1 - 1e-6);
  return bound;
}

ek::SimulationSettings draw(const Options& o, unsigned seed, double* delay) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(0, 1);
  ek::SimulationSettings s;
  s.seed = seed + 7000000;
  s.metric = uniform(random) < 0.5;
  s.scale = s.metric ? 1 : std::exp(2 * uniform(random) - 1);
  s.fix_interval = 1.5 + 4 * uniform(random);
  s.outlier_share = o.outliers >= 0 ? o.outliers : 0.4 * uniform(random);
  s.fix_stddev *= std::exp(1.4 * uniform(random) - 0.9);  // 0.8 to 3.3 m
  s.outliers_alike = o.repeated;
  s.place_spacing = o.places;
  s.common_share = o.common;
  if (o.fix_interval > 0) s.fix_interval = o.fix_interval;
  *delay = 3 * uniform(random);
  return s;
}

/// Neither odometry nor fixes for `gap` seconds; odometry in an unknown unit comes back with another one.
void blind(double gap, unsigned seed, ek::Simulation* sim) {
  std::mt19937 random(seed);
  const double unit = std::exp(2 * std::uniform_real_distribution<double>(0, 1)(random) - 1);
  const double end = kGapBegin + gap;
  std::vector<ek::Measurement> fixes;
  std::vector<bool> outlier;
  for (std::size_t k = 0; k < sim->fixes.size(); ++k) {
    if (sim->fixes[k].stamp > kGapBegin && sim->fixes[k].stamp < end) continue;
    fixes.push_back(sim->fixes[k]);
    outlier.push_back(sim->outlier[k]);
  }
  sim->fixes = fixes;
  sim->outlier = outlier;
  for (ek::Increment& i : sim->odometry) {
    if (i.metric || i.stamp <= kGapBegin) continue;
    const ek::Vector4d by(unit, unit, unit, 1);
    i.map_id = 1;
    i.motion = by.cwiseProduct(i.motion);
    i.covariance = (by.asDiagonal() * i.covariance * by.asDiagonal()).eval();
  }
}

Trial fly(const Options& o, unsigned seed) {
  double delay = 0;
  const ek::SimulationSettings s = draw(o, seed, &delay);
  ek::TrackerSettings settings;
  settings.filter.max_false_start = o.max_false_start;
  ek::Simulation sim = ek::simulate(s, settings.filter);
  if (o.gap > 0) blind(o.gap, seed, &sim);
  if (o.unnamed)
    for (ek::Measurement& fix : sim.fixes) fix.place = 0;
  ek::Tracker tracker(settings);
  Trial out;
  out.metric = s.metric;
  std::map<double, ek::Result> last_words;
  std::size_t next = 0;
  const std::size_t every = static_cast<std::size_t>(s.rate);
  out.error = out.started_after = out.sure_after = std::nan("");
  for (std::size_t i = 0; i < sim.odometry.size(); ++i) {
    const double since_gap = sim.odometry[i].stamp - kGapBegin - o.gap;
    if (since_gap <= 1e-6 && since_gap > 1e-6 - o.gap) continue;
    tracker.addIncrement(sim.odometry[i]);
    for (; next < sim.fixes.size() && sim.fixes[next].stamp + delay <= sim.odometry[i].stamp; ++next)
      tracker.addMeasurement(sim.fixes[next]);
    for (const ek::Outcome& outcome : tracker.popOutcomes()) last_words[outcome.measurement.stamp] = outcome.result;
    if (std::isnan(out.started_after) && tracker.latest()) out.started_after = sim.odometry[i].stamp - sim.stamps[0];
    const auto estimate = tracker.latest();
    if (o.gap > 0 && since_gap > 0 && std::isnan(out.sure_after) && estimate &&
        estimate->covariance.diagonal().head<3>().maxCoeff() < kSure * kSure)
      out.sure_after = since_gap;
    if (i % every != 0) continue;
    ++out.looks;
    if (!estimate) continue;
    ++out.started;
    const ek::Vector4d e = ek::poseError(estimate->pose, sim.truth[i + 1]);
    const double distance = air_ground_common::squaredMahalanobis(e, estimate->covariance);
    out.largest = std::max(out.largest, distance);
    out.distances += distance;
    out.errors.push_back(e.head<3>().norm());
    if (out.first_lie == 0 && out.largest > bound()) out.first_lie = sim.odometry[i].stamp - sim.stamps[0];
    out.error = e.head<3>().norm();
  }
  for (std::size_t k = 0; k < next; ++k) {
    const auto found = last_words.find(sim.fixes[k].stamp);
    const bool used = found != last_words.end() && ek::isUsed(found->second);
    ++out.fixes;
    out.wrong += sim.outlier[k];
    out.wrong_used += sim.outlier[k] && used;
    out.right_refused += !sim.outlier[k] && found != last_words.end() && found->second == ek::Result::kRefusedByGate;
  }
  return out;
}

/// Largest probability that such a count leaves possible at 95 %; 3 / n where nothing was seen.
double upperBound(long seen, long all) {
  if (seen == 0) return 3.0 / static_cast<double>(all);
  return 0.5 * ek::chiSquareQuantile(static_cast<int>(2 * (seen + 1)), 0.95) / static_cast<double>(all);
}

/// "median, 95 %" of the seconds until the first pose, or until it is sure again.
std::string firstPose(const std::vector<Trial>& trials, double Trial::*after, bool metric, bool clean) {
  std::vector<double> seconds;
  for (const Trial& t : trials)
    if (t.metric == metric && (!clean || t.wrong == 0) && std::isfinite(t.*after)) seconds.push_back(t.*after);
  if (seconds.empty()) return "none";
  std::sort(seconds.begin(), seconds.end());
  char text[80];
  std::snprintf(text, sizeof text, "%.1f, %.1f s (%zu flights)", seconds[seconds.size() / 2],
                seconds[seconds.size() * 95 / 100], seconds.size());
  return text;
}

/// What fixes that share their panorama's error do to the state at the looks.
void reportLooks(const std::vector<Trial>& trials) {
  std::vector<double> errors;
  double distances = 0;
  for (const Trial& t : trials) {
    errors.insert(errors.end(), t.errors.begin(), t.errors.end());
    distances += t.distances;
  }
  if (errors.empty()) return;
  std::sort(errors.begin(), errors.end());
  std::printf("| error at the looks: median, 95 %% | %.2f, %.2f m | |\n", errors[errors.size() / 2],
              errors[errors.size() * 95 / 100]);
  std::printf("| mean squared distance of the truth (4 if honest) | %.2f | |\n",
              distances / static_cast<double>(errors.size()));
}

/// Markdown, for docs/results; the flights that lie one by one to stderr.
void report(const Options& o, const std::vector<Trial>& trials) {
  long fixes = 0, wrong = 0, used = 0, refused = 0, looks = 0, started = 0, infected = 0, lies = 0, far = 0;
  std::vector<double> errors;
  for (const Trial& t : trials) {
    fixes += t.fixes, wrong += t.wrong, used += t.wrong_used, refused += t.right_refused;
    looks += t.looks, started += t.started;
    infected += t.wrong_used > 0;
    if (std::isfinite(t.error)) errors.push_back(t.error);
    if (!(t.largest > bound())) continue;
    ++lies;
    far += t.error > 10;
    std::fprintf(stderr,
                 "seed %ld: excluded from %.0f s on, distance %.1f; %s, %d wrong fixes used, %.1f m off at end\n",
                 o.first_seed + (&t - trials.data()), t.first_lie, std::sqrt(t.largest),
                 t.metric ? "metric" : "unknown unit", t.wrong_used, t.error);
  }
  std::sort(errors.begin(), errors.end());
  std::printf("| %d flights from seed %d | seen | 95 %% bound |\n|---|---|---|\n", o.runs, o.first_seed);
  std::printf("| wrong fixes that entered the state | %ld of %ld, in %ld flights | %.1e a wrong fix |\n", used, wrong,
              infected, upperBound(used, wrong));
  std::printf("| flights whose stated covariance excluded the truth | %ld | %.1e a flight |\n", lies,
              upperBound(lies, o.runs));
  std::printf("| of those more than 10 m off at the end | %ld | |\n", far);
  std::printf("| right fixes refused | %.2f %% of %ld | |\n",
              100.0 * static_cast<double>(refused) / static_cast<double>(fixes - wrong), fixes - wrong);
  std::printf("| with a pose | %.1f %% of %ld looks; %ld flights never | |\n",
              100.0 * static_cast<double>(started) / static_cast<double>(looks), looks, o.runs - long(errors.size()));
  for (const bool metric : {true, false}) {
    const char* unit = metric ? "metric" : "unknown unit";
    std::printf("| first pose, %s: median, 95 %% | %s | |\n", unit,
                firstPose(trials, &Trial::started_after, metric, false).c_str());
    std::printf("| the same, flights without a wrong fix | %s | |\n",
                firstPose(trials, &Trial::started_after, metric, true).c_str());
    if (o.gap > 0)
      std::printf("| sure again (%.0f m) after the gap, %s: median, 95 %% | %s | |\n", kSure, unit,
                  firstPose(trials, &Trial::sure_after, metric, false).c_str());
  }
  if (o.places > 0) reportLooks(trials);
  if (!errors.empty())
    std::printf("| error at the end: median, 99 %%, largest | %.2f, %.2f, %.2f m | |\n", errors[errors.size() / 2],
                errors[errors.size() * 99 / 100], errors.back());
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("How often is the tracker sure and wrong? Random flights with wrong fixes among the right ones");
  Options o;
  app.add_option("--runs", o.runs, "flights");
  app.add_option("--first-seed", o.first_seed, "of the first");
  app.add_option("--outliers", o.outliers, "share of the fixes that are wrong; negative: drawn from 0 to 0.4");
  app.add_option("--max-false-start", o.max_false_start, "the tracker's parameter");
  app.add_flag("--repeated", o.repeated,
               "the wrong fixes of a flight are off by the same, as before a facade that repeats itself");
  app.add_option("--gap", o.gap,
                 "seconds in mid-flight without odometry and fixes; odometry in an unknown unit then has another");
  app.add_option("--places", o.places, "metres of way along which fixes rest on one panorama; 0: they name none");
  app.add_option("--common", o.common, "share of a fix's variance that all fixes of its panorama have in common");
  app.add_flag("--unnamed", o.unnamed, "the tracker is not told the panoramas");
  app.add_option("--fix-interval", o.fix_interval, "[s]; 0: drawn from 1.5 to 5.5");
  CLI11_PARSE(app, argc, argv);

  std::vector<Trial> trials(static_cast<std::size_t>(o.runs));
#pragma omp parallel for schedule(dynamic, 8)
  for (int i = 0; i < o.runs; ++i)
    trials[static_cast<std::size_t>(i)] = fly(o, static_cast<unsigned>(o.first_seed + i));

  report(o, trials);
  return 0;
}
