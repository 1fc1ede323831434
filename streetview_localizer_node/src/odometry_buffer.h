// Recent poses of one source, looked up by time.
#pragma once

#include <cmath>
#include <cstddef>
#include <deque>
#include <optional>

#include "streetview_localizer/pose_estimation.h"

namespace streetview_localizer {

struct TimedPose {
  double stamp = 0;  ///< [s]
  Pose pose = Pose::Identity();
  Matrix6d covariance = Matrix6d::Identity();
};

/// Holds what is at most 10 s from the newest pose, whatever the order of the stamps, and no more than kMost poses.
class OdometryBuffer {
 public:
  static constexpr double kKept = 10;  ///< [s]
  static constexpr std::size_t kMost = 20000;

  void push(const TimedPose& pose) {
    // The last to arrive counts: a stamp that leaps leaves nothing of what was before.
    while (!poses_.empty() && (poses_.size() >= kMost || std::abs(pose.stamp - poses_.front().stamp) > kKept))
      poses_.pop_front();
    poses_.push_back(pose);
  }
  void clear() { poses_.clear(); }
  std::size_t size() const { return poses_.size(); }
  bool reaches(double stamp) const { return !poses_.empty() && poses_.back().stamp >= stamp; }
  /// The pose nearest in time, empty when it is more than `max_age` [s] off.
  std::optional<TimedPose> nearest(double stamp, double max_age) const {
    const TimedPose* best = nullptr;
    for (const TimedPose& p : poses_)
      if (!best || std::abs(p.stamp - stamp) < std::abs(best->stamp - stamp)) best = &p;
    if (!best || std::abs(best->stamp - stamp) > max_age) return std::nullopt;
    return *best;
  }

 private:
  std::deque<TimedPose> poses_;
};

}  // namespace streetview_localizer
