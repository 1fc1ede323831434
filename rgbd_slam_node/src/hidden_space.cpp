#include "rgbd_slam/hidden_space.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rgbd_slam {

using air_ground_common::CameraModel;

namespace {

constexpr float kColumn = 0.05f;  // edge [m]
constexpr float kLayer = 0.02f;   // [m]
constexpr float kStep = 0.035f;   // along a ray in plan, where it does not pass a layer sooner [m]
constexpr float kFarthest = 4;    // rays lie farther apart than columns are wide [m]
constexpr float kBehind = 0.8f;   // a surface hides what is that near behind it [m]
constexpr float kAbove = 1.3f;    // of a point, and of the camera: MAVs fly below ceilings, and over tables [m]
constexpr float kLeast = 0.15f;   // free space over what something hangs over [m]
constexpr float kNoise = 0.06f;   // right above a point nothing is looked for [m]
constexpr int kGap = 2;           // layers in which nobody looked
constexpr int kBlocks = 96;       // of pixels in a row of an image
constexpr int kSurer = 4;         // rays that a surface stopped, for one that went through: poses are off by a layer

}  // namespace

DepthRays::DepthRays(const CameraModel& camera, const cv::Mat& depth, const DepthModel& model) {
  const int block = std::max(1, depth.cols / kBlocks);
  for (int v = 0; v + block <= depth.rows; v += block) {
    for (int u = 0; u + block <= depth.cols; u += block) {
      float nearest = std::numeric_limits<float>::infinity();
      bool all = true;
      for (int y = v; y < v + block; ++y) {
        const float* row = depth.ptr<float>(y);
        for (int x = u; x < u + block; ++x) {
          if (isKnown(row[x])) {
            nearest = std::min(nearest, row[x]);
          } else {
            all = false;
          }
        }
      }
      if (!std::isfinite(nearest) || nearest < model.min_range) continue;
      const Eigen::Vector2d ray = camera.unproject({u + 0.5 * (block - 1), v + 0.5 * (block - 1)});
      if (!ray.allFinite()) continue;
      const auto before = nearest - static_cast<float>(3 * model.sigma(nearest));
      rays.push_back(
          {static_cast<float>(ray.x()), static_cast<float>(ray.y()), all ? std::max(before, 0.f) : 0.f, nearest});
    }
  }
}

HiddenSpace::Place HiddenSpace::placeOf(int x, int y, int layer) {
  // Shifts round down, of what is negative, too.
  const int tx = x >> kSideBits, ty = y >> kSideBits, tz = layer >> kLayerBits;
  return {TileGrid<Tile>::keyOf(tx, ty, tz), (y & (kSide - 1)) * kSide + (x & (kSide - 1)), layer & (kLayers - 1)};
}

void HiddenSpace::Tile::count(std::uint16_t* rays, int sign) {
  const std::uint16_t before = *rays;
  *rays = static_cast<std::uint16_t>(before + sign);
  if ((sign > 0) == (*rays > before)) return;
  if ((rounds[rays] += sign) == 0) rounds.erase(rays);
}

int HiddenSpace::Tile::countOf(const std::uint16_t* rays) const {
  const auto it = rounds.find(rays);
  return *rays + (it == rounds.end() ? 0 : it->second * (1 << 16));
}

void HiddenSpace::mark(const Eigen::Vector3f& from, const Eigen::Vector3f& to, float highest, bool free, int sign) {
  const Eigen::Vector3f way = to - from;
  const int steps = static_cast<int>(std::ceil(std::max(way.head<2>().norm() / kStep, std::abs(way.z()) / kLayer)));
  Place last{0, -1, 0};
  for (int i = 0; i <= steps; ++i) {
    const Eigen::Vector3f p = from + way * (static_cast<float>(i) / static_cast<float>(std::max(steps, 1)));
    if (p.z() > highest && way.z() >= 0) return;
    const Place place =
        placeOf(static_cast<int>(std::floor(p.x() / kColumn)), static_cast<int>(std::floor(p.y() / kColumn)),
                static_cast<int>(std::floor(p.z() / kLayer)));
    if (place.tile == last.tile && place.column == last.column && place.layer == last.layer) continue;
    last = place;
    Tile& tile = tiles_.at(place.tile);
    tile.count(&(free ? tile.free : tile.hidden)[place.column][place.layer], sign);
  }
}

void HiddenSpace::cast(const air_ground_common::Pose& T_map_camera, const DepthRays& rays, int sign) {
  const Eigen::Matrix3f R = T_map_camera.linear().cast<float>();
  const Eigen::Vector3f t = T_map_camera.translation().cast<float>();
  const float highest = t.z() + kAbove;
  for (const DepthRays::Ray& ray : rays.rays) {
    const Eigen::Vector3f direction = R * Eigen::Vector3f(ray.x, ray.y, 1);
    if (ray.free > 0) mark(t, t + std::min(ray.free, kFarthest) * direction, highest, true, sign);
    if (ray.occupied > kFarthest) continue;
    const Eigen::Vector3f surface = t + ray.occupied * direction;
    if (surface.z() < highest) mark(surface, surface + kBehind * direction.normalized(), highest, false, sign);
  }
}

void HiddenSpace::update(const std::vector<PosedPoints>& keyframes) {
  seen_.update(
      keyframes, [this] { tiles_.clear(); },
      [this](const auto& pose, const auto& rays, int sign) { cast(pose, rays, sign); });
}

HiddenSpace::Seen HiddenSpace::Tile::seen(int column, int layer) const {
  int free_rays = free[column][layer], hidden_rays = hidden[column][layer];
  if (!rounds.empty()) {
    free_rays = countOf(&free[column][layer]);
    hidden_rays = countOf(&hidden[column][layer]);
  }
  if (hidden_rays > kSurer * free_rays && hidden_rays > 1) return Seen::kHidden;
  return free_rays > 0 ? Seen::kFree : Seen::kNot;
}

float HiddenSpace::hiddenFrom(const Eigen::Vector3f& point) const {
  constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
  const int x = static_cast<int>(std::floor(point.x() / kColumn)),
            y = static_cast<int>(std::floor(point.y() / kColumn));
  const int first = static_cast<int>(std::floor((point.z() + kNoise) / kLayer)),
            last = static_cast<int>(std::floor((point.z() + kAbove) / kLayer));
  const int column = placeOf(x, y, first).column;
  const Tile* tile = nullptr;  // of the layer
  int unseen = 0;
  for (int layer = first; layer <= last; ++layer) {
    const int in_tile = layer & (kLayers - 1);
    if (layer == first || in_tile == 0) tile = tiles_.find(placeOf(x, y, layer).tile);
    switch (tile ? tile->seen(column, in_tile) : Seen::kNot) {
      case Seen::kFree:
        unseen = 0;
        break;
      case Seen::kNot:
        if (++unseen > kGap) return kNothing;
        break;
      case Seen::kHidden: {
        const float from = kLayer * static_cast<float>(layer - unseen);
        return from - point.z() < kLeast ? kNothing : from;
      }
    }
  }
  return kNothing;
}

void HiddenSpace::clear() {
  tiles_.clear();
  seen_.clear();
}

}  // namespace rgbd_slam
