#include "tracked_pose_publisher.h"

#include <sensor_msgs/NavSatFix.h>

#include <algorithm>
#include <cmath>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/tf_edge.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Matrix6d;
using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;

/// (x, y, z, yaw) into rows and columns of (x, y, z, rotX, rotY, rotZ).
void insert(const Matrix4d& covariance, Matrix6d* into) {
  const int rows[4] = {0, 1, 2, 5};
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j) (*into)(rows[i], rows[j]) = covariance(i, j);
}

/// Velocity of the base over the last step, in its frame; the variance is huge where nothing is known.
geometry_msgs::TwistWithCovariance twistOf(const std::optional<Rate>& rate, const Eigen::Matrix3d& R_level_base) {
  geometry_msgs::TwistWithCovariance twist;
  Matrix6d covariance = kUnknownVariance * Matrix6d::Identity();
  if (rate) {
    Matrix4d turn = Matrix4d::Identity();
    turn.topLeftCorner<3, 3>() = R_level_base.transpose();
    const Vector4d value = turn * rate->value;
    twist.twist.linear.x = value.x();
    twist.twist.linear.y = value.y();
    twist.twist.linear.z = value.z();
    twist.twist.angular.z = value[3];
    insert(turn * rate->covariance * turn.transpose(), &covariance);
  }
  ru::setCovariance(covariance, &twist.covariance);
  return twist;
}

}  // namespace

TrackedPosePublisher::TrackedPosePublisher(ros::NodeHandle handle, const NodeSettings& settings,
                                           const air_ground_common::LocalFrame* frame)
    : settings_(settings), frame_(frame), bounded_path_(settings.world_frame, settings.path_step) {
  if (frame_) geodetic_ = handle.advertise<sensor_msgs::NavSatFix>("tracked/geodetic", 100);
  odometry_ = handle.advertise<nav_msgs::Odometry>("tracked/odometry", 100);
  path_ = handle.advertise<nav_msgs::Path>("tracked/path", 5, true);
  innovation_ = handle.advertise<air_ground::TrackerInnovation>("tracked/innovation", 100);
}

void TrackedPosePublisher::publish(const ros::Time& stamp, const PoseEstimate& estimate,
                                   const std::optional<Rate>& rate, const Tilt& tilt,
                                   const std::optional<Pose>& T_map_base) {
  Pose T_world_base = air_ground_common::yawPose(estimate.pose[3], estimate.pose.head<3>());
  T_world_base.linear() = T_world_base.linear() * tilt.R_level_body;

  nav_msgs::Odometry odometry;
  odometry.header.stamp = stamp;
  odometry.header.frame_id = settings_.world_frame;
  odometry.child_frame_id = settings_.base_frame;
  odometry.pose.pose = ru::toMsg(T_world_base);
  Matrix6d covariance = Matrix6d::Zero();
  insert(estimate.covariance, &covariance);
  covariance(3, 3) = covariance(4, 4) = std::pow(std::max(settings_.tilt_stddev, tilt.stddev), 2);
  ru::setCovariance(covariance, &odometry.pose.covariance);
  odometry.twist = twistOf(rate, tilt.R_level_body);
  odometry_.publish(odometry);

  if (settings_.publish_tf && T_map_base) publishEdge(odometry.header, estimate, *T_map_base);
  if (frame_) publishGeodetic(stamp, estimate);
  trajectory_.push_back({stamp.toSec(), T_world_base});
  geometry_msgs::PoseStamped pose;
  pose.header = odometry.header;
  pose.pose = odometry.pose.pose;
  if (bounded_path_.add(pose)) path_.publish(bounded_path_.message());
}

// Both frames are level: only a heading and a shift lie between them.
void TrackedPosePublisher::publishEdge(const std_msgs::Header& header, const PoseEstimate& estimate,
                                       const Pose& T_map_base) {
  const double yaw = estimate.pose[3] - air_ground_common::yawOf(T_map_base.linear());
  Pose T_world_map = air_ground_common::yawPose(yaw, Eigen::Vector3d::Zero());
  T_world_map.translation() = estimate.pose.head<3>() - T_world_map.linear() * T_map_base.translation();
  broadcaster_.sendTransform(ru::tfEdge(header.stamp, header.frame_id, settings_.map_frame, T_world_map));
}

void TrackedPosePublisher::publishGeodetic(const ros::Time& stamp, const PoseEstimate& estimate) {
  const auto g = frame_->toGeodetic(estimate.pose.head<3>());
  sensor_msgs::NavSatFix fix;
  fix.header.stamp = stamp;
  fix.header.frame_id = settings_.base_frame;
  fix.status.status = sensor_msgs::NavSatStatus::STATUS_FIX;
  fix.latitude = g.latitude;
  fix.longitude = g.longitude;
  fix.altitude = g.height + settings_.geoid_undulation.value_or(0);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      fix.position_covariance[static_cast<std::size_t>(3 * i + j)] = estimate.covariance(i, j);
  fix.position_covariance_type = sensor_msgs::NavSatFix::COVARIANCE_TYPE_KNOWN;
  geodetic_.publish(fix);
}

void TrackedPosePublisher::publish(const Outcome& o, const Tracker& tracker) {
  if (!(o.measurement.stamp >= 0 && o.measurement.stamp < ru::kEndOfStamps)) return;
  air_ground::TrackerInnovation msg;
  msg.header.stamp.fromSec(o.measurement.stamp);
  msg.header.frame_id = settings_.world_frame;
  msg.source = static_cast<std::uint8_t>(o.measurement.source);
  msg.result = static_cast<std::uint8_t>(o.result);
  msg.reason = describe(o.result);
  msg.dof = static_cast<std::uint8_t>(o.dof);
  msg.revised = o.revised;
  msg.predicted = std::isfinite(o.nis);
  msg.innovation.assign(static_cast<std::size_t>(o.dof), 0);
  msg.stddev.assign(static_cast<std::size_t>(o.dof), 0);
  if (msg.predicted) {
    for (int i = 0; i < o.dof; ++i) {
      msg.innovation[static_cast<std::size_t>(i)] = o.innovation[i];
      msg.stddev[static_cast<std::size_t>(i)] = o.innovation_stddev[i];
    }
    msg.nis = o.nis;
  }
  msg.gate = o.gate;
  msg.delay = o.delay;
  msg.rivals = static_cast<std::uint32_t>(tracker.filter().strongestHypothesis());
  if (const auto estimate = tracker.latest()) {
    msg.support = static_cast<std::uint32_t>(estimate->support);
    msg.scale = estimate->scale_known ? estimate->scale : 0;
    msg.scale_stddev = estimate->scale_known ? estimate->scale_stddev : 0;
  }
  innovation_.publish(msg);
}

void TrackedPosePublisher::reset() {
  trajectory_.clear();
  bounded_path_.clear();
}

}  // namespace ekf_tracker
