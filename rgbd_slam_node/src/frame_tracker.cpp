#include "frame_tracker.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/covariance.h"
#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/statistics.h"
#include "visual_frontend/local_landmarks.h"

namespace rgbd_slam {

using visual_frontend::Feature;
using visual_frontend::kNoLandmark;
using visual_frontend::kNoTrack;
using visual_frontend::LandmarkMatch;
using visual_frontend::Observation;
using visual_frontend::PoseCorrespondence;
using visual_frontend::PoseResult;

namespace {

constexpr double kReobserveRadius = 6;  // of the search about where a landmark should be, while tracking [px]
constexpr double kNearRadius = 16;      // likewise just after the camera was lost [px]
constexpr double kNearSeconds = 0.5;    // so long after it was lost the camera is near where it was [s]
constexpr double kGyroSigma = 0.003;    // of a turn between frames beside the bias [rad]
constexpr double kDepthPosition = 0.02, kDepthTurn = 0.01;  // of a pose by depth, at most, in all [m], [rad]

constexpr double kUnanimous = 0.85;  // share of the landmarks that agree, above: there is nobody else to ask
constexpr double kBackground = 0.004, kBackgroundTurn = 0.002;  // by which landmarks and surfaces may differ [m], [rad]
constexpr double kChance = 22.5;  // 99.9 % of the squared errors of six numbers lie below, over their covariance

/// Along the directions that the surfaces fix the pose is another than theirs.
bool contradicts(const visual_frontend::PosePrior& surfaces, const PoseResult& pose) {
  const Pose difference = surfaces.T_map_camera.inverse() * pose.T_map_camera;
  air_ground_common::Vector6d d;
  d << difference.translation(), air_ground_common::logSO3(Eigen::Matrix3d(difference.linear()));
  // Landmarks err together, as in the covariance of the keyframes.
  Matrix6d noise = 9 * air_ground_common::aboutAxes(pose.T_map_camera.linear().transpose(), pose.covariance);
  noise.diagonal().head<3>().array() += kBackground * kBackground;
  noise.diagonal().tail<3>().array() += kBackgroundTurn * kBackgroundTurn;
  const Matrix6d& told = surfaces.information;
  const Matrix6d together = told - told * air_ground_common::inverse(told + air_ground_common::inverse(noise)) * told;
  return d.dot(together * d) > kChance;
}

/// Of a point at depth z, to move what a row sees; 0: too near to be one [1/m].
double inverseDepth(double z) { return z > 0.1 ? 1 / z : 0; }

}  // namespace

Observation observe(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized, const cv::Mat& depth,
                    const DepthModel& model, const visual_frontend::RollingShutter& rows, double inverse_depth) {
  Observation o;
  o.pixel = pixel;
  if (const auto z = sampleDepth(depth, pixel, model)) {
    const Eigen::Vector3d p = rows.pointToMiddleRow(pixel.y(), *z * normalized.homogeneous());
    if (p.z() > 0.5 * *z) {
      o.normalized = p.hnormalized();
      o.depth = p.z();
      o.depth_sigma = model.sigma(*z);
      return o;
    }
  }
  o.normalized = rows.toMiddleRow(pixel, normalized, inverse_depth);
  return o;
}

FrameTracker::FrameTracker(const CameraModel& camera, const SlamSettings& settings, const visual_frontend::Map& map,
                           const Frames& frames, visual_frontend::LandmarkTracks& tracks,
                           const KeyframeSurfaces& surfaces, CameraMotion& motion)
    : camera_(camera),
      settings_(settings),
      focal_(0.5 * (camera.fx + camera.fy)),
      map_(map),
      frames_(frames),
      tracks_(tracks),
      surfaces_(surfaces),
      motion_(motion),
      tracker_(camera, settings.tracker) {}

void FrameTracker::setCamera(const CameraModel& camera) {
  camera_ = camera;
  tracker_.setCamera(camera);
}

void FrameTracker::reset() {
  tracker_.reset();
  tracks_.clear();
}

void FrameTracker::restart(const cv::Mat& gray) {
  reset();
  tracker_.track(gray);
}

std::vector<Observation> FrameTracker::observations(const Pose& T_map_camera, const cv::Mat& depth) const {
  std::vector<Observation> observations;
  for (const Feature& f : tracker_.features()) {
    const LandmarkId landmark = tracks_.landmarkIn(map_, f.id);
    const double z = landmark != kNoLandmark ? (T_map_camera.inverse() * map_.landmark(landmark).position).z() : 0;
    Observation o = observe(f.pixel, f.normalized, depth, settings_.depth, motion_.rows(), inverseDepth(z));
    o.track = f.id;
    o.landmark = landmark;
    observations.push_back(o);
  }
  return observations;
}

PoseCorrespondence FrameTracker::correspondence(LandmarkId landmark, const Eigen::Vector2d& pixel,
                                                const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                                const Pose& T_camera_map) const {
  PoseCorrespondence c;
  c.p_map = map_.landmark(landmark).position;
  const double z = (T_camera_map * c.p_map).z();
  const Observation seen = observe(pixel, normalized, depth, settings_.depth, motion_.rows(), inverseDepth(z));
  c.normalized = seen.normalized;
  const auto noise = camera_.normalizedNoise(seen.normalized, settings_.pixel_sigma);
  c.sigma = noise.sigma;
  c.elongation = noise.elongation;
  c.depth = seen.depth;
  c.depth_sigma = seen.depth_sigma;
  return c;
}

FrameTracker::Correspondences FrameTracker::correspondences(const cv::Mat& depth, const Pose& T_camera_map,
                                                            std::vector<TrackId>* ids) const {
  Correspondences list;
  for (const Feature& f : tracker_.features()) {
    if (!tracks_.has(f.id)) continue;
    list.push_back(correspondence(tracks_.landmarkOf(f.id), f.pixel, f.normalized, depth, T_camera_map));
    ids->push_back(f.id);
  }
  return list;
}

PoseResult FrameTracker::solve(const Correspondences& c, const Pose& predicted, bool rotation_known) const {
  visual_frontend::RefineSettings refine;
  visual_frontend::RansacSettings ransac;
  ransac.min_inliers = std::min<int>(settings_.min_inliers, 10);
  PoseResult start;
  start.T_map_camera = predicted;
  if (rotation_known) {
    // Two points a sample; the threshold leaves room for the gyro's error over a frame.
    ransac.threshold = 4;
    PoseResult two_point = visual_frontend::ransacKnownRotation(c, predicted.linear(), ransac);
    if (two_point.success) start = std::move(two_point);
  }
  PoseResult result = visual_frontend::refinePose(c, start.T_map_camera, refine, start.inliers);
  if (result.success && result.inlier_count > 0.6 * c.size()) return result;
  ransac.threshold = 2.8;
  const PoseResult three_point = visual_frontend::ransacPose(c, ransac);
  if (!three_point.success) return result;
  const PoseResult second = visual_frontend::refinePose(c, three_point.T_map_camera, refine, three_point.inliers);
  return second.success && (!result.success || second.inlier_count > result.inlier_count) ? second : result;
}

void FrameTracker::preferBackground(const Correspondences& c, const Pose& predicted, bool rotation_known,
                                    KeyframeId reference, const cv::Mat& depth, PoseResult* pose) const {
  const auto count = static_cast<double>(c.size());
  if (!pose->success || pose->inlier_count > kUnanimous * count || count - pose->inlier_count < settings_.min_inliers)
    return;
  const auto surfaces = placedBySurfaces(predicted, reference, depth);
  if (!surfaces || !contradicts(*surfaces, *pose)) return;
  Correspondences rest;
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < c.size(); ++i) {
    if (pose->inliers[i]) continue;
    rest.push_back(c[i]);
    places.push_back(i);
  }
  const PoseResult others = solve(rest, predicted, rotation_known);
  if (!others.success) return;
  std::vector<unsigned char> chosen(c.size(), 0);
  for (std::size_t i = 0; i < rest.size(); ++i) chosen[places[i]] = others.inliers[i];
  PoseResult background = visual_frontend::refinePose(c, others.T_map_camera, {}, chosen);
  if (background.success && background.inlier_count >= settings_.min_inliers && !contradicts(*surfaces, background))
    *pose = std::move(background);
}

std::optional<visual_frontend::PosePrior> FrameTracker::placedBySurfaces(const Pose& predicted, KeyframeId reference,
                                                                         const cv::Mat& depth) const {
  if (!settings_.use_surfaces || !surfaces_.has(reference)) return std::nullopt;
  const Pose& T_map_reference = map_.keyframe(reference).T_map_camera;
  const SurfaceAlignment aligned =
      surfaces_.align(reference, surfaces_.surfaceOf(depth, motion_.rows()), T_map_reference.inverse() * predicted);
  if (!aligned.success) return std::nullopt;
  return visual_frontend::PosePrior{T_map_reference * aligned.T_a_b, aligned.information};
}

PoseResult FrameTracker::solveByDepth(const Correspondences& c, const Pose& predicted, double rotation_sigma,
                                      KeyframeId reference, const cv::Mat& depth) const {
  PoseResult result;
  visual_frontend::RefineSettings refine;
  refine.prior = placedBySurfaces(predicted, reference, depth);
  if (!refine.prior) return result;
  if (rotation_sigma > 0) {
    refine.R_map_camera_prior = predicted.linear();
    refine.rotation_prior_sigma = std::hypot(rotation_sigma, kGyroSigma);
  }
  result = visual_frontend::refinePose(c, refine.prior->T_map_camera, refine);
  const double position = result.covariance.topLeftCorner<3, 3>().trace(),
               rotation = result.covariance.bottomRightCorner<3, 3>().trace();
  result.success = result.success && position < kDepthPosition * kDepthPosition && rotation < kDepthTurn * kDepthTurn;
  return result;
}

void FrameTracker::follow(const RgbdImages& images, const Pose& T_map_predicted) {
  visual_frontend::TrackPrediction prediction;
  prediction.R_current_previous = T_map_predicted.linear().transpose() * lastPose().linear();
  const Pose T_camera_map = T_map_predicted.inverse();
  motion_.setRowMotion(images.stamp, T_map_predicted);
  tracks_.forgetMissing(map_);
  std::vector<double> depths;
  for (const Feature& f : tracker_.features()) {
    const LandmarkId landmark = tracks_.landmarkOf(f.id);
    if (landmark == kNoLandmark) continue;
    const Eigen::Vector3d p_camera = T_camera_map * map_.landmark(landmark).position;
    depths.push_back(p_camera.z());
    const auto pixel = camera_.project(p_camera);
    if (pixel && camera_.contains(*pixel)) prediction.pixels[f.id] = motion_.rows().toItsRow(*pixel, p_camera);
  }
  tracker_.track(images.gray, prediction);
  tracks_.keep(tracker_.features());
  if (!depths.empty())
    visual_frontend::realignTracks(map_, tracks_, T_map_predicted, air_ground_common::median(depths),
                                   settings_.realignment, &tracker_);
}

std::string FrameTracker::objection(double stamp, const PoseResult& pose, std::size_t landmarks) const {
  if (!pose.success || pose.inlier_count < settings_.min_inliers ||
      pose.inlier_count < settings_.min_inlier_ratio * landmarks)
    return std::to_string(landmarks) + " landmarks tracked, " + std::to_string(pose.inlier_count) + " agree on a pose";
  return tooFast(stamp, pose.T_map_camera);
}

std::string FrameTracker::tooFast(double stamp, const Pose& T_map_camera) const {
  const double dt = motion_.plausibleInterval(stamp - frames_.lastStamp());
  const double speed = (T_map_camera.translation() - lastPose().translation()).norm() / dt;
  return speed > settings_.max_speed ? "the camera would have moved at " + std::to_string(speed) + " m/s" : "";
}

TrackedPose FrameTracker::track(const RgbdImages& images, const ReferenceKeyframe& reference) {
  TrackedPose tracked;
  bool from_gyro = false;
  const Pose predicted = motion_.predict(frames_.lastStamp(), lastPose(), images.stamp, &from_gyro);
  follow(images, predicted);
  std::vector<TrackId> ids;
  const Correspondences seen = correspondences(images.depth, predicted.inverse(), &ids);
  // A rotation that may be off by more than a pixel is no known rotation.
  const double rotation_sigma = motion_.rotationSigma(images.stamp - frames_.lastStamp());
  const bool rotation_known = from_gyro && focal_ * rotation_sigma < 1.5;
  tracked.pose = solve(seen, predicted, rotation_known);
  preferBackground(seen, predicted, rotation_known, reference.id(), images.depth, &tracked.pose);
  tracked.reason = objection(images.stamp, tracked.pose, seen.size());
  if (!tracked.reason.empty() && settings_.use_surfaces) {
    const PoseResult by_depth =
        solveByDepth(seen, predicted, from_gyro ? rotation_sigma : 0, reference.id(), images.depth);
    tracked.by_depth = by_depth.success && tooFast(images.stamp, by_depth.T_map_camera).empty();
    if (tracked.by_depth) tracked.pose = by_depth;
  }
  if (!tracked.reason.empty() && !tracked.by_depth) return tracked;
  std::vector<TrackId> outliers;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (tracked.pose.inliers[i]) continue;
    outliers.push_back(ids[i]);
    tracks_.release(ids[i]);
  }
  tracker_.remove(outliers);
  ++since_reobservation_;
  if (settings_.reobserve_every > 0 && (since_reobservation_ >= settings_.reobserve_every ||
                                        reference.due(map_, tracked.pose.T_map_camera, tracks_.count()))) {
    since_reobservation_ = 0;
    PoseResult refined = tracked.pose;
    reobserve(tracked.pose.T_map_camera, kReobserveRadius, images.depth, &refined);
    // A handful of landmarks moves nothing that the surfaces fix.
    if (!tracked.by_depth || objection(images.stamp, refined, tracks_.count()).empty()) tracked.pose = refined;
  }
  tracked.success = true;
  tracked.landmarks = tracks_.count();
  return tracked;
}

TrackedPose FrameTracker::findNearLast(const RgbdImages& images) {
  TrackedPose tracked;
  if (images.stamp - frames_.lastStamp() >= kNearSeconds) return tracked;
  // The gyro still knows the rotation, but may be wrong.
  bool from_gyro = false;
  const Pose predicted = motion_.predict(frames_.lastStamp(), lastPose(), images.stamp, &from_gyro);
  tracked = findAround(predicted, kNearRadius, images);
  if (from_gyro && !tracked.success) tracked = findAround(lastPose(), kNearRadius, images);
  return tracked;
}

TrackedPose FrameTracker::findByDepth(const RgbdImages& images, KeyframeId reference) {
  TrackedPose found;
  if (!settings_.use_surfaces || images.stamp - frames_.lastStamp() >= kNearSeconds) return found;
  bool from_gyro = false;
  const Pose predicted = motion_.predict(frames_.lastStamp(), lastPose(), images.stamp, &from_gyro);
  motion_.setRowMotion(images.stamp, predicted);
  const double sigma = from_gyro ? motion_.rotationSigma(images.stamp - frames_.lastStamp()) : 0;
  found.pose = solveByDepth({}, predicted, sigma, reference, images.depth);
  found.success = found.by_depth = found.pose.success && tooFast(images.stamp, found.pose.T_map_camera).empty();
  if (found.success) restart(images.gray);
  return found;
}

TrackedPose FrameTracker::findByFeatures(const visual_frontend::Keyframe& query,
                                         const visual_frontend::PlaceMatch& match, const Pose& around,
                                         const RgbdImages& images) {
  const Pose T_camera_map = around.inverse();
  Correspondences seen;
  std::vector<LandmarkMatch> matches;
  for (const auto& [feature, landmark] : match.landmarks) {
    if (!map_.hasLandmark(landmark)) continue;
    const Eigen::Vector2d& pixel = query.orb_pixels[static_cast<std::size_t>(feature)];
    matches.push_back({landmark, pixel, camera_.unproject(pixel)});
    seen.push_back(correspondence(landmark, pixel, matches.back().normalized, images.depth, T_camera_map));
  }
  TrackedPose found;
  found.pose = solve(seen, around, false);
  found.success = found.pose.success && found.pose.inlier_count >= settings_.min_inliers;
  if (found.success) startTracks(matches, found.pose, 0);
  found.landmarks = tracks_.count();
  return found;
}

TrackedPose FrameTracker::findAround(const Pose& around, double radius, const RgbdImages& images) {
  TrackedPose found;
  reobserve(around, radius, images.depth, &found.pose);
  found.landmarks = tracks_.count();
  found.success = found.pose.success && found.landmarks >= settings_.min_inliers;
  if (!found.success) {
    restart(images.gray);
    found.reason = "a place was recognised but too few of its landmarks were found";
  }
  return found;
}

void FrameTracker::reobserve(const Pose& around, double radius, const cv::Mat& depth, PoseResult* pose) {
  const Pose T_camera_map = around.inverse();
  std::vector<TrackId> ids;
  Correspondences seen = correspondences(depth, T_camera_map, &ids);
  std::vector<Eigen::Vector2d> occupied;
  for (const Feature& f : tracker_.features())
    if (tracks_.has(f.id)) occupied.push_back(f.pixel);
  const std::size_t tracked = seen.size();
  const auto candidates =
      visual_frontend::untrackedLandmarks(map_, tracks_, tracker_.features(), around, settings_.local_keyframes);
  visual_frontend::ReobservationSettings search;
  search.search_radius = radius;
  const std::vector<LandmarkMatch> matches =
      visual_frontend::reobserve(map_, camera_, tracker_.pyramid(), around, candidates, occupied, search);
  if (matches.empty()) return;
  for (const LandmarkMatch& m : matches)
    seen.push_back(correspondence(m.landmark, m.pixel, m.normalized, depth, T_camera_map));
  const PoseResult refined = tracked > 0 ? visual_frontend::refinePose(seen, around, {}) : solve(seen, around, false);
  if (!refined.success || refined.inlier_count < pose->inlier_count) return;
  startTracks(matches, refined, tracked);
  *pose = refined;
}

void FrameTracker::startTracks(const std::vector<LandmarkMatch>& matches, const PoseResult& pose, std::size_t first) {
  // Tracks that may turn out to be one of the landmarks. Copies: starting tracks moves the features.
  std::vector<std::pair<TrackId, Eigen::Vector2d>> loose;
  for (const Feature& f : tracker_.features()) {
    if (!tracks_.has(f.id)) loose.emplace_back(f.id, f.pixel);
  }
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (!pose.inliers[first + i]) continue;
    const LandmarkMatch& match = matches[i];
    TrackId track = kNoTrack;
    for (const auto& [id, pixel] : loose) {
      if ((pixel - match.pixel).squaredNorm() < 2.0 * 2.0 && !tracks_.has(id)) track = id;
    }
    if (track == kNoTrack) track = tracker_.addFeature(match.pixel);
    if (track != kNoTrack) tracks_.assign(track, match.landmark);
  }
}

}  // namespace rgbd_slam
