// Tells when a map has been corrected so far that what was reconstructed from its earlier poses has to follow, or go.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>

#include "visual_frontend/map.h"

namespace mav_vo {

/// A map becomes metric while its scale is known to one or two percent; some seconds later, adjustments with more
/// motion correct it.
class MapRevision {
 public:
  static constexpr double kMoved = 0.002;  ///< of the scene's distance: what the newest keyframes may move, RMS
  static constexpr int kNewest = 40;

  /// After every change of the poses: counts a correction where they have moved that far since the last one counted.
  /// `scene_distance` in the map's unit.
  void follow(const visual_frontend::Map& map, double scene_distance);
  /// Rays have bent: what was made of earlier poses is off in itself, however far these moved.
  void next() { ++count_; }
  /// Another map, or another unit: not counted.
  void restart() { positions_.clear(); }
  std::uint32_t count() const { return count_; }              ///< of the times when rays have bent
  std::uint32_t corrections() const { return corrections_; }  ///< of the poses

 private:
  std::map<visual_frontend::KeyframeId, Eigen::Vector3d> positions_;  // when counted last, or added
  std::uint32_t count_ = 0, corrections_ = 0;
};

}  // namespace mav_vo
