// Rest of the vehicle: the IMU alone cannot tell rest from straight flight, the image can. A rest gives the gyro bias
// and the direction of gravity.
#pragma once

#include <optional>
#include <unordered_map>
#include <vector>

#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/imu_attitude.h"

namespace mav_vo {

struct StandstillSettings {
  double duration = 0.6;        ///< image and IMU must be still for so long [s]
  double pixels = 0.4;          ///< median motion of the features from image to image [px]
  double drift_pixels = 1.0;    ///< median motion since the rest began [px]
  double gyro_scatter = 0.015;  ///< [rad/s]
  double accel_scatter = 0.2;   ///< [m/s^2]
  double max_gyro_bias = 0.25;  ///< a larger mean rate is no bias [rad/s]
  double max_accel_bias = 0.9;  ///< a specific force that differs more from gravity is no rest [m/s^2]
};

struct Standstill {
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();  ///< mean rate [rad/s]
  Eigen::Vector3d up_imu = Eigen::Vector3d::UnitZ();    ///< direction of the mean specific force, unit
};

class StandstillDetector {
 public:
  explicit StandstillDetector(const StandstillSettings& settings = {}) : settings_(settings) {}

  /// Next image's tracks and the IMU to its time (on the IMU's clock); a result while the vehicle stands.
  std::optional<Standstill> add(double stamp, const std::vector<visual_frontend::Feature>& features,
                                const visual_frontend::ImuBuffer& imu, double imu_stamp);
  void reset();

 private:
  bool imageStill(const std::vector<visual_frontend::Feature>& features) const;

  StandstillSettings settings_;
  double still_since_ = -1;                                                  ///< negative: the image moves [s]
  std::unordered_map<visual_frontend::TrackId, Eigen::Vector2d> reference_;  ///< pixels when the rest began
};

}  // namespace mav_vo
