#include "air_ground_common/ros/renewable_subscriber.h"

#include <ros/master.h>

#include <chrono>
#include <utility>

namespace air_ground_common::ros_utils {

RenewableSubscriber::RenewableSubscriber(std::function<ros::Subscriber()> subscribe)
    : subscribe_(std::move(subscribe)), subscriber_(subscribe_()), topic_(subscriber_.getTopic()) {
  worker_ = std::thread(&RenewableSubscriber::work, this);
}

RenewableSubscriber::~RenewableSubscriber() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  worker_.join();
}

void RenewableSubscriber::renew() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    wanted_ = true;
  }
  changed_.notify_all();
}

void RenewableSubscriber::work() {
  std::unique_lock<std::mutex> lock(mutex_);
  while (true) {
    changed_.wait(lock, [&] { return stop_ || wanted_; });
    if (stop_) return;
    wanted_ = false;
    lock.unlock();
    const bool master = ros::master::check();
    if (master) {
      subscriber_.shutdown();
      subscriber_ = subscribe_();
    }
    lock.lock();
    if (master) continue;
    wanted_ = true;
    changed_.wait_for(lock, std::chrono::milliseconds(500), [&] { return stop_; });
  }
}

}  // namespace air_ground_common::ros_utils
