#include "adjustment_threads.h"

#include <utility>

namespace mav_vo {

void AdjustmentThreads::discard() {
  full_.discard();
  if (localRuns()) local_.wait();
  local_ = {};
}

void AdjustmentThreads::start(BundleJob job, double stamp) {
  if (job.full) return full_.start(std::move(job), stamp);
  images_ = 0;
  local_ = std::async(std::launch::async, [job = std::move(job)]() mutable {
    job.solve();
    return std::move(job);
  });
}

}  // namespace mav_vo
