// What dense_fusion_node's worker has to do: images, flushes and resets, in their order.
#pragma once

#include <air_ground/PosedImage.h>
#include <nav_msgs/Path.h>
#include <ros/ros.h>

#include <Eigen/Core>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/ros/health.h"

namespace dense_fusion {

/// Landmarks of the odometry.
struct SparseCloud {
  std::vector<Eigen::Vector3f> points;
  std::string frame;
  ros::Time stamp;
};

struct Work {
  enum class Kind { kImage, kCorrection, kFlush, kReset };
  Kind kind = Kind::kFlush;
  air_ground::PosedImage::ConstPtr image;
  std::shared_ptr<const SparseCloud> sparse;  ///< the newest one; null: none
  nav_msgs::Path::ConstPtr corrected;         ///< where the map has earlier images now
};

/// Callbacks add, services wait, one worker takes; all may do so at once.
class WorkQueue {
 public:
  /// Images further behind the newest than `max_latency` [s of data] are dropped; 0: none.
  WorkQueue(std::size_t most_images, double max_latency, air_ground_common::ros_utils::NodeHealth& health);

  // ---- Callbacks. Messages from before a jump of time reset the work and start anew.

  void add(const air_ground::PosedImage::ConstPtr& msg);
  void add(SparseCloud cloud);
  /// Comes before the images that wait: it places them, too.
  void add(const nav_msgs::Path::ConstPtr& corrected);
  /// Asks for a flush once when nothing has come for so long and all images are done [s].
  void flushAfter(double silence);

  // ---- Services. False: it did not come to that in time.

  bool flushAndWait(double patience);
  bool resetAndWait(double patience);

  // ---- The worker

  /// Waits for something to do; empty when stop() was called. What is taken is off the queue: what fails is not tried
  /// for ever. done() must follow.
  std::optional<Work> next();
  void done();
  /// Runs `publish` unless a reset waits: nothing of the time before a jump or a reset goes out after it.
  template <typename Publish>
  bool unlessReset(const Publish& publish) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (reset_requested_) return false;
    publish();
    return true;
  }
  std::size_t imagesWaiting() const;
  /// How far the newest image is ahead of the one with this stamp [s].
  double lag(const ros::Time& stamp) const;

  void stop();

 private:
  enum Stream { kImages, kSparseClouds, kCorrections, kStreams };
  // Both locked.
  void forget();
  void dropOldest(const std::string& why);

  const std::size_t most_images_;
  const double max_latency_;
  air_ground_common::ros_utils::NodeHealth& health_;
  mutable std::mutex mutex_;
  std::condition_variable changed_, idle_;
  air_ground_common::ros_utils::StreamGate gate_;
  std::deque<air_ground::PosedImage::ConstPtr> images_;
  std::size_t bytes_ = 0;
  std::shared_ptr<const SparseCloud> sparse_;
  nav_msgs::Path::ConstPtr corrected_;
  double newest_ = 0;  ///< stamp of an image [s]
  ros::WallTime last_arrival_;
  bool stop_ = false, reset_requested_ = false, flush_requested_ = false, flushing_ = false, flush_due_ = false,
       busy_ = false;
};

}  // namespace dense_fusion
