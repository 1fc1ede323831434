// What a node does with the messages of its camera and IMU before a library sees them.
#pragma once

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>

#include <Eigen/Core>
#include <algorithm>
#include <mutex>
#include <optional>
#include <string>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/ros/health.h"

namespace air_ground_common::ros_utils {

/// A camera as its driver describes it.
struct Calibration {
  CameraModel camera;
  sensor_msgs::CameraInfo info;
};

/// True when both describe the same camera; frame and stamp do not matter.
inline bool sameCalibration(const sensor_msgs::CameraInfo& a, const sensor_msgs::CameraInfo& b) {
  return a.width == b.width && a.height == b.height && a.distortion_model == b.distortion_model && a.D == b.D &&
         a.K == b.K && a.R == b.R && a.P == b.P && a.binning_x == b.binning_x && a.binning_y == b.binning_y &&
         a.roi.x_offset == b.roi.x_offset && a.roi.y_offset == b.roi.y_offset && a.roi.width == b.roi.width &&
         a.roi.height == b.roi.height;
}

/// True when the camera's calibration is another than the one in use, and the image is of it: images of the old size
/// may still be on their way.
inline bool recalibrated(const Calibration& in_use, const Calibration& latest, const sensor_msgs::Image& image) {
  return !sameCalibration(latest.info, in_use.info) && static_cast<int>(image.width) == latest.camera.width &&
         static_cast<int>(image.height) == latest.camera.height;
}

/// `configured` or, when that is empty, as the messages say.
inline std::string cameraFrame(const std::string& configured, const Calibration& calibration,
                               const sensor_msgs::Image& image) {
  if (!configured.empty()) return configured;
  return calibration.info.header.frame_id.empty() ? image.header.frame_id : calibration.info.header.frame_id;
}

/// Samples of an IMU: refuses what is not finite, and judges the unit by the mean acceleration. Thread-safe.
class ImuInput {
 public:
  struct Sample {
    double stamp = 0;                                            ///< [s]
    Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  ///< IMU frame [rad/s]
    Eigen::Vector3d specific_force = Eigen::Vector3d::Zero();    ///< IMU frame [m/s^2]
  };

  explicit ImuInput(NodeHealth& health) : health_(health) {}

  /// Empty, and counted, when a number is not finite.
  std::optional<Sample> read(const sensor_msgs::Imu& msg) {
    Sample sample;
    sample.stamp = msg.header.stamp.toSec();
    sample.angular_velocity = {msg.angular_velocity.x, msg.angular_velocity.y, msg.angular_velocity.z};
    sample.specific_force = {msg.linear_acceleration.x, msg.linear_acceleration.y, msg.linear_acceleration.z};
    if (!sample.angular_velocity.allFinite() || !sample.specific_force.allFinite()) {
      health_.count("IMU samples refused: not a finite number");
      return std::nullopt;
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    judgeUnit(sample.specific_force.norm());
    return sample;
  }

  /// What is wrong with the acceleration; empty while nothing is known to be. An accelerometer in g, or without
  /// gravity, makes every length wrong.
  std::string problem() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return problem_;
  }

  /// Judges afresh.
  void reset() {
    const std::lock_guard<std::mutex> lock(mutex_);
    sum_ = 0;
    samples_ = 0;
    problem_.clear();
  }

 private:
  void judgeUnit(double force) {
    constexpr int kSamples = 200;
    if (samples_ >= kSamples) return;
    sum_ += force;
    if (++samples_ < kSamples) return;
    const double mean = sum_ / kSamples;
    if (mean > 3.0 && mean < 30.0) return;
    problem_ = "the IMU's mean acceleration is " + std::to_string(mean) +
               ", not about 9.81 m/s^2: wrong unit, or gravity removed?";
    health_.count(problem_);
  }

  NodeHealth& health_;
  mutable std::mutex mutex_;
  double sum_ = 0;
  int samples_ = 0;
  std::string problem_;
};

}  // namespace air_ground_common::ros_utils
