#include "ekf_tracker/pose_filter.h"

#include <gtest/gtest.h>

#include <random>
#include <stdexcept>

#include "air_ground_common/geometry.h"
#include "air_ground_common/linear_algebra.h"
#include "simulation.h"

namespace ekf_tracker {
namespace {

const Matrix4d kFixCovariance = Vector4d(4, 5, 2, 0.017).asDiagonal();

Measurement fixAt(const Vector4d& value, double stamp = 0) {
  Measurement m;
  m.stamp = stamp;
  m.value = value;
  m.covariance = kFixCovariance;
  return m;
}

Increment stepOf(const Vector4d& motion, double stddev = 0.01) {
  Increment i;
  i.stamp = 0.05;
  i.motion = motion;
  i.covariance = Vector4d(stddev, stddev, stddev, 0.003).cwiseAbs2().asDiagonal();
  return i;
}

// As in the paper: whatever two fixes that agree start the filter, and give the scale.
FilterSettings twoStart() {
  FilterSettings settings;
  settings.max_false_start = 1;
  settings.unscaled_start_fixes = 2;
  return settings;
}

Measurement preciseFixAt(const Vector4d& value, double stamp = 0) {
  Measurement m = fixAt(value, stamp);
  m.covariance *= 0.01;
  return m;
}

// The odometry is silent, as Tracker bridges it with the settings' speed and turn rate.
void passGap(double seconds, PoseFilter* filter) {
  Increment gap;
  gap.gap = true;
  gap.stamp = seconds;
  const double moved = 1.5 * seconds, turned = std::min(0.3 * seconds, M_PI / std::sqrt(3.0));
  gap.covariance = Vector4d(moved, moved, moved, turned).cwiseAbs2().asDiagonal();
  filter->predict(gap);
}

// Two fixes at one place start the filter there, with half a fix's covariance.
void startAt(const Vector4d& pose, PoseFilter* filter) {
  EXPECT_EQ(filter->correct(fixAt(pose)).result, Result::kWaiting);
  EXPECT_FALSE(filter->started());
  EXPECT_EQ(filter->correct(fixAt(pose)).result, Result::kInitialised);
}

TEST(PoseFilter, GatesAreChiSquareQuantiles) {
  EXPECT_NEAR(chiSquareQuantile(1, 0.9973), 9.0, 0.01);
  EXPECT_NEAR(chiSquareQuantile(3, 0.9973), 14.156, 0.01);
  EXPECT_NEAR(chiSquareQuantile(4, 0.9973), 16.251, 0.01);
}

TEST(PoseFilter, FusionIsEquations12And13) {
  PoseFilter filter(twoStart());
  const Vector4d first(1, 2, 3, 0.5), second(2.5, 1, 3.5, 0.6);
  startAt(first, &filter);
  EXPECT_LT((filter.state().x.head<4>() - first).norm(), 1e-9);
  const Outcome out = filter.correct(fixAt(second));
  EXPECT_EQ(out.result, Result::kFused);
  EXPECT_EQ(out.dof, 4);
  const Vector4d difference = second - first;
  EXPECT_NEAR(out.nis, air_ground_common::squaredMahalanobis(difference, 1.5 * kFixCovariance), 1e-9);
  // Three of equal covariance: their mean, with a third of it.
  EXPECT_LT((filter.state().x.head<4>() - (2 * first + second) / 3).norm(), 1e-9);
  EXPECT_LT((filter.state().covariance.topLeftCorner<4, 4>() - kFixCovariance / 3).norm(), 1e-9);
}

TEST(PoseFilter, YawIsWrappedInStateAndInnovation) {
  PoseFilter filter(twoStart());
  startAt({0, 0, 0, 3.1}, &filter);
  const Outcome out = filter.correct(fixAt({0, 0, 0, -3.1}));
  EXPECT_EQ(out.result, Result::kFused);
  EXPECT_NEAR(out.innovation[3], 2 * M_PI - 6.2, 1e-12);
  EXPECT_NEAR(filter.state().x[3], 3.1 + (2 * M_PI - 6.2) / 3, 1e-9);
  filter.predict(stepOf({1, 0, 0, 0.2}));
  EXPECT_LE(std::abs(filter.state().x[3]), M_PI);
  // Flying "ahead" while looking west.
  EXPECT_NEAR(filter.state().x[0], -1, 1e-3);
}

TEST(PoseFilter, OutlierIsRefusedAndLeavesTheStateAlone) {
  PoseFilter filter;
  filter.correct(fixAt({0, 0, 0, 0}));
  filter.correct(fixAt({0, 0, 0, 0}));
  filter.correct(fixAt({0, 0, 0, 0}));
  const Vector6d before = filter.state().x;
  EXPECT_EQ(filter.correct(fixAt({30, 0, 0, 0})).result, Result::kRefusedByGate);
  EXPECT_EQ(filter.correct(fixAt({0, 0, 0, 1.5})).result, Result::kRefusedByGate);
  EXPECT_EQ(filter.state().x, before);
  EXPECT_EQ(filter.correct(fixAt({1, 0, 0, 0})).result, Result::kFused);
  EXPECT_EQ(filter.hypotheses(), 0);
}

TEST(PoseFilter, FirstFixWrongRecoversWithinFiveGoodOnes) {
  const FilterSettings settings;
  for (const bool metric : {true, false}) {
    int recovered = 0;
    constexpr int kRuns = 50;
    for (unsigned seed = 0; seed < kRuns; ++seed) {
      SimulationSettings s;
      s.seed = 500 + seed;
      s.metric = metric;
      s.scale = metric ? 1 : 3;
      s.fix_interval = 8;  // in an unknown unit two fixes must be far enough apart to give the scale
      Simulation sim = simulate(s, settings);
      sim.fixes[0].value += Vector4d(40, -30, 3, 1.0);
      sim.fixes[0].value[3] = air_ground_common::wrapAngle(sim.fixes[0].value[3]);
      Tracker tracker;
      for (std::size_t i = 0; i < 6; ++i) tracker.addMeasurement(sim.fixes[i]);
      for (std::size_t i = 0; sim.odometry[i].previous_stamp < sim.fixes[5].stamp; ++i)
        tracker.addIncrement(sim.odometry[i]);
      const auto estimate = tracker.latest();
      if (!estimate) continue;
      const auto index = static_cast<std::size_t>(std::lround((estimate->stamp - sim.stamps[0]) * s.rate));
      const Vector4d e = poseError(estimate->pose, sim.truth[index]);
      const double nees = air_ground_common::squaredMahalanobis(e, estimate->covariance);
      recovered += e.head<3>().norm() < 10 && nees < chiSquareQuantile(4, 0.9999);
    }
    std::cout << (metric ? "metric" : "unknown unit") << ": recovered in " << recovered << " of " << kRuns << '\n';
    EXPECT_GE(recovered, kRuns - 1);
  }
}

TEST(PoseFilter, ASingleFixStartsNothing) {
  for (const bool metric : {true, false}) {
    PoseFilter filter;
    filter.restart(metric, 0);
    Vector4d q(0, 0, 0, 0);
    const auto fly = [&] {
      Increment increment = stepOf({20, 0, 0, 0}, 0.1);
      increment.stamp = 1;
      increment.metric = metric;
      filter.predict(increment);
      q[0] += 20;
    };
    // A wrong one of small stated covariance comes first: no pose, so no prior that would keep good ones away.
    Measurement wrong = fixAt(q + Vector4d(40, 45, 0, 0), 1);
    wrong.covariance = Vector4d(0.04, 0.04, 0.04, 1e-4).asDiagonal();
    EXPECT_EQ(filter.correct(wrong).result, Result::kWaiting);
    fly();
    EXPECT_EQ(filter.correct(fixAt(q, 2)).result, Result::kWaiting);
    EXPECT_FALSE(filter.started());
    EXPECT_EQ(filter.hypotheses(), 2);
    fly();
    EXPECT_EQ(filter.correct(fixAt(q, 3)).result, Result::kWaiting);  // metres of noise: two may agree by chance
    fly();
    const Outcome out = filter.correct(fixAt(q, 4));
    EXPECT_EQ(out.result, Result::kInitialised);
    EXPECT_EQ(out.joined, std::vector<double>({2, 3}));
    EXPECT_LT((filter.state().x.head<4>() - q).norm(), 0.5);
    EXPECT_EQ(filter.starts(), 1);
  }
}

TEST(PoseFilter, PreciseFixesNeedNoThird) {
  // Standard deviations of a tenth: two such agree by chance ten thousand times more rarely.
  PoseFilter filter;
  const Measurement fix = preciseFixAt({1, 2, 3, 0.5});
  EXPECT_EQ(filter.correct(fix).result, Result::kWaiting);
  EXPECT_EQ(filter.correct(fix).result, Result::kInitialised);
}

// Fixes drawn anywhere, all of them wrong: each may found a hypothesis, which others join with the probability stated.
TEST(PoseFilter, WrongFixesStartNoMoreOftenThanStated) {
  constexpr int kRuns = 3000, kFixes = 8;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> uniform(0, 1);
  const auto starts = [&](const FilterSettings& settings) {
    int started = 0;
    for (int run = 0; run < kRuns; ++run) {
      PoseFilter filter(settings);
      for (int i = 0; i < kFixes; ++i) {
        const double away = 50 * std::sqrt(uniform(random)), direction = 2 * M_PI * uniform(random);
        filter.correct(fixAt({away * std::cos(direction), away * std::sin(direction), 10 * uniform(random),
                              2 * M_PI * uniform(random) - M_PI}));
      }
      started += filter.started();
    }
    return started;
  };
  FilterSettings settings = twoStart();
  EXPECT_GT(starts(settings), kRuns / 50);
  settings.max_false_start = 1e-3;
  EXPECT_LE(starts(settings), kRuns * kFixes * settings.max_false_start);
}

// In an unknown unit by its age; metric odometry tells how far off it may be.
TEST(PoseFilter, AFixThatNoneJoinsIsForgotten) {
  PoseFilter filter;
  filter.restart(false, 0);
  Increment step = stepOf({0, 0, 0, 0});
  step.stamp = 1;
  step.metric = false;
  filter.correct(fixAt({0, 0, 0, 0}));
  for (int i = 0; i < 59; ++i) filter.predict(step);
  EXPECT_EQ(filter.hypotheses(), 1);
  filter.predict(step);
  filter.predict(step);
  EXPECT_EQ(filter.hypotheses(), 0);
  // A gap of ten seconds, 15 m at one sigma: whatever agrees after it says little.
  filter.restart(true, 0);
  filter.correct(fixAt({0, 0, 0, 0}));
  step.metric = true;
  step.gap = true;
  step.covariance = Vector4d(15, 15, 15, 1).cwiseAbs2().asDiagonal();
  filter.predict(step);
  EXPECT_EQ(filter.hypotheses(), 0);
  EXPECT_EQ(filter.correct(fixAt({20, 0, 0, 0})).result, Result::kWaiting);
}

TEST(PoseFilter, FixesMoreThanAMinuteApartStartIt) {
  PoseFilter filter;
  Increment step = stepOf({1, 0, 0, 0.01});
  step.stamp = 1;
  step.scale_stddev = 0.01;
  filter.restart(true, step.scale_stddev);
  Vector4d q(5, -3, 2, 0.4);
  EXPECT_EQ(filter.correct(preciseFixAt(q, 0)).result, Result::kWaiting);
  for (int i = 0; i < 75; ++i) {
    filter.predict(step);
    q = move<double>(q, step.motion, 1);
  }
  EXPECT_EQ(filter.correct(preciseFixAt(q + Vector4d(0, 30, 0, 0), 75)).result, Result::kWaiting);  // a wrong one
  EXPECT_EQ(filter.correct(preciseFixAt(q, 75)).result, Result::kInitialised);
  EXPECT_LT((filter.state().x.head<4>() - q).norm(), 0.1);
}

TEST(PoseFilter, WrongFixAfterAGapIsKeptAside) {
  PoseFilter filter;
  filter.correct(preciseFixAt({0, 0, 0, 0}));
  filter.correct(preciseFixAt({0, 0, 0, 0}));
  passGap(10, &filter);
  const State before = filter.state();
  const Outcome wrong = filter.correct(preciseFixAt({40, 0, 0, 0}, 1));
  EXPECT_NEAR(wrong.nis, 40 * 40 / 225.0, 0.1);  // far inside the gate
  EXPECT_EQ(wrong.result, Result::kWaiting);
  EXPECT_EQ(filter.state().x, before.x);
  EXPECT_EQ(filter.state().covariance, before.covariance);
  const Vector4d truth(6, -9, 2, 0.8);
  EXPECT_EQ(filter.correct(preciseFixAt(truth, 2)).result, Result::kWaiting);
  EXPECT_EQ(filter.hypotheses(), 2);
  const Outcome right = filter.correct(preciseFixAt(truth, 3));
  EXPECT_EQ(right.result, Result::kInitialised);
  EXPECT_EQ(right.joined, std::vector<double>({2}));
  EXPECT_LT((filter.state().x.head<4>() - truth).norm(), 0.1);
}

TEST(PoseFilter, RightFixAfterAGapIsConfirmedByTheNext) {
  const Vector4d truth(12, -9, 2, 0.8);
  for (const double gap : {10.0, 60.0}) {
    PoseFilter filter;
    filter.correct(preciseFixAt({0, 0, 0, 0}));
    filter.correct(preciseFixAt({0, 0, 0, 0}));
    passGap(gap, &filter);
    EXPECT_EQ(filter.correct(preciseFixAt(truth, 1)).result, Result::kWaiting);
    EXPECT_GT(filter.state().covariance(0, 0), 200);
    EXPECT_EQ(filter.correct(preciseFixAt(truth, 2)).result, Result::kInitialised);
    EXPECT_LT((filter.state().x.head<4>() - truth).norm(), 0.1);
    EXPECT_LT(filter.state().covariance(0, 0), 0.04);
    EXPECT_EQ(filter.recoveries(), 0);
    EXPECT_EQ(filter.correct(preciseFixAt(truth, 3)).result, Result::kFused);
  }
}

TEST(PoseFilter, OneFixDoesWhereThePredictionSaysEnough) {
  // Within metres after a second's silence; at the paper's noise, whose fixes never have the odds of precise ones,
  // a second after another.
  PoseFilter precise, noisy(twoStart());
  precise.correct(preciseFixAt({0, 0, 0, 0}));
  precise.correct(preciseFixAt({0, 0, 0, 0}));
  passGap(1, &precise);
  EXPECT_EQ(precise.correct(preciseFixAt({1.5, -1, 0.5, 0.2})).result, Result::kFused);
  Measurement fix = fixAt({0, 0, 0, 0});
  fix.covariance = Vector4d(4.2, 4.3, 3.6, 0.131).cwiseAbs2().asDiagonal();
  noisy.correct(fix);
  EXPECT_EQ(noisy.correct(fix).result, Result::kInitialised);
  fix.value << 14, 14, 0, 0;
  const Outcome out = noisy.correct(fix);
  EXPECT_GT(out.nis, 12);
  EXPECT_EQ(out.result, Result::kFused);
}

TEST(PoseFilter, WrongFixInANewMapOfUnknownScaleIsKeptAside) {
  PoseFilter filter;
  filter.restart(false, 0);
  const double scale = 2.5;
  Vector4d q(0, 0, 0, 0.4);
  const auto fly = [&](bool new_unit) {
    Increment increment = stepOf({20 / scale, 0, 0, 0.1}, 0.1 / scale);
    increment.stamp = 10;
    increment.metric = false;
    increment.new_unit = new_unit;
    filter.predict(increment);
    q = move<double>(q, increment.motion, scale);
  };
  for (int i = 0; i < 3; ++i) {
    filter.correct(preciseFixAt(q));
    fly(false);
  }
  ASSERT_TRUE(filter.started());
  fly(true);
  const State before = filter.state();
  const Outcome wrong = filter.correct(preciseFixAt(Vector4d(before.x.head<4>() + Vector4d(0, 40, 0, 0)), 1));
  EXPECT_LT(wrong.nis, wrong.gate);
  EXPECT_EQ(wrong.result, Result::kWaiting);
  EXPECT_EQ(filter.state().x, before.x);
  EXPECT_EQ(filter.state().covariance, before.covariance);
  for (const Result expected : {Result::kWaiting, Result::kWaiting, Result::kInitialised}) {
    fly(false);
    EXPECT_EQ(filter.correct(preciseFixAt(q)).result, expected);
  }
  EXPECT_LT((filter.state().x.head<4>() - q).norm(), 0.5);
  EXPECT_NEAR(filter.state().x[4], scale, 0.05);
}

TEST(PoseFilter, SteadyFilterNeedsThreeAgreeingFixesToGiveUp) {
  PoseFilter filter;
  for (int i = 0; i < 6; ++i) filter.correct(fixAt({0, 0, 0, 0}));
  EXPECT_EQ(filter.correct(fixAt({40, 0, 0, 0})).result, Result::kRefusedByGate);
  EXPECT_EQ(filter.correct(fixAt({0, 60, 0, 0})).result, Result::kRefusedByGate);  // an outlier between them
  EXPECT_EQ(filter.correct(fixAt({41, 1, 0, 0})).result, Result::kRefusedByGate);
  EXPECT_EQ(filter.strongestHypothesis(), 2);
  EXPECT_EQ(filter.correct(fixAt({39, 0, 0, 0})).result, Result::kRecovered);
  EXPECT_NEAR(filter.state().x[0], 40, 0.5);
  EXPECT_EQ(filter.recoveries(), 1);
}

TEST(PoseFilter, ScaleFromTwoFixesAndItsUncertainty) {
  // A single straight leg, many draws: the error of the scale must match what the filter claims.
  std::mt19937 random(7);
  double normalised = 0;
  int solved = 0;
  for (int run = 0; run < 400; ++run) {
    PoseFilter filter(twoStart());
    filter.restart(false, 0);
    const double scale = 2.5;
    Vector4d q(0, 0, 0, 1);
    EXPECT_EQ(filter.correct(fixAt(q + gaussian(&random, kFixCovariance))).result, Result::kWaiting);
    for (int i = 0; i < 400; ++i) {
      Increment increment = stepOf({0, -0.1 / scale, 0, 0}, 0.01 / scale);
      increment.metric = false;
      q = move<double>(q, increment.motion, scale);
      increment.motion += gaussian(&random, increment.covariance);
      filter.predict(increment);
      if (i == 20) {
        // Two metres on: too close to say anything about the scale.
        EXPECT_EQ(filter.correct(fixAt(q)).result, Result::kWaiting);
      }
    }
    if (filter.correct(fixAt(q + gaussian(&random, kFixCovariance))).result != Result::kInitialised) continue;
    ++solved;
    const double error = filter.state().x[4] - scale;
    normalised += error * error / filter.state().covariance(4, 4);
    EXPECT_LT(std::sqrt(filter.state().covariance(4, 4)), 0.15 * scale);
  }
  EXPECT_GT(solved, 395);
  EXPECT_NEAR(normalised / solved, 1, 0.2);
}

TEST(PoseFilter, FixesThatContradictTheOdometryGiveNoScale) {
  PoseFilter filter(twoStart());
  filter.restart(false, 0);
  filter.correct(fixAt({0, 0, 0, 0}));
  Increment increment = stepOf({20, 0, 0, 0}, 0.5);
  increment.metric = false;
  filter.predict(increment);
  // The odometry flew ahead, the second fix lies behind.
  EXPECT_EQ(filter.correct(fixAt({-30, 0, 0, 0})).result, Result::kWaiting);
  EXPECT_EQ(filter.correct(fixAt({30, 0, 0, 2})).result, Result::kWaiting);
  EXPECT_EQ(filter.correct(fixAt({30, 0, 0, 0})).result, Result::kInitialised);
  EXPECT_NEAR(filter.state().x[4], 1.5, 0.05);
}

TEST(PoseFilter, HeadingGpsAndBarometerAreWeakCorrections) {
  PoseFilter filter(twoStart());
  Measurement heading;
  heading.source = Source::kHeading;
  heading.value[0] = 0.1;
  heading.covariance(0, 0) = 0.01;
  EXPECT_EQ(filter.correct(heading).result, Result::kNotStarted);
  startAt({0, 0, 10, 0}, &filter);
  EXPECT_EQ(filter.correct(heading).result, Result::kFused);
  EXPECT_NEAR(filter.state().x[3], 0.1 * 0.0085 / 0.0185, 1e-9);
  heading.value[0] = 2;
  EXPECT_EQ(filter.correct(heading).result, Result::kRefusedByGate);

  Measurement gps;
  gps.source = Source::kGps;
  gps.value << 3, 0, 10, 0;
  gps.covariance.topLeftCorner<3, 3>() = Eigen::Vector3d(16, 16, 64).asDiagonal();
  EXPECT_EQ(filter.correct(gps).result, Result::kFused);
  EXPECT_NEAR(filter.state().x[0], 3 * 2.0 / 18, 1e-9);

  Measurement pressure;
  pressure.source = Source::kBarometer;
  pressure.covariance(0, 0) = 0.01;
  pressure.value[0] = 471;
  EXPECT_EQ(filter.correct(pressure).result, Result::kFused);
  EXPECT_NEAR(filter.state().x[2], 10, 1e-9);  // the first only sets the level
  EXPECT_EQ(filter.state().support, 2);
  // Odometry loses the height, the barometer keeps it.
  Increment climb = stepOf({0, 0, 0, 0}, 3);
  climb.stamp = 1;
  filter.predict(climb);
  pressure.value[0] = 476;
  EXPECT_EQ(filter.correct(pressure).result, Result::kFused);
  EXPECT_NEAR(filter.state().x[2], 15, 0.2);
  EXPECT_TRUE(isCovariance(filter.state().covariance));
}

TEST(PoseFilter, FactorAndFloorsOfAStep) {
  FilterSettings settings;
  settings.covariance_factor = 4;
  Increment step = stepOf({1, 0, 0, 0}, 0.1);
  EXPECT_NEAR(noiseOf(step, settings)(0, 0), 4 * 0.01 + 1e-6, 1e-12);
  step.assumed_covariance = true;
  EXPECT_NEAR(noiseOf(step, settings)(0, 0), 0.01 + 1e-6, 1e-12);
  step.gap = true;
  EXPECT_EQ(noiseOf(step, settings), step.covariance);
}

TEST(PoseFilter, SettingsOutOfRangeAreNamed) {
  FilterSettings s;
  s.gate_probability = 99.73;
  EXPECT_THROW(PoseFilter{s}, std::invalid_argument);
  s = FilterSettings();
  s.min_yaw_stddev = 0;
  EXPECT_THROW(PoseFilter{s}, std::invalid_argument);
}

}  // namespace
}  // namespace ekf_tracker
