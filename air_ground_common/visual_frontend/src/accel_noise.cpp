#include "visual_frontend/accel_noise.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "air_ground_common/statistics.h"

namespace visual_frontend {

namespace {

constexpr double kStep = 0.005;  // [s]
constexpr double kMaxGap = 0.1;  // [s]
constexpr double kPart = 0.5;    // [s]
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
  for (const Band& band : bands_) {
    if (!band.power.known()) return 0;
    least = std::min(least, band.power.typical() / heldPower(band.kernel, interval_));
  }
  const double nyquist = nyquist_.typical();
  return nyquist > least ? std::pow(least, 1.5) / nyquist : std::sqrt(least);
}

}  // namespace visual_frontend
