// A place that somebody has named: what else lies within what is meant still counts.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {
namespace {

constexpr double kPoints = 0.03;  // apart [m]

/// Identical desks, 1 m apart along x and y.
float heightAt(double x, double y) {
  const double from_x = x - std::round(x), from_y = y - std::round(y);
  return std::abs(from_x) < 0.25 && std::abs(from_y) < 0.15 ? 0.4f : 0.f;
}

std::vector<Eigen::Vector3f> desks(const Eigen::AlignedBox2d& box, std::mt19937& random) {
  std::normal_distribution<float> noise(0, 0.01f);
  std::vector<Eigen::Vector3f> points;
  for (double x = box.min().x(); x < box.max().x(); x += kPoints)
    for (double y = box.min().y(); y < box.max().y(); y += kPoints)
      points.push_back({static_cast<float>(x), static_cast<float>(y), heightAt(x, y) + noise(random)});
  return points;
}

// The lowest places of the whole map lie anywhere; the desk beside the right one is a rival all the same.
TEST(InitialPose, DesksInRowsStayAmbiguous) {
  HeightMapLocalizerSettings settings;
  settings.air_map.resolution = settings.ground_map.resolution = 0.05;
  settings.coarse_factor = 2;
  for (unsigned seed = 1; seed <= 4; ++seed) {
    std::mt19937 random(seed);
    HeightMapLocalizer localizer(settings);
    ASSERT_TRUE(localizer.setGround(desks({Eigen::Vector2d(-6, -6), Eigen::Vector2d(6, 6)}, random)));
    // The maps' frames are the same; the guess is off by half a desk.
    const Eigen::Vector2d mav(0.3, 0.2);
    Prior prior;
    prior.yaw = 0;
    prior.yaw_sigma = 0.26;
    prior.position = mav + 0.55 * Eigen::Vector2d(std::cos(1.7 * seed), std::sin(1.7 * seed));
    prior.position_reference = mav;
    prior.position_sigma = 0.5;
    localizer.setPrior(prior);
    for (int k = 0; k < 4; ++k) {
      const Eigen::Vector2d centre = mav + Eigen::Vector2d(0.1 * k, 0), half(1.6, 1.1);
      ASSERT_TRUE(localizer.addAerial({desks({centre - half, centre + half}, random), {centre.x(), centre.y(), 2.5}}));
      const CoarseEstimate& e = localizer.estimate();
      EXPECT_EQ(e.status, Status::kAmbiguous) << "seed " << seed << ", cloud " << k << ": " << e.reason;
      EXPECT_LT(e.rival_distance, 3) << "both lie within 1.5 m of the guess";
    }
  }
}

}  // namespace
}  // namespace heightmap_mcl
