// What the node says about the alignment: alignment/refined, the edge between both maps on tf, and where the MAV is by
// it.
#pragma once

#include <air_ground/AlignmentEstimate.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>

#include <mutex>
#include <optional>

#include "air_ground_common/ros/alignment_broadcaster.h"
#include "air_ground_common/ros/health.h"
#include "node_parameters.h"

namespace icp_refine {

/// Of both robots, as they name them; 0: not known.
struct MapIds {
  std::uint32_t mav = 0, ground = 0;
};

/// Thread-safe.
class AlignmentOutput {
 public:
  AlignmentOutput(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health);

  /// Publishes the outcome. `tracked`: the alignment that stays on tf where the outcome is not CONVERGED, if any.
  /// `own_unit`: of the visual map, whose scale the alignment tells.
  void publish(const RefineOutcome& out, const MapIds& maps, const std::optional<Similarity>& tracked, bool own_unit);
  /// Publishes SEARCHING, with the reason `why`: what was said so far is of a map that has ended. Nothing on tf until
  /// the next CONVERGED.
  void withdraw(const std::string& why, const MapIds& maps, bool own_unit);
  /// The visual map in mav_map, as the odometry has taken it over: until then tf says nothing of a map without scale.
  void setMapScale(const std::optional<Similarity>& T_mav_map_visual);
  /// The MAV's map was corrected: what stays on tf follows before the next refinement.
  void correct(const Similarity& T_ground_map_mav_map);
  /// The MAV's odometry, `T` = T_mav_map_base: tf is made true to where the MAV is (without odometry, to the centre of
  /// the overlap), and while there is an alignment mav/pose_in_ground_map tells where that is in the ground map. A
  /// covariance that is not finite is counted, and the pose not published.
  void follow(const nav_msgs::Odometry& odometry, const Pose& T);
  /// Another map of the MAV has begun: forgets its scale and where the MAV was.
  void forgetMav();
  /// Resolved name of alignment/refined.
  std::string topic() const { return refined_publisher_.getTopic(); }

 private:
  /// tf cannot carry a scale: the edge has the alignment's rotation, and the translation that puts the MAV where it is.
  std::optional<air_ground_common::ros_utils::AlignmentBroadcaster::Edge> edge();
  /// Of mav_map, as far as tf can tell it; mutex_ held.
  std::optional<Similarity> alignment() const;
  /// Takes over what is on tf from now on, and says so in `msg`; mutex_ held.
  void keep(const RefineOutcome& out, const std::optional<Similarity>& tracked, air_ground::AlignmentEstimate* msg);

  const NodeSettings& settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  ros::Publisher refined_publisher_, pose_publisher_;
  std::mutex mutex_;
  // The last CONVERGED one, while it is tracked; of the visual map where own_unit_.
  std::optional<KnownAlignment> aligned_;
  ros::Time converged_stamp_;  // of aligned_
  bool own_unit_ = false;
  std::optional<Similarity> T_mav_map_visual_;
  std::optional<Eigen::Vector3d> position_;
  std::uint8_t last_status_ = 255;
  std::optional<air_ground_common::ros_utils::AlignmentBroadcaster> broadcaster_;
};

}  // namespace icp_refine
