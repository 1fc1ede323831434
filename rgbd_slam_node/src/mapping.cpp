// Keyframes and landmarks. Landmarks start from measured depth, also while the camera only turns (paper, section IV),
// and from parallax where the sensor sees no depth.
#include <algorithm>
#include <cmath>

#include "slam_impl.h"
#include "visual_frontend/bundle_job.h"
#include "visual_frontend/local_landmarks.h"

namespace rgbd_slam {

namespace {

constexpr double kSameView = 0.25;  // of the change of view that makes a keyframe

int landmarksOf(const Keyframe& keyframe) {
  return static_cast<int>(std::count_if(keyframe.observations.begin(), keyframe.observations.end(),
                                        [](const Observation& o) { return o.landmark != kNoLandmark; }));
}

/// How far a camera is from a keyframe's, by the larger of distance and angle over what makes a new keyframe.
double changeOfView(const visual_frontend::Map& map, const Keyframe& keyframe, const Pose& T_map_camera,
                    const SlamSettings& settings) {
  return visual_frontend::changeOfView(T_map_camera, keyframe.T_map_camera, map.medianDepth(keyframe).value_or(2.0),
                                       {settings.keyframe_translation, settings.keyframe_rotation});
}

}  // namespace

bool Slam::Impl::outgrown(const Keyframe& keyframe, const Pose& T_map_camera, int landmarks) const {
  const double change = changeOfView(map, keyframe, T_map_camera, settings);
  if (change > 1) return true;
  // From where the keyframe stood, another sees nothing new, unless landmarks were lost since.
  const int seen = landmarksOf(keyframe);
  return (change > kSameView || seen > 1.25 * landmarks) &&
         (landmarks < settings.keyframe_overlap * seen || landmarks < 3 * settings.min_inliers);
}

bool Slam::Impl::keyframeDue(const Pose& T_map_camera, int landmarks) const {
  return since_keyframe >= settings.keyframe_min_gap && outgrown(map.keyframe(reference), T_map_camera, landmarks);
}

KeyframeId Slam::Impl::keyframeOfView(const Pose& T_map_camera, int landmarks) const {
  // Shared landmarks say that the two are right to each other: else there may be a loop to close.
  for (const auto& c : map.observers(tracks.landmarks(), 2 * settings.min_inliers)) {
    if (!outgrown(map.keyframe(c.keyframe), T_map_camera, landmarks)) return c.keyframe;
  }
  return kNoKeyframe;
}

void Slam::Impl::setReference(KeyframeId id) {
  finishDepth();
  reference = id;
  since_keyframe = since_reobservation = 0;
}

void Slam::Impl::removeReplacedBy(KeyframeId id) {
  for (const auto& c : map.covisible(id, 2 * settings.min_inliers)) {
    // The first one is the origin; the latest may hold what is tracked.
    if (c.keyframe == map.keyframes().begin()->first || c.keyframe + settings.loop_min_gap > id) continue;
    if (changeOfView(map, map.keyframe(c.keyframe), map.keyframe(id).T_map_camera, settings) > kSameView) continue;
    frames.rebase(c.keyframe, id, map);
    tracks.forgetKeyframe(c.keyframe);
    covariances.forget(c.keyframe);
    keyframe_path.erase(c.keyframe);
    keyframe_points.erase(c.keyframe);
    map.removeKeyframe(c.keyframe);
  }
}

void Slam::Impl::finishDepth() {
  if (!active_depth) return;
  keyframe_points[reference] =
      std::make_shared<const std::vector<KeyframeDepth::Point>>(active_depth->points(settings.depth, settings.cloud));
  active_depth.reset();
}

KeyframeId Slam::Impl::addKeyframe(const Images& images, const Pose& T_map_camera, const Matrix6d& covariance) {
  tracker.replenish();
  Keyframe keyframe;
  keyframe.stamp = images.stamp;
  keyframe.T_map_camera = T_map_camera;
  keyframe.pyramid = tracker.pyramid();
  if (const auto up = upOfCamera(T_map_camera.linear())) {
    keyframe.up_camera = up->first;
    keyframe.up_sigma = up->second;
  }
  for (const Feature& f : tracker.features()) {
    const LandmarkId landmark = tracks.landmarkOf(f.id);
    const bool known = map.hasLandmark(landmark);
    const double z = known ? (T_map_camera.inverse() * map.landmark(landmark).position).z() : 0;
    Observation o = observe(f.pixel, f.normalized, images.depth, z > 0.1 ? 1 / z : 0);
    o.track = f.id;
    if (known) o.landmark = landmark;
    keyframe.observations.push_back(o);
  }
  fillOrb(images.gray, images.depth, keyframe);
  const KeyframeId id = map.addKeyframe(std::move(keyframe));
  ++counters.keyframes;
  keyframe_path[id] = path;

  covariances.add(id, covariance, map);
  createLandmarks(id);
  if (map.keyframeCount() > 1) adjustWindow(id);
  setReference(id);
  map.dropFarImages(T_map_camera, settings.max_image_keyframes);
  active_depth = std::make_unique<KeyframeDepth>(camera, images.depth, images.colour, settings.depth, settings.cloud,
                                                 &motion.rows());
  return id;
}

void Slam::Impl::createLandmarks(KeyframeId id) {
  visual_frontend::TriangulationSettings triangulation;
  triangulation.max_depth = 15.0;
  triangulation.min_depth = 0.2;
  tracks.addViews(map.keyframe(id));
  for (const auto& unplaced :
       visual_frontend::createLandmarks(id, camera, settings.pixel_sigma, triangulation, map, tracks)) {
    // Views that contradict each other belong to a track that slipped: begin anew with this one.
    if (unplaced.status == visual_frontend::TriangulationStatus::kLargeResidual)
      tracks.setViews(unplaced.track, {{id, unplaced.observation}});
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
  visual_frontend::adjustMap(map, camera, free, fixed, bundleSettings());
}

void Slam::Impl::adjustWhole() {
  visual_frontend::BundleSettings bundle = bundleSettings();
  bundle.max_iterations = 10;
  bundle.max_seconds = 2.0;
  visual_frontend::adjustFullMap(map, camera, bundle);
}

visual_frontend::BundleSettings Slam::Impl::bundleSettings() const {
  visual_frontend::BundleSettings bundle = settings.bundle;
  bundle.pixel_sigma = settings.pixel_sigma;
  bundle.use_gravity = settings.use_gravity && leveled;
  return bundle;
}

}  // namespace rgbd_slam
