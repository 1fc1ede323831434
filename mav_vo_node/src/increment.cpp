#include "increment.h"

namespace mav_vo {

Increment incrementBetween(double previous_stamp, const LocatedCamera& previous, const LocatedCamera& current,
                           const Pose& T_base_camera) {
  Increment step;
  step.previous_stamp = previous_stamp;
  step.T_previous_current =
      T_base_camera * previous.T_map_camera.inverse() * current.T_map_camera * T_base_camera.inverse();
  const Eigen::Matrix3d R = (previous.T_map_camera * T_base_camera.inverse()).linear().transpose();
  const Matrix6d sum = current.covariance + previous.covariance;
  step.covariance.topLeftCorner<3, 3>() = R * sum.topLeftCorner<3, 3>() * R.transpose();
  step.covariance.block<3, 1>(0, 3) = R * sum.block<3, 1>(0, 5);
  step.covariance.block<1, 3>(3, 0) = step.covariance.block<3, 1>(0, 3).transpose();
  step.covariance(3, 3) = sum(5, 5);
  step.pose_covariance = step.covariance;
  return step;
}

void scatterCovariance(const std::vector<RayPair>& pairs, const Eigen::Matrix3d& R_map_base, const Pose& T_base_camera,
                       double sigma, const MonteCarloSettings& settings, Increment* step) {
  const Eigen::Vector3d t = step->T_previous_current.translation();
  const double length = t.norm();
  const Eigen::Vector3d along = length > 0 ? Eigen::Vector3d(t / length) : Eigen::Vector3d::UnitX();
  const double length_variance = along.dot(step->pose_covariance.topLeftCorner<3, 3>() * along);
  const auto scatter =
      monteCarloIncrement(pairs, step->T_previous_current, T_base_camera, R_map_base, length_variance, sigma, settings);
  if (scatter.success) step->covariance = scatter.covariance;
}

void scaleIncrement(double factor, const Pose& T_base_camera, Increment* increment) {
  Pose step = T_base_camera.inverse() * increment->T_previous_current * T_base_camera;
  step.translation() *= factor;
  increment->T_previous_current = T_base_camera * step * T_base_camera.inverse();
  for (auto* covariance : {&increment->covariance, &increment->pose_covariance}) {
    covariance->topLeftCorner<3, 3>() *= factor * factor;
    covariance->block<3, 1>(0, 3) *= factor;
    covariance->block<1, 3>(3, 0) *= factor;
  }
}

}  // namespace mav_vo
