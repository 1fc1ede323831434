// Fixes of one panorama share its error: how much they may tell, and what they may overthrow.
#include <gtest/gtest.h>

#include <iostream>

#include "air_ground_common/linear_algebra.h"
#include "simulation.h"

namespace ekf_tracker {
namespace {

Measurement fixAt(const Vector4d& value, unsigned place, double stamp = 0) {
  Measurement m;
  m.stamp = stamp;
  m.value = value;
  m.covariance = Vector4d(0.04, 0.05, 0.02, 1e-4).asDiagonal();
  m.place = place;
  return m;
}

Increment still(double seconds, double stddev) {
  Increment step;
  step.stamp = seconds;
  step.covariance = Vector4d(stddev, stddev, stddev, 0.1 * stddev).cwiseAbs2().asDiagonal();
  return step;
}

// Average squared distance of the truth, 4 if the covariances are honest, over flights with a fix a second.
double averageNees(const SimulationSettings& base, bool named) {
  const TrackerSettings settings;
  double sum = 0;
  int looks = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    SimulationSettings s = base;
    s.seed = 9000 + seed;
    s.fix_interval = 1;
    s.common_share = 0.9;
    Simulation sim = simulate(s, settings.filter);
    Tracker tracker(settings);
    std::size_t next = 0;
    for (std::size_t i = 0; i < sim.odometry.size(); ++i) {
      tracker.addIncrement(sim.odometry[i]);
      for (; next < sim.fixes.size() && sim.fixes[next].stamp <= sim.odometry[i].stamp; ++next) {
        if (!named) sim.fixes[next].place = 0;
        tracker.addMeasurement(sim.fixes[next]);
      }
      if (i < 600 || i % 100 != 0) continue;
      const auto estimate = tracker.latest();
      if (!estimate) continue;
      sum += air_ground_common::squaredMahalanobis(poseError(estimate->pose, sim.truth[i + 1]), estimate->covariance);
      ++looks;
    }
  }
  EXPECT_GT(looks, 300);
  return sum / looks;
}

TEST(Places, HoveringBeforeOnePanoramaStaysHonest) {
  SimulationSettings s;
  s.speed = 0;
  s.place_spacing = 1e6;
  const double named = averageNees(s, true), unnamed = averageNees(s, false);
  std::cout << "hovering, average NEES " << named << ", panorama not known " << unnamed << '\n';
  EXPECT_LT(named, 6);
  EXPECT_GT(unnamed, 20);
}

TEST(Places, FlightPastPanoramasStaysHonest) {
  SimulationSettings s;
  s.place_spacing = 12;
  const double named = averageNees(s, true), unnamed = averageNees(s, false);
  std::cout << "past panoramas, average NEES " << named << ", panoramas not known " << unnamed << '\n';
  EXPECT_LT(named, 6);
  EXPECT_GT(unnamed, 8);
}

TEST(Places, FixesOfOnePanoramaTellAsMuchAsOne) {
  PoseFilter filter;
  const Vector4d truth(1, 2, 3, 0.5);
  for (int i = 0; i < 30; ++i) filter.correct(fixAt(truth, 7));
  ASSERT_TRUE(filter.started());
  EXPECT_EQ(filter.state().support, 30);
  const Matrix4d one = fixAt(truth, 7).covariance;
  EXPECT_LT((filter.state().covariance.topLeftCorner<4, 4>() - one).norm(), 1e-9);
  // What the odometry has made worse since comes back, no more and no less.
  filter.predict(still(1, 0.3));
  EXPECT_GT(filter.state().covariance(0, 0), 0.1);
  EXPECT_EQ(filter.correct(fixAt(truth, 7)).result, Result::kFused);
  EXPECT_LT((filter.state().covariance.topLeftCorner<4, 4>() - one).norm(), 1e-6);
  // Another panorama's counts, once; so does one whose panorama is not known, always.
  filter.correct(fixAt(truth, 8));
  filter.correct(fixAt(truth, 8));
  filter.correct(fixAt(truth, 7));
  EXPECT_LT((filter.state().covariance.topLeftCorner<4, 4>() - one / 2).norm(), 1e-3);
  filter.correct(fixAt(truth, 0));
  filter.correct(fixAt(truth, 0));
  EXPECT_LT((filter.state().covariance.topLeftCorner<4, 4>() - one / 4).norm(), 1e-3);
}

// A building bends the field by 20 degrees, for five minutes of hovering beside it.
TEST(Places, AMagnetometersReadingsWhereTheVehicleHoversTellAsMuchAsOne) {
  constexpr double kBent = 20 * M_PI / 180;
  PoseFilter filter;
  double time = 0;
  for (; time < 30; ++time) {
    filter.correct(fixAt({0, 0, 10, 0}, time < 15 ? 1 : 2, time));
    filter.predict(still(1, 0.002));
  }
  Measurement heading;
  heading.source = Source::kHeading;
  heading.value[0] = kBent;
  heading.covariance(0, 0) = std::pow(10 * M_PI / 180, 2);
  for (; time < 330; ++time) {
    filter.correct(heading);
    filter.predict(still(1, 0.002));
    EXPECT_LT(std::abs(filter.state().x[3]), 3 * std::sqrt(filter.state().covariance(3, 3))) << time;
  }
  EXPECT_EQ(filter.correct(fixAt({0, 0, 10, 0}, 3, time)).result, Result::kFused) << "15 degrees off before";
  // Without fixes, one reading's worth is what it tells; elsewhere the field is another.
  filter.predict(still(1, 30));
  for (int i = 0; i < 50; ++i) filter.correct(heading);
  EXPECT_NEAR(filter.state().covariance(3, 3), heading.covariance(0, 0), 0.1 * heading.covariance(0, 0));
  Increment step = still(1, 1e-3);
  step.motion << 10, 0, 0, 0;
  filter.predict(step);
  filter.correct(heading);
  EXPECT_NEAR(filter.state().covariance(3, 3), 0.5 * heading.covariance(0, 0), 0.1 * heading.covariance(0, 0));
}

TEST(Places, ThreeWrongFixesOfOnePanoramaReplaceNothing) {
  for (const bool several : {false, true}) {
    for (const bool named : {true, false}) {
      PoseFilter filter;
      double time = 0;
      for (; time < 60; ++time) {
        filter.correct(fixAt({0, 0, 0, 0}, named ? 1 + static_cast<unsigned>(time / 10) : 0, time));
        filter.predict(still(1, 0.02));
      }
      Result last = Result::kFused;
      for (unsigned i = 0; i < 3; ++i, ++time) {
        last = filter.correct(fixAt({6, 0, 0, 0}, named ? 50 + (several ? i : 0) : 0, time)).result;
        filter.predict(still(1, 0.02));
      }
      const bool replaced = several || !named;
      EXPECT_EQ(last, replaced ? Result::kRecovered : Result::kRefusedByGate) << several << named;
      EXPECT_NEAR(filter.state().x[0], replaced ? 6 : 0, 0.3) << several << named;
      // A second panorama that says the same settles it.
      if (!replaced) {
        EXPECT_EQ(filter.correct(fixAt({6, 0, 0, 0}, 51, time)).result, Result::kRecovered);
      }
    }
  }
}

// Hovering: `count` fixes of a panorama, a second apart. How many of them it takes to replace the state; 0: all do not.
int fixesToReplace(const Vector4d& value, unsigned place, int count, double* time, PoseFilter* filter) {
  for (int i = 1; i <= count; ++i, ++*time) {
    if (filter->correct(fixAt(value, place, *time)).result == Result::kRecovered) return i;
    filter->predict(still(1, 0.02));
  }
  return 0;
}

TEST(Places, AStateOfOnePanoramaYieldsToMoreFixesOfAnother) {
  const Vector4d wrong(12, 0, 0, 0), right(0, 0, 0, 0);
  for (const int fixes : {2, 3, 4, 5, 20}) {
    PoseFilter filter;
    double time = 0;
    EXPECT_EQ(fixesToReplace(wrong, 1, fixes, &time, &filter), 0);
    ASSERT_TRUE(filter.started());
    EXPECT_EQ(fixesToReplace(right, 2, 30, &time, &filter), fixes <= 3 ? 3 : fixes + 1);
    EXPECT_NEAR(filter.state().x[0], 0, 0.5);
  }
  // One that rests on two does not, however many they are.
  PoseFilter filter;
  double time = 0;
  fixesToReplace(right, 1, 5, &time, &filter);
  fixesToReplace(right, 2, 5, &time, &filter);
  EXPECT_EQ(fixesToReplace(wrong, 3, 100, &time, &filter), 0);
  EXPECT_EQ(fixesToReplace(wrong, 4, 1, &time, &filter), 1);
}

TEST(Places, AFixWhosePanoramaIsNotKnownIsNoSecondPanorama) {
  const Vector4d wrong(12, 0, 0, 0), right(0, 0, 0, 0);
  for (int unknown = 0; unknown < 4; ++unknown) {
    PoseFilter filter;
    double time = 0;
    for (unsigned place = 1; place <= 6; ++place) fixesToReplace(right, place, 10, &time, &filter);
    EXPECT_EQ(fixesToReplace(wrong, 50, unknown, &time, &filter), 0);
    EXPECT_EQ(fixesToReplace(wrong, 0, 1, &time, &filter), 0);
    EXPECT_EQ(fixesToReplace(wrong, 50, 20, &time, &filter), 0) << unknown;
    EXPECT_EQ(fixesToReplace(wrong, 51, 1, &time, &filter), 1);
  }
  // Nor does it make several of the one that a state rests on.
  PoseFilter filter;
  double time = 0;
  fixesToReplace(wrong, 1, 3, &time, &filter);
  fixesToReplace(wrong, 0, 1, &time, &filter);
  EXPECT_EQ(fixesToReplace(right, 2, 30, &time, &filter), 5);
}

}  // namespace
}  // namespace ekf_tracker
