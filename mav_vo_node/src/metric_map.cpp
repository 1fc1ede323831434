#include "metric_map.h"

namespace mav_vo {

Eigen::Matrix3d headingZero(const Eigen::Matrix3d& R_map_base) {
  return Eigen::AngleAxisd(-air_ground_common::yawOf(R_map_base), Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

air_ground_common::Similarity metricMap(double scale, const Eigen::Vector3d& up,
                                        const air_ground_common::Pose& T_visual_camera_first,
                                        const air_ground_common::Pose& T_base_camera) {
  const air_ground_common::Pose& first = T_visual_camera_first;
  air_ground_common::Similarity S;
  S.scale = scale;
  S.R = air_ground_common::levelingRotation(up);
  S.R = (headingZero(S.R * first.linear() * T_base_camera.linear().transpose()) * S.R).eval();
  // The lever from the camera to base_link is metric already.
  const Eigen::Vector3d p_camera_base = T_base_camera.inverse().translation();
  S.t = -(S.scale * (S.R * first.translation()) + S.R * first.linear() * p_camera_base);
  return S;
}

}  // namespace mav_vo
