// Where sensors sit on a robot: from parameters, or from tf.
#pragma once

#include <map>
#include <mutex>
#include <optional>
#include <string>

#include "air_ground_common/geometry.h"
#include "air_ground_common/ros/transform_buffer.h"

namespace air_ground_common::ros_utils {

/// Listens to tf for as long as it lives. Make it before the first image can come: an unlatched message on /tf_static
/// is sent once. Thread-safe.
class Mountings {
 public:
  /// `base_frame`: of the robot. `listener`: see TransformBuffer.
  explicit Mountings(const std::string& base_frame, TransformBuffer::Listener listener = {});

  /// T_base_sensor: `given` or, without, as tf says at this moment; never waits. Empty, with the edge that is missing,
  /// the frames that are known and what to do in `why`, while it is not known. `sensor` names it as the parameter
  /// base_<sensor> does: "camera", "imu". Leading slashes of `frame` do not matter.
  std::optional<Pose> lookup(const std::optional<Pose>& given, const std::string& frame, const std::string& sensor,
                             std::string* why) const;

  /// What has moved against the base by more than 0.02 rad or 1 cm since it was last looked up, as a reason and what to
  /// do; empty: nothing. A head that pans is no mounting.
  std::string moved() const;

  /// Time has run back: tf would refuse, and complain of, all that comes until then. What is on /tf_static stays.
  void forgetMoving() { transforms_.clear(); }

 private:
  std::string base_frame_;
  TransformBuffer transforms_;
  mutable std::mutex mutex_;
  mutable std::map<std::string, Pose> looked_up_;  // T_base_sensor by the sensor's frame, of those from tf
};

}  // namespace air_ground_common::ros_utils
