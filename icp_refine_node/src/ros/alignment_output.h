// What the node says about the alignment: alignment/refined, and the edge between both maps on tf.
#pragma once

#include <air_ground/AlignmentEstimate.h>
#include <ros/ros.h>

#include <mutex>
#include <optional>

#include "air_ground_common/ros/alignment_broadcaster.h"
#include "air_ground_common/ros/health.h"
#include "node_parameters.h"

namespace icp_refine {

/// Thread-safe.
class AlignmentOutput {
 public:
  AlignmentOutput(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health);

  /// Publishes the outcome. `tracking`: an outcome that is not CONVERGED leaves the transform on tf as it is.
  /// `own_unit`: of the visual map, whose scale the alignment tells.
  void publish(const RefineOutcome& out, std::uint32_t map_id, bool tracking, bool own_unit);
  /// The visual map in mav_map, as the odometry has taken it over: until then tf says nothing of a map without scale.
  void setMapScale(const std::optional<Similarity>& T_mav_map_visual);
  /// Where the MAV is in mav_map, to which tf is true; without it, the centre of the overlap.
  void setPosition(const std::optional<Eigen::Vector3d>& p_mav_map);
  /// Nothing on tf until the next CONVERGED.
  void drop();
  /// Resolved name of alignment/refined.
  std::string topic() const { return refined_publisher_.getTopic(); }

 private:
  /// tf cannot carry a scale: the edge has the alignment's rotation, and the translation that puts the MAV where it is.
  std::optional<air_ground_common::ros_utils::AlignmentBroadcaster::Edge> edge();

  const NodeSettings& settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  ros::Publisher refined_publisher_;
  std::mutex mutex_;
  std::optional<Similarity> T_ground_mav_;  // of the visual map where own_unit_
  bool own_unit_ = false;
  std::optional<Similarity> T_mav_map_visual_;
  Eigen::Vector3d overlap_ = Eigen::Vector3d::Zero();  // its centre in that map
  std::optional<Eigen::Vector3d> position_;
  std::uint8_t last_status_ = 255;
  std::optional<air_ground_common::ros_utils::AlignmentBroadcaster> broadcaster_;
};

}  // namespace icp_refine
