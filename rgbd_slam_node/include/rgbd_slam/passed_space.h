// Where somebody stood or walked when one keyframe was made, others see through: before, where GonePoints cannot look.
#pragma once

#include <Eigen/Core>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "air_ground_common/geometry.h"
#include "rgbd_slam/ground_cloud.h"
#include "rgbd_slam/seen_keyframes.h"
#include "rgbd_slam/tile_grid.h"

namespace rgbd_slam {

/// Cubes of 5 cm, and by how many keyframes each was seen to be free, and to hold a surface (occupancy by votes of
/// keyframes; as in Hornung et al., OctoMap, 2013). One thread uses it.
class PassedSpace {
 public:
  /// The cloud holds points of up to `max_range` before the keyframes (CloudSettings) [m]: surfaces farther away than
  /// that tell nothing of them.
  explicit PassedSpace(double max_range = CloudSettings().max_range) : max_range_(static_cast<float>(max_range)) {}

  /// As HiddenSpace::update.
  void update(const std::vector<PosedPoints>& keyframes);

  /// Through the point's place saw three keyframes or more, and more than twice as many as saw something there or
  /// right beside it.
  bool isGone(const Eigen::Vector3f& point) const;
  /// Takes out of a cloud what is gone; returns how many points.
  std::size_t dropGone(std::vector<CloudPoint>* cloud) const;

  void clear();
  std::size_t tiles() const { return tiles_.size(); }  ///< of 17 kB each

 private:
  static constexpr int kSideBits = 4, kSide = 1 << kSideBits, kCells = kSide * kSide * kSide;  // of a tile
  struct Cell {
    std::uint16_t through = 0, hit = 0;  // keyframes
  };
  struct Tile {
    Cell cells[kCells];
    std::bitset<kCells> through_now, hit_now;  // by the keyframe that is being cast
    bool touched = false;                      // likewise
  };
  using Index = Eigen::Vector3i;
  static std::int64_t tileOf(const Index& cell);  // its key
  static int inTile(const Index& cell);
  static Index cellOf(const Eigen::Vector3f& point);
  const Cell* find(const Index& cell) const;
  /// `sign` -1: takes out again what was cast with 1.
  void cast(const air_ground_common::Pose& T_map_camera, const DepthRays& rays, int sign);

  float max_range_;  // [m]
  TileGrid<Tile> tiles_;
  SeenKeyframes seen_;
};

}  // namespace rgbd_slam
