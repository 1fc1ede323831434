#include "air_ground_common/ros/calibration_report.h"

#include <ros/console.h>

#include <utility>

namespace air_ground_common::ros_utils {

void CalibrationReport::update(double k1) {
  health_.value("k1", k1);
  const double before = std::exchange(told_, k1);
  if (k1 == before || k1 == given_) return;  // an estimator that was reset begins with what was given
  ROS_WARN(
      "The images show that the calibration of the %s is off: k1 is %.4f, not %.4f, and is used so. Calibrate it; "
      "radial_stddev: 0 keeps what camera_info says",
      camera_.c_str(), k1, before);
}

}  // namespace air_ground_common::ros_utils
