#include "visual_frontend/keyframe_covariances.h"

#include "air_ground_common/covariance.h"

namespace visual_frontend {

void KeyframeCovariances::add(KeyframeId id, const Matrix6d& pose_covariance, const Map& map) {
  const Eigen::Vector3d p = map.keyframe(id).T_map_camera.translation();
  Matrix6d best = Matrix6d::Zero();
  bool any = false;
  for (const auto& c : map.covisible(id, 20)) {
    if (!covariance_.count(c.keyframe)) continue;
    const Matrix6d C = at(c.keyframe, p, map);
    if (!any || C.topLeftCorner<3, 3>().trace() < best.topLeftCorner<3, 3>().trace()) best = C;
    any = true;
  }
  if (!any && !covariance_.empty()) best = at(covariance_.rbegin()->first, p, map);
  // The pose takes the landmarks for exact; they err together with the keyframes that made them. Three times the
  // standard deviation makes up for it (normalised errors of simulated runs).
  covariance_[id] = best + 9 * pose_covariance;
}

Matrix6d KeyframeCovariances::at(KeyframeId id, const Eigen::Vector3d& position, const Map& map) const {
  const auto known = covariance_.find(id);
  if (known == covariance_.end()) return Matrix6d::Zero();
  return air_ground_common::covarianceAt(known->second, position - map.keyframe(id).T_map_camera.translation());
}

void KeyframeCovariances::transform(const air_ground_common::Similarity& S) {
  for (auto& entry : covariance_) entry.second = air_ground_common::transformed(entry.second, S);
}

}  // namespace visual_frontend
