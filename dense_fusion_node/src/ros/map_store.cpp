#include "map_store.h"

#include <stdexcept>

#include "air_ground_common/ros/file_services.h"
#include "fused_map_publisher.h"

namespace dense_fusion {

void MapStore::reset(double unit) {
  const std::lock_guard<std::mutex> lock(mutex_);
  map_ = PointMap(settings_.map_cell / unit, settings_.map_max_points);
}

void MapStore::add(const std::vector<SurfacePoint>& points) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const double cell = map_.cell();
  health_.count("points left out of the map: not finite, or too far away", map_.add(points));
  if (map_.cell() > cell) health_.count("map_max_points reached: the cells of the map were doubled");
}

std::size_t MapStore::size() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return map_.size();
}

std::size_t MapStore::write(const std::string& path) const {
  std::vector<SurfacePoint> copy;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    copy = map_.points();
  }
  if (copy.empty()) throw std::runtime_error("nothing has been reconstructed yet");
  const auto points = messagePoints(copy);
  air_ground_common::ros_utils::writeCloud(path, points, air_ground_common::ros_utils::CloudFields::kXyzIntensity);
  return points.size();
}

}  // namespace dense_fusion
