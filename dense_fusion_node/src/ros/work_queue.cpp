#include "work_queue.h"

#include <algorithm>
#include <chrono>
#include <utility>

namespace dense_fusion {
namespace {

constexpr std::size_t kMaxBytes = 512u << 20;  // of waiting images, however large each is

std::size_t bytesOf(const air_ground::PosedImage& msg) { return msg.image.data.size() + msg.compressed.data.size(); }

}  // namespace

WorkQueue::WorkQueue(std::size_t most_images, double max_latency, air_ground_common::ros_utils::NodeHealth& health)
    : most_images_(most_images), max_latency_(max_latency), health_(health), gate_(kStreams, health, [this] {
        ROS_WARN("time jumped back (a looped bag?): the dense map starts afresh");
        forget();
      }) {}

void WorkQueue::add(const air_ground::PosedImage::ConstPtr& msg) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!gate_.admit(kImages, msg->header.stamp)) return;
    newest_ = msg->header.stamp.toSec();
    images_.push_back(msg);
    bytes_ += bytesOf(*msg);
    while (images_.size() > most_images_ || (bytes_ > kMaxBytes && images_.size() > 1))
      dropOldest("the queue was full");
    // One of several, not all: the map keeps on growing, of fewer images.
    if (max_latency_ > 0 && newest_ - images_.front()->header.stamp.toSec() > max_latency_) {
      dropOldest("further behind than max_latency");
      ROS_WARN_THROTTLE(30,
                        "dense fusion is slower than the images come: those more than %g s behind are dropped "
                        "(parameter max_latency); lower image/scale, or raise threads",
                        max_latency_);
    }
    last_arrival_ = ros::WallTime::now();
    flush_due_ = true;
  }
  changed_.notify_all();
}

void WorkQueue::dropOldest(const std::string& why) {
  bytes_ -= bytesOf(*images_.front());
  images_.pop_front();
  health_.count("images dropped: " + why);
}

void WorkQueue::add(SparseCloud cloud) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (gate_.admit(kSparseClouds, cloud.stamp)) sparse_ = std::make_shared<const SparseCloud>(std::move(cloud));
}

void WorkQueue::add(const nav_msgs::Path::ConstPtr& corrected) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!gate_.admit(kCorrections, corrected->header.stamp)) return;
    corrected_ = corrected;
  }
  changed_.notify_all();
}

void WorkQueue::flushAfter(double silence) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!flush_due_ || !images_.empty() || busy_) return;
    if ((ros::WallTime::now() - last_arrival_).toSec() < silence) return;
    flush_due_ = false;
    flush_requested_ = true;
  }
  changed_.notify_all();
}

bool WorkQueue::flushAndWait(double patience) {
  std::unique_lock<std::mutex> lock(mutex_);
  flush_requested_ = true;
  flush_due_ = false;
  changed_.notify_all();
  return idle_.wait_for(lock, std::chrono::duration<double>(patience), [this] {
    return stop_ || (!flush_requested_ && !flushing_);
  }) && !stop_;
}

bool WorkQueue::resetAndWait(double patience) {
  std::unique_lock<std::mutex> lock(mutex_);
  forget();
  flush_requested_ = flush_due_ = false;
  changed_.notify_all();
  idle_.wait_for(lock, std::chrono::duration<double>(patience), [this] { return stop_ || !reset_requested_; });
  return !reset_requested_;
}

void WorkQueue::forget() {
  images_.clear();
  bytes_ = 0;
  sparse_.reset();
  corrected_.reset();
  reset_requested_ = true;
}

std::optional<Work> WorkQueue::next() {
  std::unique_lock<std::mutex> lock(mutex_);
  changed_.wait(lock,
                [this] { return stop_ || reset_requested_ || flush_requested_ || corrected_ || !images_.empty(); });
  if (stop_) return std::nullopt;
  busy_ = true;
  if (reset_requested_) {
    reset_requested_ = false;
    return Work{Work::Kind::kReset, nullptr, nullptr, nullptr};
  }
  if (corrected_) return Work{Work::Kind::kCorrection, nullptr, nullptr, std::exchange(corrected_, nullptr)};
  if (!images_.empty()) {
    const Work work{Work::Kind::kImage, images_.front(), sparse_, nullptr};
    images_.pop_front();
    bytes_ -= bytesOf(*work.image);
    return work;
  }
  flush_requested_ = false;
  flushing_ = true;
  return Work{};
}

void WorkQueue::done() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    flushing_ = busy_ = false;
  }
  idle_.notify_all();
}

std::size_t WorkQueue::imagesWaiting() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return images_.size();
}

double WorkQueue::lag(const ros::Time& stamp) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return std::max(0.0, newest_ - stamp.toSec());
}

void WorkQueue::stop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  idle_.notify_all();
}

}  // namespace dense_fusion
