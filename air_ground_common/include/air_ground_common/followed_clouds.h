// The clouds of a map that follow its corrections.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <iterator>
#include <utility>
#include <vector>

#include "air_ground_common/map_correction.h"

namespace air_ground_common {

/// `Point` has a `position`, a vector of three floats.
template <typename Point>
void moveBy(const Similarity& S, std::vector<Point>* points) {
  for (Point& p : *points) p.position = (S * p.position.template cast<double>()).template cast<float>();
}

/// `move(S, &cloud)` for each cloud that went through S; those that are off in themselves go.
template <typename Cloud, typename Move>
void correctClouds(const CloudCorrections& corrections, std::deque<std::pair<std::int64_t, Cloud>>* clouds,
                   const Move& move) {
  for (auto cloud = clouds->begin(); cloud != clouds->end();) {
    const auto it = corrections.find(cloud->first);
    const bool bent = it != corrections.end() && !it->second;
    if (it != corrections.end() && it->second) move(*it->second, &cloud->second);
    cloud = bent ? clouds->erase(cloud) : std::next(cloud);
  }
}

/// The newest clouds as they stand: bounded, since each is some hundred kilobytes. Not thread-safe.
template <typename Point>
class FollowedClouds {
 public:
  explicit FollowedClouds(std::size_t most = kFollowedClouds) : most_(most) {}

  /// `settle(points)`: what becomes of a cloud that is too old to follow any longer.
  template <typename Settle>
  void add(std::int64_t stamp, std::vector<Point> points, const Settle& settle) {
    clouds_.emplace_back(stamp, std::move(points));
    if (clouds_.size() <= most_) return;
    settle(clouds_.front().second);
    clouds_.pop_front();
  }
  void correct(const CloudCorrections& corrections) { correctClouds(corrections, &clouds_, moveBy<Point>); }
  void clear() { clouds_.clear(); }
  bool empty() const { return clouds_.empty(); }
  /// Stamps [ns] and points, the oldest first.
  const std::deque<std::pair<std::int64_t, std::vector<Point>>>& clouds() const { return clouds_; }

 private:
  std::size_t most_;
  std::deque<std::pair<std::int64_t, std::vector<Point>>> clouds_;
};

}  // namespace air_ground_common
