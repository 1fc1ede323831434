// Pose of a frame: KLT tracks of landmarks, P2P RANSAC with the gyro's rotation, motion-only refinement, and search for
// landmarks of the local map that have no track.
#include <algorithm>
#include <cmath>

#include "slam_impl.h"
#include "visual_frontend/pose_solver.h"

namespace rgbd_slam {

using air_ground_common::expSO3;
using air_ground_common::logSO3;

namespace {

constexpr double kGap = 1.0;  // without an image, after which nothing is known of what the camera saw between [s]

}  // namespace

Pose Slam::Impl::predict(double stamp, bool* from_gyro) const {
  Pose T = lastPose();
  const double dt = stamp - frames.lastStamp();
  *from_gyro = false;
  if (mounting.R_base_imu) {
    if (const auto R = imu.integrateRotation(frames.lastStamp(), stamp, gyro_bias)) {
      T.linear() = T.linear() * (R_camera_imu * *R * R_camera_imu.transpose());
      *from_gyro = true;
    }
  }
  if (!*from_gyro && dt < 0.5) T.linear() = T.linear() * expSO3(turn_rate * dt);
  if (dt < 0.5) T.translation() += velocity * dt;
  return T;
}

void Slam::Impl::updateMotion(double dt, const Pose& T_before, const Pose& T_now) {
  velocity = (T_now.translation() - T_before.translation()) / dt;
  turn_rate = logSO3(T_before.linear().transpose() * T_now.linear()) / dt;
}

void Slam::Impl::setRowMotion(double stamp, const Pose& T_map_camera) {
  if (!rows.active()) return;
  Eigen::Vector3d rate = turn_rate, v_map = velocity;
  const double half = std::max(0.5 * std::abs(settings.readout_time), 0.01);
  if (mounting.R_base_imu) {
    const auto mean = imu.mean(stamp - half, stamp + half);
    if (mean.count > 0) rate = R_camera_imu * (mean.angular_velocity - gyro_bias);
    if (const auto v = inertial.cameraVelocity(stamp, imu)) v_map = *v;
  }
  rows.setMotion(rate, T_map_camera.linear().transpose() * v_map);
}

Observation Slam::Impl::observe(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                double inverse_depth) const {
  Observation o;
  o.pixel = pixel;
  if (const auto z = sampleDepth(depth, pixel, settings.depth)) {
    const Eigen::Vector3d p = rows.pointToMiddleRow(pixel.y(), *z * normalized.homogeneous());
    if (p.z() > 0.5 * *z) {
      o.normalized = p.hnormalized();
      o.depth = p.z();
      o.depth_sigma = settings.depth.sigma(*z);
      return o;
    }
  }
  o.normalized = rows.toMiddleRow(pixel, normalized, inverse_depth);
  return o;
}

PoseCorrespondence Slam::Impl::correspondence(const Eigen::Vector3d& p_map, const Eigen::Vector2d& pixel,
                                              const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                              const Pose& T_camera_map) const {
  const double z = (T_camera_map * p_map).z();
  const Observation seen = observe(pixel, normalized, depth, z > 0.1 ? 1 / z : 0);
  PoseCorrespondence c;
  c.p_map = p_map;
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

Slam::Impl::Tracked Slam::Impl::track(double stamp, const cv::Mat& gray, const cv::Mat& depth) {
  Tracked tracked;
  const Pose T_before = lastPose();
  bool from_gyro = false;
  const Pose predicted = predict(stamp, &from_gyro);
  visual_frontend::TrackPrediction prediction;
  prediction.R_current_previous = predicted.linear().transpose() * T_before.linear();
  const Pose T_camera_map = predicted.inverse();
  setRowMotion(stamp, predicted);
  for (auto it = track_landmark.begin(); it != track_landmark.end();) {
    if (!map.hasLandmark(it->second)) {
      it = track_landmark.erase(it);
      continue;
    }
    const Eigen::Vector3d p_camera = T_camera_map * map.landmark(it->second).position;
    const auto pixel = camera.project(p_camera);
    if (pixel && camera.contains(*pixel)) prediction.pixels[it->first] = rows.toItsRow(*pixel, p_camera);
    ++it;
  }
  tracker.track(gray, prediction);

  std::vector<PoseCorrespondence> correspondences;
  std::vector<TrackId> tracks;
  std::unordered_map<TrackId, LandmarkId> living;
  std::unordered_map<TrackId, std::vector<LandmarkObservation>> living_views;
  for (const Feature& f : tracker.features()) {
    const auto views = track_views.find(f.id);
    if (views != track_views.end()) living_views.insert(*views);
    const auto it = track_landmark.find(f.id);
    if (it == track_landmark.end()) continue;
    living.insert(*it);
    correspondences.push_back(
        correspondence(map.landmark(it->second).position, f.pixel, f.normalized, depth, T_camera_map));
    tracks.push_back(f.id);
  }
  track_landmark = std::move(living);
  track_views = std::move(living_views);
  // A rotation that may be off by more than a pixel is no known rotation.
  const double rotation_sigma = gyro_bias_sigma * (stamp - frames.lastStamp());
  tracked.pose = solve(correspondences, predicted, from_gyro && focal * rotation_sigma < 1.5);
  const PoseResult& pose = tracked.pose;
  if (!pose.success || pose.inlier_count < settings.min_inliers ||
      pose.inlier_count < settings.min_inlier_ratio * correspondences.size()) {
    tracked.reason = std::to_string(correspondences.size()) + " landmarks tracked, " +
                     std::to_string(pose.inlier_count) + " agree on a pose";
    return tracked;
  }
  const double speed = (pose.T_map_camera.translation() - T_before.translation()).norm() / (stamp - frames.lastStamp());
  if (speed > settings.max_speed) {
    tracked.reason = "the camera would have moved at " + std::to_string(speed) + " m/s";
    return tracked;
  }
  std::vector<TrackId> outliers;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    if (pose.inliers[i]) continue;
    outliers.push_back(tracks[i]);
    track_landmark.erase(tracks[i]);
  }
  tracker.remove(outliers);
  tracked.success = true;
  tracked.landmarks = static_cast<int>(track_landmark.size());
  ++since_reobservation;
  if (settings.reobserve_every > 0 &&
      (since_reobservation >= settings.reobserve_every || keyframeDue(pose.T_map_camera, tracked.landmarks))) {
    since_reobservation = 0;
    reobserveLocalMap(pose.T_map_camera, 6.0, depth, &tracked.pose);
    tracked.landmarks = static_cast<int>(track_landmark.size());
  }
  return tracked;
}

int Slam::Impl::reobserveLocalMap(const Pose& around, double radius, const cv::Mat& depth, PoseResult* pose) {
  const Pose T_camera_map = around.inverse();
  std::set<LandmarkId> held;
  std::vector<Eigen::Vector2d> occupied;
  std::vector<PoseCorrespondence> correspondences;
  std::vector<const Feature*> loose;  // tracks that may turn out to be one of the landmarks
  for (const Feature& f : tracker.features()) {
    const auto it = track_landmark.find(f.id);
    if (it == track_landmark.end()) {
      loose.push_back(&f);
      continue;
    }
    held.insert(it->second);
    occupied.push_back(f.pixel);
    correspondences.push_back(
        correspondence(map.landmark(it->second).position, f.pixel, f.normalized, depth, T_camera_map));
  }
  const std::size_t tracked = correspondences.size();
  std::vector<LandmarkId> candidates;
  for (const LandmarkId id : map.landmarksOf(map.nearestKeyframes(around, settings.local_keyframes))) {
    if (!held.count(id)) candidates.push_back(id);
  }
  visual_frontend::ReobservationSettings search;
  search.search_radius = radius;
  const std::vector<LandmarkMatch> matches =
      visual_frontend::reobserve(map, camera, tracker.pyramid(), around, candidates, occupied, search);
  if (matches.empty()) return 0;
  for (const LandmarkMatch& m : matches)
    correspondences.push_back(
        correspondence(map.landmark(m.landmark).position, m.pixel, m.normalized, depth, T_camera_map));
  const PoseResult refined =
      tracked > 0 ? visual_frontend::refinePose(correspondences, around, {}) : solve(correspondences, around, false);
  if (!refined.success || refined.inlier_count < pose->inlier_count) return 0;
  // Copies: starting tracks moves the features that `loose` points to.
  std::vector<std::pair<TrackId, Eigen::Vector2d>> free_tracks;
  for (const Feature* f : loose) free_tracks.emplace_back(f->id, f->pixel);
  int added = 0;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (!refined.inliers[tracked + i]) continue;
    TrackId track = kNoTrack;
    for (const auto& [id, pixel] : free_tracks) {
      if ((pixel - matches[i].pixel).squaredNorm() < 2.0 * 2.0 && !track_landmark.count(id)) track = id;
    }
    if (track == kNoTrack) track = tracker.addFeature(matches[i].pixel);
    if (track == kNoTrack) continue;
    track_landmark[track] = matches[i].landmark;
    track_views.erase(track);
    ++added;
  }
  *pose = refined;
  return added;
}

Slam::Impl::Tracked Slam::Impl::relocalize(double stamp, const cv::Mat& gray, const cv::Mat& depth) {
  Tracked tracked;
  tracker.reset();
  track_landmark.clear();
  track_views.clear();
  // Descriptors of the whole image against the whole map take longer than an image may.
  if (state == State::kLost && !nearly_found && stamp - last_attempt < settings.relocalization_interval - 1e-3) {
    tracked.reason = lost_reason;
    return tracked;
  }
  if (stamp - last_attempt > kGap) strange_since = -1;
  last_attempt = stamp;
  ++counters.relocalization_attempts;
  setRowMotion(stamp, lastPose());
  tracker.track(gray);
  const auto accept = [&](const Pose& around, double radius) {
    tracked.pose = PoseResult();
    reobserveLocalMap(around, radius, depth, &tracked.pose);
    tracked.success = tracked.pose.success && static_cast<int>(track_landmark.size()) >= settings.min_inliers;
    tracked.landmarks = static_cast<int>(track_landmark.size());
    if (!tracked.success) {
      tracker.reset();
      tracker.track(gray);
      track_landmark.clear();
    }
    return tracked.success;
  };
  // Not far from where it was: the gyro still knows the rotation.
  bool from_gyro = false;
  if (stamp - frames.lastStamp() < 0.5 && accept(predict(stamp, &from_gyro), 16.0)) return tracked;
  Keyframe query;
  fillOrb(gray, depth, query);
  const auto with_depth = std::count_if(query.orb_depth.begin(), query.orb_depth.end(), [](double z) { return z > 0; });
  if (with_depth < settings.min_start_features)
    strange_since = -1;
  else if (strange_since < 0)
    strange_since = stamp;
  visual_frontend::RelocalizationGate gate;
  gate.T_map_last = lastPose();
  gate.max_distance = settings.relocalization_slack + settings.max_speed * (stamp - frames.lastStamp());
  if (gravity_known && attitude.initialized()) {
    gate.up_camera = R_camera_imu * attitude.up();
    gate.max_tilt = std::max(gate.max_tilt, 3 * attitude.upSigma());
  }
  const visual_frontend::PlaceMatch match = visual_frontend::relocalize(map, camera, query, gate, settings.place);
  if (match.success && accept(map.keyframe(match.keyframe).T_map_camera * match.T_place_query, 10.0)) return tracked;
  tracked.success = false;
  tracked.reason =
      match.success ? "a place was recognised but too few of its landmarks were found" : "lost: " + match.reason;
  lost_reason = tracked.reason;
  nearly_found = match.success || match.inliers > 0.6 * settings.place.min_inliers;
  return tracked;
}

}  // namespace rgbd_slam
