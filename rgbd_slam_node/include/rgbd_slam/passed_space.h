// Where somebody stood or walked when one keyframe was made, others see through: before, where GonePoints cannot look.
#pragma once

#include <Eigen/Core>
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
  /// As HiddenSpace::update.
  void update(const std::vector<PosedPoints>& keyframes);

  /// Through the point's place saw three keyframes or more, and more than twice as many as saw something there or
  /// right beside it.
  bool isGone(const Eigen::Vector3f& point) const;
  /// Takes out of a cloud what is gone; returns how many points.
  std::size_t dropGone(std::vector<CloudPoint>* cloud) const;

  void clear();

 private:
  static constexpr int kSideBits = 4, kSide = 1 << kSideBits;  // of a tile
  struct Cell {
    std::uint8_t through = 0, hit = 0;            // keyframes
    std::uint8_t through_last = 0, hit_last = 0;  // keyframe that was counted last; 0: none
  };
  struct Tile {
    Cell cells[kSide * kSide * kSide];
  };
  using Index = Eigen::Vector3i;
  static std::int64_t tileOf(const Index& cell);  // its key
  static int inTile(const Index& cell);
  static Index cellOf(const Eigen::Vector3f& point);
  const Cell* find(const Index& cell) const;
  void add(const air_ground_common::Pose& T_map_camera, const DepthRays& rays);

  TileGrid<Tile> tiles_;
  SeenKeyframes seen_;
  std::uint8_t vote_ = 0;  // of the keyframe that is being added
};

}  // namespace rgbd_slam
