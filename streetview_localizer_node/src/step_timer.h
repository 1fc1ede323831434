// Times of the localizer's steps.
#pragma once

#include <chrono>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

/// Adds the time until its end to one step.
class StepTimer {
 public:
  using Clock = std::chrono::steady_clock;

  StepTimer(LocalizerResult* result, Step step) : result_(result), step_(step), start_(Clock::now()) {}
  ~StepTimer() { result_->times[static_cast<std::size_t>(step_)] += secondsSince(start_); }
  StepTimer(const StepTimer&) = delete;
  StepTimer& operator=(const StepTimer&) = delete;

  static double secondsSince(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
  }

 private:
  LocalizerResult* result_;
  Step step_;
  Clock::time_point start_;
};

}  // namespace streetview_localizer
