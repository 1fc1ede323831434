#include "keyframe_surfaces.h"

#include <algorithm>
#include <set>
#include <utility>

#include "air_ground_common/covariance.h"
#include "air_ground_common/linear_algebra.h"

namespace rgbd_slam {

namespace {

constexpr KeyframeId kRelinked = 20;          // newest keyframes: 0.3 s of work
constexpr std::size_t kMostPatches = 20'000;  // evenly taken of all keyframes

/// Of several links between two keyframes the newest stays: they are of one view and err alike, so that together they
/// would count for more than they know.
void keepNewestOfEachPair(std::vector<visual_frontend::KeyframeLink>* links) {
  std::set<std::pair<KeyframeId, KeyframeId>> linked;
  const auto kept = std::remove_if(links->rbegin(), links->rend(), [&](const visual_frontend::KeyframeLink& link) {
    return !linked.insert({std::min(link.a, link.b), std::max(link.a, link.b)}).second;
  });
  links->erase(links->begin(), kept.base());
}

}  // namespace

void KeyframeSurfaces::clear() {
  surfaces_.clear();
  links_.clear();
  ties_.clear();
}

DepthSurface KeyframeSurfaces::surfaceOf(const cv::Mat& depth, const visual_frontend::RollingShutter& rows) const {
  return DepthSurface(camera_, depth, depth_, rows);
}

void KeyframeSurfaces::add(KeyframeId id, DepthSurface surface) { surfaces_.insert_or_assign(id, std::move(surface)); }

void KeyframeSurfaces::replace(KeyframeId from, KeyframeId to, const visual_frontend::Map& map) {
  surfaces_.erase(from);
  const Pose T_from_to = map.keyframe(from).T_map_camera.inverse() * map.keyframe(to).T_map_camera;
  Matrix6d adjoint = Matrix6d::Zero();  // a perturbation after T_from_to, as one before it
  adjoint.topLeftCorner<3, 3>() = adjoint.bottomRightCorner<3, 3>() = T_from_to.linear();
  adjoint.topRightCorner<3, 3>() = air_ground_common::skew(T_from_to.translation()) * T_from_to.linear();
  for (auto* links : {&links_, &ties_}) {
    for (auto& link : *links) {
      if (link.a == from) {
        link.a = to;
        link.T_a_b = T_from_to.inverse() * link.T_a_b;
      } else if (link.b == from) {
        link.b = to;
        link.T_a_b = link.T_a_b * T_from_to;
        link.information = adjoint.transpose() * link.information * adjoint;
      }
    }
    links->erase(std::remove_if(links->begin(), links->end(), [](const auto& link) { return link.a == link.b; }),
                 links->end());
    keepNewestOfEachPair(links);
  }
}

void KeyframeSurfaces::setCamera(const CameraModel& better_known) {
  for (auto& entry : surfaces_) entry.second.recalibrate(camera_, better_known);
  camera_ = better_known;
}

void KeyframeSurfaces::moveRows(KeyframeId id, const visual_frontend::RollingShutter& shift) {
  const auto surface = surfaces_.find(id);
  if (surface != surfaces_.end()) surface->second.moveRows(shift);
}

void KeyframeSurfaces::relink(const visual_frontend::Map& map) {
  const auto old = std::exchange(links_, {});
  for (const auto& l : old)
    if (l.b + kRelinked > surfaces_.rbegin()->first) link(l.b, {l.a}, map);
}

SurfaceAlignment KeyframeSurfaces::align(KeyframeId id, const DepthSurface& surface,
                                         const Pose& T_keyframe_camera) const {
  return alignSurfaces(camera_, surfaces_.at(id), surface, T_keyframe_camera);
}

void KeyframeSurfaces::link(KeyframeId id, const std::vector<KeyframeId>& others, const visual_frontend::Map& map) {
  const Pose& T_map_camera = map.keyframe(id).T_map_camera;
  for (const KeyframeId other : others) {
    if (!has(other)) continue;
    const SurfaceAlignment aligned =
        align(other, surfaces_.at(id), map.keyframe(other).T_map_camera.inverse() * T_map_camera);
    if (aligned.success) links_.push_back({other, id, aligned.T_a_b, aligned.information});
  }
}

void KeyframeSurfaces::tie(KeyframeId id, KeyframeId reference, const Matrix6d& covariance,
                           const visual_frontend::Map& map) {
  const Pose& T_map_camera = map.keyframe(id).T_map_camera;
  const Matrix6d information =
      air_ground_common::aboutAxes(T_map_camera.linear().transpose(), air_ground_common::inverse(covariance));
  ties_.push_back({reference, id, map.keyframe(reference).T_map_camera.inverse() * T_map_camera,
                   0.5 * (information + information.transpose())});
}

std::vector<visual_frontend::KeyframeLink> KeyframeSurfaces::links() const {
  std::vector<visual_frontend::KeyframeLink> all = links_;
  all.insert(all.end(), ties_.begin(), ties_.end());
  return all;
}

std::vector<SurfacePatch> KeyframeSurfaces::patches(const visual_frontend::Map& map) const {
  std::size_t known = 0;
  for (const auto& entry : surfaces_) known += entry.second.known();
  const std::size_t every = 1 + known / kMostPatches;
  std::vector<SurfacePatch> patches;
  std::size_t seen = 0;
  for (const auto& [id, surface] : surfaces_) {
    const Eigen::Matrix3d R_map_camera = map.keyframe(id).T_map_camera.linear();
    for (const DepthSurface::Cell& cell : surface.cells())
      if (cell.sigma > 0 && seen++ % every == 0)
        patches.push_back({R_map_camera * cell.normal.cast<double>(), surface.area(camera_, cell)});
  }
  return patches;
}

std::vector<KeyframeId> KeyframeSurfaces::linkedTo(KeyframeId id) const {
  std::vector<KeyframeId> others;
  for (const auto* links : {&links_, &ties_})
    for (const auto& link : *links)
      if (link.a == id || link.b == id) others.push_back(link.a == id ? link.b : link.a);
  return others;
}

}  // namespace rgbd_slam
