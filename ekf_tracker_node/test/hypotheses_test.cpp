// What ends a hypothesis and what does not: vague fixes, short silences of the odometry.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iostream>
#include <random>

#include "simulation.h"

namespace ekf_tracker {
namespace {

constexpr double kPrecise = 0.25, kVague = 3;  // [m]

Measurement fixAt(double x, double stddev, double stamp = 0) {
  Measurement m;
  m.stamp = stamp;
  m.value[0] = x;
  m.covariance = Vector4d(stddev, stddev, stddev, stddev == kVague ? 0.08 : 0.02).cwiseAbs2().asDiagonal();
  return m;
}

Increment second() {
  Increment step;
  step.stamp = 1;
  step.covariance = Vector4d(0.01, 0.01, 0.01, 0.001).cwiseAbs2().asDiagonal();
  return step;
}

PoseFilter sureOf(double x) {
  PoseFilter filter;
  for (int i = 0; i < 10; ++i) filter.correct(fixAt(x, kPrecise, i));
  EXPECT_TRUE(filter.started());
  return filter;
}

TEST(Hypotheses, AFixThatFitsTheStateEndsTheRivalsThatItContradicts) {
  PoseFilter filter = sureOf(0);
  EXPECT_EQ(filter.correct(fixAt(4, kPrecise)).result, Result::kRefusedByGate);
  EXPECT_EQ(filter.correct(fixAt(4, kPrecise)).result, Result::kRefusedByGate);
  // A vague one between them fits both, and counts for neither against the other.
  EXPECT_EQ(filter.correct(fixAt(2, kVague)).result, Result::kFused);
  EXPECT_EQ(filter.strongestHypothesis(), 2);
  PoseFilter contradicted = filter;
  EXPECT_EQ(contradicted.correct(fixAt(0, kPrecise)).result, Result::kFused);
  EXPECT_EQ(contradicted.hypotheses(), 0);
  EXPECT_EQ(filter.correct(fixAt(4, kPrecise)).result, Result::kRecovered);
  EXPECT_NEAR(filter.state().x[0], 4, 0.1);
}

TEST(Hypotheses, VagueFixesThatFitBothReplaceNothing) {
  PoseFilter filter = sureOf(0);
  EXPECT_EQ(filter.correct(fixAt(4, kPrecise)).result, Result::kRefusedByGate);
  for (int i = 0; i < 50; ++i) EXPECT_EQ(filter.correct(fixAt(2, kVague)).result, Result::kFused);
  EXPECT_EQ(filter.recoveries(), 0);
  EXPECT_LE(filter.strongestHypothesis(), 1);
}

TEST(Hypotheses, RightFixesOfAnyNoiseReplaceAWrongState) {
  constexpr int kRuns = 200;
  for (const double off : {4.0, 6.0}) {
    double sum = 0;
    int most = 0;
    for (unsigned seed = 0; seed < kRuns; ++seed) {
      std::mt19937 random(seed);
      PoseFilter filter = sureOf(off);
      int fixes = 0;
      do {
        filter.predict(second());
        Measurement fix = fixAt(0, fixes % 3 == 2 ? kVague : kPrecise, 10 + fixes);
        fix.value += gaussian(&random, fix.covariance);
        filter.correct(fix);
        ++fixes;
      } while (std::abs(filter.state().x[0]) > 1.5 && fixes < 100);
      sum += fixes;
      most = std::max(most, fixes);
    }
    std::cout << off << " m off: back after " << sum / kRuns << " fixes, at most " << most << '\n';
    EXPECT_LT(sum / kRuns, 5);
    EXPECT_LT(most, 12);
  }
}

TEST(Hypotheses, OdometryThatLosesSingleImagesGetsItsScale) {
  constexpr int kRuns = 40, kEvery = 80;  // 4 s, less than between two fixes
  int started = 0, honest = 0;
  for (unsigned seed = 0; seed < kRuns; ++seed) {
    SimulationSettings s;
    s.seed = 700 + seed;
    s.metric = false;
    s.scale = 1.7;
    s.fix_interval = 5.5;
    const Simulation sim = simulate(s, FilterSettings());
    Tracker tracker;
    std::size_t next = 0, last = 0;
    for (std::size_t i = 0; i < sim.odometry.size(); ++i) {
      if (i % kEvery == kEvery - 1) continue;
      tracker.addIncrement(sim.odometry[last = i]);
      for (; next < sim.fixes.size() && sim.fixes[next].stamp <= sim.odometry[i].stamp; ++next)
        tracker.addMeasurement(sim.fixes[next]);
    }
    const auto estimate = tracker.latest();
    if (!estimate || !estimate->scale_known) continue;
    ++started;
    const Vector4d e = poseError(estimate->pose, sim.truth[last + 1]);
    honest += e.dot(estimate->covariance.ldlt().solve(e)) < chiSquareQuantile(4, 0.999);
  }
  std::cout << "started " << started << " of " << kRuns << ", honest " << honest << '\n';
  EXPECT_GE(started, kRuns - 2);
  EXPECT_GE(honest, started - 1);
}

TEST(Hypotheses, ASilenceOfHalfASecondIsAsLongInPieces) {
  for (const double seconds : {0.4, 0.6}) {
    for (const int pieces : {1, 3}) {
      PoseFilter filter;
      filter.restart(false, 0);
      filter.correct(fixAt(0, kPrecise));
      Increment step = second();
      step.metric = false;
      step.motion[0] = 2;
      filter.predict(step);
      Increment gap;
      gap.gap = true;
      gap.metric = false;
      gap.stamp = seconds / pieces;
      for (int i = 0; i < pieces; ++i) filter.predict(gap);
      EXPECT_EQ(filter.hypotheses(), seconds < 0.5 ? 1 : 0) << seconds << ' ' << pieces;
    }
  }
}

}  // namespace
}  // namespace ekf_tracker
