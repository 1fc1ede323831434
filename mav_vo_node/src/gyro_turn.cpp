#include "gyro_turn.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/geometry.h"

namespace mav_vo {

using air_ground_common::expSO3;
using air_ground_common::rightJacobianSO3;

namespace {

constexpr double kNoiseLag = 0.01;  // samples so far apart err on their own, and a hand does not tremble so fast [s]
constexpr double kSignificance =
    6;  // of a squared difference over its mean by noise, which some 30 figures tell; F test, 99.97 %

/// Squared difference of two samples of the rate by noise and vibration, in the mean: of second differences, in which
/// a turn that is smooth cancels [rad^2/s^2].
double squareOfNoise(const std::vector<ImuSample>& samples) {
  const auto steps = static_cast<double>(samples.size() - 1);
  const double step = (samples.back().stamp - samples.front().stamp) / steps;
  const auto lag = static_cast<std::size_t>(std::max(1.0, std::round(kNoiseLag / step)));
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t i = 2 * lag; i < samples.size(); ++i, ++count)
    sum += (samples[i].angular_velocity - 2 * samples[i - lag].angular_velocity + samples[i - 2 * lag].angular_velocity)
               .squaredNorm();
  constexpr double kVariances = 6;  // of one sample, in that of a second difference; a difference has two
  return count == 0 ? 0 : 2 / kVariances * sum / static_cast<double>(count);
}

}  // namespace

std::optional<GyroTurn> gyroTurn(const ImuBuffer& imu, double begin, double end, const Eigen::Vector3d& bias) {
  const auto samples = samplesBetween(imu, begin, end);
  if (samples.size() < 2) return std::nullopt;
  GyroTurn turn;
  for (std::size_t i = 1; i < samples.size(); ++i) {
    const double dt = samples[i].stamp - samples[i - 1].stamp;
    if (!(dt > 0)) continue;
    const Eigen::Vector3d w = (0.5 * (samples[i - 1].angular_velocity + samples[i].angular_velocity) - bias) * dt;
    const Eigen::Matrix3d step = expSO3(w);
    turn.by_bias = step.transpose() * turn.by_bias - rightJacobianSO3(w) * dt;
    turn.R = turn.R * step;
  }
  turn.by_offset =
      (samples.back().angular_velocity - bias) - turn.R.transpose() * (samples.front().angular_velocity - bias);
  // A derivative that is noise would tell the offset surely, and to be what it was taken for.
  if (turn.by_offset.squaredNorm() < kSignificance * squareOfNoise(samples)) turn.by_offset.setZero();
  return turn;
}

}  // namespace mav_vo
