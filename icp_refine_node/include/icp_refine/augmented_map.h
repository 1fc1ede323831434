// The ground robot's map extended by what the MAV saw (A-VII, figure 15).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <unordered_map>
#include <vector>

#include "icp_refine/cloud.h"

namespace icp_refine {

/// Aerial points with their grey value, one a voxel (mean of its points), in mav_map. Bounded: voxels grow when there are too many.
class AerialVoxels {
 public:
  /// leaf [m] > 0, doubled whenever more than max_voxels (> 0) are taken.
  explicit AerialVoxels(double leaf, std::size_t max_voxels = std::numeric_limits<std::size_t>::max())
      : first_leaf_(static_cast<float>(leaf)), leaf_(first_leaf_), max_voxels_(max_voxels) {}

  /// intensity: 0..255. Points that are not finite are ignored.
  void add(const Eigen::Vector3f& point, float intensity);
  void clear() {
    voxels_.clear();
    leaf_ = first_leaf_;
  }
  float leaf() const { return leaf_; }  ///< present edge of a voxel [m]
  std::size_t size() const { return voxels_.size(); }

  struct Point {
    Eigen::Vector3f position;  ///< mav_map [m]
    std::uint8_t grey;
    int count;  ///< points merged
  };
  /// Voxels with at least min_points, in an order that depends on the input alone.
  std::vector<Point> points(int min_points = 1) const;

 private:
  struct Voxel {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    float intensity = 0;
    int count = 0;
    std::size_t order = 0;
  };
  void coarsen();

  float first_leaf_, leaf_;
  std::size_t max_voxels_;
  std::size_t next_order_ = 0;
  std::unordered_map<std::uint64_t, Voxel> voxels_;
};

/// Mask of the points of `aerial` (already in the ground map's frame) in whose cell of `leaf` [m], or a neighbouring one,
/// the ground map has no point: what the aerial view adds.
std::vector<char> addedByAir(const std::vector<Eigen::Vector3f>& aerial, const std::vector<Eigen::Vector3f>& ground, double leaf);

}  // namespace icp_refine
