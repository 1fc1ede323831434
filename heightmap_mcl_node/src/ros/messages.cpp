#include "messages.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/covariance.h"
#include "air_ground_common/ros/conversions.h"

namespace heightmap_mcl {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;

// One order in both.
static_assert(static_cast<int>(Status::kSearching) == AlignmentEstimate::STATUS_SEARCHING &&
              static_cast<int>(Status::kAmbiguous) == AlignmentEstimate::STATUS_AMBIGUOUS &&
              static_cast<int>(Status::kDegenerate) == AlignmentEstimate::STATUS_DEGENERATE &&
              static_cast<int>(Status::kConverged) == AlignmentEstimate::STATUS_CONVERGED);

air_ground::HeightMap toMsg(const HeightMap& map, const std_msgs::Header& header, std::uint32_t map_id) {
  air_ground::HeightMap msg;
  msg.header = header;
  msg.resolution = static_cast<float>(map.resolution);
  msg.origin_x = map.origin_x;
  msg.origin_y = map.origin_y;
  msg.width = static_cast<std::uint32_t>(map.width);
  msg.height = static_cast<std::uint32_t>(map.height);
  msg.heights = map.heights;
  msg.map_id = map_id;
  return msg;
}

nav_msgs::OccupancyGrid toMsg(const CostMap& map, const Eigen::Vector2d& shift, const std_msgs::Header& header) {
  nav_msgs::OccupancyGrid msg;
  msg.header = header;
  msg.info.map_load_time = header.stamp;
  msg.info.resolution = static_cast<float>(map.resolution);
  msg.info.width = static_cast<std::uint32_t>(map.width);
  msg.info.height = static_cast<std::uint32_t>(map.height);
  msg.info.origin.position.x = map.x0 + shift.x() - 0.5 * map.resolution;
  msg.info.origin.position.y = map.y0 + shift.y() - 0.5 * map.resolution;
  msg.info.origin.orientation.w = 1;
  float low = std::numeric_limits<float>::infinity(), high = 0;
  for (float c : map.cost) {
    if (!std::isfinite(c)) continue;
    low = std::min(low, c);
    high = std::max(high, c);
  }
  msg.data.reserve(map.cost.size());
  for (float c : map.cost) {
    const float share = std::sqrt(std::max(c - low, 0.f) / std::max(high - low, 1e-9f));
    msg.data.push_back(std::isfinite(c) ? static_cast<std::int8_t>(std::lround(100 * std::min(share, 1.f))) : -1);
  }
  return msg;
}

AlignmentEstimate toMsg(const CoarseEstimate& e, const std_msgs::Header& header, const std::string& mav_frame,
                        std::uint32_t map_id) {
  AlignmentEstimate msg;
  msg.header = header;
  msg.child_frame_id = mav_frame;
  msg.pose.pose = ros_utils::toMsg(e.similarityPose());
  const Eigen::Matrix3d R = e.R_ground_level.transpose();
  ros_utils::setCovariance(air_ground_common::aboutAxes(R, e.covariance), &msg.pose.covariance);
  msg.scale = e.scale;
  msg.scale_stddev = e.scale_stddev;
  const Eigen::Vector3d reference_point = R * e.reference_point;
  msg.reference_point.x = reference_point.x();
  msg.reference_point.y = reference_point.y();
  msg.reference_point.z = reference_point.z();
  msg.status = static_cast<std::uint8_t>(e.status);
  msg.guess = e.guess;
  msg.stage = AlignmentEstimate::STAGE_COARSE;
  msg.reason = e.reason;
  msg.particle_spread = e.particle_spread;
  msg.particle_spread_yaw = e.particle_spread_yaw;
  msg.overlap = e.overlap;
  msg.cost = e.cost;
  msg.iterations = static_cast<std::uint32_t>(e.maps);
  msg.map_id = map_id;
  return msg;
}

geometry_msgs::PoseArray toMsg(const std::vector<Particle>& particles, double z, double heading,
                               const std_msgs::Header& header) {
  geometry_msgs::PoseArray msg;
  msg.header = header;
  for (const Particle& p : particles) {
    msg.poses.push_back(ros_utils::toMsg(air_ground_common::yawPose(p.pose.yaw + heading, {p.pose.x, p.pose.y, z})));
  }
  return msg;
}

}  // namespace heightmap_mcl
