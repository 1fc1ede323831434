#include "visual_frontend/whole_map_thread.h"

#include <chrono>
#include <stdexcept>
#include <utility>

#include "air_ground_common/niceness.h"

namespace visual_frontend {

namespace {

constexpr double kEarliest = 1.0;      // after it began, and so often it is asked for [s]
constexpr double kPerKeyframe = 0.02;  // for which an idle desktop's core takes less [s]

}  // namespace

void WholeMapThread::start(BundleJob job, double stamp) {
  if (runs()) throw std::logic_error("WholeMapThread: the adjustment before runs still");
  stamp_ = stamp;
  keyframes_ = job.keyframes.size();
  cancelled_ = std::make_shared<std::atomic<bool>>(false);
  job.settings.cancelled = cancelled_;
  result_ = std::async(std::launch::async, [job = std::move(job)]() mutable {
    air_ground_common::giveWayWithin();
    job.solve();
    return std::move(job);
  });
}

bool WholeMapThread::due(double stamp) {
  if (!runs() || stamp - stamp_ < kEarliest) return false;
  if (reproducible_) return stamp - stamp_ >= kEarliest + kPerKeyframe * static_cast<double>(keyframes_);
  stamp_ = stamp;
  return result_.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
}

void WholeMapThread::cancel() {
  if (runs()) *cancelled_ = true;
}

void WholeMapThread::discard() {
  cancel();
  if (runs()) result_.wait();
  result_ = {};
}

}  // namespace visual_frontend
