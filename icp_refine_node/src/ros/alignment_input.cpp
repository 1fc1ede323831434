#include "alignment_input.h"

#include <cmath>
#include <stdexcept>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/vertical_message.h"

namespace icp_refine {

namespace ros_utils = air_ground_common::ros_utils;

namespace {

constexpr double kSharedScaleError = 0.01;  // relative: depth and calibration, that all views share

void readCovariance(const air_ground::AlignmentEstimate& msg, KnownAlignment* known) {
  known->covariance = ros_utils::covarianceFromMsg(msg.pose.covariance);
  known->centre = {msg.reference_point.x, msg.reference_point.y, msg.reference_point.z};
}

}  // namespace

Similarity similarityFrom(const air_ground::AlignmentEstimate& msg) {
  if (!(msg.scale > 0) || !std::isfinite(msg.scale)) throw std::invalid_argument("the scale is not positive");
  return similarity(ros_utils::fromMsg(msg.pose.pose), msg.scale);
}

bool isUsable(const air_ground::AlignmentEstimate& msg) {
  return msg.status == air_ground::AlignmentEstimate::STATUS_CONVERGED || msg.guess;
}

bool isWithdrawal(const air_ground::AlignmentEstimate& msg) {
  return !isUsable(msg) && (msg.status == air_ground::AlignmentEstimate::STATUS_AMBIGUOUS ||
                            msg.status == air_ground::AlignmentEstimate::STATUS_DEGENERATE);
}

CoarseAlignment coarseAlignmentFrom(const air_ground::AlignmentEstimate& msg, bool own_unit) {
  CoarseAlignment coarse;
  coarse.T_ground_map_mav_map = own_unit ? similarityFrom(msg) : similarity(ros_utils::fromMsg(msg.pose.pose));
  coarse.scale_stddev = own_unit ? msg.scale_stddev / msg.scale : 0;
  coarse.sure = msg.status == air_ground::AlignmentEstimate::STATUS_CONVERGED;
  readCovariance(msg, &coarse);
  return coarse;
}

Vertical verticalFrom(const air_ground::VoStatus& msg) {
  constexpr double kNearZ = 0.9;  // the prior is linear in the lean
  const Vertical vertical = ros_utils::verticalFromMsg(msg);
  return vertical.up.z() > kNearZ ? vertical : Vertical{};
}

KnownAlignment viewAlignmentFrom(const air_ground::AlignmentEstimate& msg, bool own_unit) {
  KnownAlignment views;
  views.T_ground_map_mav_map = similarityFrom(msg);
  readCovariance(msg, &views);
  views.scale_stddev = std::hypot(kSharedScaleError, msg.scale_stddev / msg.scale);
  views.tells_scale = own_unit;
  if (!views.covariance.allFinite() || !(views.covariance.diagonal().minCoeff() > 0) || !views.centre.allFinite() ||
      !std::isfinite(views.scale_stddev))
    throw std::invalid_argument("its covariance is none");
  return views;
}

}  // namespace icp_refine
