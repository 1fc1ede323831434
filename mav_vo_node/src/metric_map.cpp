#include "metric_map.h"

namespace mav_vo {

Eigen::Matrix3d levelRotation(const Eigen::Vector3d& up, const Eigen::Matrix3d& R_visual_camera_first,
                              const air_ground_common::Pose& T_base_camera) {
  const Eigen::Matrix3d R = air_ground_common::levelingRotation(up);
  const double yaw = air_ground_common::yawOf(R * R_visual_camera_first * T_base_camera.linear().transpose());
  return Eigen::AngleAxisd(-yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix() * R;
}

air_ground_common::Similarity metricMap(double scale, const Eigen::Vector3d& up,
                                        const air_ground_common::Pose& T_visual_camera_first,
                                        const air_ground_common::Pose& T_base_camera) {
  const air_ground_common::Pose& first = T_visual_camera_first;
  air_ground_common::Similarity S;
  S.scale = scale;
  S.R = levelRotation(up, first.linear(), T_base_camera);
  // The lever from the camera to base_link is metric already.
  const Eigen::Vector3d p_camera_base = T_base_camera.inverse().translation();
  S.t = -(S.scale * (S.R * first.translation()) + S.R * first.linear() * p_camera_base);
  return S;
}

}  // namespace mav_vo
