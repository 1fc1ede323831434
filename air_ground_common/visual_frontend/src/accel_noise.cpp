#include "visual_frontend/accel_noise.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "air_ground_common/statistics.h"

namespace visual_frontend {

namespace {

constexpr double kStep = 0.005;    // [s]
constexpr double kMaxGap = 0.1;    // [s]
constexpr double kPart = 0.5;      // [s]
constexpr double kSlowest = 0.04;  // accelerometer, from reading to reading [s]
constexpr std::size_t kParts = 8;
constexpr double kLeast = 0.15;  // of values, once the kernels are full [s]
constexpr int kOrder = 5;        // of the differences: the motion's Taylor series up to the fourth power vanishes

/// Differences of triangular means, `spacing` steps wide each way.
std::vector<double> bandKernel(int spacing) {
  std::vector<double> kernel(2 * spacing - 1);
  for (int i = 0; i < 2 * spacing - 1; ++i) kernel[i] = spacing - std::abs(i - spacing + 1);
  for (int order = 0; order < kOrder; ++order) {
    std::vector<double> difference(kernel.size() + spacing, 0.0);
    for (std::size_t i = 0; i < kernel.size(); ++i) {
      difference[i] -= kernel[i];
      difference[i + spacing] += kernel[i];
    }
    kernel = difference;
  }
  double squares = 0;
  for (const double k : kernel) squares += k * k;
  // A mean over kStep of white noise of density 1 has the variance 1 / kStep.
  for (double& k : kernel) k *= std::sqrt(kStep / squares);
  return kernel;
}

/// Mean square that a kernel makes of white noise of density 1 that is held over `interval` [s].
double heldPower(const std::vector<double>& kernel, double interval) {
  const int hold = std::max(1, static_cast<int>(std::lround(interval / kStep)));
  double squares = 0;
  for (int phase = 0; phase < hold; ++phase) {
    double sum = 0;
    for (std::size_t i = 0; i < kernel.size(); ++i) {
      sum += kernel[i];
      if ((i + phase) % hold + 1 != static_cast<std::size_t>(hold) && i + 1 < kernel.size()) continue;
      squares += sum * sum;
      sum = 0;
    }
  }
  return squares / (hold * hold * kStep);
}

/// The same of white noise that is interpolated linearly between knots `interval` [s] apart.
double interpolatedPower(const std::vector<double>& kernel, double interval) {
  constexpr int kPhases = 8;
  const double knot = interval / kStep;  // [steps]
  const int reach = static_cast<int>(static_cast<double>(kernel.size()) / knot) + 2;
  double squares = 0;
  for (int phase = 0; phase < kPhases; ++phase) {
    for (int k = -1; k < reach; ++k) {
      const double at = knot * (k + static_cast<double>(phase) / kPhases);
      double sum = 0;
      for (std::size_t i = 0; i < kernel.size(); ++i)
        sum += kernel[i] * std::max(0.0, 1 - std::abs(static_cast<double>(i) - at) / knot);
      squares += sum * sum;
    }
  }
  return squares / (kPhases * interval);
}

}  // namespace

AccelNoise::AccelNoise() {
  for (const int spacing : {5, 3}) bands_.push_back({bandKernel(spacing), spacing, {}});
}

void AccelNoise::Power::add(const Eigen::Vector3d& value, double interval) {
  seconds += interval;
  sum += value.squaredNorm() / 3 * interval;
  if (seconds < kPart) return;
  parts.push_back(sum / seconds);
  if (parts.size() > kParts) parts.pop_front();
  sum = seconds = 0;
}

double AccelNoise::Power::typical() const {
  if (parts.empty()) return seconds > 0 ? sum / seconds : 0;
  return air_ground_common::median(std::vector<double>(parts.begin(), parts.end()));
}

bool AccelNoise::Power::known() const { return !parts.empty() || seconds >= kLeast; }

void AccelNoise::reset() {
  stamp_ = -1;
  intervals_ = 0;
  nyquist_ = {};
  for (Band& band : bands_) band.power = {};
}

void AccelNoise::restart(double stamp) {
  means_.clear();
  samples_.clear();
  knots_ = {};
  integral_.setZero();
  end_ = stamp + kStep;
}

void AccelNoise::add(double stamp, const Eigen::Vector3d& specific_force) {
  const bool afresh = stamp_ < 0 || stamp - stamp_ > kMaxGap;
  if (!afresh && !(stamp > stamp_)) return;
  if (afresh) {
    restart(stamp);
  } else {
    interval_ += (stamp - stamp_ - interval_) / std::min<long>(++intervals_, 200);
    addRaw(specific_force, stamp - stamp_);
    knots_.add(stamp, specific_force);
    // Held, not interpolated: that would take from the noise of few samples a second.
    double begin = stamp_;
    for (; end_ <= stamp; end_ += kStep) {
      addMean((integral_ + (end_ - begin) * specific_force) / kStep);
      integral_.setZero();
      begin = end_;
    }
    integral_ += (stamp - begin) * specific_force;
  }
  stamp_ = stamp;
}

// Three readings on a line are no measurements of their own; where a line ends, there was one.
void AccelNoise::Knots::add(double stamp, const Eigen::Vector3d& value) {
  constexpr double kSame = 1e-3;  // relative; a stamp of today is known to a quarter of a microsecond
  constexpr long kMemory = 400;
  const Eigen::Vector3d slope = (value - last_value) / (stamp - last_stamp);
  if (readings >= 2) {
    const double weight = 1.0 / std::min(readings - 1, kMemory);
    const bool line = (slope - last_slope).norm() <= kSame * (slope.norm() + last_slope.norm());
    lines += weight * (line - lines);
    ends += weight * ((!line && on_line) - ends);
    on_line = line;
  }
  last_value = value;
  last_stamp = stamp;
  last_slope = slope;
  ++readings;
}

double AccelNoise::Knots::apart() const {
  constexpr double kLeastLines = 0.05, kEachSeen = 1.0 / 3;
  if (lines < kLeastLines || ends <= 0) return 1;
  return lines >= kEachSeen ? 1 / ends : 2 / (1 - lines);
}

void AccelNoise::addRaw(const Eigen::Vector3d& specific_force, double interval) {
  constexpr double kBinomial[] = {-1, 5, -10, 10, -5, 1};  // squares: 252
  samples_.push_back(specific_force);
  if (samples_.size() < std::size(kBinomial)) return;
  Eigen::Vector3d value = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < std::size(kBinomial); ++i) value += kBinomial[i] * samples_[i];
  nyquist_.add(std::sqrt(interval / 252) * value, interval);
  samples_.pop_front();
}

void AccelNoise::addMean(const Eigen::Vector3d& mean) {
  ++count_;
  means_.push_back(mean);
  if (means_.size() > bands_.front().kernel.size()) means_.pop_front();
  for (Band& band : bands_) {
    if (count_ % band.spacing != 0 || means_.size() < band.kernel.size()) continue;
    Eigen::Vector3d value = Eigen::Vector3d::Zero();
    const std::size_t first = means_.size() - band.kernel.size();
    for (std::size_t i = 0; i < band.kernel.size(); ++i) value += band.kernel[i] * means_[first + i];
    band.power.add(value, kStep * band.spacing);
  }
}

double AccelNoise::density() const {
  double least = std::numeric_limits<double>::infinity();
  const double knots = knots_.apart() * interval_;
  const bool interpolated = knots > 1.5 * interval_ && knots < kSlowest;
  for (const Band& band : bands_) {
    if (!band.power.known()) return 0;
    const double passed = interpolated ? interpolatedPower(band.kernel, knots) : heldPower(band.kernel, interval_);
    least = std::min(least, band.power.typical() / passed);
  }
  const double nyquist = nyquist_.typical();
  return nyquist > least ? std::pow(least, 1.5) / nyquist : std::sqrt(least);
}

}  // namespace visual_frontend
