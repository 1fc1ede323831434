// Rotation between two images by the gyro, and how it changes with what is not known of the gyro.
#pragma once

#include <optional>

#include "mav_vo/imu_preintegration.h"

namespace mav_vo {

/// Rotation between two times of the gyro's clock and its derivatives.
struct GyroTurn {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();    ///< R_begin_end of the IMU
  Eigen::Matrix3d by_bias = Eigen::Matrix3d::Zero();  ///< right-multiplied rotation by bias
  Eigen::Vector3d by_offset =
      Eigen::Vector3d::Zero();  ///< by a shift of both ends; zero where noise may make it [rad/s]
};

/// Empty where samples are missing. `bias` [rad/s].
std::optional<GyroTurn> gyroTurn(const ImuBuffer& imu, double begin, double end, const Eigen::Vector3d& bias);

}  // namespace mav_vo
