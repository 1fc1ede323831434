#include "visual_frontend/keyframe_covariances.h"

namespace visual_frontend {

Matrix6d covarianceAt(const Matrix6d& covariance, const Eigen::Vector3d& lever) {
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() = -air_ground_common::skew(lever);
  return J * covariance * J.transpose();
}

Matrix6d tiltCovariance(double sigma, const Eigen::Vector3d& position) {
  Matrix6d tilt = Matrix6d::Zero();
  tilt(3, 3) = tilt(4, 4) = sigma * sigma;
  return covarianceAt(tilt, position);
}

Matrix6d transformed(const Matrix6d& covariance, const air_ground_common::Similarity& S) {
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = S.scale * S.R;
  J.bottomRightCorner<3, 3>() = S.R;
  return J * covariance * J.transpose();
}

Matrix6d aboutAxes(const Eigen::Matrix3d& R_new_old, const Matrix6d& covariance) {
  air_ground_common::Similarity S;
  S.R = R_new_old;
  return transformed(covariance, S);
}

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
  return covarianceAt(known->second, position - map.keyframe(id).T_map_camera.translation());
}

void KeyframeCovariances::transform(const air_ground_common::Similarity& S) {
  for (auto& entry : covariance_) entry.second = transformed(entry.second, S);
}

}  // namespace visual_frontend
