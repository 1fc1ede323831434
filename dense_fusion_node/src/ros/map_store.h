// The dense map so far: the worker adds, services read.
#pragma once

#include <mutex>
#include <string>
#include <vector>

#include "air_ground_common/followed_clouds.h"
#include "air_ground_common/ros/health.h"
#include "dense_fusion/point_map.h"
#include "node_parameters.h"

namespace dense_fusion {

class MapStore {
 public:
  MapStore(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health)
      : settings_(settings), health_(health), settled_(settings.map_cell, settings.map_max_points) {}

  /// Begins anew. `unit`: DenseMapper::unit().
  void reset(double unit = 1);
  /// A fused map, by its stamp [ns].
  void add(std::int64_t stamp, std::vector<SurfacePoint> points);
  void correct(const air_ground_common::CloudCorrections& corrections);
  std::size_t size() const;
  /// Of the points now; others may come while it writes. Number of points written. Throws std::runtime_error, also when
  /// there is none.
  std::size_t write(const std::string& path) const;

 private:
  const NodeSettings& settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  PointMap merged() const;

  mutable std::mutex mutex_;
  air_ground_common::FollowedClouds<SurfacePoint> clouds_;
  PointMap settled_;  // those before
};

}  // namespace dense_fusion
