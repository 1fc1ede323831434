// Fuses and publishes the ground map's cloud on a thread of its own, for the node's sake.
#pragma once

#include <ros/node_handle.h>

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "rgbd_slam/ground_cloud.h"

namespace rgbd_slam {

/// What is published, of the keyframes at once.
std::vector<air_ground_common::ros_utils::CloudPoint> cloudForFile(const std::vector<PosedPoints>& keyframes,
                                                                   const CloudSettings& settings);

/// All calls from one thread at a time.
class CloudPublisher {
 public:
  CloudPublisher(ros::NodeHandle handle, const std::string& topic, const std::string& frame,
                 const CloudSettings& settings, air_ground_common::ros_utils::NodeHealth& health);
  ~CloudPublisher();

  /// From now on only clouds of this map are published (0: of none), and none of another stays latched.
  void beginMap(std::uint32_t map_id, const ros::Time& stamp);

  /// A request not yet begun is replaced.
  void request(std::uint32_t map_id, const ros::Time& stamp, std::vector<PosedPoints> points);

  /// Of the last cloud that was published.
  std::size_t bytes() const { return bytes_; }

 private:
  struct Request {
    std::uint32_t map_id;
    ros::Time stamp;
    std::vector<PosedPoints> points;
  };

  void work();
  void publish(const ros::Time& stamp, const std::vector<air_ground_common::ros_utils::CloudPoint>& cloud);

  const std::string frame_;
  const CloudSettings settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  ros::Publisher publisher_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<Request> request_;
  std::uint32_t map_id_ = 0;
  std::atomic<std::size_t> bytes_{0};
  bool latched_ = false;  ///< the last one published has points
  bool stop_ = false;
  std::thread worker_;
};

}  // namespace rgbd_slam
