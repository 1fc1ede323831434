#include "map_store.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "air_ground_common/followed_clouds.h"
#include "air_ground_common/ros/file_services.h"
#include "fused_map_publisher.h"

namespace dense_fusion {

void MapStore::reset() {
  const std::lock_guard<std::mutex> lock(mutex_);
  clouds_.clear();
  cell_ = settings_.map_cell;
  settled_ = PointMap(cell_, settings_.map_max_points);
}

void MapStore::followUnit(double unit) {
  const std::lock_guard<std::mutex> lock(mutex_);
  cell_ = settings_.map_cell / unit;
  if (!clouds_.empty() && cell_ >= settled_.cell()) return;  // those from nearer keep what they show
  PointMap other(cell_, settings_.map_max_points);
  other.add(settled_.points());
  settled_ = std::move(other);
}

void MapStore::add(std::int64_t stamp, std::vector<SurfacePoint> points) {
  const std::lock_guard<std::mutex> lock(mutex_);
  clouds_.emplace_back(stamp, Kept{std::move(points), {}, false});
}

void MapStore::thin() {
  const std::lock_guard<std::mutex> lock(mutex_);
  for (auto cloud = clouds_.rbegin(); cloud != clouds_.rend() && !cloud->second.thinned; ++cloud) {
    PointMap thinned(std::max(cell_, settled_.cell()), settings_.map_max_points);
    health_.count("points left out of the map: not finite, or too far away", thinned.add(cloud->second.points));
    cloud->second.points = thinned.points();
    cloud->second.thinned = true;
  }
  const double cell = settled_.cell();
  while (clouds_.size() > air_ground_common::kFollowedClouds) {
    settled_.add(asTheyStand(clouds_.front().second));
    clouds_.pop_front();
  }
  if (settled_.cell() > cell) health_.count("map_max_points reached: the cells of the map were doubled");
}

void MapStore::correct(const air_ground_common::CloudCorrections& corrections) {
  const std::lock_guard<std::mutex> lock(mutex_);
  air_ground_common::correctClouds(corrections, &clouds_, [](const air_ground_common::Similarity& S, Kept* cloud) {
    cloud->T_now_published = compose(S, cloud->T_now_published);
  });
}

std::optional<std::pair<std::int64_t, std::vector<SurfacePoint>>> MapStore::asPublished(std::int64_t first,
                                                                                        std::int64_t last) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto it = std::find_if(clouds_.begin(), clouds_.end(),
                               [&](const auto& cloud) { return cloud.first >= first && cloud.first <= last; });
  if (it == clouds_.end()) return std::nullopt;
  return std::make_pair(it->first, it->second.points);
}

std::vector<SurfacePoint> MapStore::asTheyStand(const Kept& cloud) {
  std::vector<SurfacePoint> points = cloud.points;
  air_ground_common::moveBy(cloud.T_now_published, &points);
  return points;
}

PointMap MapStore::merged() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  PointMap map = settled_;
  for (const auto& [stamp, cloud] : clouds_) map.add(asTheyStand(cloud));
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
