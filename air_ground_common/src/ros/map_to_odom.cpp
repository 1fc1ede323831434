#include "map_to_odom.h"

#include <iterator>
#include <vector>

#include "air_ground_common/ros/sensor_input.h"
#include "air_ground_common/ros/tf_edge.h"

namespace air_ground_common::ros_utils {
namespace {

constexpr double kPatience = 1.0;  // of a pose for odom -> base [s of data]

}  // namespace

MapToOdom::MapToOdom(const std::string& map_frame, const std::string& odom_frame, const std::string& base_frame,
                     NodeHealth& health)
    : map_frame_(map_frame),
      odom_frame_(withoutSlash(odom_frame)),
      base_frame_(withoutSlash(base_frame)),
      health_(health),
      transforms_([this](const geometry_msgs::TransformStamped&, const std::string&) {
        const std::lock_guard<std::mutex> lock(mutex_);
        publishKnown();
      }) {}

void MapToOdom::add(const ros::Time& stamp, const Pose& T_map_base) {
  const std::lock_guard<std::mutex> lock(mutex_);
  waiting_.push_back({stamp, T_map_base});
  publishKnown();
  while (!waiting_.empty() && stamp.toSec() - waiting_.front().stamp.toSec() > kPatience) {
    std::string why;
    transforms_.lookup(odom_frame_, base_frame_, waiting_.front().stamp, &why);
    health_.count("poses without '" + odom_frame_ + "' -> '" + base_frame_ +
                  "' on tf at their stamp, which odom_from_tf asks for: " + why);
    waiting_.pop_front();
  }
}

void MapToOdom::reset() {
  const std::lock_guard<std::mutex> lock(mutex_);
  waiting_.clear();
  transforms_.clear();
}

void MapToOdom::publishKnown() {
  std::vector<geometry_msgs::TransformStamped> known;
  for (auto it = waiting_.begin(); it != waiting_.end();) {
    const auto T_odom_base = transforms_.lookup(odom_frame_, base_frame_, it->stamp);
    if (T_odom_base)
      known.push_back(tfEdge(it->stamp, map_frame_, odom_frame_, normalized(it->T_map_base * T_odom_base->inverse())));
    it = T_odom_base ? waiting_.erase(it) : std::next(it);
  }
  if (!known.empty()) broadcaster_.sendTransform(known);
}

}  // namespace air_ground_common::ros_utils
