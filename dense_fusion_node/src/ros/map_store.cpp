#include "map_store.h"

#include <stdexcept>

#include "air_ground_common/ros/file_services.h"
#include "fused_map_publisher.h"

namespace dense_fusion {

void MapStore::reset(double unit) {
  const std::lock_guard<std::mutex> lock(mutex_);
  clouds_.clear();
  settled_ = PointMap(settings_.map_cell / unit, settings_.map_max_points);
}

void MapStore::add(std::int64_t stamp, std::vector<SurfacePoint> points) {
  const std::lock_guard<std::mutex> lock(mutex_);
  PointMap thinned(settled_.cell(), settings_.map_max_points);
  health_.count("points left out of the map: not finite, or too far away", thinned.add(points));
  const double cell = settled_.cell();
  clouds_.add(stamp, thinned.points(), [this](const std::vector<SurfacePoint>& old) { settled_.add(old); });
  if (settled_.cell() > cell) health_.count("map_max_points reached: the cells of the map were doubled");
}

void MapStore::correct(const air_ground_common::CloudCorrections& corrections) {
  const std::lock_guard<std::mutex> lock(mutex_);
  clouds_.correct(corrections);
}

PointMap MapStore::merged() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  PointMap map = settled_;
  for (const auto& [stamp, points] : clouds_.clouds()) map.add(points);
  return map;
}

std::size_t MapStore::size() const { return merged().size(); }

std::size_t MapStore::write(const std::string& path) const {
  const std::vector<SurfacePoint> copy = merged().points();
  if (copy.empty()) throw std::runtime_error("nothing has been reconstructed yet");
  const auto points = messagePoints(copy);
  air_ground_common::ros_utils::writeCloud(path, points, air_ground_common::ros_utils::CloudFields::kXyzIntensity);
  return points.size();
}

}  // namespace dense_fusion
