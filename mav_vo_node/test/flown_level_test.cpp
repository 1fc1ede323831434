#include "../src/flown_level.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "air_ground_common/geometry.h"
#include "air_ground_common/units.h"

namespace mav_vo {
namespace {

using air_ground_common::expSO3;
using air_ground_common::kDegree;
using air_ground_common::Vertical;

struct Flight {
  double turn = 2 * M_PI;            // of the heading, over all [rad]
  double pitch_down = 50 * kDegree;  // of the camera
  double roll_stddev = 0;            // of the vehicle, anew every second [rad]
  double on_its_side = 0;            // the camera about its axis [rad]
  double seconds = 30;
  unsigned seed = 1;
};

/// Attitudes in a map whose axes are turned by R_map_level.
std::vector<FlownAttitude> fly(const Flight& flight, const Eigen::Matrix3d& R_map_level) {
  // Optical axes of a camera that looks along x: x right, y down, z ahead.
  Eigen::Matrix3d R_level_ahead;
  R_level_ahead << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  std::mt19937 random(flight.seed);
  std::normal_distribution<double> roll(0, 1);
  std::vector<FlownAttitude> out;
  double now = 0;
  for (int i = 0; i < 5 * flight.seconds; ++i) {
    if (i % 5 == 0) now = flight.roll_stddev * roll(random);
    const double stamp = 0.2 * i;
    const Eigen::Matrix3d R = R_map_level * expSO3({0, 0, flight.turn * stamp / flight.seconds}) * expSO3({now, 0, 0}) *
                              R_level_ahead * expSO3({-flight.pitch_down, 0, 0}) * expSO3({0, 0, flight.on_its_side});
    out.push_back({stamp, -R.col(0), R * Eigen::Vector3d(0, 1, 1)});
  }
  return out;
}

double lean(const Vertical& vertical, const Eigen::Matrix3d& R_map_level) {
  return std::acos(std::clamp(vertical.up.dot(R_map_level.col(2)), -1.0, 1.0));
}

TEST(VerticalOfFlight, IsAcrossTheLateralAxesWhereverTheCameraLooks) {
  const Eigen::Matrix3d R = expSO3({0.4, -0.8, 0.3});
  for (const double down : {0.0, 30.0, 50.0, 90.0}) {
    Flight flight;
    flight.pitch_down = down * kDegree;
    const Vertical vertical = verticalOfFlight(fly(flight, R));
    EXPECT_GT(vertical.stddev, 0) << down;
    EXPECT_LT(vertical.stddev, 0.03) << down;
    EXPECT_LT(lean(vertical, R), 1e-6) << down;
  }
}

TEST(VerticalOfFlight, KnowsHowFarRollsLetItErr) {
  const Eigen::Matrix3d R = expSO3({-0.5, 0.2, 0});
  for (const double turn : {60.0, 120.0, 360.0}) {
    double squared = 0;
    int runs = 0;
    for (unsigned seed = 1; seed <= 40; ++seed) {
      Flight flight;
      flight.turn = turn * kDegree;
      flight.roll_stddev = 5 * kDegree;
      flight.seed = seed;
      const Vertical vertical = verticalOfFlight(fly(flight, R));
      if (vertical.stddev == 0) continue;
      squared += std::pow(lean(vertical, R) / vertical.stddev, 2);
      ++runs;
    }
    ASSERT_GE(runs, 35) << turn;
    EXPECT_LT(squared / runs, 2) << turn << " deg: two axes, one sigma each";
  }
}

TEST(VerticalOfFlight, IsNotKnownToWhoHasNotTurnedOrLiesOnTheSide) {
  const Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Flight straight;
  straight.turn = 2 * kDegree;
  straight.roll_stddev = 3 * kDegree;
  EXPECT_EQ(verticalOfFlight(fly(straight, R)).stddev, 0);
  Flight portrait;
  portrait.on_its_side = M_PI / 2;
  EXPECT_EQ(verticalOfFlight(fly(portrait, R)).stddev, 0);
  portrait.pitch_down = 0;
  EXPECT_EQ(verticalOfFlight(fly(portrait, R)).stddev, 0);
  EXPECT_EQ(verticalOfFlight({}).stddev, 0);
}

}  // namespace
}  // namespace mav_vo
