// Nearest neighbours in a cloud: a balanced kd-tree in float with leaves of 16 points, laid out for vector units.
#pragma once

#include <limits>
#include <vector>

#include "icp_refine/cloud.h"

namespace icp_refine {

/// Kd-tree over points or, with normal_weight > 0, over (point, normal_weight * normal): a neighbour is then near in
/// place and in orientation. Holds copies; queries are exact, const and thread-safe.
class NeighborSearch {
 public:
  /// normal_weight [m]: distance that a normal turned by 1 rad counts for. Needs normals when > 0.
  /// Throws std::invalid_argument for an empty cloud, or missing normals.
  explicit NeighborSearch(const Cloud& cloud, float normal_weight = 0);

  float normalWeight() const { return normal_weight_; }

  /// Index of the nearest point within max_distance [m], -1 when there is none; `normal` counts with normal_weight > 0
  /// only. `hint`: index of a point that is likely near, such as the neighbour of a moment ago, or -1; it shortens the
  /// search and does not change what is found.
  int nearest(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, float max_distance, int hint = -1) const;

  /// Indices of up to k nearest points, nearest first, with squared distances [m^2]: of those nearer than the root of
  /// squared_limit [m^2]. For trees without normals.
  void nearestK(const Eigen::Vector3f& point, int k, std::vector<int>& indices, std::vector<float>& squared_distances,
                float squared_limit = std::numeric_limits<float>::infinity()) const;

 private:
  void build(std::vector<int>& order, int begin, int end);

  float normal_weight_;
  int dimensions_;             // 3, or 6 with normals
  std::vector<float> points_;  // [point][dimension]: a hint's coordinates
  std::vector<float> leaves_;  // see kernel::TreeView
  std::vector<int> index_, axis_;
  std::vector<float> split_;
};

}  // namespace icp_refine
