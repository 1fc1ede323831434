// Height maps of random blocks, for comparisons of kernels with their references.
#pragma once

#include <cmath>
#include <random>

#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl::random_maps {

/// Random blocks with holes, far from square, with an offset and a large mean height.
inline HeightMap randomMap(int width, int height, std::uint64_t seed, double hole_share) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<float> uniform(0, 1);
  HeightMap map;
  map.resolution = 0.05;
  map.origin_x = -1.35;
  map.origin_y = 2.15;
  map.width = width;
  map.height = height;
  map.heights.assign(static_cast<std::size_t>(width) * height, 5.f);
  for (int block = 0; block < width * height / 150; ++block) {
    const int c0 = static_cast<int>(uniform(random) * width), r0 = static_cast<int>(uniform(random) * height);
    const float h = uniform(random);
    for (int r = r0; r < std::min(r0 + 9, height); ++r) {
      for (int c = c0; c < std::min(c0 + 6, width); ++c) map.at(r, c) = 5.f + h;
    }
  }
  for (float& h : map.heights) {
    h += 0.02f * uniform(random);
    if (uniform(random) < hole_share) h = kHole;
  }
  return map;
}

/// Turns a share of the cells into bounds above a floor of 4.95 m, from below the lowest level up to the cap.
inline HeightMap withBounds(HeightMap map, std::uint64_t seed, double share) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<float> uniform(0, 1);
  map.floor = 4.95;
  map.cap = 1.2;
  map.bounds.assign(map.heights.size(), 0);
  for (std::size_t k = 0; k < map.heights.size(); ++k) {
    if (uniform(random) >= share || std::isnan(map.heights[k])) continue;
    map.bounds[k] = 1;
    map.heights[k] = std::min(4.95f + 1.4f * uniform(random), 4.95f + 1.2f);
  }
  return map;
}

/// The part of `ground` below a window, as a MAV would map it: shifted, turned and lowered.
inline HeightMap cutOut(const HeightMap& ground, const PlanarPose& pose, double dz, int width, int height) {
  HeightMap air;
  air.resolution = ground.resolution;
  air.origin_x = -0.4;
  air.origin_y = -0.7;
  air.width = width;
  air.height = height;
  air.heights.assign(static_cast<std::size_t>(width) * height, kHole);
  for (int r = 0; r < height; ++r) {
    for (int c = 0; c < width; ++c) {
      const Eigen::Vector2d p = air.center(r, c);
      const double x = std::cos(pose.yaw) * p.x() - std::sin(pose.yaw) * p.y() + pose.x;
      const double y = std::sin(pose.yaw) * p.x() + std::cos(pose.yaw) * p.y() + pose.y;
      const int gc = static_cast<int>(std::floor((x - ground.origin_x) / ground.resolution));
      const int gr = static_cast<int>(std::floor((y - ground.origin_y) / ground.resolution));
      if (gc >= 0 && gr >= 0 && gc < ground.width && gr < ground.height)
        air.at(r, c) = ground.at(gr, gc) - static_cast<float>(dz);
    }
  }
  return air;
}

/// What of two random maps is not plain heights.
struct Cells {
  double bounds;  ///< share of the cells
  int edge;       ///< see aerialCells
};
const Cells kKindsOfCells[] = {{0, 0}, {0.3, 0}, {0, 1}, {0.3, 2}};

/// A ground and an aerial map for comparisons at random poses about kReference.
struct MapPair {
  HeightMap ground = randomMap(97, 61, 1, 0.2), air = randomMap(43, 37, 2, 0.3);

  explicit MapPair(const Cells& cells) {
    if (cells.bounds == 0) return;
    ground = withBounds(ground, 4, cells.bounds);
    air = withBounds(air, 5, cells.bounds);
  }
};
const Eigen::Vector2d kReference(-0.4, 2.9);  ///< in the aerial map [m]

}  // namespace heightmap_mcl::random_maps
