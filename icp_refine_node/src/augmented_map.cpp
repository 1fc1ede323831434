#include "icp_refine/augmented_map.h"

#include <algorithm>
#include <cmath>
#include <unordered_set>
#include <utility>

namespace icp_refine {

namespace {

void add(const std::vector<LabeledPoint>& points, AerialVoxels* voxels) {
  for (const auto& p : points) voxels->add(p.position, p.rgb[0]);
}

}  // namespace

void AerialVoxels::add(const Eigen::Vector3f& point, float intensity) {
  if (!point.allFinite() || point.cwiseAbs().maxCoeff() > 1e4f || !std::isfinite(intensity)) return;
  Voxel& v = voxelOf(point);
  v.sum += point;
  v.intensity += intensity;
  ++v.count;
  while (voxels_.size() > max_voxels_ && leaf_ < 1e3f) coarsen();
}

AerialVoxels::Voxel& AerialVoxels::voxelOf(const Eigen::Vector3f& point) {
  const auto [cell, fresh] = of_cell_.try_emplace(cellKey(point, leaf_), voxels_.size());
  return fresh ? voxels_.emplace_back() : voxels_[cell->second];
}

void AerialVoxels::coarsen() {
  leaf_ *= 2;
  of_cell_.clear();
  for (const Voxel& v : std::exchange(voxels_, {})) {
    Voxel& merged = voxelOf(v.sum / static_cast<float>(v.count));
    merged.sum += v.sum;
    merged.intensity += v.intensity;
    merged.count += v.count;
  }
}

void AerialVoxels::reserve(std::size_t voxels) {
  voxels_.reserve(voxels);
  of_cell_.reserve(voxels);
}

std::vector<AerialVoxels::Point> AerialVoxels::points(int min_points) const {
  std::vector<Point> out;
  out.reserve(voxels_.size());
  for (const Voxel& v : voxels_) {
    if (v.count < min_points) continue;
    const float n = static_cast<float>(v.count);
    out.push_back({v.sum / n, static_cast<std::uint8_t>(std::clamp(v.intensity / n, 0.f, 255.f)), v.count});
  }
  return out;
}

std::vector<char> addedByAir(const std::vector<Eigen::Vector3f>& aerial, const std::vector<Eigen::Vector3f>& ground,
                             double leaf) {
  const float size = static_cast<float>(leaf);
  std::unordered_set<std::uint64_t> occupied;
  for (const auto& p : ground) {
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dz = -1; dz <= 1; ++dz) {
          occupied.insert(cellKey(
              p + size * Eigen::Vector3f(static_cast<float>(dx), static_cast<float>(dy), static_cast<float>(dz)),
              size));
        }
      }
    }
  }
  std::vector<char> mask(aerial.size());
  for (std::size_t i = 0; i < aerial.size(); ++i) mask[i] = !occupied.count(cellKey(aerial[i], size));
  return mask;
}

void AugmentedMap::addAerial(std::int64_t stamp, std::vector<LabeledPoint> points) {
  if (!corrected_) add(points, &aerial_);
  clouds_.add(stamp, std::move(points), [this](const std::vector<LabeledPoint>& old) { add(old, &settled_); });
}

void AugmentedMap::correctAerial(const air_ground_common::CloudCorrections& corrections) {
  clouds_.correct(corrections);
  corrected_ = true;
}

// All clouds once more take a second where the map is large: corrections come every few seconds, whether or not
// somebody looks at the map.
void AugmentedMap::followCorrections() {
  if (!std::exchange(corrected_, false)) return;
  const std::size_t voxels = aerial_.size();
  aerial_ = settled_;
  aerial_.reserve(voxels);
  for (const auto& [stamp, points] : clouds_.clouds()) add(points, &aerial_);
}

void AugmentedMap::clearAerial() {
  clouds_.clear();
  settled_.clear();
  aerial_.clear();
  corrected_ = false;
}

std::vector<LabeledPoint> AugmentedMap::points() {
  std::vector<LabeledPoint> out = ground_;
  for (auto& p : out) {
    p.source = 0;
    if (settings_.ground_red) p.rgb = {220, 30, 30};
  }
  if (!T_ground_map_mav_map_) return out;
  followCorrections();
  const Eigen::Matrix3f sR = (T_ground_map_mav_map_->scale * T_ground_map_mav_map_->R).cast<float>();
  const Eigen::Vector3f t = T_ground_map_mav_map_->t.cast<float>();
  const auto voxels = aerial_.points(settings_.min_points);
  std::vector<char> mask(voxels.size(), 1);
  if (settings_.fill_only) {
    std::vector<Eigen::Vector3f> aerial, ground;
    for (const auto& v : voxels) aerial.push_back(sR * v.position + t);
    for (const auto& p : ground_) ground.push_back(p.position);
    mask = addedByAir(aerial, ground, settings_.leaf * 2);
  }
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    if (mask[i]) out.push_back({sR * voxels[i].position + t, {voxels[i].grey, voxels[i].grey, voxels[i].grey}, 1});
  }
  return out;
}

}  // namespace icp_refine
