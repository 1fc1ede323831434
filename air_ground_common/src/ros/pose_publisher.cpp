#include "air_ground_common/ros/pose_publisher.h"

#include <nav_msgs/Odometry.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/tf_edge.h"
#include "map_to_odom.h"

namespace air_ground_common::ros_utils {
namespace {

constexpr double kUnknown = 1e6;  // variance

/// The mean velocity of a motion that took `dt` [s], in the base at its end.
void setTwist(const Motion& motion, double dt, geometry_msgs::TwistWithCovariance* twist) {
  const Eigen::Matrix3d R_current_previous = motion.T_previous_current.linear().transpose();
  const Eigen::Vector3d v = R_current_previous * motion.T_previous_current.translation() / dt,
                        w = logSO3(motion.T_previous_current.linear()) / dt;
  twist->twist.linear.x = v.x();
  twist->twist.linear.y = v.y();
  twist->twist.linear.z = v.z();
  twist->twist.angular.x = w.x();
  twist->twist.angular.y = w.y();
  twist->twist.angular.z = w.z();
  if (!motion.covariance) return;
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = J.bottomRightCorner<3, 3>() = R_current_previous / dt;
  setCovariance(J * *motion.covariance * J.transpose(), &twist->covariance);
}

}  // namespace

BoundedPath::BoundedPath(const std::string& frame_id, double step, std::size_t most, double interval)
    : first_step_(step), step_(step), interval_(interval), most_(std::max<std::size_t>(most, 2)) {
  path_.header.frame_id = frame_id;
}

bool BoundedPath::add(const geometry_msgs::PoseStamped& pose) {
  const auto distance = [&] {
    const auto &a = path_.poses.back().pose.position, &b = pose.pose.position;
    return Eigen::Vector3d(a.x - b.x, a.y - b.y, a.z - b.z).norm();
  };
  if (path_.poses.empty() || distance() >= step_) {
    if (path_.poses.size() >= most_) {
      std::size_t kept = 0;
      for (std::size_t i = 0; i < path_.poses.size(); i += 2) path_.poses[kept++] = path_.poses[i];
      path_.poses.resize(kept);
      step_ *= 2;
    }
    path_.poses.push_back(pose);
    grown_ = true;
  }
  const ros::Time& stamp = pose.header.stamp;
  if (!grown_ || (stamp >= published_ && stamp.toSec() - published_.toSec() < interval_)) return false;
  grown_ = false;
  path_.header.stamp = published_ = stamp;
  return true;
}

void BoundedPath::clear() {
  path_.poses.clear();
  step_ = first_step_;
  grown_ = false;
  published_ = ros::Time();
}

PosePublisher::PosePublisher(ros::NodeHandle handle, const PosePublisherSettings& settings, NodeHealth& health)
    : settings_(settings),
      odometry_(handle.advertise<nav_msgs::Odometry>(settings.odometry_topic, 100)),
      path_(handle.advertise<nav_msgs::Path>(settings.path_topic, 5, true)),
      bounded_path_(settings.map_frame, settings.path_step) {
  if (settings.publish_tf && settings.odom_from_tf)
    map_to_odom_ = std::make_unique<MapToOdom>(settings.map_frame, settings.odom_frame, settings.base_frame, health);
}

PosePublisher::~PosePublisher() = default;

bool PosePublisher::publish(const ros::Time& stamp, const Pose& T_map_base, const Motion& motion,
                            const Matrix6d& covariance) {
  if (stamp <= last_stamp_) return false;
  const bool moved = !std::exchange(map_begins_, false);
  nav_msgs::Odometry odometry;
  odometry.header.stamp = stamp;
  odometry.header.frame_id = settings_.map_frame;
  odometry.child_frame_id = settings_.base_frame;
  odometry.pose.pose = toMsg(T_map_base);
  setCovariance(covariance, &odometry.pose.covariance);
  setCovariance(kUnknown * Matrix6d::Identity(), &odometry.twist.covariance);
  if (moved) setTwist(motion, stamp.toSec() - last_stamp_.toSec(), &odometry.twist);
  odometry_.publish(odometry);
  if (!T_odom_base_)
    T_odom_base_ = normalized(T_map_base);
  else if (moved)
    T_odom_base_ = normalized(*T_odom_base_ * motion.T_previous_current);
  if (map_to_odom_)
    map_to_odom_->add(stamp, T_map_base);
  else if (settings_.publish_tf)
    broadcaster_.sendTransform(std::vector<geometry_msgs::TransformStamped>{
        tfEdge(stamp, settings_.map_frame, settings_.odom_frame, normalized(T_map_base * T_odom_base_->inverse())),
        tfEdge(stamp, settings_.odom_frame, settings_.base_frame, *T_odom_base_)});
  geometry_msgs::PoseStamped pose;
  pose.header = odometry.header;
  pose.pose = odometry.pose.pose;
  if (bounded_path_.add(pose)) path_.publish(bounded_path_.message());
  last_stamp_ = stamp;
  return true;
}

void PosePublisher::beginMap() {
  map_begins_ = true;
  bounded_path_.clear();
}

void PosePublisher::reset() {
  beginMap();
  T_odom_base_.reset();
  last_stamp_ = ros::Time();
  if (map_to_odom_) map_to_odom_->reset();
}

}  // namespace air_ground_common::ros_utils
