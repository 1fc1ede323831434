#include "alignment_output.h"

#include "air_ground_common/ros/conversions.h"

namespace icp_refine {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;

std::uint8_t statusOf(RefineStatus status) {
  switch (status) {
    case RefineStatus::kSearching:
      return AlignmentEstimate::STATUS_SEARCHING;
    case RefineStatus::kDegenerate:
      return AlignmentEstimate::STATUS_DEGENERATE;
    case RefineStatus::kConverged:
      return AlignmentEstimate::STATUS_CONVERGED;
    case RefineStatus::kRejected:
      return AlignmentEstimate::STATUS_REJECTED;
  }
  return AlignmentEstimate::STATUS_REJECTED;
}

AlignmentEstimate messageOf(const RefineOutcome& out) {
  AlignmentEstimate msg;
  msg.header.stamp = out.stamp > 0 ? ros::Time().fromNSec(static_cast<std::uint64_t>(out.stamp)) : ros::Time::now();
  const bool finite = isValid(out.T_ground_map_mav_map) && out.covariance.allFinite();
  const Similarity T = finite ? out.T_ground_map_mav_map : Similarity();
  msg.pose.pose = ros_utils::toMsg(poseOf(T));
  ros_utils::setCovariance(finite ? out.covariance : Matrix6d(Matrix6d::Identity() * 1e6), &msg.pose.covariance);
  msg.scale = T.scale;
  msg.scale_stddev = finite ? out.scale_stddev : 0;
  msg.reference_point.x = out.reference_point.x();
  msg.reference_point.y = out.reference_point.y();
  msg.reference_point.z = out.reference_point.z();
  msg.status = statusOf(finite ? out.status : RefineStatus::kRejected);
  msg.stage = AlignmentEstimate::STAGE_REFINED;
  msg.reason = out.reason;
  msg.overlap = out.overlap;
  msg.cost = out.residual_rms;
  msg.iterations = static_cast<std::uint32_t>(out.iterations);
  return msg;
}

}  // namespace

AlignmentOutput::AlignmentOutput(const NodeSettings& settings, ros_utils::NodeHealth& health)
    : settings_(settings), health_(health) {
  refined_publisher_ = ros::NodeHandle().advertise<AlignmentEstimate>("alignment/refined", 10);
  if (settings.publish_tf) broadcaster_.emplace(settings.tf_rate, [this] { return edge(); });
}

void AlignmentOutput::publish(const RefineOutcome& out, std::uint32_t map_id, bool tracking, bool own_unit) {
  AlignmentEstimate msg = messageOf(out);
  msg.header.frame_id = settings_.ground_map_frame;
  msg.child_frame_id = own_unit ? settings_.visual_map_frame : settings_.mav_map_frame;
  msg.map_id = map_id;
  const bool good = msg.status == AlignmentEstimate::STATUS_CONVERGED;
  bool without_scale = false;
  {
    std::lock_guard<std::mutex> lock(mutex_);
    own_unit_ = own_unit;
    without_scale = good && own_unit && !T_mav_map_visual_ && broadcaster_;
    if (good) {
      T_ground_mav_ = out.T_ground_map_mav_map;
      overlap_ = inverse(*T_ground_mav_) * out.reference_point;
    } else if (!tracking) {
      T_ground_mav_.reset();
    }
  }
  refined_publisher_.publish(msg);
  if (good && broadcaster_) broadcaster_->send();

  static const char* kNames[] = {"SEARCHING", "AMBIGUOUS", "DEGENERATE", "CONVERGED", "REJECTED"};
  health_.state(good ? 0 : 1, std::string(kNames[msg.status]) + ": " + out.reason +
                                  (without_scale ? "; no tf before mav_vo tells mav/map_scale" : ""));
  if (msg.status == AlignmentEstimate::STATUS_DEGENERATE) health_.count("degenerate refinements");
  if (msg.status == AlignmentEstimate::STATUS_REJECTED) health_.count("rejected refinements");
  if (msg.status != last_status_) ROS_INFO_STREAM("alignment " << kNames[msg.status] << ": " << out.reason);
  last_status_ = msg.status;
}

void AlignmentOutput::setPosition(const std::optional<Eigen::Vector3d>& p_mav_map) {
  std::lock_guard<std::mutex> lock(mutex_);
  position_ = p_mav_map;
}

void AlignmentOutput::setMapScale(const std::optional<Similarity>& T_mav_map_visual) {
  std::lock_guard<std::mutex> lock(mutex_);
  T_mav_map_visual_ = T_mav_map_visual;
}

void AlignmentOutput::drop() {
  std::lock_guard<std::mutex> lock(mutex_);
  T_ground_mav_.reset();
}

std::optional<ros_utils::AlignmentBroadcaster::Edge> AlignmentOutput::edge() {
  std::lock_guard<std::mutex> lock(mutex_);
  if (!T_ground_mav_ || (own_unit_ && !T_mav_map_visual_)) return std::nullopt;
  const Similarity T_ground_mav_map = own_unit_ ? compose(*T_ground_mav_, inverse(*T_mav_map_visual_)) : *T_ground_mav_;
  const Eigen::Vector3d overlap = own_unit_ ? *T_mav_map_visual_ * overlap_ : overlap_;
  const Pose T = rigidAt(T_ground_mav_map, position_.value_or(overlap));
  using Edge = ros_utils::AlignmentBroadcaster::Edge;
  if (settings_.inverse_tf) return Edge{settings_.mav_map_frame, settings_.ground_map_frame, T.inverse()};
  return Edge{settings_.ground_map_frame, settings_.mav_map_frame, T};
}

}  // namespace icp_refine
