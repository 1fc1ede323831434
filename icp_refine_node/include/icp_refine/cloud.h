// Point cloud as plain arrays, and nearest neighbours in it (PCL's FLANN kd-tree behind a pimpl).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "air_ground_common/geometry.h"

namespace icp_refine {

using air_ground_common::Matrix6d;
using air_ground_common::Pose;
using air_ground_common::Vector6d;

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
Cloud transformed(const Cloud& cloud, const Pose& T);

/// Removes points with a coordinate that is not finite or beyond 1e6 m; returns how many.
std::size_t removeInvalid(Cloud& cloud);

/// Integer cell of a point on a grid of `size` [m], packed in 63 bits (21 a coordinate). Points must lie within 2^20
/// cells.
std::uint64_t cellKey(const Eigen::Vector3f& p, float size);

/// Kd-tree over points or, with normal_weight > 0, over (point, normal_weight * normal): a neighbour is then near in
/// place and in orientation. Holds copies; queries are const and thread-safe. PCL's KdTreeFLANN.
class NeighborSearch {
 public:
  /// normal_weight [m]: distance that a normal turned by 1 rad counts for. Needs normals when > 0.
  /// Throws std::invalid_argument for an empty cloud, or missing normals.
  explicit NeighborSearch(const Cloud& cloud, float normal_weight = 0);
  ~NeighborSearch();
  NeighborSearch(NeighborSearch&&) noexcept;
  NeighborSearch& operator=(NeighborSearch&&) noexcept;

  float normalWeight() const;

  /// Index of the nearest point within max_distance [m], -1 when there is none; `normal` counts with normal_weight > 0
  /// only.
  int nearest(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, float max_distance) const;

  /// Indices of up to k nearest points, nearest first, with squared distances [m^2]. For trees without normals.
  void nearestK(const Eigen::Vector3f& point, int k, std::vector<int>& indices,
                std::vector<float>& squared_distances) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace icp_refine
