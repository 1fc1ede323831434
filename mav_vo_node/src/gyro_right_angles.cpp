// Where gyro and images contradict each other: whether they agree with other axes.
#include <algorithm>
#include <limits>

#include "mav_vo/gyro_alignment.h"

namespace mav_vo {

std::optional<Eigen::Matrix3d> GyroAlignment::rightAngles(const ImuBuffer& imu) const {
  double best = std::numeric_limits<double>::infinity(), second = best;
  Eigen::Matrix3d R_best = Eigen::Matrix3d::Identity();
  for (int i = 0; i < 24; ++i) {  // each axis up, four headings
    Eigen::Matrix3d R = Eigen::Matrix3d::Zero();
    R((i / 4) % 3, 0) = i < 12 ? 1 : -1;
    R((i / 4 + 1 + i % 2) % 3, 1) = i % 4 < 2 ? 1 : -1;
    R.col(2) = R.col(0).cross(R.col(1));
    GyroAlignment turned(*this);
    turned.R_camera_imu_ = R_camera_imu_ * R;
    const double cost = turned.beginAnew(imu);
    second = std::min(second, std::max(cost, best));
    if (cost >= best) continue;
    turned.summarize(imu);
    best = cost;
    R_best = turned.misfit_ > kAgreement ? Eigen::Matrix3d(Eigen::Matrix3d::Identity()) : R;
  }
  if (R_best.isIdentity() || second < best + kOtherMinimum) return std::nullopt;
  return R_best;
}

}  // namespace mav_vo
