#include "icp_refine/neighbor_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "kd_tree_kernel.h"

namespace icp_refine {

using kernel::kFan;
using kernel::kLeaf;
static_assert(kFan == kLeaf, "boxes are made of leaves and of groups alike");

namespace {

// Leaves [begin, end) are split after a multiple of the largest group of boxes that is smaller: groups are then parts
// of the tree.
int splitOf(int begin, int end) {
  const int count = end - begin;
  int unit = 1;
  while (unit * kFan < count) unit *= kFan;
  return begin + std::max(1, (count / 2 + unit / 2) / unit) * unit;
}

}  // namespace

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
  if (dimensions_ == 6)
    fill<6>(n, leaves);
  else
    fill<3>(n, leaves);
}

// Builds on copies of the points, which are moved about: no access to memory at random.
template <int D>
void NeighborSearch::fill(int n, int leaves) {
  std::vector<Entry<D>> entries(n);
  for (int i = 0; i < n; ++i) {
    std::copy_n(&points_[static_cast<std::size_t>(i) * D], D, entries[i].at);
    entries[i].index = i;
  }
  build(entries, 0, leaves);
  makeBoxes(leaves);
}

// Splits the widest axis such that all leaves but the last are full: a part of the tree is then known by its leaves.
template <int D>
void NeighborSearch::build(std::vector<Entry<D>>& entries, int begin, int end) {
  const int first = begin * kLeaf, last = std::min(end * kLeaf, static_cast<int>(entries.size()));
  if (end - begin == 1) {
    for (int i = first; i < last; ++i) {
      index_[i] = entries[i].index;
      for (int d = 0; d < D; ++d) leaves_[(begin * D + d) * kLeaf + (i - first)] = entries[i].at[d];
    }
    return;
  }
  std::array<float, D> low, high;
  low.fill(std::numeric_limits<float>::max());
  high.fill(std::numeric_limits<float>::lowest());
  for (int i = first; i < last; ++i) {
    const float* p = entries[i].at;
    for (int d = 0; d < D; ++d) low[d] = std::min(low[d], p[d]), high[d] = std::max(high[d], p[d]);
  }
  int axis = 0;
  for (int d = 1; d < D; ++d) {
    if (high[d] - low[d] > high[axis] - low[axis]) axis = d;
  }
  const int middle = splitOf(begin, end);
  // Ties by index: the tree, and with it the choice among equals, does not depend on the standard library.
  std::nth_element(entries.begin() + first, entries.begin() + middle * kLeaf, entries.begin() + last,
                   [axis](const Entry<D>& a, const Entry<D>& b) {
                     return a.at[axis] != b.at[axis] ? a.at[axis] < b.at[axis] : a.index < b.index;
                   });
  build(entries, begin, middle);
  build(entries, middle, end);
}

void NeighborSearch::makeBoxes(int leaves) {
  constexpr float kFar = std::numeric_limits<float>::infinity();
  const int D = dimensions_;
  const auto at = [D](int level_begin, int child, int d, int side) {
    return (((level_begin + child / kFan) * D + d) * 2 + side) * kFan + child % kFan;
  };
  for (int count = leaves, begin = 0;; count = (count + kFan - 1) / kFan) {
    const int below = first_group_.empty() ? 0 : first_group_.back(), groups = (count + kFan - 1) / kFan;
    boxes_.resize(static_cast<std::size_t>(begin + groups) * D * 2 * kFan, kFar);
    for (int child = 0; child < count; ++child)
      for (int d = 0; d < D; ++d) {
        // Of a leaf its points, of a group its boxes.
        const float *lower, *upper;
        if (first_group_.empty()) {
          lower = upper = &leaves_[(static_cast<std::size_t>(child) * D + d) * kLeaf];
        } else {
          lower = &boxes_[at(below + child, 0, d, 0)];
          upper = lower + kFan;
        }
        float low = kFar, high = -kFar;
        for (int i = 0; i < kFan; ++i) {
          if (lower[i] == kFar) continue;
          low = std::min(low, lower[i]);
          high = std::max(high, upper[i]);
        }
        boxes_[at(begin, child, d, 0)] = low;
        boxes_[at(begin, child, d, 1)] = high;
      }
    first_group_.push_back(begin);
    begin += groups;
    if (groups == 1) return;
  }
}

kernel::TreeView NeighborSearch::view() const {
  return {leaves_.data(), index_.data(), boxes_.data(), first_group_.data(), static_cast<int>(first_group_.size())};
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
  float squared;
  trace.index = dimensions_ == 6 ? kernel::nearest6(view(), query, &squared, &next)
                                 : kernel::nearest3(view(), query, &squared, &next);
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
  const int count = kernel::nearestK3(view(), query, k, squared_limit, indices.data(), squared_distances.data());
  indices.resize(count);
  squared_distances.resize(count);
}

}  // namespace icp_refine
