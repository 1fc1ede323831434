#include "ekf_tracker/tracker.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <map>
#include <random>
#include <stdexcept>

#include "air_ground_common/linear_algebra.h"
#include "simulation.h"

namespace ekf_tracker {
namespace {

struct Delivery {
  double arrival;
  Measurement measurement;
};

// All sensors of a flight, some between odometry stamps, with the arrival that `delay` gives.
template <typename Delay>
std::vector<Delivery> deliveries(const Simulation& sim, Delay delay) {
  std::vector<Delivery> out;
  for (const Measurement& fix : sim.fixes) out.push_back({fix.stamp + delay(), fix});
  for (std::size_t i = 7; i < sim.truth.size(); i += 13) {
    Measurement m;
    m.source = Source::kHeading;
    m.stamp = sim.stamps[i] - 0.021;
    m.value[0] = sim.truth[i][3] + 0.02 * static_cast<double>(i % 5);
    m.covariance(0, 0) = 0.03;
    out.push_back({m.stamp + delay(), m});
    m.source = Source::kBarometer;
    m.stamp += 0.007;
    m.value[0] = 400 + sim.truth[i][2];
    m.covariance(0, 0) = 0.1;
    out.push_back({m.stamp + delay(), m});
  }
  std::stable_sort(out.begin(), out.end(), [](const Delivery& a, const Delivery& b) { return a.arrival < b.arrival; });
  return out;
}

PoseEstimate run(const Simulation& sim, const std::vector<Delivery>& all, std::map<Result, int>* results = nullptr) {
  Tracker tracker;
  std::size_t next = 0;
  for (const Increment& increment : sim.odometry) {
    for (; next < all.size() && all[next].arrival <= increment.stamp; ++next)
      tracker.addMeasurement(all[next].measurement);
    tracker.addIncrement(increment);
  }
  for (; next < all.size(); ++next) tracker.addMeasurement(all[next].measurement);
  if (results)
    for (const Outcome& o : tracker.popOutcomes()) ++(*results)[o.result];
  return *tracker.latest();
}

TEST(Tracker, DelayedMeasurementsGiveWhatOrderedOnesGive) {
  for (const bool metric : {true, false}) {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      SimulationSettings s;
      s.seed = seed;
      s.metric = metric;
      s.scale = metric ? 1 : 2;
      s.duration = 40;
      s.outlier_share = 0.2;
      const Simulation sim = simulate(s, FilterSettings());
      std::mt19937 random(seed);
      std::uniform_real_distribution<double> uniform(0, 3);
      const PoseEstimate ordered = run(sim, deliveries(sim, [] { return 0.0; }));
      const PoseEstimate late = run(sim, deliveries(sim, [] { return 1.0; }));
      const PoseEstimate shuffled = run(sim, deliveries(sim, [&] { return uniform(random); }));
      for (const PoseEstimate* other : {&late, &shuffled}) {
        EXPECT_LT(poseError(other->pose, ordered.pose).norm(), 1e-9);
        EXPECT_LT((other->covariance - ordered.covariance).norm(), 1e-9);
        EXPECT_NEAR(other->scale, ordered.scale, 1e-9);
        EXPECT_EQ(other->support, ordered.support);
      }
      // The comparison can fail: dropping the delay's compensation is visible.
      std::vector<Delivery> mislabelled = deliveries(sim, [] { return 1.0; });
      for (Delivery& d : mislabelled) d.measurement.stamp += 1.0;
      EXPECT_GT(poseError(run(sim, mislabelled).pose, ordered.pose).norm(), 0.1);
    }
  }
}

TEST(Tracker, EstimateAtAnEarlierTimeIsTheOneOfThatTime) {
  SimulationSettings s;
  s.duration = 20;
  const Simulation sim = simulate(s, FilterSettings());
  Tracker tracker;
  for (const Measurement& fix : sim.fixes) tracker.addMeasurement(fix);
  std::optional<PoseEstimate> then;
  for (const Increment& increment : sim.odometry) {
    tracker.addIncrement(increment);
    if (!then && increment.stamp >= 110) then = tracker.latest();
  }
  const auto now = tracker.at(then->stamp);
  ASSERT_TRUE(now);
  EXPECT_LT((now->pose - then->pose).norm(), 1e-12);
  const auto between = tracker.at(then->stamp + 0.02);
  EXPECT_LT(poseError(between->pose, then->pose).norm(), 0.1);
  EXPECT_GT(poseError(between->pose, then->pose).norm(), 0.01);
  EXPECT_FALSE(tracker.at(1e6));
  EXPECT_FALSE(tracker.at(0));
  EXPECT_FALSE(tracker.at(std::numeric_limits<double>::quiet_NaN()));
}

TEST(Tracker, TenSecondGapIsBridgedAndHealedByTheNextFixes) {
  SimulationSettings s;
  s.seed = 3;
  const Simulation sim = simulate(s, FilterSettings());
  Tracker tracker;
  int gaps = 0;
  std::size_t next = 0;
  double before_gap = 0, after_gap = 0;
  for (std::size_t i = 0; i < sim.odometry.size(); ++i) {
    const Increment& increment = sim.odometry[i];
    for (; next < sim.fixes.size() && sim.fixes[next].stamp <= increment.stamp; ++next) {
      // No fixes in the gap either.
      if (sim.fixes[next].stamp < 130 || sim.fixes[next].stamp > 140) tracker.addMeasurement(sim.fixes[next]);
    }
    if (increment.previous_stamp >= 130 - 1e-6 && increment.previous_stamp < 140 - 1e-6) continue;
    if (i == 599) before_gap = std::sqrt(tracker.latest()->covariance(0, 0));
    const IncrementResult result = tracker.addIncrement(increment);
    gaps += result == IncrementResult::kUsedAfterGap;
    if (result == IncrementResult::kUsedAfterGap) after_gap = std::sqrt(tracker.latest()->covariance(0, 0));
  }
  EXPECT_EQ(gaps, 1);
  EXPECT_GT(after_gap, before_gap + 10);
  const Vector4d e = poseError(tracker.latest()->pose, sim.truth.at(sim.odometry.size()));
  EXPECT_LT(e.head<3>().norm(), 5);
  EXPECT_EQ(tracker.filter().recoveries(), 0);
}

TEST(Tracker, BadInputIsRefusedByName) {
  TrackerSettings settings;
  settings.filter.covariance_factor = 25;
  Tracker tracker(settings);
  Increment step;
  step.previous_stamp = 10;
  step.stamp = 10.05;
  step.motion << 0.1, 0, 0, 0;
  step.covariance = Matrix4d::Identity() * 1e-4;
  EXPECT_EQ(tracker.addIncrement(step), IncrementResult::kUsed);
  EXPECT_EQ(tracker.addIncrement(step), IncrementResult::kOutOfOrder);  // repeated
  std::swap(step.previous_stamp, step.stamp);
  EXPECT_EQ(tracker.addIncrement(step), IncrementResult::kOutOfOrder);
  step.previous_stamp = 10.05;
  step.stamp = 10.1;
  step.motion[1] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(tracker.addIncrement(step), IncrementResult::kInvalid);
  step.motion[1] = 0;
  step.covariance(2, 2) = std::numeric_limits<double>::quiet_NaN();
  bool replaced = false;
  EXPECT_EQ(tracker.addIncrement(step, &replaced), IncrementResult::kUsed);
  EXPECT_TRUE(replaced);
  // Numbers whose squares are none.
  step.previous_stamp = 10.1;
  step.stamp = 10.15;
  step.motion[2] = -1e300;
  EXPECT_EQ(tracker.addIncrement(step), IncrementResult::kInvalid);
  step.motion[2] = 0;
  step.covariance = 1e300 * Matrix4d::Identity();
  EXPECT_EQ(tracker.addIncrement(step, &replaced), IncrementResult::kUsed);
  EXPECT_TRUE(replaced);

  Measurement fix;
  const auto resultOf = [&](const Measurement& m) {
    tracker.addMeasurement(m);
    const auto outcomes = tracker.popOutcomes();
    EXPECT_EQ(outcomes.size(), 1u);
    return outcomes.empty() ? Result::kFused : outcomes[0].result;
  };
  fix.stamp = 10.1;
  fix.covariance(1, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(resultOf(fix), Result::kInvalid);
  fix.covariance = -Matrix4d::Identity();
  EXPECT_EQ(resultOf(fix), Result::kInvalid);
  fix.covariance = Matrix4d::Identity();
  for (const double none : {std::numeric_limits<double>::infinity(), 1e300}) {
    fix.value[0] = none;
    EXPECT_EQ(resultOf(fix), Result::kInvalid) << none;
  }
  fix.value.setZero();
  fix.stamp = 9;
  EXPECT_EQ(resultOf(fix), Result::kTooOld);
  fix.stamp = 1000;
  EXPECT_EQ(resultOf(fix), Result::kFromFuture);
  fix.stamp = 10.05;
  EXPECT_EQ(resultOf(fix), Result::kWaiting);
  EXPECT_EQ(resultOf(fix), Result::kDuplicate);
  fix.stamp = 10.1;
  tracker.addMeasurement(fix);
  EXPECT_TRUE(tracker.latest()->pose.allFinite());
  tracker.reset();
  EXPECT_FALSE(tracker.latest());
}

TEST(Tracker, DefaultCovarianceIsNotMultiplied) {
  TrackerSettings settings;
  settings.filter.covariance_factor = 25;
  settings.filter.metric_scale_stddev = 0.001;
  settings.filter.scale_drift = 0;
  Tracker tracker(settings);
  Increment step;
  step.previous_stamp = 10;
  step.stamp = 11;
  step.covariance = Matrix4d::Identity() * 1e-12;
  tracker.addIncrement(step);
  Measurement fix;
  fix.covariance = Matrix4d::Identity() * 1e-10;
  for (const double stamp : {10.5, 11.0}) {
    fix.stamp = stamp;
    tracker.addMeasurement(fix);
  }
  step.previous_stamp = 11;
  step.stamp = 11.05;
  step.motion[0] = 0.5;
  step.covariance(0, 0) = std::numeric_limits<double>::quiet_NaN();
  tracker.addIncrement(step);
  // A fifth of the length and the floor, once more the floor of every step, and the scale.
  EXPECT_NEAR(tracker.latest()->covariance(0, 0), std::pow(0.2 * 0.5 + 0.001, 2) + 1e-6 + std::pow(0.001 * 0.5, 2),
              1e-8);
  EXPECT_NEAR(tracker.latest()->covariance(3, 3), std::pow(0.02, 2) + 1e-8, 1e-8);
  const auto rate = tracker.rate();
  ASSERT_TRUE(rate);
  EXPECT_NEAR(rate->value[0], 10, 1e-3);
  EXPECT_NEAR(rate->covariance(0, 0), (std::pow(0.101, 2) + 1e-6) / 0.0025, 1e-4);
}

// What fixes told of a map's scale says nothing of the next one's, which is metric by its own measure.
TEST(Tracker, AnotherMetricMapHasAScaleOfItsOwn) {
  for (const unsigned id : {0u, 1u}) {
    Tracker tracker;
    Increment step;
    step.covariance = Matrix4d::Identity() * 1e-6;
    step.scale_stddev = 0.1;
    Measurement fix;
    fix.covariance = Matrix4d::Identity() * 0.0025;
    double x = 0;
    const auto fly = [&](int steps, unsigned map, bool fixes) {
      for (int i = 0; i < steps; ++i) {
        step.previous_stamp = step.stamp;
        step.stamp += 0.05;
        step.motion << 0.1, 0, 0, 0;
        step.map_id = map;
        EXPECT_EQ(tracker.addIncrement(step), IncrementResult::kUsed);
        x += 0.09;
        fix.stamp = step.stamp;
        fix.value[0] = x;
        if (fixes && i % 20 == 0) tracker.addMeasurement(fix);
      }
    };
    fly(400, 0, true);
    EXPECT_NEAR(tracker.latest()->scale, 0.9, 0.02);
    EXPECT_LT(tracker.latest()->scale_stddev, 0.05);
    fly(1, id, false);
    EXPECT_NEAR(tracker.latest()->scale, id == 0 ? 0.9 : 1, 0.02);
    if (id != 0) {
      EXPECT_NEAR(tracker.latest()->scale_stddev, 0.1, 0.01);
    }
    EXPECT_NEAR(tracker.latest()->pose[0], x, 0.1);
  }
}

TEST(Tracker, RateTellsWhatIsUnknown) {
  for (const bool metric : {true, false}) {
    Tracker tracker;
    Increment step;
    step.motion << 0.1, 0, 0, 0.01;
    step.covariance = Matrix4d::Identity() * 1e-6;
    EXPECT_FALSE(tracker.rate());
    Measurement fix;
    fix.covariance = Matrix4d::Identity() * 0.01;
    for (int i = 0; i < 20; ++i) {
      step.previous_stamp = 10 + 0.05 * i;
      step.stamp = step.previous_stamp + 0.05;
      tracker.addIncrement(step);
      fix.stamp = step.stamp;
      if (i < 2) tracker.addMeasurement(fix);
    }
    step.previous_stamp = step.stamp;
    step.stamp += 0.05;
    step.metric = metric;
    step.map_id = 1;
    tracker.addIncrement(step);
    const auto rate = tracker.rate();
    ASSERT_TRUE(rate);
    EXPECT_NEAR(rate->value[0], metric ? 0.1 * tracker.latest()->scale / 0.05 : 0, 1e-9);
    EXPECT_GT(rate->covariance(0, 0), metric ? std::pow(2 * tracker.latest()->scale_stddev, 2) : 1e5);
    EXPECT_LT(rate->covariance(0, 0), metric ? 1 : 1e7);
    EXPECT_NEAR(rate->value[3], 0.2, 1e-9);
    EXPECT_NEAR(rate->covariance(3, 3), (1e-6 + 1e-8) / 0.0025, 1e-9);
    EXPECT_TRUE(isCovariance(rate->covariance));
  }
}

TEST(Tracker, AResultThatALateFixChangesIsToldAgain) {
  Tracker tracker;
  Increment step;
  step.covariance = Matrix4d::Identity() * 1e-8;
  for (int i = 0; i < 100; ++i) {
    step.previous_stamp = 10 + 0.05 * i;
    step.stamp = 10.05 + 0.05 * i;
    tracker.addIncrement(step);
  }
  const auto give = [&](double stamp, double x) {
    Measurement fix;
    fix.stamp = stamp;
    fix.value[0] = x;
    fix.covariance = Matrix4d::Identity() * 0.01;
    tracker.addMeasurement(fix);
    std::map<double, std::pair<Result, bool>> told;
    for (const Outcome& o : tracker.popOutcomes())
      EXPECT_TRUE(told.emplace(o.measurement.stamp, std::make_pair(o.result, o.revised)).second);
    return told;
  };
  using Told = std::map<double, std::pair<Result, bool>>;
  EXPECT_EQ(give(11, 0), (Told{{11, {Result::kWaiting, false}}}));
  // The start takes the one that waited with it.
  EXPECT_EQ(give(12, 0), (Told{{11, {Result::kAgreed, true}}, {12, {Result::kInitialised, false}}}));
  EXPECT_EQ(give(13, 50), (Told{{13, {Result::kRefusedByGate, false}}}));
  // Older ones that agree with the refused one: by them the filter would have started elsewhere.
  EXPECT_EQ(give(10.2, 50), (Told{{10.2, {Result::kWaiting, false}}}));
  EXPECT_EQ(give(10.4, 50), (Told{{10.2, {Result::kAgreed, true}},
                                  {10.4, {Result::kInitialised, false}},
                                  {11, {Result::kRefusedByGate, true}},
                                  {12, {Result::kRefusedByGate, true}},
                                  {13, {Result::kFused, true}}}));
}

TEST(Tracker, AFixAheadOfTheOdometryWaitsForIt) {
  SimulationSettings s;
  s.duration = 5;
  const Simulation sim = simulate(s, FilterSettings());
  TrackerSettings settings;
  settings.filter.max_false_start = 1;
  Tracker tracker(settings);
  tracker.addIncrement(sim.odometry[0]);
  Measurement fix = sim.fixes[0];
  tracker.addMeasurement(fix);
  EXPECT_EQ(tracker.popOutcomes().size(), 1u);
  fix.stamp = sim.odometry[9].stamp;
  tracker.addMeasurement(fix);
  for (int i = 1; i < 9; ++i) tracker.addIncrement(sim.odometry[static_cast<std::size_t>(i)]);
  EXPECT_TRUE(tracker.popOutcomes().empty());
  EXPECT_EQ(tracker.waiting(), 1u);
  tracker.addIncrement(sim.odometry[9]);
  EXPECT_EQ(tracker.popOutcomes().size(), 2u);  // its own, and of the one that waited for it
  EXPECT_EQ(tracker.latest()->support, 2);
}

TEST(Tracker, NewMapInAnUnknownUnitKeepsThePoseAndFindsItsScale) {
  for (const bool metric : {true, false}) {
    SimulationSettings s;
    s.metric = metric;
    s.duration = 75;
    Simulation sim = simulate(s, FilterSettings());
    Tracker ordered, late;
    for (const Measurement& fix : sim.fixes) ordered.addMeasurement(fix);
    int changes = 0, blind = 0, worst_nees = 0;
    std::size_t next = 0;
    for (std::size_t i = 0; i < sim.odometry.size(); ++i) {
      Increment increment = sim.odometry[i];
      if (increment.previous_stamp > 130) {
        increment.map_id = 1;
        if (!metric) {  // another unit
          const Vector4d unit(4, 4, 4, 1);
          increment.motion = unit.cwiseProduct(increment.motion);
          increment.covariance = (unit.asDiagonal() * increment.covariance * unit.asDiagonal()).eval();
        }
      }
      changes += ordered.addIncrement(increment) == IncrementResult::kNewUnit;
      late.addIncrement(increment);
      for (; next < sim.fixes.size() && sim.fixes[next].stamp + 2 <= increment.stamp; ++next)
        late.addMeasurement(sim.fixes[next]);
      const auto estimate = ordered.latest();
      ASSERT_TRUE(estimate || increment.stamp < 130);
      if (!estimate) continue;
      blind += !estimate->scale_known;
      const Vector4d e = poseError(estimate->pose, sim.truth[i + 1]);
      worst_nees =
          std::max(worst_nees, static_cast<int>(air_ground_common::squaredMahalanobis(e, estimate->covariance)));
    }
    EXPECT_EQ(changes, metric ? 0 : 1);
    EXPECT_EQ(blind > 20, !metric) << blind;
    EXPECT_LT(blind, 500);
    EXPECT_LT(worst_nees, 30);
    EXPECT_EQ(ordered.filter().recoveries(), 0);
    EXPECT_NEAR(ordered.latest()->scale, metric ? 1 : 0.25, metric ? 0.4 : 0.1);
    EXPECT_TRUE(ordered.latest()->scale_known);
    // A fix that comes after the change and belongs before it.
    while (next < sim.fixes.size()) late.addMeasurement(sim.fixes[next++]);
    EXPECT_LT(poseError(late.latest()->pose, ordered.latest()->pose).norm(), 1e-9);
  }
}

TEST(Tracker, OdometryThatBecomesMetricKeepsThePose) {
  SimulationSettings s;
  s.metric = false;
  s.scale = 3;
  s.duration = 70;
  Simulation sim = simulate(s, FilterSettings());
  Tracker tracker;
  for (const Measurement& fix : sim.fixes) tracker.addMeasurement(fix);
  for (Increment& increment : sim.odometry) {
    if (increment.previous_stamp > 140) {
      const Vector4d unit(s.scale, s.scale, s.scale, 1);
      increment.metric = true;
      increment.motion = unit.cwiseProduct(increment.motion);
      increment.covariance = unit.asDiagonal() * increment.covariance * unit.asDiagonal();
    }
    tracker.addIncrement(increment);
  }
  ASSERT_TRUE(tracker.latest());
  EXPECT_NEAR(tracker.latest()->scale, 1, 0.15);
  EXPECT_EQ(tracker.filter().recoveries(), 0);
  EXPECT_LT(poseError(tracker.latest()->pose, sim.truth[sim.odometry.size()]).head<3>().norm(), 6);
}

TEST(Tracker, MemoryAndHistoryAreBounded) {
  TrackerSettings settings;
  settings.history = 5;
  Tracker tracker(settings);
  SimulationSettings s;
  s.duration = 30;
  const Simulation sim = simulate(s, settings.filter);
  for (const Increment& increment : sim.odometry) tracker.addIncrement(increment);
  Measurement old = sim.fixes[1];
  tracker.addMeasurement(old);
  EXPECT_EQ(tracker.popOutcomes().at(0).result, Result::kTooOld);
  Tracker silent;
  for (int i = 0; i < 3000; ++i) {
    old.stamp = i;
    silent.addMeasurement(old);
  }
  EXPECT_LE(silent.waiting(), 2000u);
  settings.history = -1;
  EXPECT_THROW(Tracker{settings}, std::invalid_argument);
}

}  // namespace
}  // namespace ekf_tracker
