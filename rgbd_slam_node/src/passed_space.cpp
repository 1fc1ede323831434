#include "rgbd_slam/passed_space.h"

#include <algorithm>
#include <cmath>

#include "rgbd_slam/hidden_space.h"

namespace rgbd_slam {

namespace {

constexpr float kCube = 0.05f;      // edge [m]
constexpr float kFarthest = 4;      // rays lie farther apart than cubes are wide [m]
constexpr float kClearance = 0.1f;  // before a surface: poses and depth err, and its cube is no free one [m]
constexpr float kMargin = 1;        // beyond the range of the cloud: who is farther away tells of its points, too [m]
constexpr int kLeast = 3;           // keyframes that see through
constexpr int kSurer = 2;           // of them, for one that saw something: rays pass beside what is thin

}  // namespace

std::int64_t PassedSpace::tileOf(const Index& cell) {
  // Shifts round down, of what is negative, too.
  return TileGrid<Tile>::keyOf(cell[0] >> kSideBits, cell[1] >> kSideBits, cell[2] >> kSideBits);
}

int PassedSpace::inTile(const Index& cell) {
  const auto part = [&cell](int axis) { return cell[axis] & (kSide - 1); };
  return (part(2) * kSide + part(1)) * kSide + part(0);
}

PassedSpace::Index PassedSpace::cellOf(const Eigen::Vector3f& point) {
  return (point / kCube).array().floor().cast<int>();
}

const PassedSpace::Cell* PassedSpace::find(const Index& cell) const {
  const Tile* tile = tiles_.find(tileOf(cell));
  return tile ? &tile->cells[inTile(cell)] : nullptr;
}

void PassedSpace::cast(const air_ground_common::Pose& T_map_camera, const DepthRays& rays, int sign) {
  const Eigen::Matrix3f R = T_map_camera.linear().cast<float>();
  const Eigen::Vector3f t = T_map_camera.translation().cast<float>();
  std::vector<Tile*> touched;
  const auto vote = [&](const Eigen::Vector3f& point, bool hit) {
    const Index index = cellOf(point);
    Tile& tile = tiles_.at(tileOf(index));
    if (!tile.touched) touched.push_back(&tile);
    tile.touched = true;
    const int place = inTile(index);
    auto voted = (hit ? tile.hit_now : tile.through_now)[place];
    if (voted) return;
    voted = true;
    std::uint16_t& votes = hit ? tile.cells[place].hit : tile.cells[place].through;
    votes = static_cast<std::uint16_t>(votes + sign);
  };
  for (const DepthRays::Ray& ray : rays.rays) {
    const Eigen::Vector3f way = R * Eigen::Vector3f(ray.x, ray.y, 1);
    if (ray.occupied <= max_range_ + kMargin) vote(t + ray.occupied * way, true);
    const float length = way.norm(), end = std::min(ray.free * length, kFarthest) - kClearance;
    for (float s = 0; s < end; s += 0.7f * kCube) vote(t + s / length * way, false);
  }
  for (Tile* tile : touched) {
    tile->through_now.reset();
    tile->hit_now.reset();
    tile->touched = false;
  }
}

void PassedSpace::update(const std::vector<PosedPoints>& keyframes) {
  seen_.update(
      keyframes, [this] { tiles_.clear(); },
      [this](const auto& pose, const auto& rays, int sign) { cast(pose, rays, sign); });
}

bool PassedSpace::isGone(const Eigen::Vector3f& point) const {
  const Index centre = cellOf(point);
  const Cell* own = find(centre);
  if (!own || own->through < kLeast) return false;
  for (int i = 0; i < 27; ++i) {
    const Cell* cell = find(centre + Index(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1));
    if (cell && kSurer * cell->hit >= own->through) return false;
  }
  return true;
}

std::size_t PassedSpace::dropGone(std::vector<CloudPoint>* cloud) const {
  const auto gone =
      std::remove_if(cloud->begin(), cloud->end(), [this](const CloudPoint& point) { return isGone(point.position); });
  const auto count = static_cast<std::size_t>(cloud->end() - gone);
  cloud->erase(gone, cloud->end());
  return count;
}

void PassedSpace::clear() {
  tiles_.clear();
  seen_.clear();
}

}  // namespace rgbd_slam
