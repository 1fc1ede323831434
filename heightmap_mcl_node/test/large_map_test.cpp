// Maps of more cells than the search over all places takes, and than a descent needs.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "heightmap_mcl/localizer.h"
#include "synthetic_world.h"

namespace heightmap_mcl {
namespace {

constexpr double kEdge = 24;      // of the site [m]
constexpr double kPoints = 0.03;  // apart [m]

/// A site with a block on every 6 m^2, each of its own size and height.
class Site {
 public:
  explicit Site(unsigned seed) : random_(seed) {
    std::uniform_real_distribution<double> at(0, kEdge), size(0.15, 0.6);
    std::uniform_real_distribution<float> height(0.15f, 0.8f);
    for (int i = 0; i < kEdge * kEdge / 6; ++i) {
      const Eigen::Vector2d centre(at(random_), at(random_)), half(size(random_), size(random_));
      blocks_.push_back({{centre - half, centre + half}, height(random_)});
    }
  }

  /// What a look from above gives of a box, in a frame that T_frame_site places.
  std::vector<Eigen::Vector3f> seen(const Eigen::AlignedBox2d& box, const air_ground_common::Pose& T_frame_site) {
    std::normal_distribution<double> noise(0, 0.01);
    std::vector<Eigen::Vector3f> points;
    for (double x = box.min().x(); x < box.max().x(); x += kPoints)
      for (double y = box.min().y(); y < box.max().y(); y += kPoints)
        points.emplace_back((T_frame_site * Eigen::Vector3d(x, y, heightAt({x, y}) + noise(random_))).cast<float>());
    return points;
  }

 private:
  struct Block {
    Eigen::AlignedBox2d box;
    float height;
  };

  double heightAt(const Eigen::Vector2d& p) const {
    double height = 0;
    for (const Block& block : blocks_)
      if (block.box.contains(p)) height = std::max<double>(height, block.height);
    return height;
  }

  std::mt19937 random_;
  std::vector<Block> blocks_;
};

TEST(LargeMaps, AreAlignedAsSmallOnesAre) {
  for (unsigned seed = 1; seed <= 2; ++seed) {
    Site site(seed);
    HeightMapLocalizer localizer(HeightMapLocalizerSettings{});
    const Eigen::AlignedBox2d all(Eigen::Vector2d::Zero(), Eigen::Vector2d::Constant(kEdge));
    ASSERT_TRUE(localizer.setGround(site.seen(all, air_ground_common::Pose::Identity())));
    const air_ground_common::Pose T_ground_mav = air_ground_common::yawPose(2.1 + seed, {9, 14, 0.3});
    int converged = 0;
    for (int k = 0; k < 5; ++k) {
      // An oblique view reaches far: the merged map has more than half a million cells.
      const Eigen::Vector2d centre(6.5 + 1.5 * k, 11 - k), half(6, 5);
      const Eigen::Vector3d reference = T_ground_mav.inverse() * Eigen::Vector3d(centre.x(), centre.y(), 3);
      ASSERT_TRUE(localizer.addAerial({site.seen({centre - half, centre + half}, T_ground_mav.inverse()), reference}));
      const CoarseEstimate& e = localizer.estimate();
      if (e.status != Status::kConverged) continue;
      ++converged;
      const auto error = synthetic::errorOf(e.T_ground_mav, T_ground_mav, reference);
      EXPECT_LT(error.position, 0.02) << "seed " << seed << ", cloud " << k;
      EXPECT_LT(std::abs(error.yaw), 0.003) << "seed " << seed << ", cloud " << k;
      EXPECT_LT(std::abs(error.z), 0.02) << "seed " << seed << ", cloud " << k;
    }
    EXPECT_GE(converged, 3) << "seed " << seed;
  }
}

}  // namespace
}  // namespace heightmap_mcl
