// When what a map consists of may go out again: it grows, what carries it does not.
#pragma once

#include <algorithm>
#include <limits>

namespace rgbd_slam {

/// Times by one clock, any [s]. Not thread-safe.
class MapPacer {
 public:
  /// Messages are `interval` apart [s], and further where they take longer than that at `bandwidth` [bytes/s].
  MapPacer(double interval, double bandwidth) : interval_(interval), bandwidth_(bandwidth) {}

  /// There is something to send. `corrected`: receivers work with a map that is wrong.
  void changed(bool corrected) {
    changed_ = true;
    corrected_ = corrected_ || corrected;
  }
  /// Now, if it takes about so many bytes. A correction may have the line one message ahead of its time; the next one
  /// waits for it.
  bool due(double now, double bytes) const {
    if (!changed_) return false;
    return corrected_ ? now >= free_ - bytes / bandwidth_ : now >= std::max(free_, last_ + interval_);
  }
  void sent(double now, double bytes) {
    changed_ = corrected_ = false;
    last_ = now;
    free_ = std::max(free_, now) + bytes / bandwidth_;
  }
  /// What there is to send is due at once.
  void hurry() { last_ = free_ = -std::numeric_limits<double>::infinity(); }
  /// Another map, or another time.
  void restart() {
    hurry();
    changed_ = corrected_ = false;
  }

 private:
  double interval_, bandwidth_;
  double last_ = -std::numeric_limits<double>::infinity(), free_ = last_;  // free_: when all so far has gone through
  bool changed_ = false, corrected_ = false;
};

}  // namespace rgbd_slam
