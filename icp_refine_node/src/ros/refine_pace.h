// When the next refinement is due.
#pragma once

#include <chrono>

namespace icp_refine {

/// Refinements lie a period apart, which bounds the load: those of dense clouds from one another, and those of what
/// else changes from any. A cloud does not wait since something else was refined a moment ago.
class RefinePace {
 public:
  using Clock = std::chrono::steady_clock;

  explicit RefinePace(Clock::duration period) : period_(period) {}

  /// What has come: `news` are to be refined, a `cloud` is among them.
  void add(bool news, bool cloud) {
    pending_ |= news;
    cloud_ |= cloud;
  }
  bool pending() const { return pending_; }
  Clock::time_point due() const { return cloud_ ? after_clouds_ : after_any_; }
  /// A refinement of all that has come ended now.
  void refined(Clock::time_point now) {
    after_any_ = now + period_;
    if (cloud_) after_clouds_ = after_any_;
    drop();
  }
  /// What has come is not refined.
  void drop() { pending_ = cloud_ = false; }

 private:
  const Clock::duration period_;
  bool pending_ = false, cloud_ = false;
  Clock::time_point after_clouds_, after_any_;
};

}  // namespace icp_refine
