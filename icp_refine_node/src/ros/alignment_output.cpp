#include "alignment_output.h"

#include <geometry_msgs/PoseWithCovarianceStamped.h>

#include "air_ground_common/covariance.h"
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
  ros::NodeHandle handle;
  refined_publisher_ = handle.advertise<AlignmentEstimate>("alignment/refined", 10, true);
  pose_publisher_ = handle.advertise<geometry_msgs::PoseWithCovarianceStamped>("mav/pose_in_ground_map", 100);
  if (settings.publish_tf) broadcaster_.emplace(settings.tf_rate, [this] { return edge(); });
}

void AlignmentOutput::keep(const RefineOutcome& out, const std::optional<Similarity>& tracked, AlignmentEstimate* msg) {
  const bool good = msg->status == AlignmentEstimate::STATUS_CONVERGED;
  if (good) {
    aligned_ = KnownAlignment{out.T_ground_map_mav_map, out.covariance, out.reference_point,
                              out.scale_stddev / out.T_ground_map_mav_map.scale};
    converged_stamp_ = msg->header.stamp;
  } else if (!tracked) {
    aligned_.reset();
  } else if (aligned_ && isValid(*tracked)) {
    aligned_->T_ground_map_mav_map = *tracked;  // it follows corrections of the MAV's map
  }
  msg->held = !good && alignment();
  if (good || msg->held) msg->converged_stamp = converged_stamp_;
}

void AlignmentOutput::publish(const RefineOutcome& out, const MapIds& maps, const std::optional<Similarity>& tracked,
                              bool own_unit) {
  AlignmentEstimate msg = messageOf(out);
  msg.header.frame_id = settings_.ground_map_frame;
  msg.child_frame_id = own_unit ? settings_.visual_map_frame : settings_.mav_map_frame;
  msg.map_id = maps.mav;
  msg.ground_map_id = maps.ground;
  const bool good = msg.status == AlignmentEstimate::STATUS_CONVERGED;
  bool without_scale = false;
  {
    std::lock_guard<std::mutex> lock(mutex_);
    own_unit_ = own_unit;
    without_scale = good && own_unit && !T_mav_map_visual_ && broadcaster_;
    keep(out, tracked, &msg);
  }
  refined_publisher_.publish(msg);
  if (good && broadcaster_) broadcaster_->send();

  static const char* kNames[] = {"SEARCHING", "AMBIGUOUS", "DEGENERATE", "CONVERGED", "REJECTED"};
  health_.state(good ? health_.kOk : health_.kWarn,
                std::string(kNames[msg.status]) + ": " + out.reason +
                    (without_scale ? "; no tf before mav_vo tells mav/map_scale" : ""));
  if (msg.status == AlignmentEstimate::STATUS_DEGENERATE)
    health_.count(
        "refinements DEGENERATE: what both robots saw does not fix the pose. Its reason names the direction; fly over "
        "more that stands out there");
  if (msg.status == AlignmentEstimate::STATUS_REJECTED)
    health_.count(
        "refinements REJECTED: where they put the MAV's cloud, it contradicts the ground map. Wait for the next cloud, "
        "or for another coarse alignment");
  if (out.lost)
    ROS_WARN_STREAM("the alignment is lost, and tf with it: " << out.reason);
  else if (msg.status != last_status_)
    ROS_INFO_STREAM("alignment " << kNames[msg.status] << ": " << out.reason);
  last_status_ = msg.status;
}

void AlignmentOutput::withdraw(const std::string& why, const MapIds& maps, bool own_unit) {
  RefineOutcome out;
  out.reason = why;
  publish(out, maps, std::nullopt, own_unit);
}

void AlignmentOutput::correct(const Similarity& T_ground_map_mav_map) {
  std::lock_guard<std::mutex> lock(mutex_);
  if (aligned_ && isValid(T_ground_map_mav_map)) aligned_->T_ground_map_mav_map = T_ground_map_mav_map;
}

void AlignmentOutput::follow(const nav_msgs::Odometry& odometry, const Pose& T) {
  const Matrix6d covariance =
      Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(odometry.pose.covariance.data());
  geometry_msgs::PoseWithCovarianceStamped msg;
  msg.header.stamp = odometry.header.stamp;
  msg.header.frame_id = settings_.ground_map_frame;
  {
    std::lock_guard<std::mutex> lock(mutex_);
    position_ = T.translation();
    const auto T_ground_mav_map = alignment();
    if (!T_ground_mav_map) return;
    const Pose T_ground_base = rigidAt(*T_ground_mav_map, T.translation()) * T;
    msg.pose.pose = ros_utils::toMsg(T_ground_base);
    ros_utils::setCovariance(covarianceAbout(*aligned_, T_ground_base.translation()) +
                                 air_ground_common::transformed(covariance, *T_ground_mav_map),
                             &msg.pose.covariance);
  }
  if (!covariance.allFinite()) return health_.count("odometry whose covariance is not finite");
  pose_publisher_.publish(msg);
}

void AlignmentOutput::forgetMav() {
  std::lock_guard<std::mutex> lock(mutex_);
  position_.reset();
  T_mav_map_visual_.reset();
}

void AlignmentOutput::setMapScale(const std::optional<Similarity>& T_mav_map_visual) {
  std::lock_guard<std::mutex> lock(mutex_);
  T_mav_map_visual_ = T_mav_map_visual;
}

std::optional<Similarity> AlignmentOutput::alignment() const {
  if (!aligned_ || (own_unit_ && !T_mav_map_visual_)) return std::nullopt;
  const Similarity& T = aligned_->T_ground_map_mav_map;
  return own_unit_ ? compose(T, inverse(*T_mav_map_visual_)) : T;
}

std::optional<ros_utils::AlignmentBroadcaster::Edge> AlignmentOutput::edge() {
  std::lock_guard<std::mutex> lock(mutex_);
  const auto T_ground_mav_map = alignment();
  if (!T_ground_mav_map) return std::nullopt;
  const Pose T = rigidAt(*T_ground_mav_map, position_ ? *position_ : inverse(*T_ground_mav_map) * aligned_->centre);
  using Edge = ros_utils::AlignmentBroadcaster::Edge;
  if (settings_.inverse_tf) return Edge{settings_.mav_map_frame, settings_.ground_map_frame, T.inverse()};
  return Edge{settings_.ground_map_frame, settings_.mav_map_frame, T};
}

}  // namespace icp_refine
