// Times of the localizer's steps.
#pragma once

#include <array>
#include <chrono>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

/// Of one image, whatever it is tried with.
class StepTimes {
 public:
  using Clock = std::chrono::steady_clock;
  static double secondsSince(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
  }

  /// Adds the time until its end to one step.
  class Timer {
   public:
    explicit Timer(double* seconds) : seconds_(seconds), start_(Clock::now()) {}
    ~Timer() { *seconds_ += secondsSince(start_); }
    Timer(const Timer&) = delete;
    Timer& operator=(const Timer&) = delete;

   private:
    double* seconds_;
    Clock::time_point start_;
  };
  [[nodiscard]] Timer measure(Step step) { return Timer(&seconds_[static_cast<std::size_t>(step)]); }

  /// What `work` returns.
  template <typename Work>
  auto timed(Step step, Work work) {
    const auto timer = measure(step);
    return work();
  }

  const std::array<double, kSteps>& seconds() const { return seconds_; }

 private:
  std::array<double, kSteps> seconds_{};
};

}  // namespace streetview_localizer
