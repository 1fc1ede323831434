// The particles' motion, sampling and moments, on costs of a few cells.
#include "heightmap_mcl/particle_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

using namespace heightmap_mcl;

namespace {

CostVolume singleCell(double x, double y, double yaw) {
  CostVolume volume;
  CostMap map;
  map.resolution = 1e-3;
  map.x0 = x;
  map.y0 = y;
  map.yaw = yaw;
  map.width = map.height = 1;
  map.cost = {0.01f};
  volume.slices = {map};
  return volume;
}

Eigen::Vector2d meanOf(const ParticleFilter& filter) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const auto& p : filter.particles()) mean += p.weight * Eigen::Vector2d(p.pose.x, p.pose.y);
  return mean;
}

}  // namespace

TEST(ParticleFilter, MotionTurnsTheDisplacementByTheHeading) {
  FilterSettings settings;
  settings.position_noise = settings.yaw_noise = 0;
  settings.position_noise_per_metre = settings.yaw_noise_per_metre = 0;
  ParticleFilter filter(settings, 1);
  // mav_map's x axis points along ground y.
  ASSERT_TRUE(filter.initialize(singleCell(3, 4, M_PI / 2), {}, {0, 0}));
  EXPECT_NEAR(meanOf(filter).x(), 3, 0.01);
  filter.move({0.5, 0.2});
  EXPECT_NEAR(meanOf(filter).x(), 3 - 0.2, 0.01);
  EXPECT_NEAR(meanOf(filter).y(), 4 + 0.5, 0.01);
}

TEST(ParticleFilter, SamplesFollowTheCost) {
  FilterSettings settings;
  settings.particles = 1000;
  settings.sampling_sigma = 0.02;
  auto volume = singleCell(0, 0, 0);
  auto& map = volume.slices[0];
  map.width = 3;
  map.resolution = 1;
  map.cost = {0.05f, 0.03f, std::numeric_limits<float>::infinity()};
  ParticleFilter filter(settings, 2);
  ASSERT_TRUE(filter.initialize(volume, {}, {0, 0}));
  const auto shareAt = [&filter](double x) {
    int n = 0;
    for (const auto& p : filter.particles()) n += std::abs(p.pose.x - x) <= 0.5;
    return n / 1000.0;
  };
  EXPECT_EQ(shareAt(2), 0);
  EXPECT_NEAR(shareAt(1), std::exp(1) / (1 + std::exp(1)), 0.02);  // eq. 5
  filter.setSigmaShare(0.5);
  ASSERT_TRUE(filter.initialize(volume, {}, {0, 0}));
  EXPECT_NEAR(shareAt(1), std::exp(2) / (1 + std::exp(2)), 0.02);
  for (float& c : map.cost) c = std::numeric_limits<float>::infinity();
  EXPECT_FALSE(filter.initialize(volume, {}, {0, 0}));
  EXPECT_FALSE(filter.initialized());
}

TEST(ParticleFilter, SpreadIsCircularInHeading) {
  FilterSettings settings;
  ParticleFilter filter(settings, 1);
  auto volume = singleCell(0, 0, M_PI - 0.05);
  volume.slices.push_back(singleCell(0, 0, -M_PI + 0.05).slices[0]);
  ASSERT_TRUE(filter.initialize(volume, {}, {0, 0}));
  EXPECT_LT(filter.spread().yaw, 0.12);
  const auto modes = filter.modes(0.3, 0.3);
  EXPECT_NEAR(modes.front().weight, 1, 1e-9);
  EXPECT_GT(std::abs(modes.front().mean.yaw), M_PI - 0.05);
}
