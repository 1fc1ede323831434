// The dense map so far: the worker adds, services read.
#pragma once

#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "air_ground_common/map_correction.h"
#include "air_ground_common/ros/health.h"
#include "dense_fusion/point_map.h"
#include "node_parameters.h"

namespace dense_fusion {

class MapStore {
 public:
  MapStore(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health)
      : settings_(settings),
        health_(health),
        cell_(settings.map_cell),
        settled_(settings.map_cell, settings.map_max_points) {}

  /// Begins anew, in metres.
  void reset();
  /// Clouds to come are in the map's own unit, of a scene as near as DenseMapper::unit() says.
  void followUnit(double unit);
  /// A fused map, by its stamp [ns].
  void add(std::int64_t stamp, std::vector<SurfacePoint> points);
  /// Makes those added as small as they are kept: some time after they were published.
  void thin();
  void correct(const air_ground_common::CloudCorrections& corrections);
  std::size_t size() const;
  /// The first of the clouds that follow corrections still whose stamp [ns] lies in first ... last: thinned by now, and
  /// where it was before all corrections. Empty: there is none.
  std::optional<std::pair<std::int64_t, std::vector<SurfacePoint>>> asPublished(std::int64_t first,
                                                                                std::int64_t last) const;
  /// Of the points now; others may come while it writes. Number of points written. Throws std::runtime_error, also when
  /// there is none.
  std::size_t write(const std::string& path) const;

 private:
  const NodeSettings& settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  struct Kept {
    std::vector<SurfacePoint> points;  // where they were published
    air_ground_common::Similarity T_now_published;
    bool thinned = false;
  };
  static std::vector<SurfacePoint> asTheyStand(const Kept& cloud);
  PointMap merged() const;

  mutable std::mutex mutex_;
  std::deque<std::pair<std::int64_t, Kept>> clouds_;  // the oldest first
  double cell_;                                       // of those to come, in the poses' unit
  PointMap settled_;                                  // those before, as they stand
};

}  // namespace dense_fusion
