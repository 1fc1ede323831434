#include "visual_frontend/reobservation.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "patch_alignment.h"

namespace visual_frontend {

namespace {

/// Values around a position at steps of one pixel: the windows of a search share their samples.
class SearchRegion {
 public:
  void load(const cv::Mat& image, const Eigen::Vector2f& centre, int radius, int half) {
    radius_ = radius;
    half_ = half;
    side_ = 2 * (radius + half);
    values_.resize(static_cast<std::size_t>(side_) * side_);
    const float first = 0.5f - static_cast<float>(radius + half);
    for (int v = 0, i = 0; v < side_; ++v) {
      for (int u = 0; u < side_; ++u, ++i) {
        if (!sampleBilinear(image, centre.x() + first + u, centre.y() + first + v, &values_[i]))
          values_[i] = std::numeric_limits<float>::quiet_NaN();
      }
    }
  }
  /// Patch moved by (dx, dy) from the centre; NaN outside the image.
  void window(int dx, int dy, float* out) const {
    const int size = 2 * half_;
    for (int v = 0; v < size; ++v)
      std::copy_n(&values_[static_cast<std::size_t>(v + dy + radius_) * side_ + dx + radius_], size, out + v * size);
  }

 private:
  int radius_ = 0, half_ = 0, side_ = 0;
  std::vector<float> values_;
};

struct Candidate {
  const Landmark* landmark;
  Eigen::Vector2d pixel;
  const Keyframe* reference;
  const Observation* observation;
};

/// Candidates that the image should show, each with the observation whose viewing direction is nearest; those seen most
/// often first.
std::vector<Candidate> visibleCandidates(const Map& map, const CameraModel& camera, const Pose& T_map_camera,
                                         const std::vector<LandmarkId>& ids, double border, double min_cosine) {
  const Pose T_camera_map = T_map_camera.inverse();
  std::vector<Candidate> visible;
  for (const LandmarkId id : ids) {
    if (!map.hasLandmark(id)) continue;
    const Landmark& landmark = map.landmark(id);
    const auto pixel = camera.project(T_camera_map * landmark.position);
    if (!pixel || !camera.contains(*pixel, border)) continue;
    const Eigen::Vector3d ray = (landmark.position - T_map_camera.translation()).normalized();
    Candidate best{&landmark, *pixel, nullptr, nullptr};
    double best_cosine = min_cosine;
    for (const LandmarkObservation& o : landmark.observations) {
      const Keyframe& keyframe = map.keyframe(o.keyframe);
      if (keyframe.pyramid.empty()) continue;
      const double cosine = ray.dot((landmark.position - keyframe.T_map_camera.translation()).normalized());
      if (cosine < best_cosine) continue;
      best_cosine = cosine;
      best.reference = &keyframe;
      best.observation = &keyframe.observations[o.index];
    }
    if (best.reference) visible.push_back(best);
  }
  std::stable_sort(visible.begin(), visible.end(), [](const Candidate& a, const Candidate& b) {
    return a.landmark->observations.size() > b.landmark->observations.size();
  });
  return visible;
}

/// For level `at` of the current image from level `from` of the reference; A: current by reference pixels. False where
/// the reference ends.
bool makeTemplate(const Candidate& c, const Eigen::Matrix2d& A, int at, int from, int half, PatchTemplate* result) {
  const double steps = 1.0 / (1 << from);
  const Eigen::Matrix2d B = A.inverse() * (steps * (1 << at));
  return makeTemplate(c.reference->pyramid[from], steps * c.observation->pixel, B, half, result);
}

/// Best place of the template within `radius` pixels of `predicted` by correlation; the score, -1 where there is none.
float search(const cv::Mat& image, const Patch& reference, int radius, const Eigen::Vector2f& predicted,
             SearchRegion* region, Eigen::Vector2f* best) {
  Patch window;
  window.half = reference.half;
  float best_score = -1;
  *best = predicted;
  region->load(image, predicted, radius, reference.half);
  for (int dy = -radius; dy <= radius; ++dy) {
    for (int dx = -radius; dx <= radius; ++dx) {
      region->window(dx, dy, window.values);
      window.statistics();
      const float score = zncc(reference, window);
      if (score > best_score) {  // never where the window leaves the image
        best_score = score;
        *best = predicted + Eigen::Vector2f(static_cast<float>(dx), static_cast<float>(dy));
      }
    }
  }
  return best_score;
}

/// Finds a candidate in the image: coarse search, then alignment there and at the fine level.
std::optional<LandmarkMatch> find(const Candidate& c, const CameraModel& camera, const ImagePyramid& current,
                                  const Pose& T_camera_map, int half, const ReobservationSettings& settings,
                                  SearchRegion* region) {
  const Pose T_reference_map = c.reference->T_map_camera.inverse();
  const double depth = (T_reference_map * c.landmark->position).z();
  if (!(depth > 0)) return std::nullopt;
  // From where the landmark would appear in the reference, so that a reprojection error there does not bend the warp.
  const auto reference_pixel = camera.project(T_reference_map * c.landmark->position);
  if (!reference_pixel) return std::nullopt;
  const auto A = patchWarp(camera, *reference_pixel, depth, T_camera_map * c.reference->T_map_camera);
  if (!A) return std::nullopt;
  const double scale = std::sqrt(std::abs(A->determinant()));
  if (!(scale > settings.min_scale && scale < settings.max_scale)) return std::nullopt;
  // Seen larger now: search in a coarser level of the current image, where the scales meet.
  int level = 0;
  for (double s = scale; s > 1.5 && level + 1 < static_cast<int>(current.size()); s *= 0.5) ++level;
  // Seen smaller now: take the template from a coarser level of the reference.
  const int reference_levels = static_cast<int>(c.reference->pyramid.size());
  int reference_level = 0;
  for (double s = scale; s < 0.7 && reference_level + 1 < reference_levels; s *= 2) ++reference_level;
  const int search_level = std::min(level + 1, static_cast<int>(current.size()) - 1);
  const int coarse_reference = std::min(reference_level + (search_level - level), reference_levels - 1);
  PatchTemplate fine, coarse;
  if (!makeTemplate(c, *A, level, reference_level, half, &fine) ||
      !makeTemplate(c, *A, search_level, coarse_reference, half, &coarse))
    return std::nullopt;

  const double search_scale = 1 << search_level;
  const int radius = static_cast<int>(std::ceil(settings.search_radius / search_scale));
  Eigen::Vector2f position;
  if (search(current[search_level], coarse.patch, radius, (c.pixel / search_scale).cast<float>(), region, &position) <
          settings.min_zncc - 0.15 ||
      alignPatch(current[search_level], coarse, settings.max_iterations, &position) < settings.min_zncc - 0.1)
    return std::nullopt;
  position *= static_cast<float>(1 << (search_level - level));
  LandmarkMatch match;
  match.zncc = alignPatch(current[level], fine, settings.max_iterations, &position);
  if (match.zncc < settings.min_zncc) return std::nullopt;
  match.landmark = c.landmark->id;
  match.pixel = position.cast<double>() * static_cast<double>(1 << level);
  if ((match.pixel - c.pixel).norm() > 1.5 * settings.search_radius || !camera.contains(match.pixel, 1))
    return std::nullopt;
  match.normalized = camera.unproject(match.pixel);
  return match;
}

}  // namespace

std::vector<LandmarkMatch> reobserve(const Map& map, const CameraModel& camera, const ImagePyramid& current,
                                     const Pose& T_map_camera, const std::vector<LandmarkId>& candidates,
                                     const std::vector<Eigen::Vector2d>& occupied,
                                     const ReobservationSettings& settings) {
  std::vector<LandmarkMatch> matches;
  if (current.empty()) return matches;
  const int half = std::clamp(settings.half_patch, 2, kMaxHalfPatch - 1);
  const int cell = std::max(4, settings.cell_size);
  const int columns = camera.width / cell + 1;
  std::vector<unsigned char> taken(static_cast<std::size_t>(columns) * (camera.height / cell + 1), 0);
  const auto cellOf = [&](const Eigen::Vector2d& p) {
    return static_cast<std::size_t>(p.y() / cell) * columns + static_cast<std::size_t>(p.x() / cell);
  };
  for (const Eigen::Vector2d& p : occupied) {
    if (camera.contains(p)) taken[cellOf(p)] = 1;
  }
  const Pose T_camera_map = T_map_camera.inverse();
  SearchRegion region;
  for (const Candidate& c :
       visibleCandidates(map, camera, T_map_camera, candidates, half + 4, std::cos(settings.max_view_angle))) {
    if (static_cast<int>(matches.size()) >= settings.max_matches) break;
    if (taken[cellOf(c.pixel)]) continue;
    const auto match = find(c, camera, current, T_camera_map, half, settings, &region);
    if (!match) continue;
    taken[cellOf(c.pixel)] = 1;
    matches.push_back(*match);
  }
  return matches;
}

}  // namespace visual_frontend
