// What the tracker tells the world: odometry, path, tf, geodetic position, and what became of each measurement.
#pragma once

#include <air_ground/TrackerInnovation.h>
#include <nav_msgs/Odometry.h>
#include <ros/node_handle.h>
#include <tf2_ros/transform_broadcaster.h>

#include <optional>

#include "air_ground_common/geodesy.h"
#include "air_ground_common/ros/pose_publisher.h"
#include "air_ground_common/trajectory.h"
#include "ekf_tracker/tilt_filter.h"
#include "ekf_tracker/tracker.h"
#include "node_parameters.h"

namespace ekf_tracker {

class TrackedPosePublisher {
 public:
  /// `frame`: of the world; null: no geodetic position. Both must outlive this.
  TrackedPosePublisher(ros::NodeHandle handle, const NodeSettings& settings,
                       const air_ground_common::LocalFrame* frame);

  /// `rate`: of the last step; `tilt`: of the base; `T_map_base`: its pose by the odometry at
  /// this stamp, without which there is no tf.
  void publish(const ros::Time& stamp, const PoseEstimate& estimate, const std::optional<Rate>& rate, const Tilt& tilt,
               const std::optional<air_ground_common::Pose>& T_map_base);
  void publish(const Outcome& outcome, const Tracker& tracker);

  /// Poses of the base in the world since the last reset.
  const air_ground_common::Trajectory& trajectory() const { return trajectory_; }
  void reset();

 private:
  void publishEdge(const std_msgs::Header& header, const PoseEstimate& estimate,
                   const air_ground_common::Pose& T_map_base);
  void publishGeodetic(const ros::Time& stamp, const PoseEstimate& estimate);

  const NodeSettings& settings_;
  const air_ground_common::LocalFrame* frame_;
  ros::Publisher odometry_, path_, innovation_, geodetic_;
  tf2_ros::TransformBroadcaster broadcaster_;
  air_ground_common::Trajectory trajectory_;  // 10 MB an hour at 20 Hz
  air_ground_common::ros_utils::BoundedPath bounded_path_;
};

}  // namespace ekf_tracker
