// The aerial clouds that a refinement may use.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <utility>

#include "air_ground_common/followed_clouds.h"
#include "icp_refine/cloud.h"
#include "icp_refine/height_check.h"

namespace icp_refine {

/// Some clouds in a row make a reading. Not thread-safe.
class AerialClouds {
 public:
  /// Each cloud is thinned to `leaf` [m]; `in_row`: of a reading.
  AerialClouds(double leaf, int in_row) : leaf_(leaf), in_row_(static_cast<std::size_t>(in_row)) {}

  /// In mav_map, stamp in nanoseconds; what is not finite is left out. As many are kept as follow corrections.
  void add(std::int64_t stamp, Cloud cloud);
  /// The map was corrected: the clouds follow. Returns what it went through at the newest that did.
  Similarity correct(const air_ground_common::CloudCorrections& corrections);
  void clear() { clouds_.clear(); }
  bool empty() const { return clouds_.empty(); }
  std::int64_t newestStamp() const { return clouds_.empty() ? 0 : clouds_.back().first; }  ///< [ns]

  struct Reading {
    std::int64_t stamp = 0;  ///< of its newest cloud [ns]
    Cloud cloud;             ///< in mav_map
  };
  Reading newest() const;
  /// What `T_ground_map_mav_map` puts on the ground map (GroundHeights::near): the newest clouds, unless they lie
  /// beside it, and earlier ones of a MAV that has flown on do not.
  Reading on(const GroundHeights& ground, const Similarity& T_ground_map_mav_map) const;

 private:
  Reading readingFrom(std::size_t first) const;

  double leaf_;
  std::size_t in_row_;
  std::deque<std::pair<std::int64_t, Cloud>> clouds_;
};

}  // namespace icp_refine
