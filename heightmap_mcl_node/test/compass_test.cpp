#include "heightmap_mcl/compass.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "air_ground_common/geometry.h"

using namespace heightmap_mcl;

TEST(Compass, HeadingOfOneMapInTheOther) {
  // North lies along y of the ground map; the MAV's map is turned by 70 degrees in it. The field points down by 63.
  const double yaw = 70 * M_PI / 180;
  const Eigen::Vector3d field_ground = 48e-6 * Eigen::Vector3d(0, std::cos(1.1), -std::sin(1.1));
  const Eigen::Vector3d field_mav = air_ground_common::yawPose(yaw, Eigen::Vector3d::Zero()).inverse() * field_ground;
  std::mt19937_64 random(1);
  std::normal_distribution<double> noise(0, 1e-6);
  MagneticNorth ground, mav;
  for (int i = 0; i < 19; ++i) {
    EXPECT_TRUE(ground.add(field_ground));
    EXPECT_TRUE(mav.add(field_mav));
  }
  EXPECT_FALSE(headingPrior(ground, mav, 0.1));
  for (int i = 0; i < 200; ++i) {
    ground.add(field_ground + Eigen::Vector3d(noise(random), noise(random), noise(random)));
    mav.add(field_mav + Eigen::Vector3d(noise(random), noise(random), noise(random)));
  }
  const auto prior = headingPrior(ground, mav, 0.1);
  ASSERT_TRUE(prior);
  EXPECT_NEAR(*prior->yaw, yaw, 0.02);
  EXPECT_NEAR(ground.deviation(), 1e-6 / (48e-6 * std::cos(1.1)), 0.01);
  EXPECT_NEAR(prior->yaw_sigma, std::hypot(0.1, std::hypot(ground.deviation(), mav.deviation())), 1e-9);
  EXPECT_LT(prior->yaw_sigma, 0.15);
}

TEST(Compass, AFieldThatTurnsSaysSo) {
  MagneticNorth ground, mav;
  for (int i = 0; i < 400; ++i) {
    ground.add({std::cos(0.1 * i), std::sin(0.1 * i), 0});
    mav.add({1, 0, 0});
  }
  const auto prior = headingPrior(ground, mav, 0.1);
  ASSERT_TRUE(prior);
  EXPECT_GT(prior->yaw_sigma, 1);  // as good as none
  EXPECT_EQ(searchHeadings(72, *prior).size(), 72u);
}

TEST(Compass, UnusableReadingsAreRefused) {
  MagneticNorth north;
  EXPECT_FALSE(north.add({std::nan(""), 0, 0}));
  EXPECT_FALSE(north.add({0, 0, 0}));
  EXPECT_FALSE(north.add({0.01, 0, -1}));
  EXPECT_FALSE(north.direction());
}
