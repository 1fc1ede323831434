// Searches in a kd-tree on plain arrays; vectorised per CPU generation at run time (clones.h).
#pragma once

#include <cstdint>

namespace icp_refine::kernel {

constexpr int kLeaf = 16;   // points a leaf: one or two vectors of distances
constexpr int kFan = 16;    // children of a node: one or two vectors of distances to their boxes
constexpr int kLevels = 8;  // at most: 16^9 points

/// Leaves of points, and levels of boxes around them: of 16 leaves each, of 16 boxes of the level below each, and so on
/// up to a single group. Child j of a level lies in its group j / kFan.
struct TreeView {
  const float* coordinates;   ///< [leaf][dimension][kLeaf]; places beyond the last point are infinitely far away
  const std::int32_t* index;  ///< [leaf][kLeaf]: of the point in the cloud
  const float* boxes;         ///< [group][dimension][lower, upper][kFan]; those beyond the last child likewise
  const int* first_group;     ///< of each level
  int levels;
};

/// Index of the nearest of the points whose squared distance is below `next`, and its squared distance; -1 when there
/// is none. `next` becomes the squared distance of the second nearest of them, if there is one. `query` has 3 or 6
/// numbers.
int nearest3(const TreeView& tree, const float* query, float* squared, float* next);
int nearest6(const TreeView& tree, const float* query, float* squared, float* next);

/// Up to k nearest points whose squared distance is below `squared_limit`, nearest first; returns how many.
int nearestK3(const TreeView& tree, const float* query, int k, float squared_limit, std::int32_t* indices,
              float* squared);

}  // namespace icp_refine::kernel
