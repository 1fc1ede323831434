// Point cloud as plain arrays.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "icp_refine/similarity.h"

namespace icp_refine {

struct Cloud {
  std::vector<Eigen::Vector3f> points;   ///< [m]
  std::vector<Eigen::Vector3f> normals;  ///< unit length; empty, or one a point

  std::size_t size() const { return points.size(); }
  bool empty() const { return points.empty(); }
  bool hasNormals() const { return !points.empty() && normals.size() == points.size(); }

  /// Keeps the points (and normals) whose mask entry is not 0; mask.size() == size(). Order is kept.
  void keep(const std::vector<char>& mask);
  /// Keeps the points at `indices`, in that order.
  void select(const std::vector<int>& indices);
};

/// T applied to points, its rotation to normals.
Cloud transformed(const Cloud& cloud, const Similarity& T);
Cloud transformed(const Cloud& cloud, const Pose& T);

/// Mean of the points [m]; zero for an empty cloud.
Eigen::Vector3d middle(const Cloud& cloud);

/// Removes points with a coordinate that is not finite or beyond 1e6 m; returns how many.
std::size_t removeInvalid(Cloud& cloud);

/// Integer cell of a point on a grid of `size` [m], packed in 63 bits (21 a coordinate). Points must lie within 2^20
/// cells.
std::uint64_t cellKey(const Eigen::Vector3f& p, float size);

}  // namespace icp_refine
