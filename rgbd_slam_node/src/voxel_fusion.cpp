// Fusing the points of all keyframes in voxels, at once or as the map grows.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>
#include <string>
#include <tuple>
#include <unordered_map>

#include "displacement.h"
#include "rgbd_slam/ground_cloud.h"

namespace rgbd_slam {

using air_ground_common::Pose;

namespace {

constexpr int kSide = 8;                        // voxels along the edge of a block
constexpr int kVoxels = kSide * kSide * kSide;  // of a block
constexpr int kReach = 2;                       // voxels around one that its weight is compared with
constexpr int kPadded = kSide + 2 * kReach;

struct Index {
  int x, y, z;
  bool operator<(const Index& o) const { return std::tie(z, y, x) < std::tie(o.z, o.y, o.x); }
};

std::int64_t keyOf(const Index& i) {
  return (static_cast<std::int64_t>(i.z & 0x1fffff) << 42) | (static_cast<std::int64_t>(i.y & 0x1fffff) << 21) |
         (i.x & 0x1fffff);
}

/// Sums over the points of a voxel. In double, positions from the voxel's corner: points are taken out again by
/// subtraction, and 1e-16 of what went through stays behind.
struct Voxel {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d bgr = Eigen::Vector3d::Zero();
  double weight = 0;
  int count = 0;
};

/// A surface fills an eighth of a block: voxels are kept as they come, and found by their place.
struct Block {
  Block() { slots.fill(-1); }
  Voxel& at(int place) {
    if (slots[place] < 0) {
      slots[place] = static_cast<std::int16_t>(voxels.size());
      voxels.emplace_back();
    }
    return voxels[slots[place]];
  }
  const Voxel* find(int place) const {
    return slots[place] < 0 || voxels[slots[place]].count == 0 ? nullptr : &voxels[slots[place]];
  }

  Index index{};
  std::array<std::int16_t, kVoxels> slots;
  std::vector<Voxel> voxels;
  int count = 0;  // points in all
};

struct Fused {
  Pose T_map_camera;
  KeyframePoints points;
  float range = 0;  // of the farthest point [m]
};

int floorDivide(int a, int b) { return a >= 0 ? a / b : -((-a + b - 1) / b); }

/// Largest weight within kReach voxels of a place of the block in the middle.
float largestAround(const std::vector<float>& padded, int x, int y, int z) {
  float largest = 0;
  for (int dz = 0; dz <= 2 * kReach; ++dz) {
    for (int dy = 0; dy <= 2 * kReach; ++dy) {
      const float* row = &padded[((z + dz) * kPadded + y + dy) * kPadded + x];
      largest = std::max(largest, *std::max_element(row, row + 2 * kReach + 1));
    }
  }
  return largest;
}

}  // namespace

struct GroundCloud::Impl {
  CloudSettings settings;
  double tolerance;
  std::map<int, Fused> keyframes;
  std::unordered_map<std::int64_t, Block> blocks;
  std::set<Index> changed;  // blocks with other voxels than their points tell
  std::map<Index, std::vector<std::pair<std::int64_t, CloudPoint>>> cloud;  // by block, with the voxels' keys

  void add(const Fused& keyframe, int sign);
  void refresh(const Index& index);
  std::vector<float> paddedWeights(const Index& index) const;
};

GroundCloud::GroundCloud(const CloudSettings& settings, double tolerance) : impl_(new Impl) {
  settings.validate();
  if (!(tolerance >= 0)) throw std::invalid_argument("GroundCloud: tolerance must not be negative");
  impl_->settings = settings;
  impl_->tolerance = tolerance;
}
GroundCloud::~GroundCloud() = default;
GroundCloud::GroundCloud(GroundCloud&&) noexcept = default;
GroundCloud& GroundCloud::operator=(GroundCloud&&) noexcept = default;

void GroundCloud::Impl::add(const Fused& keyframe, int sign) {
  const Eigen::Matrix3f R = keyframe.T_map_camera.linear().cast<float>();
  const Eigen::Vector3f t = keyframe.T_map_camera.translation().cast<float>();
  const float inverse = static_cast<float>(1 / settings.voxel);
  Block* block = nullptr;  // neighbouring points mostly share theirs
  for (const KeyframeDepth::Point& point : *keyframe.points) {
    const Eigen::Vector3f p = R * point.position + t;
    const Index v{static_cast<int>(std::floor(p.x() * inverse)), static_cast<int>(std::floor(p.y() * inverse)),
                  static_cast<int>(std::floor(p.z() * inverse))};
    const Index b{floorDivide(v.x, kSide), floorDivide(v.y, kSide), floorDivide(v.z, kSide)};
    if (!block || block->index.x != b.x || block->index.y != b.y || block->index.z != b.z) {
      block = &blocks[keyOf(b)];
      block->index = b;
      changed.insert(b);
    }
    Voxel& voxel = block->at(((v.z - b.z * kSide) * kSide + v.y - b.y * kSide) * kSide + v.x - b.x * kSide);
    const double weight = sign * static_cast<double>(point.weight);
    voxel.position += weight * (p.cast<double>() - settings.voxel * Eigen::Vector3d(v.x, v.y, v.z));
    voxel.bgr += weight * Eigen::Vector3d(point.bgr[0], point.bgr[1], point.bgr[2]);
    voxel.weight += weight;
    voxel.count += sign;
    if (voxel.count == 0) voxel = Voxel();
    block->count += sign;
  }
}

int GroundCloud::update(const std::vector<PosedPoints>& keyframes) {
  Impl& s = *impl_;
  std::map<int, const PosedPoints*> present;
  for (const PosedPoints& k : keyframes) {
    if (k.points && !present.emplace(k.keyframe, &k).second)
      throw std::invalid_argument("GroundCloud: two keyframes have the number " + std::to_string(k.keyframe));
  }
  for (auto it = s.keyframes.begin(); it != s.keyframes.end();) {
    if (present.count(it->first)) {
      ++it;
    } else {
      s.add(it->second, -1);
      it = s.keyframes.erase(it);
    }
  }
  int fused = 0;
  for (const auto& [id, posed] : present) {
    const auto known = s.keyframes.find(id);
    if (known != s.keyframes.end()) {
      Fused& old = known->second;
      if (old.points == posed->points &&
          displacement(old.T_map_camera, posed->T_map_camera, old.range) <= s.tolerance * s.settings.voxel)
        continue;
      s.add(old, -1);
    }
    Fused& now = s.keyframes[id];
    now.T_map_camera = posed->T_map_camera;
    now.points = posed->points;
    now.range = 0;
    for (const KeyframeDepth::Point& p : *now.points) now.range = std::max(now.range, p.position.norm());
    s.add(now, 1);
    ++fused;
  }
  // A voxel's weight counts for the points two voxels away.
  std::set<Index> around;
  for (const Index& b : s.changed) {
    for (int i = 0; i < 27; ++i) around.insert({b.x + i % 3 - 1, b.y + i / 3 % 3 - 1, b.z + i / 9 - 1});
  }
  s.changed.clear();
  for (const Index& b : around) s.refresh(b);
  return fused;
}

std::vector<float> GroundCloud::Impl::paddedWeights(const Index& index) const {
  std::array<const Block*, 27> near{};
  for (int i = 0; i < 27; ++i) {
    const auto it = blocks.find(keyOf({index.x + i % 3 - 1, index.y + i / 3 % 3 - 1, index.z + i / 9 - 1}));
    if (it != blocks.end() && it->second.count > 0) near[i] = &it->second;
  }
  std::vector<float> weights(kPadded * kPadded * kPadded);
  const auto split = [](int i) { return std::make_pair((i - kReach + kSide) / kSide, (i - kReach + kSide) % kSide); };
  for (int z = 0, i = 0; z < kPadded; ++z) {
    for (int y = 0; y < kPadded; ++y) {
      for (int x = 0; x < kPadded; ++x, ++i) {
        const auto [bx, vx] = split(x);
        const auto [by, vy] = split(y);
        const auto [bz, vz] = split(z);
        const Block* block = near[(bz * 3 + by) * 3 + bx];
        const Voxel* voxel = block ? block->find((vz * kSide + vy) * kSide + vx) : nullptr;
        weights[i] = voxel ? static_cast<float>(voxel->weight) : 0.f;
      }
    }
  }
  return weights;
}

void GroundCloud::Impl::refresh(const Index& index) {
  const auto found = blocks.find(keyOf(index));
  if (found == blocks.end()) return;
  if (found->second.count == 0) {
    blocks.erase(found);
    cloud.erase(index);
    return;
  }
  // A surface seen well from near lies in few voxels; what was seen from far scatters around it with little weight.
  std::vector<float> weights;
  if (settings.min_weight_share > 0) weights = paddedWeights(index);
  auto& points = cloud[index];
  points.clear();
  const Block& block = found->second;
  for (int i = 0; i < kVoxels; ++i) {
    const Voxel* seen = block.find(i);
    if (!seen) continue;
    const Voxel& voxel = *seen;
    const int x = i % kSide, y = i / kSide % kSide, z = i / (kSide * kSide);
    if (!weights.empty() &&
        static_cast<float>(voxel.weight) < settings.min_weight_share * largestAround(weights, x, y, z))
      continue;
    const Index v{index.x * kSide + x, index.y * kSide + y, index.z * kSide + z};
    CloudPoint point;
    point.position = (settings.voxel * Eigen::Vector3d(v.x, v.y, v.z) + voxel.position / voxel.weight).cast<float>();
    for (int c = 0; c < 3; ++c)
      point.bgr[c] = static_cast<std::uint8_t>(std::lround(std::clamp(voxel.bgr[c] / voxel.weight, 0.0, 255.0)));
    point.weight = static_cast<float>(voxel.weight);
    points.emplace_back(keyOf(v), point);
  }
}

std::vector<CloudPoint> GroundCloud::points() const {
  std::vector<std::pair<std::int64_t, const CloudPoint*>> order;
  for (const auto& entry : impl_->cloud)
    for (const auto& [key, point] : entry.second) order.emplace_back(key, &point);
  std::sort(order.begin(), order.end());
  std::vector<CloudPoint> result;
  result.reserve(order.size());
  for (const auto& entry : order) result.push_back(*entry.second);
  return result;
}

void GroundCloud::clear() {
  const CloudSettings settings = impl_->settings;
  const double tolerance = impl_->tolerance;
  *impl_ = Impl();
  impl_->settings = settings;
  impl_->tolerance = tolerance;
}

std::vector<CloudPoint> fusePoints(const std::vector<PosedPoints>& keyframes, const CloudSettings& settings) {
  GroundCloud cloud(settings);
  std::vector<PosedPoints> numbered = keyframes;
  for (std::size_t i = 0; i < numbered.size(); ++i) numbered[i].keyframe = static_cast<int>(i);
  cloud.update(numbered);
  return cloud.points();
}

}  // namespace rgbd_slam
