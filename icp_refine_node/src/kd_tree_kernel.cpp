#include "kd_tree_kernel.h"

#include <algorithm>

// Plain arrays only: no Eigen type may cross into these functions, whose alignment rules differ per clone.
#define AIR_GROUND_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))

namespace icp_refine::kernel {
namespace {

constexpr int kDepth = 40;  // of a tree with 2^40 leaves

// Visits the leaves that may hold a point nearer than bound(), nearest first. visit(leaf, squared distances).
template <int D, class Bound, class Visit>
inline __attribute__((always_inline)) void search(const TreeView& tree, const float* query, const Bound& bound,
                                                  const Visit& visit) {
  // A part of the tree that is still to be visited, with the query's offset to it along each axis.
  struct Part {
    int begin, end;
    float squared, offset[D];
  };
  Part stack[kDepth];
  int top = 0;
  Part now{0, tree.leaves, 0, {}};
  constexpr float kRounding = 1 - 1e-6f;
  while (true) {
    while (now.end - now.begin > 1) {
      const int middle = (now.begin + now.end) / 2, axis = tree.axis[middle];
      const float difference = query[axis] - tree.split[middle];
      const float squared = now.squared + (difference * difference - now.offset[axis] * now.offset[axis]);
      const bool left = difference < 0;
      if (squared * kRounding < bound()) {
        Part& other = stack[top++];
        other = now;
        other.squared = squared;
        other.offset[axis] = difference;
        (left ? other.begin : other.end) = middle;
      }
      (left ? now.end : now.begin) = middle;
    }
    const float* c = tree.coordinates + static_cast<std::ptrdiff_t>(now.begin) * D * kLeaf;
    float squared[kLeaf];
    for (int i = 0; i < kLeaf; ++i) squared[i] = (c[i] - query[0]) * (c[i] - query[0]);
    for (int d = 1; d < D; ++d) {
      for (int i = 0; i < kLeaf; ++i) squared[i] += (c[d * kLeaf + i] - query[d]) * (c[d * kLeaf + i] - query[d]);
    }
    const float limit = bound();
    int any = 0;
    for (int i = 0; i < kLeaf; ++i) any |= squared[i] < limit;
    if (any) visit(now.begin, squared);
    do {
      if (top == 0) return;
      now = stack[--top];
    } while (now.squared * kRounding >= bound());
  }
}

template <int D>
inline __attribute__((always_inline)) int nearest(const TreeView& tree, const float* query, float* squared,
                                                  float* next) {
  float best = *next, second = *next;
  int slot = -1;
  search<D>(
      tree, query, [&second] { return second; },
      [&](int leaf, const float* distances) {
        for (int i = 0; i < kLeaf; ++i) {
          if (distances[i] >= second) continue;
          if (distances[i] < best)
            second = best, best = distances[i], slot = leaf * kLeaf + i;
          else
            second = distances[i];
        }
      });
  *squared = best;
  *next = second;
  return slot < 0 ? -1 : tree.index[slot];
}

}  // namespace

AIR_GROUND_CLONES
int nearest3(const TreeView& tree, const float* query, float* squared, float* next) {
  return nearest<3>(tree, query, squared, next);
}

AIR_GROUND_CLONES
int nearest6(const TreeView& tree, const float* query, float* squared, float* next) {
  return nearest<6>(tree, query, squared, next);
}

AIR_GROUND_CLONES
int nearestK3(const TreeView& tree, const float* query, int k, float squared_limit, std::int32_t* indices,
              float* squared) {
  int count = 0;
  float worst = squared_limit;
  search<3>(
      tree, query, [&worst] { return worst; },
      [&](int leaf, const float* distances) {
        for (int i = 0; i < kLeaf; ++i) {
          const float d = distances[i];
          if (d >= worst) continue;
          int at = count < k ? count++ : k - 1;
          for (; at > 0 && squared[at - 1] > d; --at) {
            squared[at] = squared[at - 1];
            indices[at] = indices[at - 1];
          }
          squared[at] = d;
          indices[at] = tree.index[leaf * kLeaf + i];
          if (count == k) worst = squared[k - 1];
        }
      });
  return count;
}

}  // namespace icp_refine::kernel
