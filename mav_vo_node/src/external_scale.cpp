#include "mav_vo/external_scale.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/covariance.h"
#include "air_ground_common/geometry.h"
#include "increment.h"
#include "metric_map.h"

namespace mav_vo {

using air_ground_common::Similarity;

namespace {

Pose moved(const Similarity& S, const Pose& T) {
  Pose out = Pose::Identity();
  out.linear() = S.R * T.linear();
  out.translation() = S * T.translation();
  return out;
}

/// The ground map's vertical in the visual map.
Eigen::Vector3d upIn(const AlignedScale& aligned) {
  return aligned.T_ground_visual.R.transpose() * Eigen::Vector3d::UnitZ();
}

}  // namespace

bool ExternalScale::update(const AlignedScale& aligned) {
  if (!(aligned.T_ground_visual.scale > 0) || !(aligned.scale_stddev > 0) ||
      aligned.scale_stddev > settings_.largest_stddev)
    return false;
  if (adopted_ && adopted_->map_id != aligned.map_id) forget();
  if (adopted_ && !differs(aligned, *adopted_)) {
    candidate_.reset();
    return false;
  }
  const bool confirmed = !adopted_ || (candidate_ && !differs(aligned, *candidate_));
  candidate_ = aligned;
  if (!confirmed) return false;
  adopt(aligned);
  return true;
}

void ExternalScale::forget() {
  adopted_.reset();
  candidate_.reset();
}

bool ExternalScale::differs(const AlignedScale& a, const AlignedScale& b) const {
  const double change = std::abs(std::log(a.T_ground_visual.scale / b.T_ground_visual.scale));
  const double tilt = std::acos(std::clamp(upIn(a).dot(upIn(b)), -1.0, 1.0));
  const double k = settings_.significance;
  return change > std::max(settings_.min_change, k * std::hypot(a.scale_stddev, b.scale_stddev)) ||
         tilt > std::max(settings_.min_tilt, k * std::hypot(a.tilt_stddev, b.tilt_stddev));
}

void ExternalScale::adopt(const AlignedScale& aligned) {
  adopted_ = aligned;
  candidate_.reset();
  T_map_visual_ =
      metricMap(aligned.T_ground_visual.scale, upIn(aligned), aligned.T_visual_camera_first, T_base_camera_);
}

std::optional<Similarity> ExternalScale::T_map_visual(std::uint32_t map_id) const {
  if (!adopted_ || adopted_->map_id != map_id) return std::nullopt;
  return T_map_visual_;
}

VoResult ExternalScale::metric(const VoResult& visual) const {
  const auto S = T_map_visual(visual.map_id);
  if (!S) return visual;
  VoResult r = visual;
  r.metric = true;
  r.vertical = {};  // level as far as the alignment is
  if (r.state == OdometryState::kScaling) {
    r.state = OdometryState::kTracking;
    r.reason = "scale from the ground map";
  }
  r.scale = S->scale;
  r.scale_stddev = S->scale * adopted_->scale_stddev;
  r.scale_deviation = adopted_->scale_stddev;
  if (!r.pose_valid) return r;
  r.depth_min *= S->scale;
  r.depth_max *= S->scale;
  r.T_map_camera = moved(*S, visual.T_map_camera);
  r.camera_covariance = air_ground_common::transformed(visual.camera_covariance, *S);
  // What the scale leaves open grows from the map's origin.
  const Eigen::Vector3d p = r.T_map_camera.translation();
  r.camera_covariance.topLeftCorner<3, 3>() += adopted_->scale_stddev * adopted_->scale_stddev * p * p.transpose();
  const Pose T_camera_base = T_base_camera_.inverse();
  r.T_map_base = r.T_map_camera * T_camera_base;
  r.covariance =
      air_ground_common::covarianceAt(r.camera_covariance, r.T_map_camera.linear() * T_camera_base.translation());
  if (r.increment) scaleIncrement(S->scale, T_base_camera_, &*r.increment);
  return r;
}

air_ground_common::Trajectory ExternalScale::metric(const air_ground_common::Trajectory& visual,
                                                    std::uint32_t map_id) const {
  const auto S = T_map_visual(map_id);
  air_ground_common::Trajectory out = visual;
  if (S)
    for (auto& pose : out) pose.T_map_body = moved(*S, pose.T_map_body);
  return out;
}

}  // namespace mav_vo
