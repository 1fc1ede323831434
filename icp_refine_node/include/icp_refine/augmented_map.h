// The ground robot's map extended by what the MAV saw (A-VII, figure 15).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>
#include <unordered_map>
#include <utility>
#include <vector>

#include "air_ground_common/followed_clouds.h"
#include "air_ground_common/mesh.h"
#include "icp_refine/cloud.h"

namespace icp_refine {

using air_ground_common::LabeledPoint;

/// Aerial points with their grey value, one a voxel (mean of its points), in mav_map. Bounded: voxels grow when there
/// are too many.
class AerialVoxels {
 public:
  /// leaf [m] > 0, doubled whenever more than max_voxels (> 0) are taken.
  explicit AerialVoxels(double leaf, std::size_t max_voxels = std::numeric_limits<std::size_t>::max())
      : first_leaf_(static_cast<float>(leaf)), leaf_(first_leaf_), max_voxels_(max_voxels) {}

  /// intensity: 0..255. Points that are not finite are ignored.
  void add(const Eigen::Vector3f& point, float intensity);
  void clear() {
    voxels_.clear();
    of_cell_.clear();
    leaf_ = first_leaf_;
  }
  float leaf() const { return leaf_; }  ///< present edge of a voxel [m]
  std::size_t size() const { return voxels_.size(); }
  /// Room for so many.
  void reserve(std::size_t voxels);

  struct Point {
    Eigen::Vector3f position;  ///< mav_map [m]
    std::uint8_t grey;
    int count;  ///< points merged
  };
  /// Voxels with at least min_points, in the order of their first points.
  std::vector<Point> points(int min_points = 1) const;

 private:
  struct Voxel {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    float intensity = 0;
    int count = 0;
  };
  Voxel& voxelOf(const Eigen::Vector3f& point);
  void coarsen();

  float first_leaf_, leaf_;
  std::size_t max_voxels_;
  std::vector<Voxel> voxels_;
  std::unordered_map<std::uint64_t, std::size_t> of_cell_;  // index into voxels_
};

/// Mask of the points of `aerial` (already in the ground map's frame) in whose cell of `leaf` [m], or a neighbouring
/// one, the ground map has no point: what the aerial view adds.
std::vector<char> addedByAir(const std::vector<Eigen::Vector3f>& aerial, const std::vector<Eigen::Vector3f>& ground,
                             double leaf);

struct AugmentedMapSettings {
  double leaf = 0.02;                ///< edge of the aerial voxels [m]
  std::size_t max_voxels = 2000000;  ///< with more of them they grow
  int min_points = 1;                ///< voxels with fewer are left out
  bool fill_only = false;            ///< aerial points only where the ground robot saw nothing
  bool ground_red = true;            ///< false: its points keep their colours
};

/// The ground robot's points and, while the alignment is known, the MAV's among them.
class AugmentedMap {
 public:
  explicit AugmentedMap(const AugmentedMapSettings& settings)
      : settings_(settings), settled_(settings.leaf, settings.max_voxels), aerial_(settled_) {}

  /// In the ground map's frame.
  void setGround(std::vector<LabeledPoint> points) { ground_ = std::move(points); }
  void clearGround() { ground_.clear(); }
  /// A cloud in mav_map, by its stamp [ns]; the points' grey value is rgb[0].
  void addAerial(std::int64_t stamp, std::vector<LabeledPoint> points);
  /// mav_map was corrected. The voxels follow when the points are asked for.
  void correctAerial(const air_ground_common::CloudCorrections& corrections);
  void clearAerial();

  /// Without a transform the map is the ground robot's alone.
  void align(const std::optional<Similarity>& T_ground_map_mav_map) { T_ground_map_mav_map_ = T_ground_map_mav_map; }
  bool aligned() const { return T_ground_map_mav_map_.has_value(); }

  /// Ground points (source 0) first, then aerial ones (source 1), in the ground map's frame.
  std::vector<LabeledPoint> points();

 private:
  void followCorrections();

  AugmentedMapSettings settings_;
  std::vector<LabeledPoint> ground_;
  air_ground_common::FollowedClouds<LabeledPoint> clouds_;
  AerialVoxels settled_, aerial_;  // of those before; of all
  bool corrected_ = false;         // since aerial_ was made
  std::optional<Similarity> T_ground_map_mav_map_;
};

}  // namespace icp_refine
