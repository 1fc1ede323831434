// Clouds and their corrections, to those who subscribe late, too.
#pragma once

#include <air_ground/CloudCorrections.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <ros/spinner.h>
#include <sensor_msgs/PointCloud2.h>

#include <condition_variable>
#include <mutex>
#include <optional>
#include <string>

#include "dense_fusion/cloud_order.h"
#include "map_store.h"
#include "work_queue.h"

namespace dense_fusion {

/// mav/dense_cloud, mav/cloud_corrections. A subscriber that comes late gets the clouds that `map` keeps of the present
/// map, in the order of their stamps, as they were published (but for `map_cell`), and the corrections since: with both
/// it stands where one stands that was there all along. Thread-safe.
class CloudPublisher {
 public:
  /// `queue` and `map` outlive it. Nothing goes out while a reset waits in the queue.
  CloudPublisher(ros::NodeHandle handle, const MapStore& map, WorkQueue& queue,
                 air_ground_common::ros_utils::NodeHealth& health);
  ~CloudPublisher();

  /// What was published is of a map that has ended: nobody gets it any more.
  void startMap();

  // Both are called within WorkQueue::unlessReset().

  /// A cloud that `map` has already. Where a subscriber is being served it goes out after that.
  void publish(const sensor_msgs::PointCloud2ConstPtr& cloud);
  /// Of all clouds of the map since they were published.
  void publish(const air_ground::CloudCorrections& corrections);

 private:
  void onCloudSubscriber(const ros::SingleSubscriberPublisher& subscriber);
  /// The number of clouds sent.
  std::size_t serve(const ros::SingleSubscriberPublisher& subscriber);
  void onCorrectionsSubscriber(const ros::SingleSubscriberPublisher& subscriber);
  void sendDue();  // mutex_ held
  void sendDueUnlessReset();

  const MapStore& map_;
  WorkQueue& queue_;
  air_ground_common::ros_utils::NodeHealth& health_;

  std::mutex mutex_;  // within that of queue_
  std::condition_variable stopping_;
  bool stop_ = false;
  CloudOrder<sensor_msgs::PointCloud2ConstPtr> order_;
  std::string frame_;
  std::optional<air_ground::CloudCorrections> last_corrections_;

  ros::CallbackQueue subscribers_;  // who comes and goes
  ros::Publisher cloud_, corrections_;
  ros::AsyncSpinner spinner_{1, &subscribers_};
};

}  // namespace dense_fusion
