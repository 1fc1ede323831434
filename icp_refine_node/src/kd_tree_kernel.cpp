#include "kd_tree_kernel.h"

#include <algorithm>
#include <cstring>
#include <limits>

#include "air_ground_common/clones.h"

namespace icp_refine::kernel {
namespace {

// Squared distances that are not negative rise with their bits. The last bits make room for the number of a child.
std::int32_t bitsOf(float squared) {
  std::int32_t bits;
  std::memcpy(&bits, &squared, sizeof bits);
  return bits;
}

// Of each child of a group: its number, and the squared distance of its box, rounded down. Distances of boxes are
// rounded like those of points, so that none comes out greater than that of a point inside.
template <int D>
inline __attribute__((always_inline)) void measure(const float* boxes, const float* query, std::int32_t* keys) {
  float squared[kFan] = {};
  for (int d = 0; d < D; ++d) {
    const float *lower = boxes + 2 * d * kFan, *upper = lower + kFan;
    for (int i = 0; i < kFan; ++i) {
      const float outside = std::max(0.f, std::max(lower[i] - query[d], query[d] - upper[i]));
      squared[i] += outside * outside;
    }
  }
  std::memcpy(keys, squared, sizeof squared);
  for (int i = 0; i < kFan; ++i) keys[i] = (keys[i] & ~(kFan - 1)) | i;
}

// Visits the leaves that may hold a point nearer than bound(), in each group the nearest first.
// visit(leaf, squared distances).
template <int D, class Bound, class Visit>
inline __attribute__((always_inline)) void search(const TreeView& tree, const float* query, const Bound& bound,
                                                  const Visit& visit) {
  constexpr std::int32_t kDone = std::numeric_limits<std::int32_t>::max();
  alignas(64) std::int32_t keys[kLevels][kFan];
  int group[kLevels];
  const auto enter = [&](int level, int which) __attribute__((always_inline)) {
    group[level] = which;
    measure<D>(tree.boxes + static_cast<std::ptrdiff_t>(tree.first_group[level] + which) * D * 2 * kFan, query,
               keys[level]);
  };
  int level = tree.levels - 1;
  enter(level, 0);
  while (level < tree.levels) {
    std::int32_t next = kDone;
    for (int i = 0; i < kFan; ++i) next = std::min(next, keys[level][i]);
    if ((next & ~(kFan - 1)) >= bitsOf(bound())) {
      ++level;
      continue;
    }
    const int lane = next & (kFan - 1), child = group[level] * kFan + lane;
    keys[level][lane] = kDone;
    if (level > 0) {
      enter(--level, child);
      continue;
    }
    const float* c = tree.coordinates + static_cast<std::ptrdiff_t>(child) * D * kLeaf;
    float squared[kLeaf] = {};
    for (int d = 0; d < D; ++d) {
      for (int i = 0; i < kLeaf; ++i) squared[i] += (c[d * kLeaf + i] - query[d]) * (c[d * kLeaf + i] - query[d]);
    }
    const float limit = bound();
    int any = 0;
    for (int i = 0; i < kLeaf; ++i) any |= squared[i] < limit;
    if (any) visit(child, squared);
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
