#include "pose_tracker.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/covariance.h"
#include "air_ground_common/statistics.h"
#include "visual_frontend/local_landmarks.h"

namespace mav_vo {

using air_ground_common::logSO3;
using air_ground_common::quantile;
using visual_frontend::Feature;
using visual_frontend::kNoLandmark;
using visual_frontend::LandmarkId;
using visual_frontend::PoseCorrespondence;

namespace {

constexpr double kMinInlierShare = 0.35;  // of the tracked landmarks; below, the pose is not believed
constexpr int kLocalKeyframes = 8;        // nearest ones, whose landmarks are looked for
constexpr double kEqualShare = 0.6;       // so many of the best motion's landmarks make another one its equal
constexpr double kOtherMotion = 4.0;      // median shift of the landmarks between two motions that are not one [sigma]
constexpr double kClearlyNearer = 0.5;    // to the prediction than the other motion
constexpr double kSteadyReadouts = 3;     // time over which the motion during an image is averaged [readout times]

/// How far the landmarks shift in the image between two poses, in the median [sigma].
double shiftBetween(const Pose& a, const Pose& b, const std::vector<PoseCorrespondence>& points) {
  const Pose T_a = a.inverse(), T_b = b.inverse();
  std::vector<double> shifts;
  for (const PoseCorrespondence& c : points) {
    const Eigen::Vector3d p_a = T_a * c.p_map, p_b = T_b * c.p_map;
    if (p_a.z() > 0 && p_b.z() > 0) shifts.push_back((p_a.hnormalized() - p_b.hnormalized()).norm() / c.sigma);
  }
  return quantile(shifts, 0.5);
}

}  // namespace

PoseTracker::PoseTracker(const CameraModel& camera, const OdometrySettings& settings, const visual_frontend::Map& map,
                         visual_frontend::LandmarkTracks& tracks, GyroRotations turn)
    : camera_(camera),
      settings_(settings),
      map_(map),
      tracks_(tracks),
      turn_(std::move(turn)),
      tracker_(camera, settings.tracker),
      shutter_(camera, settings.readout_time) {}

void PoseTracker::setCamera(const CameraModel& camera) {
  camera_ = camera;
  tracker_.setCamera(camera);
  shutter_.setCamera(camera);
}

void PoseTracker::reset() {
  tracker_.reset();
  beginMap(Pose::Identity(), Eigen::Vector3d::Zero());
  motion_ = steady_ = {};
  intervals_.clear();
  depth_min_ = depth_max_ = 0;
}

void PoseTracker::beginMap(const Pose& T_map_camera, const Eigen::Vector3d& velocity) {
  T_map_camera_ = T_map_camera;
  motion_.velocity = steady_.velocity = velocity;
  located_stamp_ = -1;
  scene_distance_ = 1;
}

void PoseTracker::followShutter(double stamp, const Pose& predicted) {
  if (!shutter_.active()) return;
  const double half = 0.5 * std::abs(shutter_.readoutTime());
  const auto turn = turn_(stamp - half, stamp + half);
  shutter_.setMotion(turn ? Eigen::Vector3d(logSO3(turn->R_a_b) / (2 * half)) : steady_.turn_rate,
                     predicted.linear().transpose() * steady_.velocity);
}

// Where the camera should be at this image, and where its features.
Pose PoseTracker::predict(double last_stamp, double stamp, bool tracking,
                          visual_frontend::TrackPrediction* prediction) {
  Pose predicted = T_map_camera_;
  if (R_previous_current_) prediction->R_current_previous = R_previous_current_->transpose();
  predicted_ = tracking && located_stamp_ == last_stamp;
  if (predicted_) {
    predicted.translation() += motion_.velocity * (stamp - located_stamp_);
    const Eigen::Matrix3d turn = R_previous_current_
                                     ? *R_previous_current_
                                     : air_ground_common::expSO3(motion_.turn_rate * (stamp - located_stamp_));
    predicted.linear() = T_map_camera_.linear() * turn;
    prediction->R_current_previous = turn.transpose();
  }
  followShutter(stamp, predicted);
  if (!predicted_) return predicted;
  const Pose T_camera_map = predicted.inverse();
  for (const Feature& f : tracker_.features()) {
    const LandmarkId id = tracks_.landmarkIn(map_, f.id);
    if (id == kNoLandmark) continue;
    const Eigen::Vector3d p_camera = T_camera_map * map_.landmark(id).position;
    if (const auto pixel = camera_.project(p_camera)) prediction->pixels[f.id] = shutter_.toItsRow(*pixel, p_camera);
  }
  return predicted;
}

void PoseTracker::track(double last_stamp, double stamp, const cv::Mat& gray, bool tracking) {
  R_previous_current_.reset();
  if (last_stamp >= 0)
    if (const auto turn = turn_(last_stamp, stamp)) R_previous_current_ = turn->R_a_b;
  visual_frontend::TrackPrediction prediction;
  const Pose predicted = predict(last_stamp, stamp, tracking, &prediction);
  tracker_.track(gray, prediction);
  T_map_camera_ = predicted;
}

Eigen::Vector2d PoseTracker::rayOf(const Feature& feature) const {
  if (!shutter_.active()) return feature.normalized;
  double inverse_depth = 0;
  if (map_.keyframeCount() > 0) {
    const LandmarkId id = tracks_.landmarkIn(map_, feature.id);
    const double depth =
        id != kNoLandmark ? (T_map_camera_.inverse() * map_.landmark(id).position).z() : scene_distance_;
    if (depth > 0.1 * scene_distance_) inverse_depth = 1 / depth;
  }
  return shutter_.toMiddleRow(feature.pixel, feature.normalized, inverse_depth);
}

std::vector<Feature> PoseTracker::currentFeatures() const {
  std::vector<Feature> features = tracker_.features();
  if (shutter_.active())
    for (Feature& f : features) f.normalized = rayOf(f);
  return features;
}

std::vector<visual_frontend::Observation> PoseTracker::observations() const {
  std::vector<visual_frontend::Observation> observations;
  for (const Feature& f : currentFeatures())
    observations.push_back({tracks_.landmarkIn(map_, f.id), f.id, f.pixel, f.normalized});
  return observations;
}

std::vector<PoseCorrespondence> PoseTracker::correspondences(std::vector<TrackId>* seen) const {
  std::vector<PoseCorrespondence> list;
  for (const Feature& f : tracker_.features()) {
    const LandmarkId id = tracks_.landmarkIn(map_, f.id);
    if (id == kNoLandmark) continue;
    const Eigen::Vector2d ray = rayOf(f);
    const auto noise = camera_.normalizedNoise(ray, settings_.pixel_sigma);
    list.push_back({map_.landmark(id).position, ray, noise.sigma, 0, 0, noise.elongation});
    seen->push_back(f.id);
  }
  return list;
}

PoseResult PoseTracker::solve(const Correspondences& points, const std::optional<double>& turn_sigma) const {
  PoseResult result;
  // A known turn leaves three unknowns of six: half as many landmarks agree by chance as rarely.
  const int needed = turn_sigma ? (settings_.min_inliers + 1) / 2 : settings_.min_inliers;
  const double believed = kMinInlierShare * static_cast<double>(points.size());
  if (static_cast<int>(points.size()) < needed) {
    result.reason = "only " + std::to_string(points.size()) + " known landmarks in view, " + std::to_string(needed) +
                    " needed: move more slowly, or turn back to known ground";
    return result;
  }
  result = search(points, turn_sigma.has_value());
  if (!result.success || !chooseMotion(points, turn_sigma.has_value(), &result)) return result;
  visual_frontend::RefineSettings refine;
  if (turn_sigma) {
    refine.R_map_camera_prior = T_map_camera_.linear();
    refine.rotation_prior_sigma = *turn_sigma;
  }
  result = visual_frontend::refinePose(points, result.T_map_camera, refine, result.inliers);
  if (result.success && (result.inlier_count < needed || result.inlier_count < believed)) {
    result.success = false;
    result.reason = std::to_string(result.inlier_count) + " of " + std::to_string(points.size()) +
                    " landmarks agree on a pose: something large moves in view, or the image is blurred";
  }
  return result;
}

// A start for the refinement, and the landmarks that agree with it.
PoseResult PoseTracker::search(const Correspondences& points, bool turn_known) const {
  visual_frontend::RansacSettings ransac;
  ransac.seed = settings_.seed;
  ransac.min_inliers = settings_.min_inliers / 2;
  ransac.threshold = 4.0;
  PoseResult result;
  if (turn_known) result = visual_frontend::ransacKnownRotation(points, T_map_camera_.linear(), ransac);
  if (!result.success || result.inlier_count < kMinInlierShare * static_cast<double>(points.size()))
    result = visual_frontend::ransacPose(points, ransac);
  return result;
}

// Something large may move in view, with as many landmarks on it as on what stands still: then not the number of the
// landmarks but the way on which the camera was tells which motion is its own. False, with the reason, where it does
// not: no pose is better than one that is carried off.
bool PoseTracker::chooseMotion(const Correspondences& points, bool turn_known, PoseResult* found) const {
  Correspondences rest;
  std::vector<std::size_t> at;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (found->inliers[i]) continue;
    rest.push_back(points[i]);
    at.push_back(i);
  }
  const double needed = std::max(kEqualShare * found->inlier_count, 1.0 * settings_.min_inliers);
  if (static_cast<double>(rest.size()) < needed) return true;
  PoseResult other = search(rest, turn_known);
  if (!other.success || other.inlier_count < needed) return true;
  if (shiftBetween(found->T_map_camera, other.T_map_camera, points) < kOtherMotion) return true;
  const double first = shiftBetween(T_map_camera_, found->T_map_camera, points),
               second = shiftBetween(T_map_camera_, other.T_map_camera, points);
  if (predicted_ && first < kClearlyNearer * second) return true;
  if (!predicted_ || !(second < kClearlyNearer * first)) {
    found->success = false;
    found->reason = std::to_string(found->inlier_count) + " and " + std::to_string(other.inlier_count) + " of " +
                    std::to_string(points.size()) + " landmarks tell of two motions: something large moves in view";
    return false;
  }
  std::vector<unsigned char> inliers(points.size(), 0);
  for (std::size_t i = 0; i < at.size(); ++i) inliers[at[i]] = other.inliers[i];
  other.inliers = std::move(inliers);
  *found = std::move(other);
  return true;
}

bool PoseTracker::locate(const std::optional<double>& turn_sigma) {
  std::vector<TrackId> seen;
  const auto points = correspondences(&seen);
  result_ = solve(points, turn_sigma);
  if (!result_.success) return false;
  T_map_camera_ = result_.T_map_camera;
  std::vector<TrackId> wrong;
  std::vector<double> depths;
  const Pose T_camera_map = T_map_camera_.inverse();
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (!result_.inliers[i])
      wrong.push_back(seen[i]);
    else
      depths.push_back((T_camera_map * points[i].p_map).z());
  }
  tracker_.remove(wrong);
  for (const TrackId id : wrong) tracks_.release(id);
  scene_distance_ = quantile(depths, 0.5);
  depth_min_ = quantile(depths, 0.05);
  depth_max_ = quantile(depths, 0.95);
  return true;
}

void PoseTracker::settle(double stamp, const std::optional<Pose>& T_map_previous) {
  const double dt = stamp - located_stamp_;
  if (!T_map_previous) {
    motion_ = steady_ = {};
  } else if (!intervals_.tooShort(dt)) {  // else the camera is taken to go on as before
    motion_.velocity = (T_map_camera_.translation() - T_map_previous->translation()) / dt;
    motion_.turn_rate = logSO3(T_map_previous->linear().transpose() * T_map_camera_.linear()) / dt;
    // What is wrong with a pose is wrong with the next one's rows, and that, by as much and more, with its pose: where
    // an image is read out for more than a third of the time to the next, motions of two poses swing up within seconds.
    const double share = dt / std::max(dt, kSteadyReadouts * std::abs(shutter_.readoutTime()));
    steady_.velocity += share * (motion_.velocity - steady_.velocity);
    steady_.turn_rate += share * (motion_.turn_rate - steady_.turn_rate);
  }
  if (T_map_previous) intervals_.add(dt);
  previous_covariance_ = result_.covariance;
  located_stamp_ = stamp;
}

void PoseTracker::realign() {
  visual_frontend::realignTracks(map_, tracks_, T_map_camera_, scene_distance_, settings_.realignment, &tracker_);
}

void PoseTracker::reobserve(const visual_frontend::ReobservationSettings& how) {
  const auto candidates = visual_frontend::untrackedLandmarks(map_, tracks_, tracker_.features(), T_map_camera_,
                                                              kLocalKeyframes, scene_distance_);
  std::vector<Eigen::Vector2d> occupied;
  for (const Feature& f : tracker_.features()) occupied.push_back(f.pixel);
  for (const auto& match :
       visual_frontend::reobserve(map_, camera_, tracker_.pyramid(), T_map_camera_, candidates, occupied, how)) {
    const TrackId track = tracker_.addFeature(match.pixel);
    if (track != visual_frontend::kNoTrack) tracks_.assign(track, match.landmark);
  }
}

void PoseTracker::coast(double dt) {
  T_map_camera_.translation() += motion_.velocity * dt;
  T_map_camera_.linear() =
      T_map_camera_.linear() *
      (R_previous_current_ ? *R_previous_current_ : air_ground_common::expSO3(motion_.turn_rate * dt));
}

void PoseTracker::beginAround(const Pose& T_map_camera, const cv::Mat& gray,
                              const visual_frontend::ReobservationSettings& how) {
  T_map_camera_ = T_map_camera;
  predicted_ = false;
  for (const Feature& f : tracker_.features()) tracks_.release(f.id);
  tracker_.reset();
  tracker_.track(gray);
  reobserve(how);
}

void PoseTracker::transform(const air_ground_common::Similarity& S) {
  for (Motion* motion : {&motion_, &steady_}) motion->velocity = S.scale * (S.R * motion->velocity);
  scene_distance_ *= S.scale;
  depth_min_ *= S.scale;
  depth_max_ *= S.scale;
  for (Matrix6d* covariance : {&result_.covariance, &previous_covariance_})
    *covariance = air_ground_common::transformed(*covariance, S);
}

}  // namespace mav_vo
