#include "rgbd_slam/surface_vertical.h"

#include <algorithm>
#include <cmath>

namespace rgbd_slam {

namespace {

constexpr double kAlike = 0.1;       // between normals that count for one direction [rad]
constexpr double kOther = 0.2;       // between directions that are not the same [rad]
constexpr double kMinShare = 0.12;   // of all the area
constexpr double kMinArea = 0.3;     // [m^2]
constexpr double kRival = 0.5;       // of the best direction's area
constexpr std::size_t kStarts = 64;  // of the search
constexpr int kSteps = 6;            // of each

struct Direction {
  Eigen::Vector3d up;
  double area = 0;
};

/// Mean shift of the normals (Fukunaga and Hostetler 1975) from a direction.
Direction modeFrom(const Eigen::Vector3d& start, const std::vector<SurfacePatch>& flat) {
  const double least = std::cos(kAlike);
  Direction mode{start, 0};
  for (int step = 0; step < kSteps; ++step) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    mode.area = 0;
    for (const SurfacePatch& patch : flat) {
      if (patch.normal.dot(mode.up) < least) continue;
      sum += patch.area * patch.normal;
      mode.area += patch.area;
    }
    if (!(sum.norm() > 0)) break;
    mode.up = sum.normalized();
  }
  return mode;
}

double angleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::acos(std::clamp(a.dot(b), -1.0, 1.0));
}

}  // namespace

std::optional<Eigen::Vector3d> verticalOfSurfaces(const std::vector<SurfacePatch>& patches, double max_tilt) {
  double all = 0;
  std::vector<SurfacePatch> flat;
  for (const SurfacePatch& patch : patches) {
    all += patch.area;
    // A ceiling is seen from below.
    const Eigen::Vector3d up = patch.normal.z() < 0 ? Eigen::Vector3d(-patch.normal) : patch.normal;
    if (up.z() > std::cos(max_tilt)) flat.push_back({up, patch.area});
  }
  std::vector<Direction> modes{modeFrom(Eigen::Vector3d::UnitZ(), flat)};
  const std::size_t step = std::max<std::size_t>(1, flat.size() / kStarts);
  for (std::size_t i = 0; i < flat.size(); i += step) modes.push_back(modeFrom(flat[i].normal, flat));
  const Direction& level = modes.front();
  const auto more = [](const Direction& a, const Direction& b) { return a.area < b.area; };
  const Direction& best = *std::max_element(modes.begin(), modes.end(), more);
  if (best.area < kMinShare * all || best.area < kMinArea) return std::nullopt;
  if (level.area >= kRival * best.area && angleBetween(level.up, Eigen::Vector3d::UnitZ()) < kAlike) return level.up;
  for (const Direction& other : modes)
    if (other.area > kRival * best.area && angleBetween(other.up, best.up) > kOther) return std::nullopt;
  if (angleBetween(best.up, Eigen::Vector3d::UnitZ()) > max_tilt) return std::nullopt;
  return best.up;
}

}  // namespace rgbd_slam
