// What the sources of the filter share of its state.
#pragma once

#include "ekf_tracker/pose_filter.h"

namespace ekf_tracker {

enum { kYaw = 3, kScale = 4, kOffset = 5 };

inline void symmetrise(Matrix6d* p) { *p = 0.5 * (*p + p->transpose()).eval(); }

}  // namespace ekf_tracker
