#include "kept_maps.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/geometry.h"
#include "heightmap_mcl/dominant_floor.h"

namespace heightmap_mcl {
namespace {

constexpr double kLevelStep = 0.004;        // a smaller change of the level is not worth new maps [rad]
constexpr double kFloorShare = 0.10;        // of the points, that a floor must hold
constexpr double kFloorSigmas = 3;          // by which it may lean from what the MAV takes for level
constexpr std::size_t kMostPoints = 40000;  // kept of a cloud
constexpr double kTail = 0.005;             // of the points on each side, that do not count for the extent

double quantile(std::vector<float>& values, double q) {
  const auto k = values.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), k, values.end());
  return *k;
}

std::vector<Eigen::Vector3f> thinnedPoints(const std::vector<Eigen::Vector3f>& points) {
  const std::size_t step = (points.size() + kMostPoints - 1) / kMostPoints;
  std::vector<Eigen::Vector3f> some;
  for (std::size_t i = 0; i < points.size(); i += step) some.push_back(points[i]);
  return some;
}

}  // namespace

void KeptMaps::clear() {
  clouds_.clear();
  scale_ = 1;
  R_level_.setIdentity();
  vertical_ = {};
  floor_ = std::numeric_limits<double>::quiet_NaN();
}

void KeptMaps::setOwnUnit(bool own_unit) {
  own_unit_ = own_unit;
  clear();
}

bool KeptMaps::add(const AerialCloud& cloud, std::size_t* cropped) {
  // A cloud that shows a table alone has the floor of those before it.
  LevelHistogram levels;
  for (const Cloud& kept : clouds_) levels.add(kept.map.levels);
  HeightMap map = mapOf(cloud.points, levels, cropped);
  if (map.empty()) return false;
  clouds_.push_back({std::move(map), {thinnedPoints(cloud.points), cloud.reference, cloud.stamp}});
  while (count() > settings_.verifyFor(own_unit_)) clouds_.pop_front();
  return true;
}

double KeptMaps::correct(const air_ground_common::CloudCorrections& since) {
  double most = 0;
  for (auto cloud = clouds_.begin(); cloud != clouds_.end();) {
    const auto it = since.find(cloud->given.stamp);
    if (it == since.end()) {
      ++cloud;
      continue;
    }
    if (!it->second) {
      cloud = clouds_.erase(cloud);
      most = std::numeric_limits<double>::infinity();
      continue;
    }
    const AerialCloud before = cloud->given;
    moveBy(*it->second, &cloud->given);
    double sum = 0;
    for (std::size_t i = 0; i < before.points.size(); ++i)
      sum += static_cast<double>((cloud->given.points[i] - before.points[i]).norm());
    most = std::max(most, scale_ * sum / static_cast<double>(before.points.size()));
    ++cloud;
  }
  if (most > 0) remake();
  return most;
}

void KeptMaps::dropFar() {
  // A single map has a border of a cell.
  const double bound = settings_.air_map.max_extent + 3 * settings_.air_map.resolution;
  while (clouds_.size() > 1 && unionExtent(newest(count())) > bound) {
    clouds_.pop_front();
    ++far_dropped_;
  }
}

std::deque<KeptMaps::Cloud> KeptMaps::takeAll() {
  std::deque<Cloud> clouds;
  clouds.swap(clouds_);
  return clouds;
}

double KeptMaps::largest() const {
  double largest = 0;
  for (const Cloud& kept : clouds_) largest = std::max(largest, static_cast<double>(kept.map.defined()));
  return largest;
}

Eigen::Vector2d KeptMaps::reference() const {
  const Eigen::Vector3d level = scale_ * (R_level_ * clouds_.back().given.reference);
  return level.head<2>();
}

std::vector<const HeightMap*> KeptMaps::newest(int count) const {
  std::vector<const HeightMap*> maps;
  const int n = static_cast<int>(clouds_.size());
  for (int i = std::max(0, n - count); i < n; ++i) maps.push_back(&clouds_[i].map);
  return maps;
}

HeightMap KeptMaps::merged(int count) const {
  HeightMap map = merge(newest(count), settings_.merge);
  return std::isnan(floor_) ? map : withFloor(std::move(map), floor_);
}

HeightMap KeptMaps::mergedOnOwnFloor() const { return merge(newest(count()), settings_.merge); }

HeightMap KeptMaps::mapOf(const std::vector<Eigen::Vector3f>& points, const LevelHistogram& earlier,
                          std::size_t* cropped) const {
  if (!own_unit_ && R_level_.isIdentity()) return buildHeightMap(points, settings_.air_map, cropped, &earlier);
  const Eigen::Matrix3f S = (scale_ * R_level_).cast<float>();
  std::vector<Eigen::Vector3f> metric;
  metric.reserve(points.size());
  for (const auto& p : points) metric.push_back(S * p);
  return buildHeightMap(metric, settings_.air_map, cropped, &earlier);
}

bool KeptMaps::updateLevel(bool ground_is_flat) {
  if (!own_unit_ && !ground_is_flat) return turnTo(Eigen::Matrix3d::Identity());
  if (own_unit_ && settings_.own_unit.max_tilt <= 0) return false;
  std::vector<Eigen::Vector3f> all;
  for (const Cloud& kept : clouds_) all.insert(all.end(), kept.given.points.begin(), kept.given.points.end());
  if (!own_unit_) {
    const auto floor = findDominantFloor(all, Eigen::Vector3d::UnitZ(), flatFloorRule(settings_.max_slope));
    return turnTo(floor ? air_ground_common::levelingRotation(floor->up) : Eigen::Matrix3d::Identity());
  }
  FloorRule rule{settings_.own_unit.max_tilt, kFloorShare, 0, 0};
  if (vertical_.stddev > 0) rule.max_tilt = std::min(rule.max_tilt, kFloorSigmas * vertical_.stddev);
  const auto floor = findDominantFloor(all, vertical_.up, rule);
  if (!floor && !(vertical_.stddev > 0)) return false;
  return turnTo(air_ground_common::levelingRotation(floor ? floor->up : vertical_.up));
}

bool KeptMaps::turnTo(const Eigen::Matrix3d& R_level) {
  if (air_ground_common::rotationAngle(R_level, R_level_) < kLevelStep) return false;
  R_level_ = R_level;
  return true;
}

void KeptMaps::remake(double scale) {
  scale_ = scale;
  LevelHistogram levels;
  for (Cloud& kept : clouds_) {
    kept.map = mapOf(kept.given.points, levels);
    levels.add(kept.map.levels);
  }
}

LevelCloud KeptMaps::levelCloud(std::size_t most) const {
  std::size_t count = 0;
  for (const Cloud& kept : clouds_) count += kept.given.points.size();
  const std::size_t step = std::max<std::size_t>(1, (count + most - 1) / most);
  LevelCloud level;
  const Eigen::Matrix3f R = R_level_.cast<float>();
  std::size_t i = 0;
  std::vector<float> x, y;
  for (const Cloud& kept : clouds_) {
    for (const auto& p : kept.given.points) {
      if (i++ % step != 0 || !p.allFinite()) continue;
      level.points.push_back(R * p);
      x.push_back(level.points.back().x());
      y.push_back(level.points.back().y());
    }
  }
  if (level.points.empty()) return level;
  const Eigen::Vector2d low(quantile(x, kTail), quantile(y, kTail)),
      high(quantile(x, 1 - kTail), quantile(y, 1 - kTail));
  level.centre = 0.5 * (low + high);
  level.extent = (high - low).maxCoeff();
  return level;
}

}  // namespace heightmap_mcl
