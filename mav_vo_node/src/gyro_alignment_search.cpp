// Where gyro and images contradict each other: whether they agree with other axes, or at another time.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "mav_vo/gyro_alignment.h"

namespace mav_vo {

namespace {

constexpr double kReach = 1.0;           // of the offsets [s]
constexpr double kStep = 0.05;           // between them, from which the nearest minimum is found [s]
constexpr double kApart = 0.1;           // offsets of different minima [s]
constexpr std::size_t kLeastPairs = 12;  // that have samples whatever the offset is

}  // namespace

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

std::optional<double> GyroAlignment::otherTime(const ImuBuffer& imu) const {
  if (imu.empty()) return std::nullopt;
  GyroAlignment covered(*this);
  auto& pairs = covered.pairs_;
  const double first = imu.samples().front().stamp + kReach + kApart,
               last = imu.samples().back().stamp - kReach - kApart;
  pairs.erase(std::remove_if(pairs.begin(), pairs.end(),
                             [&](const Pair& pair) { return pair.begin < first || pair.end > last; }),
              pairs.end());
  if (pairs.size() < kLeastPairs) return std::nullopt;
  struct Minimum {
    double offset, cost;
  };
  std::vector<Minimum> minima;
  Minimum best{0, std::numeric_limits<double>::infinity()};
  double misfit = 0;  // there
  const int steps = static_cast<int>(std::lround(kReach / kStep));
  for (int i = -steps; i <= steps; ++i) {
    GyroAlignment moved(covered);
    moved.settings_.time_offset = moved.prior_mean_(3) = kStep * i;
    const double cost = moved.beginAnew(imu);
    minima.push_back({moved.timeOffset(), cost});
    if (cost >= best.cost) continue;
    best = minima.back();
    moved.summarize(imu);
    misfit = moved.misfit_;
  }
  const bool alone = std::all_of(minima.begin(), minima.end(), [&](const Minimum& other) {
    return std::abs(other.offset - best.offset) < kApart || other.cost > best.cost + kOtherMinimum;
  });
  if (!alone || misfit > kAgreement) return std::nullopt;
  return best.offset;
}

}  // namespace mav_vo
