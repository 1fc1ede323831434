#include "cloud_publisher.h"

#include <chrono>
#include <utility>

#include "air_ground_common/niceness.h"
#include "rgbd_slam/hidden_space.h"
#include "rgbd_slam/passed_space.h"

namespace rgbd_slam {

namespace ros_utils = air_ground_common::ros_utils;

namespace {

std::vector<ros_utils::CloudPoint> messagePoints(const std::vector<CloudPoint>& cloud) {
  std::vector<ros_utils::CloudPoint> points(cloud.size());
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    points[i].position = cloud[i].position;
    points[i].rgb = {cloud[i].bgr[2], cloud[i].bgr[1], cloud[i].bgr[0]};
  }
  return points;
}

}  // namespace

std::vector<ros_utils::CloudPoint> cloudForFile(const std::vector<PosedPoints>& keyframes,
                                                const CloudSettings& settings) {
  std::vector<CloudPoint> points = fusePoints(keyframes, settings);
  PassedSpace passed(settings.max_range);
  passed.update(keyframes);
  passed.dropGone(&points);
  return messagePoints(points);
}

CloudPublisher::CloudPublisher(ros::NodeHandle handle, const std::string& topic, const std::string& frame,
                               const CloudSettings& settings, ros_utils::NodeHealth& health)
    : frame_(frame),
      settings_(settings),
      health_(health),
      publisher_(handle.advertise<sensor_msgs::PointCloud2>(topic, 2, true)),
      worker_(&CloudPublisher::work, this) {}

CloudPublisher::~CloudPublisher() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  worker_.join();
}

void CloudPublisher::beginMap(std::uint32_t map_id, const ros::Time& stamp) {
  const std::lock_guard<std::mutex> lock(mutex_);
  map_id_ = map_id;
  request_.reset();
  if (latched_) publish(stamp, {});
}

void CloudPublisher::request(std::uint32_t map_id, const ros::Time& stamp, std::vector<PosedPoints> points) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    request_ = Request{map_id, stamp, std::move(points)};
  }
  changed_.notify_one();
}

void CloudPublisher::work() {
  air_ground_common::giveWayWithin();
  GroundCloud ground(settings_);            // of fused_map
  HiddenSpace hidden;                       // likewise
  PassedSpace passed(settings_.max_range);  // likewise
  std::uint32_t fused_map = 0;
  while (true) {
    Request request;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      changed_.wait(lock, [&] { return stop_ || request_; });
      if (stop_) return;
      request = std::move(*request_);
      request_.reset();
    }
    const auto begin = std::chrono::steady_clock::now();
    try {
      if (request.map_id != fused_map) {
        ground.clear();
        hidden.clear();
        passed.clear();
      }
      fused_map = request.map_id;
      ground.update(request.points);
      hidden.update(request.points);
      passed.update(request.points);
      std::vector<CloudPoint> points = ground.points();
      health_.value("ground points that others see through", static_cast<double>(passed.dropGone(&points)));
      auto cloud = messagePoints(points);
      for (ros_utils::CloudPoint& point : cloud) point.hidden_from = hidden.hiddenFrom(point.position);
      const std::lock_guard<std::mutex> lock(mutex_);
      if (request.map_id != map_id_) continue;  // its map was given up meanwhile
      publish(request.stamp, cloud);
    } catch (const std::exception& e) {
      health_.count(std::string("ground clouds that could not be fused: ") + e.what());
    }
    health_.timing("ground cloud", std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
}

void CloudPublisher::publish(const ros::Time& stamp, const std::vector<ros_utils::CloudPoint>& cloud) {
  std_msgs::Header header;
  header.stamp = stamp;
  header.frame_id = frame_;
  const auto msg = ros_utils::toMsg(cloud, ros_utils::CloudFields::kXyzRgbHidden, header);
  bytes_ = msg.data.size();
  publisher_.publish(msg);
  latched_ = !cloud.empty();
}

}  // namespace rgbd_slam
