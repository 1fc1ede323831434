#include "keyframe_publisher.h"

#include <air_ground/MapKeyframes.h>

#include "air_ground_common/ros/conversions.h"

namespace rgbd_slam {
namespace {

using visual_frontend::Keyframe;

air_ground::KeyframeFeatures featuresOf(const Keyframe& keyframe) {
  air_ground::KeyframeFeatures msg;
  msg.id = static_cast<std::uint32_t>(keyframe.id);
  msg.stamp.fromSec(keyframe.stamp);
  for (std::size_t i = 0; i < keyframe.orb_depth.size(); ++i) {
    if (!(keyframe.orb_depth[i] > 0)) continue;
    const Eigen::Vector3d p = keyframe.orb_depth[i] * keyframe.orb_normalized[i].homogeneous();
    geometry_msgs::Point32 point;
    point.x = static_cast<float>(p.x());
    point.y = static_cast<float>(p.y());
    point.z = static_cast<float>(p.z());
    msg.points.push_back(point);
    const auto* bytes = keyframe.orb_descriptors.ptr<std::uint8_t>(static_cast<int>(i));
    msg.descriptors.insert(msg.descriptors.end(), bytes, bytes + keyframe.orb_descriptors.cols);
  }
  return msg;
}

}  // namespace

KeyframePublisher::KeyframePublisher(ros::NodeHandle handle, const std::string& topic, const std::string& frame)
    : frame_(frame),
      publisher_(handle.advertise<air_ground::MapKeyframes>(
          topic, 5, [this](const ros::SingleSubscriberPublisher&) { subscriber_came_ = true; })) {}

bool KeyframePublisher::awaited() const {
  using namespace std::chrono_literals;
  return subscriber_came_ && publisher_.getNumSubscribers() > 0 && std::chrono::steady_clock::now() - served_ >= 1s;
}

void KeyframePublisher::publish(std::uint32_t map_id, const ros::Time& stamp, const visual_frontend::Map& map) {
  if (publisher_.getNumSubscribers() == 0) return;
  const bool anew = subscriber_came_.exchange(false);
  if (anew) served_ = std::chrono::steady_clock::now();
  if (anew || map_id != map_id_) known_.clear();
  map_id_ = map_id;
  air_ground::MapKeyframes msg;
  msg.header.stamp = stamp;
  msg.header.frame_id = frame_;
  msg.map_id = map_id;
  for (const auto& [id, keyframe] : map.keyframes()) {
    msg.ids.push_back(static_cast<std::uint32_t>(id));
    msg.poses.push_back(air_ground_common::ros_utils::toMsg(keyframe.T_map_camera));
    if (known_.insert(id).second) msg.features.push_back(featuresOf(keyframe));
  }
  publisher_.publish(msg);
}

}  // namespace rgbd_slam
