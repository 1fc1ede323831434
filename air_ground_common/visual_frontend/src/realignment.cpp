#include "visual_frontend/realignment.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <optional>

#include "patch_alignment.h"

namespace visual_frontend {

namespace {

/// The oldest of the views that is like that of a camera at `centre`; null: none.
const LandmarkObservation* oldestAlike(const Map& map, const LandmarkTracks::Views& views,
                                       const Eigen::Vector3d& position, const Eigen::Vector3d& centre,
                                       double min_cosine) {
  const Eigen::Vector3d ray = (position - centre).normalized();
  for (const LandmarkObservation& view : views) {
    const Keyframe& keyframe = map.keyframe(view.keyframe);
    if (!keyframe.pyramid.empty() &&
        ray.dot((position - keyframe.T_map_camera.translation()).normalized()) >= min_cosine)
      return &view;
  }
  return nullptr;
}

/// Where the view's patch is in the current image, from where its track is.
std::optional<Eigen::Vector2d> alignedTo(const Keyframe& reference, const Observation& seen, const cv::Mat& image,
                                         const CameraModel& camera, const Pose& T_camera_map,
                                         const Eigen::Vector3d& position, const Eigen::Vector2d& track,
                                         const RealignmentSettings& settings) {
  const Eigen::Vector3d p_reference = reference.T_map_camera.inverse() * position;
  // From where the point would appear, so that a reprojection error does not bend the warp.
  const auto projected = camera.project(p_reference);
  if (!projected) return std::nullopt;
  const auto A = patchWarp(camera, *projected, p_reference.z(), T_camera_map * reference.T_map_camera);
  if (!A) return std::nullopt;
  const double scale = std::sqrt(std::abs(A->determinant()));
  if (!(scale > settings.min_scale && scale < settings.max_scale)) return std::nullopt;
  PatchTemplate patch;
  if (!makeTemplate(reference.pyramid[0], seen.pixel, A->inverse(), settings.half_patch, &patch)) return std::nullopt;
  Eigen::Vector2f found = track.cast<float>();
  if (alignPatch(image, patch, settings.max_iterations, &found) < settings.min_zncc) return std::nullopt;
  const Eigen::Vector2d pixel = found.cast<double>();
  if ((pixel - track).norm() > settings.max_shift || !camera.contains(pixel, 1)) return std::nullopt;
  return pixel;
}

}  // namespace

int realignTracks(const Map& map, const LandmarkTracks& tracks, const Pose& T_map_camera, double distance,
                  const RealignmentSettings& settings, FeatureTracker* tracker) {
  if (tracker->pyramid().empty()) return 0;
  const double min_cosine = std::cos(settings.max_view_angle);
  const Pose T_camera_map = T_map_camera.inverse();
  std::vector<std::optional<Eigen::Vector2d>> pixels;
  for (const Feature& f : tracker->features()) {
    const LandmarkId id = tracks.landmarkIn(map, f.id);
    const bool placed = id != kNoLandmark;
    const Eigen::Vector3d position =
        placed ? map.landmark(id).position : T_map_camera * (distance * f.normalized.homogeneous()).eval();
    const auto unplaced = placed ? LandmarkTracks::Views() : tracks.viewsOf(f.id);
    const auto& views = placed ? map.landmark(id).observations : unplaced;
    const LandmarkObservation* first = oldestAlike(map, views, position, T_map_camera.translation(), min_cosine);
    pixels.emplace_back();
    if (!first) continue;
    const Keyframe& reference = map.keyframe(first->keyframe);
    pixels.back() = alignedTo(reference, reference.observations[first->index], tracker->pyramid()[0], tracker->camera(),
                              T_camera_map, position, f.pixel, settings);
  }
  tracker->move(pixels);
  return static_cast<int>(std::count_if(pixels.begin(), pixels.end(), [](const auto& p) { return p.has_value(); }));
}

}  // namespace visual_frontend
