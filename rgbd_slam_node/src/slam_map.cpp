// The map of the SLAM. Landmarks start from measured depth, also while the camera only turns (paper, section IV), and
// from parallax where the sensor sees no depth.
#include <algorithm>
#include <utility>

#include "slam_impl.h"
#include "visual_frontend/bundle_job.h"
#include "visual_frontend/image_memory.h"
#include "visual_frontend/local_landmarks.h"

namespace rgbd_slam {

namespace {

constexpr int kMostLinks = 3;                 // of a new keyframe to others by their surfaces
constexpr std::size_t kMostCalibrating = 40;  // keyframes that tell of the calibration, the newest
constexpr int kWholeIterations = 10;          // of an adjustment of the whole map
constexpr double kMaxWholeSeconds = 2;        // and its wall clock while the frames wait [s]
constexpr double kMaxBesideSeconds = 20;      // beside the tracking [s]
constexpr double kNoLimit = 600;              // where a slow machine shall give the same [s]
constexpr int kMostLookedThrough = 6;         // keyframes of a view, one each frame: a millisecond of work

bool contains(const std::vector<KeyframeId>& list, KeyframeId id) {
  return std::find(list.begin(), list.end(), id) != list.end();
}

/// Adds a keyframe that is not in the list, as long as there is room.
void addOnce(KeyframeId id, int most, std::vector<KeyframeId>* list) {
  if (static_cast<int>(list->size()) < most && !contains(*list, id)) list->push_back(id);
}

}  // namespace

void Slam::Impl::addToMap(const RgbdImages& images, const TrackedPose& tracked, SlamResult* result) {
  const Pose& T_map_camera = tracked.pose.T_map_camera;
  const KeyframeId known = keyframeOfView(images, tracked, result->relocalized);
  if (known == kNoKeyframe) {
    const KeyframeId id = addKeyframe(images, tracked);
    result->keyframe = true;
    frames.add(images.stamp, map.keyframe(id).T_map_camera, id, map);
    if (settings.loop_closure) result->map_corrected = closeLoop(id);
    removeReplacedBy(id);
    if (result->map_corrected) motion.moveMap(lastPose() * T_map_camera.inverse());
    return;
  }
  if (known != reference.id()) setReference(known);
  frames.add(images.stamp, T_map_camera, known, map);
  const Pose T_reference_camera = map.keyframe(known).T_map_camera.inverse() * T_map_camera;
  dense.fuse(images.depth, T_reference_camera.inverse(), motion.rows());
  if (!tracked.by_depth) result->points_gone = lookThrough(images.depth, T_map_camera);
}

bool Slam::Impl::lookThrough(const cv::Mat& depth, const Pose& T_map_camera) {
  // Keyframes that share landmarks are right to each other: of others a wrong pose would be seen through, too.
  std::vector<KeyframeId> sharing{reference.id()};
  for (const auto& c : map.covisible(reference.id(), 2 * settings.min_inliers))
    addOnce(c.keyframe, kMostLookedThrough, &sharing);
  const KeyframeId id = sharing[counters.frames % sharing.size()];
  return dense.lookThrough(id, depth, T_map_camera.inverse() * map.keyframe(id).T_map_camera, motion.rows());
}

KeyframeId Slam::Impl::keyframeOfView(const RgbdImages& images, const TrackedPose& tracked, bool relocalized) {
  const Pose& T_map_camera = tracked.pose.T_map_camera;
  if (tracked.by_depth) {
    // In the light again: what is there to see becomes landmarks.
    tracking.tracker().replenish();
    const bool begin_anew = reference.hasFewLandmarks(map) && featuresWithDepth(images) >= settings.min_start_features;
    return begin_anew ? kNoKeyframe : reference.nearest(map, T_map_camera);
  }
  const bool due = relocalized || reference.due(map, T_map_camera, tracked.landmarks);
  return due ? reference.ofView(map, tracks, T_map_camera, tracked.landmarks) : reference.id();
}

int Slam::Impl::featuresWithDepth(const RgbdImages& images) const {
  const auto& features = tracking.tracker().features();
  return static_cast<int>(std::count_if(features.begin(), features.end(), [&](const visual_frontend::Feature& f) {
    return sampleDepth(images.depth, f.pixel, settings.depth).has_value();
  }));
}

void Slam::Impl::setReference(KeyframeId id) {
  dense.finish();
  reference.set(map, id);
  tracking.postponeReobservation();
}

void Slam::Impl::removeReplacedBy(KeyframeId id) {
  for (const auto& c : map.covisible(id, 2 * settings.min_inliers)) {
    // The first one is the origin; the latest may hold what is tracked.
    if (c.keyframe == map.keyframes().begin()->first || c.keyframe + settings.loop_min_gap > id) continue;
    if (!reference.same(map, c.keyframe, id)) continue;
    frames.rebase(c.keyframe, id, map);
    tracks.forgetKeyframe(c.keyframe);
    covariances.forget(c.keyframe);
    loops.replace(c.keyframe, id);
    dense.forget(c.keyframe);
    surfaces.replace(c.keyframe, id, map);
    map.removeKeyframe(c.keyframe);
  }
}

KeyframeId Slam::Impl::addKeyframe(const RgbdImages& images, const TrackedPose& tracked) {
  const Pose& T_map_camera = tracked.pose.T_map_camera;
  tracking.tracker().replenish();
  Keyframe keyframe;
  keyframe.stamp = images.stamp;
  keyframe.T_map_camera = T_map_camera;
  keyframe.pyramid = tracking.tracker().pyramid();
  if (const auto up = level.upInCamera(images.stamp, T_map_camera.linear(), motion)) {
    keyframe.up_camera = up->first;
    keyframe.up_sigma = up->second;
  }
  keyframe.observations = tracking.observations(T_map_camera, images.depth);
  describe(images, keyframe);
  const KeyframeId id = map.addKeyframe(std::move(keyframe));
  ++counters.keyframes;
  loops.add(id);
  covariances.add(id, tracked.pose.covariance, map);
  createLandmarks(id);
  if (settings.use_surfaces) {
    surfaces.add(id, surfaces.surfaceOf(images.depth, motion.rows()));
    linkBySurfaces(id);
    if (tracked.by_depth) surfaces.tie(id, reference.id(), tracked.pose.covariance, map);
  }
  if (map.keyframeCount() > 1) adjustWindow(id);
  setReference(id);
  map.dropFarImages(T_map_camera,
                    visual_frontend::imagesKept(tracking.tracker().pyramid(), settings.max_image_keyframes));
  dense.begin(id, images.stamp, images.depth, images.colour, map.keyframe(id).T_map_camera, motion.rows());
  return id;
}

void Slam::Impl::describe(const RgbdImages& images, Keyframe& keyframe) const {
  visual_frontend::describeKeyframe(images.gray, camera, settings.place, keyframe);
  for (std::size_t i = 0; i < keyframe.orb_pixels.size(); ++i) {
    const auto seen =
        observe(keyframe.orb_pixels[i], keyframe.orb_normalized[i], images.depth, settings.depth, motion.rows());
    keyframe.orb_normalized[i] = seen.normalized;
    keyframe.orb_depth.push_back(seen.depth);
  }
}

void Slam::Impl::createLandmarks(KeyframeId id) {
  visual_frontend::TriangulationSettings triangulation;
  // What counts as a feature with depth makes a landmark, a noisy last metre aside.
  triangulation.max_depth = std::max(15.0, 1.1 * settings.depth.max_range);
  triangulation.min_depth = std::min(0.2, 0.9 * settings.depth.min_range);
  tracks.addViews(map.keyframe(id));
  for (const auto& unplaced :
       visual_frontend::createLandmarks(id, camera, settings.pixel_sigma, triangulation, map, tracks)) {
    // Views that contradict each other belong to a track that slipped: begin anew with this one.
    if (unplaced.status == visual_frontend::TriangulationStatus::kLargeResidual)
      tracks.setViews(unplaced.track, {{id, unplaced.observation}});
  }
}

void Slam::Impl::linkBySurfaces(KeyframeId id) {
  if (reference.id() == kNoKeyframe) return;
  std::vector<KeyframeId> others{reference.id()};
  for (const auto& c : map.covisible(id, 2 * settings.min_inliers)) addOnce(c.keyframe, kMostLinks, &others);
  for (const KeyframeId other : surfaces.linkedTo(reference.id())) addOnce(other, kMostLinks, &others);
  surfaces.link(id, others, map);
}

bool Slam::Impl::closeLoop(KeyframeId id) {
  const LoopCloser::Outcome outcome = loops.close(id, level.known(), covariances, map, tracks);
  const bool corrected = outcome == LoopCloser::Outcome::kCorrected;
  counters.loops_refused += outcome == LoopCloser::Outcome::kRefused;
  if (corrected || outcome == LoopCloser::Outcome::kMerged) ++counters.loops;
  if (outcome == LoopCloser::Outcome::kMerged) adjustWindow(id);
  if (corrected) adjustWhole();
  return corrected;
}

bool Slam::Impl::alignShutter(const RgbdImages& images) {
  const double in_use = motion.rows().readoutTime();
  const auto readout = shutter.add(images, lastPose(), tracking.tracker().features(), in_use);
  if (!readout) return false;
  const Pose T_map_before = lastPose();
  moveRows(*readout - in_use, camera, frames, map, dense, surfaces);
  motion.setReadoutTime(*readout);
  if (map.keyframeCount() > 1) adjustWholeAtOnce();
  motion.moveMap(lastPose() * T_map_before.inverse());
  return true;
}

// By the images alone: where colour and depth are not of one calibration, depth would speak for the wrong one.
bool Slam::Impl::alignCalibration() {
  if (!calibration.estimates() || map.keyframeCount() < next_calibration) return false;
  next_calibration = map.keyframeCount() + map.keyframeCount() / 2;
  std::vector<KeyframeId> newest;
  for (auto it = map.keyframes().rbegin(); it != map.keyframes().rend() && newest.size() < kMostCalibrating; ++it)
    newest.push_back(it->first);
  visual_frontend::BundleSettings images = bundleSettings();
  images.use_depth = images.use_gravity = false;
  images.max_iterations = 12;
  visual_frontend::BundleJob job =
      visual_frontend::extractBundle(map, camera, {newest.begin(), newest.end() - 1}, {newest.back()}, images);
  const auto velocity = [this](double stamp) { return frames.velocityAt(stamp, map); };
  job.for_calibration = true;
  calibration.open(velocity, map, &job);
  job.solve();
  if (!job.result.usable) return false;
  calibration.follow(*job.problem.calibration);
  const Pose T_map_before = lastPose();
  setCamera(calibration.camera());
  calibration.recalibrate(velocity, &map);
  surfaces.relink(map);
  shutter.distrust();
  adjustWholeAtOnce();
  motion.moveMap(lastPose() * T_map_before.inverse());
  next_calibration = map.keyframeCount() + kCalibrationKeyframes / 2;
  return true;
}

void Slam::Impl::setCamera(const CameraModel& better_known) {
  camera = better_known;
  tracking.setCamera(camera);
  loops.setCamera(camera);
  dense.recalibrate(camera);
  surfaces.setCamera(camera);
  motion.setCamera(camera);
}

// Ever more of the scene tells, so it is asked whenever the map has doubled.
std::optional<MapLevel::Correction> Slam::Impl::levelBySurfaces() {
  constexpr double kMaxTilt = 0.8;  // a camera that is carried looks down; a wall is no floor [rad]
  if (level.known() || map.keyframeCount() < next_levelling) return std::nullopt;
  next_levelling = 2 * map.keyframeCount();
  const auto up = verticalOfSurfaces(surfaces.patches(map), kMaxTilt);
  if (!up) return std::nullopt;
  return level.takeSurfaces(*up, firstBase());
}

bool Slam::Impl::levelMap() {
  auto correction = level.update(last_stamp, motion, lastPose(), firstBase());
  if (!correction) correction = levelBySurfaces();
  if (!correction) return false;
  air_ground_common::Similarity S;
  S.R = correction->R;
  map.transform(S);
  covariances.transform(S);
  motion.turn(S.R);
  if (correction->directions_false)
    for (const auto& entry : map.keyframes()) map.keyframe(entry.first).up_camera.reset();
  if (whole.runs()) adjustWhole();
  return true;
}

void Slam::Impl::adjustWindow(KeyframeId id) {
  std::vector<KeyframeId> free{id};
  for (const auto& c : map.covisible(id, 10)) addOnce(c.keyframe, settings.window, &free);
  for (const KeyframeId other : surfaces.linkedTo(id)) addOnce(other, settings.window, &free);
  std::vector<KeyframeId> fixed;
  for (const auto& c : map.observers(map.landmarksOf(free), 5))
    if (!contains(free, c.keyframe)) addOnce(c.keyframe, settings.window_fixed, &fixed);
  for (const KeyframeId moving : free)
    for (const KeyframeId other : surfaces.linkedTo(moving))
      if (!contains(free, other)) addOnce(other, settings.window_fixed, &fixed);
  // The first keyframe defines the map; with nothing outside the window the oldest inside holds it.
  const auto oldest = std::min_element(free.begin(), free.end());
  if (*oldest == map.keyframes().begin()->first || fixed.empty()) {
    fixed.push_back(*oldest);
    free.erase(oldest);
  }
  if (free.empty()) return;
  visual_frontend::BundleJob job =
      visual_frontend::extractBundle(map, camera, free, fixed, bundleSettings(), surfaces.links());
  job.solve();
  visual_frontend::applyBundle(job, map);
}

visual_frontend::BundleJob Slam::Impl::wholeMap() const {
  visual_frontend::BundleSettings bundle = bundleSettings();
  bundle.max_iterations = kWholeIterations;
  return visual_frontend::extractWholeMap(map, camera, bundle, surfaces.links());
}

void Slam::Impl::adjustWholeAtOnce() {
  whole.discard();
  visual_frontend::BundleJob job = wholeMap();
  if (!settings.reproducible) job.settings.max_seconds = kMaxWholeSeconds;
  job.solve();
  visual_frontend::applyBundle(job, map);
}

void Slam::Impl::adjustWhole() {
  if (settings.synchronous) return adjustWholeAtOnce();
  if (whole.runs()) return whole.cancel();
  visual_frontend::BundleJob job = wholeMap();
  if (!settings.reproducible) job.settings.max_seconds = kMaxBesideSeconds;
  whole.start(std::move(job), last_stamp);
}

bool Slam::Impl::adoptWhole(double stamp) {
  if (!whole.due(stamp)) return false;
  if (!whole.cancelled()) return takeWhole();
  whole.discard();
  adjustWhole();
  return false;
}

bool Slam::Impl::takeWhole() {
  const Pose T_map_before = lastPose();
  if (whole.cancelled()) {
    adjustWholeAtOnce();
  } else {
    const visual_frontend::BundleJob job = whole.await();
    if (!job.result.usable) return false;
    visual_frontend::applyBundle(job, map);
  }
  motion.moveMap(lastPose() * T_map_before.inverse());
  shutter.interrupt();
  return true;
}

visual_frontend::BundleSettings Slam::Impl::bundleSettings() const {
  visual_frontend::BundleSettings bundle = settings.bundle;
  bundle.pixel_sigma = settings.pixel_sigma;
  if (settings.reproducible) bundle.max_seconds = kNoLimit;
  bundle.use_gravity = settings.use_gravity && level.known() && level.settled();
  return bundle;
}

}  // namespace rgbd_slam
