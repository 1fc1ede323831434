#include "rgbd_slam/rotation_check.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "air_ground_common/text.h"

namespace rgbd_slam {
namespace {

using air_ground_common::formatted;

constexpr int kTurns = 50;
constexpr double kTurn = 0.09;           // a turn takes at least this: in less the images' noise looks like one [s]
constexpr double kTurning = 0.2;         // slower ones are mostly noise and bias [rad/s]
constexpr double kSurelyTurning = 0.3;   // a bias of 0.2 rad/s leaves more than a share 1 / kUnit of it [rad/s]
constexpr double kLongest = 0.5;         // between two frames [s]
constexpr double kMinCorrelation = 0.5;  // cosine of an error of 60 degrees: between right and any swapped axis
constexpr double kUnit = 4;              // ratio that no bias explains; degrees for radians make 57

Eigen::Index indexOf(const Eigen::Vector3d& v) {
  Eigen::Index axis = 0;
  v.cwiseAbs().maxCoeff(&axis);
  return axis;
}

std::string axisOf(const Eigen::Vector3d& v) {
  const Eigen::Index axis = indexOf(v);
  return std::string(v[axis] < 0 ? "-" : "+") + "xyz"[axis];
}

}  // namespace

void RotationCheck::add(const Eigen::Vector3d& seen, const Eigen::Vector3d& felt, double seconds) {
  if (!(seconds > 0) || seconds > kLongest || !seen.allFinite() || !felt.allFinite()) return;
  seen_ += seen;
  felt_ += felt;
  seconds_ += seconds;
  if (seconds_ < kTurn) return;
  addTurn(seen_, felt_, seconds_);
  seen_.setZero();
  felt_.setZero();
  seconds_ = 0;
}

void RotationCheck::addTurn(const Eigen::Vector3d& seen, const Eigen::Vector3d& felt, double seconds) {
  const bool both = std::min(seen.norm(), felt.norm()) >= kTurning * seconds;
  if (!both && seen.norm() < kSurelyTurning * seconds) return;
  seen_seen_ += seen * seen.transpose();
  felt_seen_ += felt * seen.transpose();
  felt_felt_ += felt.squaredNorm();
  if (++turns_ >= kTurns) judge();
}

void RotationCheck::judge() {
  const double seen_turn = std::sqrt(seen_seen_.trace()), felt_turn = std::sqrt(felt_felt_);
  const double correlation = felt_seen_.trace() / std::max(1e-12, seen_turn * felt_turn);
  const double ratio = felt_turn / std::max(1e-12, seen_turn);
  std::string problem;
  if (ratio > kUnit || ratio < 1 / kUnit) {
    problem = formatted(
        "gyro and images turn differently: the gyro by %.2g times as much; check its unit (rad/s), and that it "
        "measures",
        ratio);
  } else if (correlation < kMinCorrelation) {
    Eigen::Vector3d axis = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(seen_seen_).eigenvectors().col(2);
    if (axis[indexOf(axis)] < 0) axis = -axis;
    problem = formatted(
        "gyro and images turn differently (correlation %.2f): turns about %s of the base come from the IMU as "
        "turns about %s; check its transform to base_link and the order and signs of its axes",
        correlation, axisOf(axis).c_str(), axisOf(felt_seen_ * axis).c_str());
  }
  reset();
  problem_ = problem;
}

}  // namespace rgbd_slam
