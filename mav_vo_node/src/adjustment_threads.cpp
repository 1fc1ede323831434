#include "adjustment_threads.h"

#include <chrono>
#include <utility>
#ifdef __linux__
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

namespace mav_vo {

namespace {

constexpr int kAdoptAfterImages = 2;  // a local adjustment beside the tracking moves the map before this image after it
constexpr double kAdoptFullAfter = 1.0;    // one of the whole map, at the earliest; and so often it is asked for [s]
constexpr double kFullPerKeyframe = 0.02;  // for which an idle desktop's core takes less [s]

/// A thread of the lowest priority delays neither tracking nor local adjustments.
void yieldToOtherThreads() {
#ifdef __linux__
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), 10);
#endif
}

}  // namespace

void AdjustmentThreads::discard() {
  for (Running* running : {&local_, &full_}) {
    if (running->result.valid()) running->result.wait();
    *running = {};
  }
}

void AdjustmentThreads::start(BundleJob job, double stamp) {
  Running& slot = job.full ? full_ : local_;
  slot.stamp = stamp;
  slot.images = 0;
  slot.keyframes = job.keyframes.size();
  slot.result = std::async(std::launch::async, [job = std::move(job)]() mutable {
    if (job.full) yieldToOtherThreads();
    job.solve();
    return std::move(job);
  });
}

// A late result is waited for, so that no image is tracked on an older map than it would be on an idle machine.
bool AdjustmentThreads::localDue() { return localRuns() && ++local_.images >= kAdoptAfterImages; }

bool AdjustmentThreads::fullDue(double stamp) {
  if (!fullRuns() || stamp - full_.stamp < kAdoptFullAfter) return false;
  if (reproducible_)
    return stamp - full_.stamp >= kAdoptFullAfter + kFullPerKeyframe * static_cast<double>(full_.keyframes);
  full_.stamp = stamp;
  return full_.result.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
}

}  // namespace mav_vo
