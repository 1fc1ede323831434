// How high the obstacles are: what a flight must keep clear of.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "air_ground_common/mesh.h"

namespace air_ground_sim {

/// Height [m] of the highest point of the mesh within `radius` of a place (vertices and triangle samples every 5 cm).
class HeightLookup {
 public:
  explicit HeightLookup(const air_ground_common::TriangleMesh& mesh);
  double operator()(const Eigen::Vector2d& place, double radius) const;

 private:
  static constexpr double kCell = 0.05;
  int size_ = 0;
  double origin_ = 0;
  std::vector<float> cells_;
};

}  // namespace air_ground_sim
