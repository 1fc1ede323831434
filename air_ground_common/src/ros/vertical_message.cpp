#include "air_ground_common/ros/vertical_message.h"

#include <cmath>

namespace air_ground_common::ros_utils {

void setVertical(const Vertical& vertical, air_ground::VoStatus* status) {
  status->tilt_stddev = vertical.stddev;
  status->up.x = vertical.up.x();
  status->up.y = vertical.up.y();
  status->up.z = vertical.up.z();
}

Vertical verticalFromMsg(const air_ground::VoStatus& status) {
  constexpr double kShortest = 0.5;  // of what should be 1: shorter is a mistake
  if (!(status.tilt_stddev > 0) || !std::isfinite(status.tilt_stddev)) return {};
  const Eigen::Vector3d up(status.up.x, status.up.y, status.up.z);
  if (up.isZero()) return {Eigen::Vector3d::UnitZ(), status.tilt_stddev};
  if (!up.allFinite() || up.norm() < kShortest) return {};
  return {up.normalized(), status.tilt_stddev};
}

}  // namespace air_ground_common::ros_utils
