// What streetview_localizer_node's worker has to do, the newest image, and what is known of its pose beforehand.
#pragma once

#include <air_ground/VoStatus.h>
#include <ros/time.h>
#include <sensor_msgs/Image.h>

#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <string>

#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/image_input.h"
#include "air_ground_common/ros/sensor_input.h"
#include "air_ground_common/stamped_buffer.h"
#include "node_parameters.h"
#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

struct TimedPose {
  double stamp = 0;  ///< [s]
  Pose pose = Pose::Identity();
  Matrix6d covariance = Matrix6d::Identity();
};

struct Job {
  sensor_msgs::Image::ConstPtr image;
  CameraModel camera;
  std::string camera_frame;  ///< without leading slash; empty where neither settings nor messages name one
  unsigned pass = 0;         ///< counts the starts afresh
};

/// Callbacks add, one worker takes; all may do so at once.
class ImageQueue {
 public:
  ImageQueue(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health)
      : settings_(settings), health_(health) {}

  // ---- Callbacks

  void setCamera(const air_ground_common::ros_utils::Calibration& calibration);
  /// Takes the place of an image that waits.
  void add(const air_ground_common::ros_utils::ImageMessage& message);
  void addPrediction(const TimedPose& T_world_base);
  void addAttitude(const TimedPose& T_map_base);
  void addStatus(const air_ground::VoStatus& odometry);
  /// Forgets images and poses.
  void reset();
  void stop();

  // ---- The worker

  /// Waits for an image that can be used (counts why others cannot) and, where `attitudes_come` then, a little for the
  /// attitude of its time. Empty when stop() was called.
  std::optional<Job> next(const std::function<bool()>& attitudes_come);
  /// Nothing of it was forgotten meanwhile.
  bool isCurrent(const Job& job) const;
  /// Of the image's time, as far as poses near it have come. `use_prediction` false: without the tracked pose.
  PosePrior priorFor(const Job& job, const Pose& T_base_camera, bool use_prediction);

 private:
  /// An image as it came, with the calibration of then.
  struct Arrival {
    air_ground_common::ros_utils::ImageMessage message;
    air_ground_common::ros_utils::Calibration calibration;
    unsigned pass = 0;
  };
  std::optional<Job> jobOf(const Arrival& arrival) const;

  const NodeSettings& settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  mutable std::mutex mutex_;  // guards what follows
  std::condition_variable wake_;
  bool stop_ = false;
  unsigned pass_ = 0;
  std::size_t skipped_ = 0;
  std::optional<air_ground_common::ros_utils::Calibration> calibration_;
  std::optional<Arrival> waiting_;
  ros::Time last_started_;
  air_ground_common::StampedBuffer<TimedPose> predictions_{kPosesKept}, attitudes_{kPosesKept};
  static constexpr double kPosesKept = 10;  // [s]
  std::optional<double> inertial_;          ///< when the odometry of these images last agreed with an IMU [s]
};

}  // namespace streetview_localizer
