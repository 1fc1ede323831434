#include "streetview_localizer/back_projection.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <stdexcept>

namespace streetview_localizer {

using air_ground_common::CameraModel;
using air_ground_common::MeshScene;
using air_ground_common::Pose;
using air_ground_common::RayHit;

struct BackProjector::Impl {
  Impl(const CityModel& m, const BackProjectionSettings& s) : model(m), settings(s), scene(m.mesh) {}

  const CityModel& model;
  BackProjectionSettings settings;
  MeshScene scene;

  // Embree finds the triangle in single precision; its plane gives the point in double.
  SurfacePoint refine(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, const RayHit& hit) const {
    SurfacePoint s;
    s.triangle = hit.triangle;
    s.distance = hit.distance;
    s.normal = hit.normal.cast<double>();
    const Eigen::Vector3i& t = model.mesh.triangles[hit.triangle];
    const Eigen::Vector3d a = model.mesh.vertices[t[0]].cast<double>(),
                          ab = model.mesh.vertices[t[1]].cast<double>() - a,
                          ac = model.mesh.vertices[t[2]].cast<double>() - a;
    const Eigen::Vector3d cross = ab.cross(ac);
    const double longest = std::max({ab.norm(), ac.norm(), (ab - ac).norm()});
    if (cross.norm() > 1e-3 * longest) {  // higher than a millimetre: the plane is well defined
      s.normal = cross.normalized();
      const double slope = s.normal.dot(direction);
      if (std::abs(slope) > 1e-4) s.distance = s.normal.dot(a - origin) / slope;
    }
    if (s.normal.dot(direction) > 0) s.normal = -s.normal;
    s.point = origin + s.distance * direction;
    return s;
  }

  // True when a ray beside the feature's meets nothing, or a surface that does not join the feature's: a silhouette, or
  // a step between facades. Where two facades meet in a corner, one of them passes close to the other's point.
  bool nearDiscontinuity(const View& view, const Eigen::Vector2d& pixel, const SurfacePoint& s) const {
    if (settings.edge_distance <= 0) return false;
    const Eigen::Vector3d origin = view.T_world_camera.translation();
    std::vector<Eigen::Vector3f> directions(8);
    for (int i = 0; i < 8; ++i) {
      const Eigen::Vector2d q =
          pixel + settings.edge_distance * Eigen::Vector2d(std::cos(i * M_PI / 4), std::sin(i * M_PI / 4));
      directions[i] = (view.T_world_camera.linear() * view.camera.ray(q)).cast<float>();
    }
    const std::vector<RayHit> hits = scene.castMany(origin.cast<float>(), directions);
    for (std::size_t i = 0; i < hits.size(); ++i) {
      if (hits[i].triangle < 0) return true;
      const Eigen::Vector3d offset = origin + hits[i].distance * directions[i].cast<double>() - s.point;
      if (std::min(std::abs(s.normal.dot(offset)), std::abs(hits[i].normal.cast<double>().dot(offset))) >
          settings.discontinuity)
        return true;
    }
    return false;
  }
};

BackProjector::BackProjector(const CityModel& model, const BackProjectionSettings& settings)
    : impl_(std::make_unique<Impl>(model, settings)) {}
BackProjector::~BackProjector() = default;
BackProjector::BackProjector(BackProjector&&) noexcept = default;

const CityModel& BackProjector::model() const { return impl_->model; }
const MeshScene& BackProjector::scene() const { return impl_->scene; }

std::optional<SurfacePoint> BackProjector::cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
  const Eigen::Vector3d d = direction.normalized();
  const auto hit = impl_->scene.cast(origin.cast<float>(), d.cast<float>());
  if (!hit) return std::nullopt;
  return impl_->refine(origin, d, *hit);
}

BackProjectionCounts BackProjector::apply(View* view) const {
  BackProjectionCounts counts;
  const BackProjectionSettings& s = impl_->settings;
  const std::size_t n = view->features.size();
  const Eigen::Vector3d origin = view->T_world_camera.translation();
  std::vector<Eigen::Vector3d> rays(n);
  std::vector<Eigen::Vector3f> directions(n);
  for (std::size_t i = 0; i < n; ++i) {
    const cv::Point2f& pt = view->features.keypoints[i].pt;
    rays[i] = view->T_world_camera.linear() * view->camera.ray({pt.x, pt.y});
    directions[i] = rays[i].cast<float>();
  }
  const std::vector<RayHit> hits = impl_->scene.castMany(origin.cast<float>(), directions);
  Features kept;
  std::vector<int> rows;
  view->points.clear();
  view->normals.clear();
  for (std::size_t i = 0; i < n; ++i) {
    if (hits[i].triangle < 0) {
      ++counts.sky;
      continue;
    }
    const int t = hits[i].triangle;
    if (!impl_->model.isBuilding(t) || (s.walls_only && impl_->model.surface[t] != Surface::kWall)) {
      ++counts.ground;
      continue;
    }
    const SurfacePoint p = impl_->refine(origin, rays[i], hits[i]);
    if (p.distance < s.min_depth || p.distance > s.max_depth) {
      ++counts.range;
      continue;
    }
    if (-p.normal.dot(rays[i]) < std::cos(s.max_incidence)) {
      ++counts.grazing;
      continue;
    }
    const cv::KeyPoint& k = view->features.keypoints[i];
    if (impl_->nearDiscontinuity(*view, {k.pt.x, k.pt.y}, p)) {
      ++counts.edge;
      continue;
    }
    ++counts.kept;
    kept.keypoints.push_back(k);
    rows.push_back(static_cast<int>(i));
    view->points.push_back(p.point.cast<float>());
    view->normals.push_back(p.normal.cast<float>());
  }
  if (!view->features.descriptors.empty()) {
    kept.descriptors.create(counts.kept, view->features.descriptors.cols, view->features.descriptors.type());
    for (int i = 0; i < counts.kept; ++i) view->features.descriptors.row(rows[i]).copyTo(kept.descriptors.row(i));
  }
  view->features = std::move(kept);
  return counts;
}

ModelImage BackProjector::render(const CameraModel& camera, const Pose& T_world_camera) const {
  camera.validate();
  ModelImage image;
  image.depth.create(camera.height, camera.width, CV_32F);
  image.triangle.create(camera.height, camera.width, CV_32S);
  const Eigen::Vector3f origin = T_world_camera.translation().cast<float>();
  const Eigen::Vector3d axis = T_world_camera.linear().col(2);
  // Tiles of 4 x 2 pixels make the rays of a packet neighbours.
  std::vector<Eigen::Vector3f> directions;
  std::vector<cv::Point> pixels;
  for (int y = 0; y < camera.height; y += 2) {
    directions.clear();
    pixels.clear();
    for (int x = 0; x < camera.width; x += 4)
      for (int v = y; v < std::min(y + 2, camera.height); ++v)
        for (int u = x; u < std::min(x + 4, camera.width); ++u) {
          pixels.emplace_back(u, v);
          directions.push_back((T_world_camera.linear() * camera.ray({double(u), double(v)})).cast<float>());
        }
    const std::vector<RayHit> hits = impl_->scene.castMany(origin, directions);
    for (std::size_t i = 0; i < hits.size(); ++i) {
      image.triangle.at<int>(pixels[i]) = hits[i].triangle;
      image.depth.at<float>(pixels[i]) =
          hits[i].triangle < 0 ? 0.f : hits[i].distance * directions[i].dot(axis.cast<float>());
    }
  }
  return image;
}

}  // namespace streetview_localizer
