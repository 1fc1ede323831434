// Bundle adjustments of a map: which keyframes move, and when; at once, or beside the tracking.
#pragma once

#include <vector>

#include "adjustment_threads.h"
#include "mav_vo/odometry.h"

namespace mav_vo {

/// Keyframes that adjustNewest() moves, at most, once the map is metric.
inline int mostInWindow(const OdometrySettings& settings) { return 2 * settings.window; }

class MapAdjuster {
 public:
  using Jobs = std::vector<BundleJob>;  ///< solved, to be applied to the map in this order

  MapAdjuster(const CameraModel& camera, const OdometrySettings& settings)
      : camera_(camera), settings_(settings), threads_(settings.reproducible) {}

  void setCamera(const CameraModel& camera) { camera_ = camera; }
  /// Waits for what runs; nothing comes of it.
  void discard() { threads_.discard(); }
  /// What adjustNewest() began, waited for. The map must have it before the next one is taken out of it.
  Jobs finishNewest();
  /// The newest keyframes and what they see, older observers held. `settings`: those that the state of the map decides;
  /// `stamp`: of the image [s]. Returns what is done. Throws std::logic_error while the one
  /// before runs: finishNewest().
  Jobs adjustNewest(const visual_frontend::Map& map, const visual_frontend::InertialMap& inertial,
                    visual_frontend::BundleSettings settings, double stamp);
  /// The whole map, but for the oldest keyframes of a long flight.
  BundleJob wholeMap(const visual_frontend::Map& map, const visual_frontend::InertialMap& inertial,
                     visual_frontend::BundleSettings settings) const;
  Jobs adjustWhole(BundleJob whole, double stamp);
  bool wholeDue(double stamp) const { return stamp >= next_whole_; }
  /// When a map of so many keyframes is adjusted as a whole next.
  void schedule(double stamp, std::size_t keyframes);
  /// What this image must have of the adjustments beside the tracking.
  Jobs due(double stamp);
  Jobs finish();  ///< waits for all that run

 private:
  Jobs run(BundleJob job, double stamp);

  CameraModel camera_;
  OdometrySettings settings_;
  AdjustmentThreads threads_;
  double next_whole_ = 0;  // [s]
};

}  // namespace mav_vo
