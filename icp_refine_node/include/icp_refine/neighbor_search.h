// Nearest neighbours in a cloud: a balanced kd-tree in float with leaves of 16 points, laid out for vector units.
#pragma once

#include <array>
#include <limits>
#include <vector>

#include "icp_refine/cloud.h"

namespace icp_refine {

namespace kernel {
struct TreeView;
}

/// Kd-tree over points or, with normal_weight > 0, over (point, normal_weight * normal): a neighbour is then near in
/// place and in orientation. Holds copies; queries are exact, const and thread-safe.
class NeighborSearch {
 public:
  /// normal_weight [m]: distance that a normal turned by 1 rad counts for. Needs normals when > 0.
  /// Throws std::invalid_argument for an empty cloud, or missing normals.
  explicit NeighborSearch(const Cloud& cloud, float normal_weight = 0);

  /// What a search leaves for the next one of the same point.
  struct Trace {
    std::array<float, 6> query;  ///< where it was
    float others = -1;           ///< all points but the one found were at least this far away [m]; -1: no search yet
    int index = -1;              ///< found
  };

  /// Point of the cloud at place k of the tree, k in [0, size of the cloud): places near each other hold points that
  /// are.
  int pointAt(int k) const { return index_[k]; }

  /// Index of the nearest point within max_distance [m], -1 when there is none; `normal` counts with normal_weight > 0
  /// only. `trace`: of the last search for this point, with the same max_distance, or a new one. A point that has moved
  /// less since than its neighbour is nearer than all others keeps it; what is found does not depend on the trace.
  int nearest(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, float max_distance, Trace& trace) const;
  int nearest(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, float max_distance) const {
    Trace trace;
    return nearest(point, normal, max_distance, trace);
  }

  /// Indices of up to k nearest points, nearest first, with squared distances [m^2]: of those nearer than the root of
  /// squared_limit [m^2]. For trees without normals.
  void nearestK(const Eigen::Vector3f& point, int k, std::vector<int>& indices, std::vector<float>& squared_distances,
                float squared_limit = std::numeric_limits<float>::infinity()) const;

 private:
  template <int D>
  struct Entry {
    float at[D];
    int index;
  };
  template <int D>
  void fill(int n, int leaves);
  template <int D>
  void build(std::vector<Entry<D>>& entries, int begin, int end);
  void makeBoxes(int leaves);
  kernel::TreeView view() const;

  float normal_weight_;
  int dimensions_;             // 3, or 6 with normals
  std::vector<float> points_;  // [point][dimension]
  std::vector<float> leaves_;  // see kernel::TreeView
  std::vector<int> index_;
  std::vector<float> boxes_;
  std::vector<int> first_group_;
};

}  // namespace icp_refine
