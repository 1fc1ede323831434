#include "ground_themes.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "coordinate_system.h"

namespace streetview_localizer {
namespace {

constexpr double kAround = 50;  // [m]
// Walls are often drawn some metres into the ground, so that it may lie above their feet; below, they would hover. [m]
constexpr double kMostAbove = 4, kMostBelow = 3;
constexpr std::size_t kMostPoints = 2000;  // compared of a theme, and of the relief

bool isRelief(const std::string& theme) { return theme == "ReliefFeature" || theme == "TINRelief"; }

/// Every n-th, so that few enough are left.
std::vector<Eigen::Vector3d> thinned(const std::vector<Eigen::Vector3d>& points) {
  std::vector<Eigen::Vector3d> some;
  for (std::size_t i = 0; i < points.size(); i += 1 + points.size() / kMostPoints) some.push_back(points[i]);
  return some;
}

/// In plan, 0 inside [m].
double distanceTo(const Box& box, const Eigen::Vector3d& p) {
  return (p - p.cwiseMax(box.low).cwiseMin(box.high)).head<2>().norm();
}

class Ground {
 public:
  explicit Ground(const PolygonModel& model) {
    std::map<int, Box> buildings;
    for (const Polygon& polygon : model.polygons) {
      for (const Eigen::Vector3d& p : polygon.rings[0]) {
        if (polygon.building >= 0) buildings[polygon.building].add(p);
        if (isRelief(polygon.theme)) relief_.push_back(p);
      }
    }
    relief_ = thinned(relief_);
    for (const auto& [index, box] : buildings) buildings_.push_back(box);
  }

  /// At a place; empty where nothing around tells [m].
  std::optional<double> heightAt(const Eigen::Vector3d& p) const {
    std::optional<double> height;
    double nearest = kAround;
    for (const Eigen::Vector3d& r : relief_)
      if (const double d = (r - p).head<2>().norm(); d <= nearest) nearest = d, height = r.z();
    if (height) return height;
    for (const Box& box : buildings_)
      if (const double d = distanceTo(box, p); d <= nearest) nearest = d, height = box.low.z();
    return height;
  }

 private:
  std::vector<Eigen::Vector3d> relief_;
  std::vector<Box> buildings_;
};

}  // namespace

void leaveOutStrayGround(PolygonModel* model, std::vector<std::string>* remarks) {
  std::map<std::string, std::vector<Eigen::Vector3d>> corners;
  for (const Polygon& polygon : model->polygons)
    if (!polygon.theme.empty() && !isRelief(polygon.theme))
      corners[polygon.theme].insert(corners[polygon.theme].end(), polygon.rings[0].begin(), polygon.rings[0].end());
  if (corners.empty()) return;
  const Ground ground(*model);
  std::set<std::string> stray;
  for (const auto& [theme, points] : corners) {
    std::vector<double> above;
    for (const Eigen::Vector3d& p : thinned(points))
      if (const auto height = ground.heightAt(p)) above.push_back(p.z() - *height);
    if (above.empty()) continue;
    const double median = air_ground_common::median(std::move(above));
    if (median <= kMostAbove && median >= -kMostBelow) continue;
    stray.insert(theme);
    remarks->push_back(theme + air_ground_common::formatted(" surfaces lie %.0f m %s the ground at the buildings: "
                                                            "they are no ground, and were left out",
                                                            std::abs(median), median > 0 ? "above" : "below"));
  }
  auto& all = model->polygons;
  all.erase(std::remove_if(all.begin(), all.end(), [&](const Polygon& p) { return stray.count(p.theme) > 0; }),
            all.end());
}

}  // namespace streetview_localizer
