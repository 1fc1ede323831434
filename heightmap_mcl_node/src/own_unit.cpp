// Clouds in a unit of their own that are level only roughly: the dominant floor makes them level, and the scale that
// was found metric.
#include <utility>

#include "heightmap_mcl/dominant_floor.h"
#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

namespace {

constexpr double kLevelStep = 0.004;  // a smaller change of the level is not worth new maps [rad]
constexpr double kFloorShare = 0.10;  // of the points, that a floor must hold

}  // namespace

std::vector<Eigen::Vector3f> HeightMapLocalizer::kept(const std::vector<Eigen::Vector3f>& points) const {
  constexpr std::size_t kMostKept = 40000;
  const std::size_t step = (points.size() + kMostKept - 1) / kMostKept;
  std::vector<Eigen::Vector3f> some;
  for (std::size_t i = 0; i < points.size(); i += step) some.push_back(points[i]);
  return some;
}

void HeightMapLocalizer::setOwnUnit(bool own_unit) {
  if (own_unit == own_unit_) return;
  own_unit_ = own_unit;
  restart(true);
}

HeightMap HeightMapLocalizer::mapOf(const std::vector<Eigen::Vector3f>& points, const LevelHistogram& earlier,
                                    std::size_t* cropped) const {
  if (!own_unit_) return buildHeightMap(points, settings_.air_map, cropped, &earlier);
  const Eigen::Matrix3f S = (scale_ * R_level_).cast<float>();
  std::vector<Eigen::Vector3f> metric;
  metric.reserve(points.size());
  for (const auto& p : points) metric.push_back(S * p);
  return buildHeightMap(metric, settings_.air_map, cropped, &earlier);
}

void HeightMapLocalizer::remakeKeptMaps() {
  LevelHistogram levels;
  for (Kept& kept : aerial_) {
    kept.map = mapOf(kept.points, levels);
    levels.add(kept.map.levels);
  }
}

bool HeightMapLocalizer::updateLevel() {
  if (settings_.max_tilt <= 0) return false;
  std::vector<Eigen::Vector3f> all;
  for (const Kept& kept : aerial_) all.insert(all.end(), kept.points.begin(), kept.points.end());
  const auto floor = findDominantFloor(all, settings_.max_tilt, kFloorShare);
  if (!floor) return false;
  const Eigen::Matrix3d R = air_ground_common::levelingRotation(floor->up);
  if (air_ground_common::rotationAngle(R, R_level_) < kLevelStep) return false;
  R_level_ = R;
  return true;
}

}  // namespace heightmap_mcl
