#include <algorithm>
#include <cmath>
#include <vector>

#include "air_ground_common/statistics.h"
#include "odometry_impl.h"
#include "visual_frontend/local_landmarks.h"

namespace mav_vo {

using air_ground_common::quantile;

namespace {

constexpr double kPlaceEvery = 5;         // images between searches for a known place while lost
constexpr double kMinInlierShare = 0.35;  // of the tracked landmarks; below, the pose is not believed

}  // namespace

std::vector<PoseCorrespondence> Odometry::Impl::correspondences(std::vector<TrackId>* seen) const {
  std::vector<PoseCorrespondence> list;
  for (const Feature& f : tracker.features()) {
    const auto id = landmarkOf(f.id);
    if (!id) continue;
    const Eigen::Vector2d ray = rayOf(f);
    const auto noise = camera.normalizedNoise(ray, settings.pixel_sigma);
    list.push_back({map.landmark(*id).position, ray, noise.sigma, 0, 0, noise.elongation});
    seen->push_back(f.id);
  }
  return list;
}

bool Odometry::Impl::locate(bool gyro) {
  std::vector<TrackId> seen;
  const auto points = correspondences(&seen);
  last_pose = PoseResult{};
  // A known turn leaves three unknowns of six: half as many landmarks agree by chance as rarely.
  const int needed = gyro ? (settings.min_inliers + 1) / 2 : settings.min_inliers;
  if (static_cast<int>(points.size()) < needed) {
    last_pose.reason = "only " + std::to_string(points.size()) + " known landmarks in view, " + std::to_string(needed) +
                       " needed: move more slowly, or turn back to known ground";
    return false;
  }
  visual_frontend::RansacSettings ransac;
  ransac.seed = settings.seed;
  ransac.min_inliers = settings.min_inliers / 2;
  ransac.threshold = 4.0;
  PoseResult start;
  if (gyro) start = visual_frontend::ransacKnownRotation(points, T_map_camera.linear(), ransac);
  if (!start.success || start.inlier_count < kMinInlierShare * static_cast<double>(points.size()))
    start = visual_frontend::ransacPose(points, ransac);
  if (!start.success) {
    last_pose = start;
    return false;
  }
  visual_frontend::RefineSettings refine;
  if (gyro) {
    refine.R_map_camera_prior = T_map_camera.linear();
    refine.rotation_prior_sigma =
        std::hypot(settings.gyro_prior_sigma, imu.gyroBiasStddev() * (last_stamp - located_stamp));
  }
  last_pose = visual_frontend::refinePose(points, start.T_map_camera, refine);
  if (!last_pose.success) return false;
  if (last_pose.inlier_count < needed ||
      last_pose.inlier_count < kMinInlierShare * static_cast<double>(points.size())) {
    last_pose.success = false;
    last_pose.reason = std::to_string(last_pose.inlier_count) + " of " + std::to_string(points.size()) +
                       " landmarks agree on a pose: something large moves in view, or the image is blurred";
    return false;
  }
  T_map_camera = last_pose.T_map_camera;
  std::vector<TrackId> wrong;
  std::vector<double> depths;
  const Pose T_camera_map = T_map_camera.inverse();
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (!last_pose.inliers[i])
      wrong.push_back(seen[i]);
    else
      depths.push_back((T_camera_map * points[i].p_map).z());
  }
  tracker.remove(wrong);
  for (const TrackId id : wrong) tracks.release(id);
  inliers = last_pose.inlier_count;
  scene_distance = quantile(depths, 0.5);
  depth_min = quantile(depths, 0.05);
  depth_max = quantile(depths, 0.95);
  return true;
}

void Odometry::Impl::lookForOldLandmarks(const visual_frontend::ReobservationSettings& how) {
  const auto candidates =
      visual_frontend::untrackedLandmarks(map, tracks, tracker.features(), T_map_camera, 8, scene_distance);
  std::vector<Eigen::Vector2d> occupied;
  for (const Feature& f : tracker.features()) occupied.push_back(f.pixel);
  for (const auto& match :
       visual_frontend::reobserve(map, camera, tracker.pyramid(), T_map_camera, candidates, occupied, how)) {
    const TrackId track = tracker.addFeature(match.pixel);
    if (track != visual_frontend::kNoTrack) tracks.assign(track, match.landmark);
  }
}

bool Odometry::Impl::relocalize(const cv::Mat& gray, bool gyro) {
  if (map.keyframeCount() == 0 || frames.empty()) return false;
  ++frames_lost;
  if (tracker.features().size() < 0.5 * settings.tracker.max_features) tracker.replenish();
  // Near the last pose the landmarks' patches are enough; elsewhere the image is recognised by its ORB features.
  if (frames_lost <= 10 && last_stamp - located_stamp < 0.7) {
    if (gyro && frames_lost > 1) T_map_camera.linear() = T_map_camera.linear() * *R_previous_current;
    auto wide = settings.reobservation;
    wide.search_radius = 25;
    lookForOldLandmarks(wide);
    if (locate(gyro)) return true;
  }
  if ((frames_lost - 1) % static_cast<int>(kPlaceEvery) != 0) return false;
  Keyframe query;
  query.stamp = last_stamp;
  visual_frontend::describeKeyframe(gray, camera, settings.place, query);
  visual_frontend::RelocalizationGate gate;
  gate.T_map_last = frames.lastPose(map);
  if (metric)
    gate.max_distance = settings.relocalization_slack + settings.max_speed * (last_stamp - frames.lastStamp());
  if (metric && settings.use_imu && imu.attitude().initialized()) {
    gate.up_camera = T_camera_imu.linear() * imu.attitude().up();
    gate.max_tilt = std::max(gate.max_tilt, 3 * imu.attitude().upSigma());
  }
  const auto match = visual_frontend::relocalize(map, camera, query, gate, settings.place);
  if (!match.success) {
    reason = "lost: no known place recognised (" + match.reason + "); show the camera what it has seen before";
    return false;
  }
  T_map_camera = map.keyframe(match.keyframe).T_map_camera * match.T_place_query;
  for (const Feature& f : tracker.features()) tracks.release(f.id);
  tracker.reset();
  tracker.track(gray);
  auto wide = settings.reobservation;
  wide.search_radius = 15;
  lookForOldLandmarks(wide);
  const bool found = locate(false);
  tracker.replenish();
  return found;
}

Increment Odometry::Impl::incrementSince(const Pose& T_map_previous) const {
  Increment step;
  step.previous_stamp = located_stamp;
  step.T_previous_current = T_base_camera * T_map_previous.inverse() * T_map_camera * T_base_camera.inverse();
  // Image noise of the two poses is independent; the map's error is common to both and drops out.
  const Eigen::Matrix3d R = (T_map_previous * T_base_camera.inverse()).linear().transpose();
  const Matrix6d sum = last_pose.covariance + previous_covariance;
  step.covariance.topLeftCorner<3, 3>() = R * sum.topLeftCorner<3, 3>() * R.transpose();
  step.covariance.block<3, 1>(0, 3) = R * sum.block<3, 1>(0, 5);
  step.covariance.block<1, 3>(3, 0) = step.covariance.block<3, 1>(0, 3).transpose();
  step.covariance(3, 3) = sum(5, 5);
  step.pose_covariance = step.covariance;
  if (settings.increment_covariance == IncrementCovariance::kMonteCarlo) scatterCovariance(R.transpose(), &step);
  return step;
}

// Where five points cannot tell (hovering, turning on the spot, too few tracks) the poses' covariance stays.
void Odometry::Impl::scatterCovariance(const Eigen::Matrix3d& R_map_base, Increment* step) const {
  std::vector<RayPair> pairs;
  for (const Feature& f : tracker.features()) {
    if (f.age >= 1 && landmarkOf(f.id)) pairs.push_back({camera.unproject(f.previous_pixel), f.normalized});
  }
  MonteCarloSettings how;
  how.samples = settings.increment_samples;
  how.seed = settings.seed;
  const Eigen::Vector3d t = step->T_previous_current.translation();
  const double length = t.norm();
  const Eigen::Vector3d along = length > 0 ? Eigen::Vector3d(t / length) : Eigen::Vector3d::UnitX();
  const double length_variance = along.dot(step->pose_covariance.topLeftCorner<3, 3>() * along);
  const auto scatter =
      monteCarloIncrement(pairs, step->T_previous_current, T_base_camera, R_map_base, length_variance, sigma(), how);
  if (scatter.success) step->covariance = scatter.covariance;
}

// Error of the pose in the map: image noise, that of the keyframe it was made from, and what scale and tilt of the map
// leave open, which grows from its origin.
Matrix6d Odometry::Impl::mapCovariance(const Matrix6d& camera_covariance) const {
  Matrix6d C = camera_covariance;
  const double relative = metric && scale.filter().initialized() ? scale.filter().relativeStddev() : 0.0;
  const Eigen::Vector3d p = T_map_camera.translation();
  C.topLeftCorner<3, 3>() += relative * relative * p * p.transpose();
  if (!frames.empty()) C += covariances.at(frames.lastReference(), p, map);
  if (metric) C += visual_frontend::tiltCovariance(kMapTilt, p);
  C.diagonal().array() += 1e-10;
  return C;
}

}  // namespace mav_vo
