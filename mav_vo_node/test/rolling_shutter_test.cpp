// Rolling shutter against points projected at the exact pose of their row.
#include <gtest/gtest.h>

#include <random>

#include "mav_vo/rolling_shutter.h"
#include "synthetic_flight.h"

using namespace mav_vo;
using synthetic::Pose;

namespace {

TEST(RollingShutter, CarriesPointsToTheMiddleRow) {
  const auto camera = synthetic::camera();
  const Eigen::Vector3d rate(0.4, -0.3, 0.5), velocity(0.6, -0.4, 0.2);
  const double readout = 0.02;
  RollingShutter shutter(camera, readout);
  shutter.setMotion(rate, velocity);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> unit(-1, 1);
  double worst_without = 0;
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d p_middle(1.2 * unit(random), 0.7 * unit(random), 2 + 0.5 * unit(random));
    // The row at which the moving camera sees the point, by fixed-point iteration on the exact motion.
    Eigen::Vector2d pixel = *camera.project(p_middle);
    const Eigen::Vector2d straight = pixel;
    for (int k = 0; k < 10; ++k) {
      const double t = ((pixel.y() + 0.5) / camera.height - 0.5) * readout;
      Pose T_middle_row = Pose::Identity();
      T_middle_row.linear() = air_ground_common::expSO3(rate * t);
      T_middle_row.translation() = velocity * t;
      pixel = *camera.project(T_middle_row.inverse() * p_middle);
    }
    if (!camera.contains(pixel)) continue;
    worst_without = std::max(worst_without, (pixel - straight).norm());
    const Eigen::Vector2d corrected =
        *camera.project(shutter.toMiddleRow(pixel, camera.unproject(pixel), 1 / p_middle.z()).homogeneous());
    EXPECT_LT((corrected - straight).norm(), 0.05);
    EXPECT_LT((shutter.toItsRow(straight, p_middle) - pixel).norm(), 0.05);
  }
  EXPECT_GT(worst_without, 1.5);
}

TEST(RollingShutter, IsTransparentForAGlobalShutter) {
  RollingShutter shutter(synthetic::camera(), 0.0);
  shutter.setMotion({1, 1, 1}, {1, 1, 1});
  const Eigen::Vector2d pixel(100, 50), normalized(0.1, -0.2);
  EXPECT_EQ(shutter.toMiddleRow(pixel, normalized, 1.0), normalized);
  EXPECT_EQ(shutter.toItsRow(pixel, {0.1, 0.2, 1}), pixel);
}

}  // namespace
