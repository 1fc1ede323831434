// What a node does with the messages of its camera and IMU before a library sees them.
#pragma once

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/imu_combiner.h"
#include "air_ground_common/packet_spreader.h"
#include "air_ground_common/range_end.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/text.h"

namespace air_ground_common::ros_utils {

/// A camera as its driver describes it.
struct Calibration {
  CameraModel camera;
  sensor_msgs::CameraInfo info;
};

/// How far `b`'s distortion moves what the border of the image shows by `a`'s, at most [px].
inline double distortionShift(const sensor_msgs::CameraInfo& a, const sensor_msgs::CameraInfo& b) {
  constexpr double kUnknown = std::numeric_limits<double>::infinity();
  if (a.D == b.D) return 0;
  CameraModel model_a, model_b;
  try {
    model_a.setDistortion(a.distortion_model, a.D);
    model_b.setDistortion(b.distortion_model, b.D);
  } catch (const std::invalid_argument&) {
    return kUnknown;
  }
  for (CameraModel* model : {&model_a, &model_b}) {
    model->fx = a.K[0];
    model->fy = a.K[4];
    model->cx = a.K[2];
    model->cy = a.K[5];
  }
  double largest = -1;
  for (const double u : {0.0, 0.5, 1.0}) {
    for (const double v : {0.0, 0.5, 1.0}) {
      const Eigen::Vector2d pixel(u * (a.width - 1.0), v * (a.height - 1.0)), ray = model_a.unproject(pixel);
      if (!ray.allFinite()) continue;  // outside the circle of a fisheye
      const auto seen = model_b.project(ray.homogeneous());
      largest = std::max(largest, seen ? (*seen - pixel).norm() : kUnknown);
    }
  }
  return largest < 0 ? kUnknown : largest;
}

/// True when both describe the same camera; frame and stamp do not matter, nor does what an autofocus changes from
/// image to image: 0.3 % of the focal length, and a pixel by the distortion.
inline bool sameCalibration(const sensor_msgs::CameraInfo& a, const sensor_msgs::CameraInfo& b) {
  const double slack = 0.003 * a.K[0];
  const auto close = [slack](const auto& x, const auto& y, std::initializer_list<std::size_t> those_that_vary) {
    auto rest = y;
    for (const std::size_t i : those_that_vary)
      if (std::abs(x[i] - y[i]) < slack) rest[i] = x[i];
    return x == rest;
  };
  return a.width == b.width && a.height == b.height && a.distortion_model == b.distortion_model &&
         close(a.K, b.K, {0, 2, 4, 5}) && a.R == b.R && close(a.P, b.P, {0, 2, 3, 5, 6, 7}) &&
         a.binning_x == b.binning_x && a.binning_y == b.binning_y && a.roi.x_offset == b.roi.x_offset &&
         a.roi.y_offset == b.roi.y_offset && a.roi.width == b.roi.width && a.roi.height == b.roi.height &&
         distortionShift(a, b) < 1;
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
  return withoutSlash(calibration.info.header.frame_id.empty() ? image.header.frame_id
                                                               : calibration.info.header.frame_id);
}

/// Samples of an IMU: refuses what is not finite, not measured or beyond any sensor's range, counts those at the end of
/// their sensor's, judges the unit by the mean acceleration of the last samples, and spreads packets of samples that
/// were stamped on arrival. Thread-safe.
class ImuInput {
 public:
  using Sample = ImuCombiner::Sample;  ///< in the IMU's frame: stamp [s], angular velocity [rad/s], force [m/s^2]

  /// `separate`: the accelerometer has messages of its own.
  ImuInput(NodeHealth& health, bool separate) : health_(health), separate_(separate) {}

  /// Samples that are complete with this message, of the gyro alone where `separate`. None, and counted, when a number
  /// is not finite or beyond any sensor's range, or the message itself says that it was not measured (first covariance
  /// -1).
  std::vector<Sample> read(const sensor_msgs::Imu& msg) {
    const Eigen::Vector3d rate(msg.angular_velocity.x, msg.angular_velocity.y, msg.angular_velocity.z);
    const bool measured = msg.angular_velocity_covariance[0] != -1;
    if (!measured) health_.count("IMU samples refused: they say that turn rates are not measured");
    if (separate_)
      return measured && turnRate(rate) ? add(msg, rate, gyro_spreader_, &ImuCombiner::addGyro) : std::vector<Sample>{};
    const Eigen::Vector3d force(msg.linear_acceleration.x, msg.linear_acceleration.y, msg.linear_acceleration.z);
    const bool force_measured = msg.linear_acceleration_covariance[0] != -1;
    if (!force_measured)
      health_.count("IMU samples refused: they say that accelerations are not measured (on a topic of their own?)");
    if (!measured || !force_measured || !turnRate(rate) || !acceleration(force)) return {};
    const std::lock_guard<std::mutex> lock(mutex_);
    judgeUnit(force.norm());
    countPackets(spreader_);
    return spreader_.add({msg.header.stamp.toSec(), rate, force});
  }

  /// The same for a message of the accelerometer's own.
  std::vector<Sample> readAccelerometer(const sensor_msgs::Imu& msg) {
    const Eigen::Vector3d force(msg.linear_acceleration.x, msg.linear_acceleration.y, msg.linear_acceleration.z);
    return acceleration(force) ? add(msg, force, force_spreader_, &ImuCombiner::addAccelerometer)
                               : std::vector<Sample>{};
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
    combiner_.clear();
    spreader_.clear();
    gyro_spreader_.clear();
    force_spreader_.clear();
  }

 private:
  struct Reading {
    double stamp;  ///< [s]
    Eigen::Vector3d value;
  };

  bool turnRate(const Eigen::Vector3d& reading) {
    if (!admit(reading, kMaxAngularVelocity,
               "IMU samples refused: turns faster than any gyro can read (spoilt, or not in rad/s?)"))
      return false;
    countClipped(reading, rate_end_, "turn rates", "rad/s", "rotations err");
    return true;
  }

  bool acceleration(const Eigen::Vector3d& reading) {
    if (!admit(reading, kMaxSpecificForce,
               "IMU samples refused: accelerations beyond what a sensor can read (spoilt, or not in m/s^2?)"))
      return false;
    countClipped(reading, force_end_, "accelerations", "m/s^2", "scale and vertical err");
    return true;
  }

  void countClipped(const Eigen::Vector3d& reading, RangeEnd& end, const char* what, const char* unit,
                    const char* harm) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!end.reached(reading)) return;
    health_.count(
        formatted("%s cut off at %.3g %s, the end of the sensor's range: %s. Set a wider range in its driver, "
                  "or damp its mount",
                  what, end.largest(), unit, harm));
  }

  bool admit(const Eigen::Vector3d& reading, double limit, const char* beyond) {
    if (reading.norm() <= limit) return true;
    health_.count(reading.allFinite() ? beyond : "IMU samples refused: not a finite number");
    return false;
  }

  template <class Kind>
  void countPackets(const PacketSpreader<Kind>& spreader) {
    if (spreader.inPackets())
      health_.count(
          "IMU samples stamped on arrival, in packets: spread evenly; better have the driver take the sensor's clock");
  }

  std::vector<Sample> add(const sensor_msgs::Imu& msg, const Eigen::Vector3d& value, PacketSpreader<Reading>& spreader,
                          void (ImuCombiner::*stream)(double, const Eigen::Vector3d&)) {
    const std::lock_guard<std::mutex> lock(mutex_);
    countPackets(spreader);
    for (const Reading& reading : spreader.add({msg.header.stamp.toSec(), value}))
      (combiner_.*stream)(reading.stamp, reading.value);
    std::vector<Sample> samples;
    while (const auto sample = combiner_.pop()) {
      judgeUnit(sample->specific_force.norm());
      samples.push_back(*sample);
    }
    return samples;
  }

  void judgeUnit(double force) {
    constexpr int kSamples = 200;  // then it is judged anew: an IMU may send zeros while it warms up
    sum_ += force;
    if (++samples_ < kSamples) return;
    const double mean = sum_ / kSamples;
    sum_ = 0;
    samples_ = 0;
    problem_.clear();
    if (mean > 3.0 && mean < 30.0) return;
    problem_ = "the IMU's mean acceleration is " + std::to_string(mean) +
               ", not about 9.81 m/s^2: wrong unit, or gravity removed?";
    health_.count(problem_);
  }

  NodeHealth& health_;
  const bool separate_;
  mutable std::mutex mutex_;  // of what follows
  ImuCombiner combiner_;
  PacketSpreader<Sample> spreader_;
  PacketSpreader<Reading> gyro_spreader_, force_spreader_;  // where they are apart
  RangeEnd rate_end_{2.0}, force_end_{18.0};                // no gyro's below 125 deg/s, no accelerometer's below 2 g
  double sum_ = 0;
  int samples_ = 0;
  std::string problem_;
};

}  // namespace air_ground_common::ros_utils
