#include "icp_refine/neighbor_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "kd_tree_kernel.h"

namespace icp_refine {

using kernel::kLeaf;

NeighborSearch::NeighborSearch(const Cloud& cloud, float normal_weight)
    : normal_weight_(normal_weight), dimensions_(normal_weight > 0 ? 6 : 3) {
  if (cloud.empty()) throw std::invalid_argument("NeighborSearch: the cloud is empty");
  if (normal_weight > 0 && !cloud.hasNormals())
    throw std::invalid_argument("NeighborSearch: normal_weight > 0 needs normals; add SurfaceNormals to the filters");
  const int n = static_cast<int>(cloud.size()), leaves = (n + kLeaf - 1) / kLeaf;
  points_.reserve(static_cast<std::size_t>(n) * dimensions_);
  for (int i = 0; i < n; ++i) {
    for (int d = 0; d < 3; ++d) points_.push_back(cloud.points[i][d]);
    for (int d = 3; d < dimensions_; ++d) points_.push_back(normal_weight * cloud.normals[i][d - 3]);
  }
  leaves_.assign(static_cast<std::size_t>(leaves) * dimensions_ * kLeaf, std::numeric_limits<float>::infinity());
  index_.assign(static_cast<std::size_t>(leaves) * kLeaf, -1);
  axis_.assign(leaves, 0);
  split_.assign(leaves, 0);
  std::vector<int> order(n);
  std::iota(order.begin(), order.end(), 0);
  build(order, 0, leaves);
}

// Splits the widest axis such that all leaves but the last are full: a part of the tree is then known by its leaves.
void NeighborSearch::build(std::vector<int>& order, int begin, int end) {
  const int first = begin * kLeaf, last = std::min(end * kLeaf, static_cast<int>(order.size()));
  if (end - begin == 1) {
    for (int i = first; i < last; ++i) {
      index_[i] = order[i];
      for (int d = 0; d < dimensions_; ++d)
        leaves_[(begin * dimensions_ + d) * kLeaf + (i - first)] = points_[order[i] * dimensions_ + d];
    }
    return;
  }
  std::array<float, 6> low, high;
  low.fill(std::numeric_limits<float>::max());
  high.fill(std::numeric_limits<float>::lowest());
  for (int i = first; i < last; ++i) {
    const float* p = &points_[order[i] * dimensions_];
    for (int d = 0; d < dimensions_; ++d) low[d] = std::min(low[d], p[d]), high[d] = std::max(high[d], p[d]);
  }
  int axis = 0;
  for (int d = 1; d < dimensions_; ++d) {
    if (high[d] - low[d] > high[axis] - low[axis]) axis = d;
  }
  const int middle = (begin + end) / 2;
  const auto coordinate = [&](int i) { return points_[i * dimensions_ + axis]; };
  // Ties by index: the tree, and with it the choice among equals, does not depend on the standard library.
  std::nth_element(order.begin() + first, order.begin() + middle * kLeaf, order.begin() + last, [&](int a, int b) {
    return coordinate(a) != coordinate(b) ? coordinate(a) < coordinate(b) : a < b;
  });
  axis_[middle] = axis;
  split_[middle] = coordinate(order[middle * kLeaf]);
  build(order, begin, middle);
  build(order, middle, end);
}

int NeighborSearch::nearest(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, float max_distance,
                            Trace& trace) const {
  float query[6] = {point.x(), point.y(), point.z()};
  for (int d = 3; d < dimensions_; ++d) query[d] = normal_weight_ * normal[d - 3];
  const auto distanceTo = [&](const float* other) {
    float squared = 0;
    for (int d = 0; d < dimensions_; ++d) squared += (other[d] - query[d]) * (other[d] - query[d]);
    return std::sqrt(squared);
  };
  constexpr float kRounding = 1 + 1e-4f;
  float next = std::nextafter(max_distance * max_distance, std::numeric_limits<float>::infinity());
  if (trace.others >= 0) {
    // All others are at least others - moved away, and, where others is not max_distance, the two nearest lie within
    // others + moved.
    const float moved = distanceTo(trace.query.data());
    if (trace.index >= 0 &&
        (distanceTo(&points_[static_cast<std::size_t>(trace.index) * dimensions_]) + moved) * kRounding < trace.others)
      return trace.index;
    const float reach = (trace.others + moved) * kRounding;
    next = std::min(next, reach * reach);
  }
  const kernel::TreeView tree{leaves_.data(), index_.data(), axis_.data(), split_.data(),
                              static_cast<int>(axis_.size())};
  float squared;
  trace.index = dimensions_ == 6 ? kernel::nearest6(tree, query, &squared, &next)
                                 : kernel::nearest3(tree, query, &squared, &next);
  trace.others = std::sqrt(next);
  std::copy_n(query, 6, trace.query.begin());
  return trace.index;
}

void NeighborSearch::nearestK(const Eigen::Vector3f& point, int k, std::vector<int>& indices,
                              std::vector<float>& squared_distances, float squared_limit) const {
  if (dimensions_ != 3) throw std::logic_error("NeighborSearch::nearestK: built with normals");
  indices.resize(k);
  squared_distances.resize(k);
  const float query[3] = {point.x(), point.y(), point.z()};
  const kernel::TreeView tree{leaves_.data(), index_.data(), axis_.data(), split_.data(),
                              static_cast<int>(axis_.size())};
  const int count = kernel::nearestK3(tree, query, k, squared_limit, indices.data(), squared_distances.data());
  indices.resize(count);
  squared_distances.resize(count);
}

}  // namespace icp_refine
