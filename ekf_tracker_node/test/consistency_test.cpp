// Is the uncertainty honest? Averages over 50 simulated flights against the chi-square distribution.
#include <gtest/gtest.h>

#include <iostream>
#include <map>

#include "air_ground_common/linear_algebra.h"
#include "simulation.h"

namespace ekf_tracker {
namespace {

constexpr int kRuns = 50;
constexpr double kFixDelay = 1.0;

struct Averages {
  std::vector<double> nees;  ///< by checkpoint, every 5 s from 30 s on
  double nis = 0, position_error = 0, yaw_error = 0;
  int fixes = 0, samples = 0, refused_good = 0, used_bad = 0, bad = 0, unstarted = 0;
};

Averages fly(const SimulationSettings& base, unsigned first_seed) {
  Averages out;
  const TrackerSettings settings;
  for (int run = 0; run < kRuns; ++run) {
    SimulationSettings s = base;
    s.seed = first_seed + static_cast<unsigned>(run);
    const Simulation sim = simulate(s, settings.filter);
    Tracker tracker(settings);
    std::size_t next_fix = 0, checkpoint = 0;
    std::map<double, Outcome> last_words;
    for (std::size_t i = 0; i < sim.odometry.size(); ++i) {
      EXPECT_EQ(tracker.addIncrement(sim.odometry[i]), IncrementResult::kUsed);
      const double now = sim.odometry[i].stamp;
      while (next_fix < sim.fixes.size() && sim.fixes[next_fix].stamp + kFixDelay <= now) {
        tracker.addMeasurement(sim.fixes[next_fix]);
        ++next_fix;
        for (const Outcome& o : tracker.popOutcomes()) last_words[o.measurement.stamp] = o;
      }
      const auto estimate = tracker.latest();
      if (estimate) {
        const Matrix4d& p = estimate->covariance;
        EXPECT_EQ(p, p.transpose());
        EXPECT_TRUE(isCovariance(p));
        EXPECT_GT(estimate->scale, 0);
        EXPECT_LE(std::abs(estimate->pose[3]), M_PI);
      }
      const double elapsed = now - sim.stamps[0];
      if (elapsed + 1e-9 < 30 + 5.0 * static_cast<double>(checkpoint)) continue;
      if (out.nees.size() <= checkpoint) out.nees.push_back(0);
      if (!estimate) {
        ++out.unstarted;
      } else {
        const Vector4d e = poseError(estimate->pose, sim.truth[i + 1]);
        out.nees[checkpoint] += air_ground_common::squaredMahalanobis(e, estimate->covariance) / kRuns;
        out.position_error += e.head<3>().norm();
        out.yaw_error += std::abs(e[3]);
        ++out.samples;
      }
      ++checkpoint;
    }
    for (std::size_t k = 0; k < next_fix; ++k) {
      const Outcome& o = last_words.at(sim.fixes[k].stamp);
      const bool bad = sim.outlier[k];
      out.bad += bad;
      out.used_bad += bad && isUsed(o.result);
      out.refused_good += !bad && o.result == Result::kRefusedByGate;
      if (bad || (o.result != Result::kFused && o.result != Result::kRefusedByGate)) continue;
      out.nis += o.nis;
      ++out.fixes;
    }
  }
  out.nis /= out.fixes;
  out.position_error /= out.samples;
  out.yaw_error /= out.samples;
  return out;
}

void expectConsistent(const Averages& a, const char* what) {
  const double low = chiSquareQuantile(4 * kRuns, 0.025) / kRuns, high = chiSquareQuantile(4 * kRuns, 0.975) / kRuns;
  double mean = 0;
  int inside = 0;
  for (const double nees : a.nees) {
    mean += nees / static_cast<double>(a.nees.size());
    inside += nees > low && nees < high;
  }
  const double nis_low = chiSquareQuantile(4 * a.fixes, 0.025) / a.fixes,
               nis_high = chiSquareQuantile(4 * a.fixes, 0.975) / a.fixes;
  std::cout << what << ": average NEES " << mean << " (95 %: " << low << " to " << high << "), " << inside << " of "
            << a.nees.size() << " checkpoints inside; NIS " << a.nis << " of " << a.fixes << " fixes (95 %: " << nis_low
            << " to " << nis_high << "); mean error " << a.position_error << " m, " << a.yaw_error * 180 / M_PI
            << " deg; good fixes refused " << a.refused_good << '\n';
  EXPECT_EQ(a.unstarted, 0);
  EXPECT_GT(mean, low);
  EXPECT_LT(mean, high);
  EXPECT_GE(inside, static_cast<int>(a.nees.size()) - 2);
  EXPECT_GT(a.nis, nis_low);
  EXPECT_LT(a.nis, nis_high);
  EXPECT_LE(a.refused_good, std::max(3, a.fixes / 100));
}

TEST(Consistency, MetricOdometryFixesASecondLate) { expectConsistent(fly(SimulationSettings(), 1000), "metric"); }

TEST(Consistency, OdometryInAnUnknownUnit) {
  SimulationSettings s;
  s.metric = false;
  s.scale = 2.5;
  expectConsistent(fly(s, 2000), "unknown unit");
}

TEST(Consistency, NoGrossOutlierEntersTheState) {
  SimulationSettings s;
  s.outlier_share = 0.2;
  for (const bool metric : {true, false}) {
    s.metric = metric;
    s.scale = metric ? 1 : 0.4;
    const Averages a = fly(s, 3000);
    std::cout << (metric ? "metric" : "unknown unit") << ", outliers " << a.bad << ", used " << a.used_bad
              << ", good refused " << a.refused_good << ", mean error " << a.position_error << " m\n";
    EXPECT_GT(a.bad, 150);
    EXPECT_EQ(a.used_bad, 0);
    EXPECT_LT(a.position_error, 2.5);
  }
}

}  // namespace
}  // namespace ekf_tracker
