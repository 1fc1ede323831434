// Pose of a frame: KLT tracks of landmarks, P2P RANSAC with the gyro's rotation, motion-only refinement, and search for
// landmarks of the local map that have no track.
#include <algorithm>
#include <cmath>

#include "slam_impl.h"
#include "visual_frontend/local_landmarks.h"
#include "visual_frontend/pose_solver.h"

namespace rgbd_slam {

namespace {

constexpr double kGap = 1.0;  // without an image, after which nothing is known of what the camera saw between [s]

}  // namespace

Pose Slam::Impl::predict(double stamp, bool* from_gyro) const {
  return motion.predict(frames.lastStamp(), lastPose(), stamp, from_gyro);
}

Observation Slam::Impl::observe(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                double inverse_depth) const {
  Observation o;
  o.pixel = pixel;
  if (const auto z = sampleDepth(depth, pixel, settings.depth)) {
    const Eigen::Vector3d p = motion.rows().pointToMiddleRow(pixel.y(), *z * normalized.homogeneous());
    if (p.z() > 0.5 * *z) {
      o.normalized = p.hnormalized();
      o.depth = p.z();
      o.depth_sigma = settings.depth.sigma(*z);
      return o;
    }
  }
  o.normalized = motion.rows().toMiddleRow(pixel, normalized, inverse_depth);
  return o;
}

PoseCorrespondence Slam::Impl::correspondence(LandmarkId landmark, const Eigen::Vector2d& pixel,
                                              const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                              const Pose& T_camera_map) const {
  PoseCorrespondence c;
  c.p_map = map.landmark(landmark).position;
  const double z = (T_camera_map * c.p_map).z();
  const Observation seen = observe(pixel, normalized, depth, z > 0.1 ? 1 / z : 0);
  c.normalized = seen.normalized;
  const auto noise = camera.normalizedNoise(seen.normalized, settings.pixel_sigma);
  c.sigma = noise.sigma;
  c.elongation = noise.elongation;
  c.depth = seen.depth;
  c.depth_sigma = seen.depth_sigma;
  return c;
}

PoseResult Slam::Impl::solve(const std::vector<PoseCorrespondence>& c, const Pose& predicted,
                             bool rotation_known) const {
  visual_frontend::RefineSettings refine;
  visual_frontend::RansacSettings ransac;
  ransac.min_inliers = std::min<int>(settings.min_inliers, 10);
  Pose start = predicted;
  if (rotation_known) {
    // Two points a sample; the threshold leaves room for the gyro's error over a frame.
    ransac.threshold = 4;
    const PoseResult two_point = visual_frontend::ransacKnownRotation(c, predicted.linear(), ransac);
    if (two_point.success) start = two_point.T_map_camera;
  }
  PoseResult result = visual_frontend::refinePose(c, start, refine);
  if (result.success && result.inlier_count > 0.6 * c.size()) return result;
  ransac.threshold = 2.8;
  const PoseResult three_point = visual_frontend::ransacPose(c, ransac);
  if (!three_point.success) return result;
  const PoseResult second = visual_frontend::refinePose(c, three_point.T_map_camera, refine);
  return second.success && (!result.success || second.inlier_count > result.inlier_count) ? second : result;
}

void Slam::Impl::trackFeatures(const Images& images, const Pose& T_map_predicted) {
  visual_frontend::TrackPrediction prediction;
  prediction.R_current_previous = T_map_predicted.linear().transpose() * lastPose().linear();
  const Pose T_camera_map = T_map_predicted.inverse();
  motion.setRowMotion(images.stamp, T_map_predicted);
  tracks.forgetMissing(map);
  for (const Feature& f : tracker.features()) {
    const LandmarkId landmark = tracks.landmarkOf(f.id);
    if (landmark == kNoLandmark) continue;
    const Eigen::Vector3d p_camera = T_camera_map * map.landmark(landmark).position;
    const auto pixel = camera.project(p_camera);
    if (pixel && camera.contains(*pixel)) prediction.pixels[f.id] = motion.rows().toItsRow(*pixel, p_camera);
  }
  tracker.track(images.gray, prediction);
  tracks.keep(tracker.features());
}

std::string Slam::Impl::objection(double stamp, const PoseResult& pose, std::size_t landmarks) const {
  if (!pose.success || pose.inlier_count < settings.min_inliers ||
      pose.inlier_count < settings.min_inlier_ratio * landmarks)
    return std::to_string(landmarks) + " landmarks tracked, " + std::to_string(pose.inlier_count) + " agree on a pose";
  const double speed =
      (pose.T_map_camera.translation() - lastPose().translation()).norm() / (stamp - frames.lastStamp());
  return speed > settings.max_speed ? "the camera would have moved at " + std::to_string(speed) + " m/s" : "";
}

Slam::Impl::Tracked Slam::Impl::track(const Images& images) {
  Tracked tracked;
  bool from_gyro = false;
  const Pose predicted = predict(images.stamp, &from_gyro);
  trackFeatures(images, predicted);
  std::vector<PoseCorrespondence> correspondences;
  std::vector<TrackId> ids;
  for (const Feature& f : tracker.features()) {
    if (!tracks.has(f.id)) continue;
    correspondences.push_back(
        correspondence(tracks.landmarkOf(f.id), f.pixel, f.normalized, images.depth, predicted.inverse()));
    ids.push_back(f.id);
  }
  // A rotation that may be off by more than a pixel is no known rotation.
  const double rotation_sigma = motion.rotationSigma(images.stamp - frames.lastStamp());
  tracked.pose = solve(correspondences, predicted, from_gyro && focal * rotation_sigma < 1.5);
  tracked.reason = objection(images.stamp, tracked.pose, correspondences.size());
  if (!tracked.reason.empty()) return tracked;
  std::vector<TrackId> outliers;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (tracked.pose.inliers[i]) continue;
    outliers.push_back(ids[i]);
    tracks.release(ids[i]);
  }
  tracker.remove(outliers);
  ++since_reobservation;
  if (settings.reobserve_every > 0 &&
      (since_reobservation >= settings.reobserve_every || keyframeDue(tracked.pose.T_map_camera, tracks.count()))) {
    since_reobservation = 0;
    reobserveLocalMap(tracked.pose.T_map_camera, 6.0, images.depth, &tracked.pose);
  }
  tracked.success = true;
  tracked.landmarks = tracks.count();
  return tracked;
}

void Slam::Impl::reobserveLocalMap(const Pose& around, double radius, const cv::Mat& depth, PoseResult* pose) {
  const Pose T_camera_map = around.inverse();
  std::vector<Eigen::Vector2d> occupied;
  std::vector<PoseCorrespondence> correspondences;
  for (const Feature& f : tracker.features()) {
    if (!tracks.has(f.id)) continue;
    occupied.push_back(f.pixel);
    correspondences.push_back(correspondence(tracks.landmarkOf(f.id), f.pixel, f.normalized, depth, T_camera_map));
  }
  const std::size_t tracked = correspondences.size();
  const auto candidates =
      visual_frontend::untrackedLandmarks(map, tracks, tracker.features(), around, settings.local_keyframes);
  visual_frontend::ReobservationSettings search;
  search.search_radius = radius;
  const std::vector<LandmarkMatch> matches =
      visual_frontend::reobserve(map, camera, tracker.pyramid(), around, candidates, occupied, search);
  if (matches.empty()) return;
  for (const LandmarkMatch& m : matches)
    correspondences.push_back(correspondence(m.landmark, m.pixel, m.normalized, depth, T_camera_map));
  const PoseResult refined =
      tracked > 0 ? visual_frontend::refinePose(correspondences, around, {}) : solve(correspondences, around, false);
  if (!refined.success || refined.inlier_count < pose->inlier_count) return;
  std::vector<LandmarkMatch> agreeing;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (refined.inliers[tracked + i]) agreeing.push_back(matches[i]);
  }
  startTracks(agreeing);
  *pose = refined;
}

void Slam::Impl::startTracks(const std::vector<LandmarkMatch>& matches) {
  // Tracks that may turn out to be one of the landmarks. Copies: starting tracks moves the features.
  std::vector<std::pair<TrackId, Eigen::Vector2d>> loose;
  for (const Feature& f : tracker.features()) {
    if (!tracks.has(f.id)) loose.emplace_back(f.id, f.pixel);
  }
  for (const LandmarkMatch& match : matches) {
    TrackId track = kNoTrack;
    for (const auto& [id, pixel] : loose) {
      if ((pixel - match.pixel).squaredNorm() < 2.0 * 2.0 && !tracks.has(id)) track = id;
    }
    if (track == kNoTrack) track = tracker.addFeature(match.pixel);
    if (track != kNoTrack) tracks.assign(track, match.landmark);
  }
}

Slam::Impl::Tracked Slam::Impl::accept(const Images& images, const Pose& around, double radius) {
  Tracked found;
  reobserveLocalMap(around, radius, images.depth, &found.pose);
  found.landmarks = tracks.count();
  found.success = found.pose.success && found.landmarks >= settings.min_inliers;
  if (!found.success) {
    tracker.reset();
    tracker.track(images.gray);
    tracks.clear();
    found.reason = "a place was recognised but too few of its landmarks were found";
  }
  return found;
}

visual_frontend::PlaceMatch Slam::Impl::recognize(const Images& images) {
  Keyframe query;
  fillOrb(images.gray, images.depth, query);
  const auto with_depth = std::count_if(query.orb_depth.begin(), query.orb_depth.end(), [](double z) { return z > 0; });
  if (with_depth >= settings.min_start_features) strange_for += since_attempt;
  visual_frontend::RelocalizationGate gate;
  gate.T_map_last = lastPose();
  gate.max_distance = settings.relocalization_slack + settings.max_speed * (images.stamp - frames.lastStamp());
  if (gravity_known && motion.attitude().initialized()) {
    gate.up_camera = motion.upInCamera();
    gate.max_tilt = std::max(gate.max_tilt, 3 * motion.attitude().upSigma());
  }
  return visual_frontend::relocalize(map, camera, query, gate, settings.place);
}

Slam::Impl::Tracked Slam::Impl::relocalize(const Images& images) {
  Tracked tracked;
  const double stamp = images.stamp;
  tracker.reset();
  tracks.clear();
  // Descriptors of the whole image against the whole map take longer than an image may.
  if (state == State::kLost && !nearly_found && stamp - last_attempt < settings.relocalization_interval - 1e-3) {
    tracked.reason = lost_reason;
    return tracked;
  }
  // What passed in a gap of the images is not known to be strange.
  since_attempt = last_attempt >= 0 && stamp - last_attempt <= kGap ? stamp - last_attempt : 0;
  last_attempt = stamp;
  ++counters.relocalization_attempts;
  motion.setRowMotion(stamp, lastPose());
  tracker.track(images.gray);
  // Not far from where it was: the gyro still knows the rotation.
  bool from_gyro = false;
  if (stamp - frames.lastStamp() < 0.5) tracked = accept(images, predict(stamp, &from_gyro), 16.0);
  if (from_gyro && !tracked.success) tracked = accept(images, lastPose(), 16.0);  // a gyro may be wrong
  if (tracked.success) return tracked;
  const visual_frontend::PlaceMatch match = recognize(images);
  if (match.success)
    tracked = accept(images, map.keyframe(match.keyframe).T_map_camera * match.T_place_query, 10.0);
  else
    tracked.reason = "lost: " + match.reason;
  lost_reason = tracked.reason;
  nearly_found = match.success || match.inliers > 0.6 * settings.place.min_inliers;
  return tracked;
}

}  // namespace rgbd_slam
