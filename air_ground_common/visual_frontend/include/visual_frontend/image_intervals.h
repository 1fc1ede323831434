// Times between images: by a driver's jitter, or an image that came twice, two may seem to be next to no time apart.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "air_ground_common/statistics.h"

namespace visual_frontend {

class ImageIntervals {
 public:
  void add(double interval) {
    intervals_.push_back(interval);
    if (intervals_.size() > kKept) intervals_.erase(intervals_.begin());
  }
  void clear() { intervals_.clear(); }

  /// Over less than half of the usual time the step between two poses, or its noise, would be a leap of metres a
  /// second.
  bool tooShort(double interval) const { return interval < least(); }
  /// The interval, or half of the usual one where that is longer [s].
  double plausible(double interval) const { return std::max(interval, least()); }

 private:
  static constexpr std::size_t kKept = 15;
  double least() const { return intervals_.empty() ? 0 : 0.5 * air_ground_common::median(intervals_); }

  std::vector<double> intervals_;  // the last ones [s]
};

}  // namespace visual_frontend
