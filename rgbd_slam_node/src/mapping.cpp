// Keyframes and landmarks. Landmarks start from measured depth, also while the camera only turns (paper, section IV),
// and from parallax where the sensor sees no depth.
#include <algorithm>
#include <cmath>

#include "slam_impl.h"
#include "visual_frontend/triangulation.h"

namespace rgbd_slam {

bool Slam::Impl::keyframeDue(const Pose& T_map_camera, int landmarks) const {
  if (since_keyframe < settings.keyframe_min_gap) return false;
  const Keyframe& last = map.keyframe(map.lastKeyframe());
  // Seen from afar, parallax grows slowly: distances count against the depth of the scene.
  std::vector<double> depths;
  for (const Observation& o : last.observations) {
    if (o.landmark != kNoLandmark)
      depths.push_back((last.T_map_camera.inverse() * map.landmark(o.landmark).position).z());
  }
  double median = 2.0;
  if (!depths.empty()) {
    std::nth_element(depths.begin(), depths.begin() + depths.size() / 2, depths.end());
    median = depths[depths.size() / 2];
  }
  // Both against their thresholds.
  const double moved =
      (T_map_camera.translation() - last.T_map_camera.translation()).norm() / (settings.keyframe_translation * median);
  const double turned =
      air_ground_common::rotationAngle(T_map_camera.linear(), last.T_map_camera.linear()) / settings.keyframe_rotation;
  if (moved > 1 || turned > 1) return true;
  // From where the last keyframe stood, another sees nothing new, unless landmarks were lost since.
  const bool something_new = moved > 0.25 || turned > 0.25 || keyframe_landmarks > 1.25 * landmarks;
  return something_new &&
         (landmarks < settings.keyframe_overlap * keyframe_landmarks || landmarks < 3 * settings.min_inliers);
}

void Slam::Impl::finishDepth() {
  if (!active_depth) return;
  keyframe_points[map.lastKeyframe()] =
      std::make_shared<const std::vector<KeyframeDepth::Point>>(active_depth->points(settings.depth, settings.cloud));
  active_depth.reset();
}

KeyframeId Slam::Impl::addKeyframe(double stamp, const Pose& T_map_camera, const Matrix6d& covariance,
                                   const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth) {
  finishDepth();
  tracker.replenish();
  Keyframe keyframe;
  keyframe.stamp = stamp;
  keyframe.T_map_camera = T_map_camera;
  keyframe.pyramid = tracker.pyramid();
  if (const auto up = upOfCamera(T_map_camera.linear())) {
    keyframe.up_camera = up->first;
    keyframe.up_sigma = up->second;
  }
  for (const Feature& f : tracker.features()) {
    const auto it = track_landmark.find(f.id);
    const bool known = it != track_landmark.end() && map.hasLandmark(it->second);
    const double z = known ? (T_map_camera.inverse() * map.landmark(it->second).position).z() : 0;
    Observation o = observe(f.pixel, f.normalized, depth, z > 0.1 ? 1 / z : 0);
    o.track = f.id;
    if (known) o.landmark = it->second;
    keyframe.observations.push_back(o);
  }
  fillOrb(gray, depth, keyframe);
  const KeyframeId id = map.addKeyframe(std::move(keyframe));
  ++counters.keyframes;
  keyframe_path[id] = path;

  keyframe_covariance[id] = visual_frontend::chainedCovariance(map, keyframe_covariance, id, covariance);

  createLandmarks(id);
  if (map.keyframeCount() > 1) adjustWindow(id);
  keyframe_landmarks = 0;
  for (const Observation& o : map.keyframe(id).observations) keyframe_landmarks += o.landmark != kNoLandmark;
  since_keyframe = since_reobservation = 0;
  map.dropFarImages(T_map_camera, settings.max_image_keyframes);
  active_depth = std::make_unique<KeyframeDepth>(camera, depth, bgr, settings.depth, settings.cloud, &rows);
  return id;
}

void Slam::Impl::createLandmarks(KeyframeId id) {
  visual_frontend::TriangulationSettings triangulation;
  triangulation.max_depth = 15.0;
  triangulation.min_depth = 0.2;
  const int count = static_cast<int>(map.keyframe(id).observations.size());
  for (int i = 0; i < count; ++i) {
    const Observation& o = map.keyframe(id).observations[i];
    if (o.landmark != kNoLandmark) continue;
    std::vector<LandmarkObservation> views = track_views[o.track];
    views.push_back({id, i});
    std::vector<visual_frontend::ViewRay> rays;
    for (const LandmarkObservation& view : views) {
      const Keyframe& keyframe = map.keyframe(view.keyframe);
      const Observation& seen = keyframe.observations[view.index];
      const auto noise = camera.normalizedNoise(seen.normalized, settings.pixel_sigma);
      rays.push_back(
          {keyframe.T_map_camera, seen.normalized, noise.sigma, seen.depth, seen.depth_sigma, noise.elongation});
    }
    const auto result = visual_frontend::triangulate(rays, triangulation);
    if (!result.ok()) {
      // Views that contradict each other belong to a track that slipped: begin anew with this one.
      if (result.status == visual_frontend::TriangulationStatus::kLargeResidual) views = {{id, i}};
      track_views[o.track] = std::move(views);
      continue;
    }
    const TrackId track = o.track;
    const LandmarkId landmark = map.addLandmark(result.p_map);
    map.landmark(landmark).covariance = result.covariance;
    for (const LandmarkObservation& view : views) map.connect(view.keyframe, view.index, landmark);
    track_landmark[track] = landmark;
    track_views.erase(track);
  }
}

void Slam::Impl::adjustWindow(KeyframeId id) {
  std::vector<KeyframeId> free{id};
  for (const auto& c : map.covisible(id, 10)) {
    if (static_cast<int>(free.size()) >= settings.window) break;
    free.push_back(c.keyframe);
  }
  std::vector<KeyframeId> fixed;
  for (const auto& c : map.observers(map.landmarksOf(free), 5)) {
    if (static_cast<int>(fixed.size()) >= settings.window_fixed) break;
    if (std::find(free.begin(), free.end(), c.keyframe) == free.end()) fixed.push_back(c.keyframe);
  }
  // The first keyframe defines the map; with nothing outside the window the oldest inside holds it.
  const auto oldest = std::min_element(free.begin(), free.end());
  if (*oldest == map.keyframes().begin()->first || fixed.empty()) {
    fixed.push_back(*oldest);
    free.erase(oldest);
  }
  if (free.empty()) return;
  visual_frontend::BundleSettings bundle = settings.bundle;
  bundle.pixel_sigma = settings.pixel_sigma;
  bundle.use_gravity = settings.use_gravity && leveled;
  visual_frontend::adjustMap(map, camera, free, fixed, bundle);
}

}  // namespace rgbd_slam
