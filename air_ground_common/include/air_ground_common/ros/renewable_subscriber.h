// A subscription that can be made anew, so that a latched message which has come already comes again.
#pragma once

#include <ros/subscriber.h>

#include <condition_variable>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

namespace air_ground_common::ros_utils {

class RenewableSubscriber {
 public:
  /// `subscribe` is called at once, and for each renewal, then on a thread of its own.
  explicit RenewableSubscriber(std::function<ros::Subscriber()> subscribe);
  ~RenewableSubscriber();
  RenewableSubscriber(const RenewableSubscriber&) = delete;
  RenewableSubscriber& operator=(const RenewableSubscriber&) = delete;

  /// Returns at once: subscribing waits for the master, which a callback must not. Without master it is done when one
  /// is back; until then the old subscription stays.
  void renew();

  /// Resolved.
  const std::string& topic() const { return topic_; }

 private:
  void work();

  std::function<ros::Subscriber()> subscribe_;
  ros::Subscriber subscriber_;  ///< the thread's, after the constructor
  std::string topic_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool wanted_ = false, stop_ = false;
  std::thread worker_;
};

}  // namespace air_ground_common::ros_utils
