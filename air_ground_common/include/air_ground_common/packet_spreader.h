// Samples that were stamped when their packet arrived, not when they were measured: many within microseconds, then none
// for tens of milliseconds. They are spread evenly over the time since the packet before.
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <utility>
#include <vector>

namespace air_ground_common {

/// Sample: anything with a `stamp` [s]. Stamps that go back begin afresh. Others than packets pass as they are, at
/// once; of packets each waits for the next one. Not thread-safe.
template <typename Sample>
class PacketSpreader {
 public:
  std::vector<Sample> add(Sample sample) {
    if (!stamps_.empty() && sample.stamp < stamps_.back()) clear();
    const bool same = !stamps_.empty() && sample.stamp - stamps_.back() < kShort * meanStep();
    note(sample.stamp);
    if (packet_.empty() && !inPackets()) {
      end_ = sample.stamp;
      return {std::move(sample)};
    }
    std::vector<Sample> complete;
    if (!same && !packet_.empty()) complete = spread();
    if (complete.empty() || inPackets()) {
      packet_.push_back(std::move(sample));
    } else {  // no packets any more
      end_ = sample.stamp;
      complete.push_back(std::move(sample));
    }
    return complete;
  }

  /// Most of the last samples came in packets.
  bool inPackets() const {
    return stamps_.size() == kWindow && 3 * short_steps_ > kWindow && short_steps_ + kPackets < kWindow;
  }

  void clear() { *this = PacketSpreader(); }

 private:
  static constexpr std::size_t kWindow = 120;  // samples that are looked at
  static constexpr std::size_t kPackets = 3;   // of them, at least: a pause or two are none
  static constexpr double kShort = 0.2;        // of the mean step: no jitter makes a third of all steps so short

  double meanStep() const {
    return stamps_.size() < 2 ? 0 : (stamps_.back() - stamps_.front()) / static_cast<double>(stamps_.size() - 1);
  }

  void note(double stamp) {
    stamps_.push_back(stamp);
    if (stamps_.size() > kWindow) stamps_.pop_front();
    const double mean = meanStep();
    short_steps_ = 0;
    for (std::size_t i = 1; i < stamps_.size(); ++i) short_steps_ += stamps_[i] - stamps_[i - 1] < kShort * mean;
  }

  std::vector<Sample> spread() {
    const double begin = end_, end = std::max(end_, packet_.back().stamp);
    for (std::size_t i = 0; i < packet_.size(); ++i)
      packet_[i].stamp = begin + (end - begin) * static_cast<double>(i + 1) / static_cast<double>(packet_.size());
    end_ = end;
    return std::exchange(packet_, {});
  }

  std::deque<double> stamps_;  // as they came
  std::size_t short_steps_ = 0;
  std::vector<Sample> packet_;  // that is not complete yet
  double end_ = 0;              // of the packet before [s]
};

}  // namespace air_ground_common
