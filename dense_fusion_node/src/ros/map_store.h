// The dense map so far: the worker adds, services read.
#pragma once

#include <mutex>
#include <string>
#include <vector>

#include "air_ground_common/ros/health.h"
#include "dense_fusion/point_map.h"
#include "node_parameters.h"

namespace dense_fusion {

class MapStore {
 public:
  MapStore(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health)
      : settings_(settings), health_(health), map_(settings.map_cell, settings.map_max_points) {}

  /// Begins anew. `unit`: DenseMapper::unit().
  void reset(double unit = 1);
  void add(const std::vector<SurfacePoint>& points);
  std::size_t size() const;
  /// Of the points now; others may come while it writes. Number of points written. Throws std::runtime_error, also when
  /// there is none.
  std::size_t write(const std::string& path) const;

 private:
  const NodeSettings& settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  mutable std::mutex mutex_;
  PointMap map_;
};

}  // namespace dense_fusion
