#include "mav_vo/clock_search.h"

#include <algorithm>
#include <cmath>

namespace mav_vo {

namespace {

constexpr double kReach = 1.0;  // of the offsets [s]
constexpr double kStep = 0.05;  // between them, from which the nearest minimum is found [s]
constexpr int kOffsets = static_cast<int>(2 * kReach / kStep + 1.5);
constexpr double kApart = 0.1;           // offsets of different minima [s]
constexpr std::size_t kLeastPairs = 12;  // that have samples whatever the offset is

}  // namespace

ClockSearch::ClockSearch(const GyroAlignment& alignment, const ImuBuffer& imu) : alignment_(alignment), imu_(imu) {
  const double first = imu_.samples().front().stamp + kReach + kApart,
               last = imu_.samples().back().stamp - kReach - kApart;
  auto& pairs = alignment_.pairs_;
  pairs.erase(std::remove_if(pairs.begin(), pairs.end(),
                             [&](const auto& pair) { return pair.begin < first || pair.end > last; }),
              pairs.end());
}

std::optional<ClockSearch> ClockSearch::begin(const GyroAlignment& alignment, const ImuBuffer& imu) {
  if (imu.empty() || alignment.pairs_.size() < kLeastPairs) return std::nullopt;
  ClockSearch search(alignment, imu);
  if (search.alignment_.pairs_.size() < kLeastPairs) return std::nullopt;
  return search;
}

bool ClockSearch::advance(int offsets) {
  for (; offsets > 0 && tried_ < kOffsets; --offsets, ++tried_) {
    GyroAlignment moved(alignment_);
    moved.settings_.time_offset = moved.prior_mean_(3) = kStep * tried_ - kReach;
    const double cost = moved.beginAnew(imu_);
    minima_.push_back({moved.timeOffset(), cost});
    if (cost >= best_.cost) continue;
    best_ = minima_.back();
    moved.summarize(imu_);
    misfit_ = moved.misfit_;
  }
  return tried_ == kOffsets;
}

std::optional<double> ClockSearch::found() const {
  const bool alone = std::all_of(minima_.begin(), minima_.end(), [&](const Minimum& other) {
    return std::abs(other.offset - best_.offset) < kApart || other.cost > best_.cost + GyroAlignment::kOtherMinimum;
  });
  if (tried_ < kOffsets || !alone || misfit_ > GyroAlignment::kAgreement) return std::nullopt;
  return best_.offset;
}

}  // namespace mav_vo
