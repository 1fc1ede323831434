#include "cloud_publisher.h"

#include <chrono>

#include "dense_fusion/guarded.h"
#include "fused_map_publisher.h"

namespace dense_fusion {

namespace ros_utils = air_ground_common::ros_utils;

namespace {

constexpr std::uint32_t kConnection = 20;  // messages that wait for one subscriber; the oldest go
// Between two kept clouds: what receives them holds some dozens until it has worked on them.
constexpr std::chrono::milliseconds kPause(50);

}  // namespace

CloudPublisher::CloudPublisher(ros::NodeHandle handle, const MapStore& map, WorkQueue& queue,
                               ros_utils::NodeHealth& health)
    : map_(map), queue_(queue), health_(health) {
  corrections_ = handle.advertise<air_ground::CloudCorrections>(
      "mav/cloud_corrections", kConnection,
      [this](const ros::SingleSubscriberPublisher& subscriber) { onCorrectionsSubscriber(subscriber); });
  // To send what is kept takes seconds, and only the callback can send to one subscriber: a thread of its own.
  handle.setCallbackQueue(&subscribers_);
  cloud_ = handle.advertise<sensor_msgs::PointCloud2>(
      "mav/dense_cloud", kConnection,
      [this](const ros::SingleSubscriberPublisher& subscriber) { onCloudSubscriber(subscriber); },
      [this](const ros::SingleSubscriberPublisher&) {
        {
          const std::lock_guard<std::mutex> lock(mutex_);
          order_.left();
        }
        sendDueUnlessReset();
      });
  spinner_.start();
}

CloudPublisher::~CloudPublisher() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  stopping_.notify_all();
  spinner_.stop();
}

void CloudPublisher::startMap() {
  const std::lock_guard<std::mutex> lock(mutex_);
  order_.startMap();
  last_corrections_.reset();
}

void CloudPublisher::publish(const sensor_msgs::PointCloud2ConstPtr& cloud) {
  const std::lock_guard<std::mutex> lock(mutex_);
  frame_ = cloud->header.frame_id;
  order_.add(static_cast<std::int64_t>(cloud->header.stamp.toNSec()), cloud);
  sendDue();
}

void CloudPublisher::publish(const air_ground::CloudCorrections& corrections) {
  const std::lock_guard<std::mutex> lock(mutex_);
  last_corrections_ = corrections;
  corrections_.publish(corrections);
}

void CloudPublisher::sendDue() {
  for (const auto& cloud : order_.due(cloud_.getNumSubscribers())) cloud_.publish(cloud);
}

void CloudPublisher::sendDueUnlessReset() {
  queue_.unlessReset([this] {
    const std::lock_guard<std::mutex> lock(mutex_);
    sendDue();
  });
}

void CloudPublisher::onCloudSubscriber(const ros::SingleSubscriberPublisher& subscriber) {
  std::size_t sent = 0;
  runGuarded([&] { sent = serve(subscriber); }, [this](const std::string& what) { health_.count("failed: " + what); });
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    order_.served();
  }
  sendDueUnlessReset();
  if (sent > 0) ROS_INFO_STREAM(subscriber.getSubscriberName() << " has come late: " << sent << " kept clouds sent");
}

std::size_t CloudPublisher::serve(const ros::SingleSubscriberPublisher& subscriber) {
  std::unique_lock<std::mutex> lock(mutex_);
  const auto share = order_.welcome();
  if (!share) return 0;
  std_msgs::Header header;
  header.frame_id = frame_;
  std::size_t sent = 0;
  for (std::int64_t from = share->first; !stop_;) {
    lock.unlock();
    const auto cloud = map_.asPublished(from, share->last);
    if (!cloud) return sent;
    from = cloud->first + 1;
    header.stamp.fromNSec(static_cast<std::uint64_t>(cloud->first));
    const auto msg = ros_utils::toMsg(messagePoints(cloud->second), ros_utils::CloudFields::kXyzIntensity, header);
    bool stands = false;
    queue_.unlessReset([&] {
      const std::lock_guard<std::mutex> standing(mutex_);
      stands = order_.stands(*share);
      if (stands) subscriber.publish(msg);
    });
    if (!stands) return sent;
    ++sent;
    lock.lock();
    stopping_.wait_for(lock, kPause, [this] { return stop_; });
  }
  return sent;
}

void CloudPublisher::onCorrectionsSubscriber(const ros::SingleSubscriberPublisher& subscriber) {
  queue_.unlessReset([&] {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (last_corrections_) subscriber.publish(*last_corrections_);
  });
}

}  // namespace dense_fusion
