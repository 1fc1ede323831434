#include "visual_frontend/bundle_job.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <iterator>
#include <map>
#include <utility>

#include "air_ground_common/linear_algebra.h"

namespace visual_frontend {

namespace {

using CameraIndex = std::map<KeyframeId, int>;

constexpr double kTrackCorrelation = 10;  // points of a map over those that err on their own
constexpr double kSureCalibration = 25;   // squared error over its variance: one of 10^5 by chance in two dimensions
constexpr double kSureRefinement = 9;     // the same of a calibration that has been found to be off before
constexpr double kLeastShift = 0.5;       // what it moves the measurements, RMS [sigmas]

void addCameras(const Map& map, const std::vector<KeyframeId>& ids, bool fixed, const InertialMap* inertial,
                CameraIndex* index, BundleJob* job) {
  for (const KeyframeId id : ids) {
    if (!index->emplace(id, static_cast<int>(job->keyframes.size())).second) continue;
    const Keyframe& keyframe = map.keyframe(id);
    BundleProblem::Camera camera{keyframe.T_map_camera, fixed, keyframe.up_camera, keyframe.up_sigma, {}, fixed};
    if (inertial)
      if (const auto state = inertial->states.find(id); state != inertial->states.end()) camera.state = state->second;
    job->problem.cameras.push_back(camera);
    job->keyframes.push_back(id);
  }
}

/// Inertial motion between the keyframes of the problem.
void addLinks(const Map& map, const InertialMap& inertial, const CameraIndex& index, BundleProblem* problem) {
  for (const auto& [id, camera] : index) {
    const auto link = inertial.links.find(id);
    if (link == inertial.links.end()) continue;
    // The link starts at the keyframe before this one in the map, which must be in the problem too.
    const auto in_map = map.keyframes().find(id);
    if (in_map == map.keyframes().begin()) continue;
    const auto previous = index.find(std::prev(in_map)->first);
    if (previous == index.end()) continue;
    if (problem->cameras[previous->second].fixed && problem->cameras[camera].fixed) continue;
    problem->links.push_back({previous->second, camera, link->second});
  }
}

/// A landmark that two cameras of the problem see, or one with depth, and what they saw.
void addLandmark(const Map& map, const CameraModel& camera, const Landmark& landmark, const CameraIndex& index,
                 BundleJob* job) {
  bool depth = false;
  int views = 0;
  for (const LandmarkObservation& o : landmark.observations) {
    if (!index.count(o.keyframe)) continue;
    ++views;
    depth = depth || (job->settings.use_depth && map.keyframe(o.keyframe).observations[o.index].depth > 0);
  }
  if (views < 2 && !depth) return;
  const int point = static_cast<int>(job->landmarks.size());
  job->problem.points.push_back(landmark.position);
  job->landmarks.push_back(landmark.id);
  for (const LandmarkObservation& o : landmark.observations) {
    const auto it = index.find(o.keyframe);
    if (it == index.end()) continue;
    const Observation& seen = map.keyframe(o.keyframe).observations[o.index];
    const NormalizedNoise noise = camera.normalizedNoise(seen.normalized, job->settings.pixel_sigma);
    job->problem.measurements.push_back(
        {it->second, point, seen.normalized, noise.sigma, seen.depth, seen.depth_sigma, noise.elongation});
    job->sources.push_back(o);
  }
}

/// W with W^T W = `information`, which may be singular.
Matrix6d squareRoot(const Matrix6d& information) {
  const auto eigen = air_ground_common::symmetricEigen(information);
  return eigen.values.cwiseMax(0).cwiseSqrt().asDiagonal() * eigen.vectors.transpose();
}

/// The camera is another one than it was taken for, beyond doubt and so that it matters.
bool isSure(const CalibrationEstimate& estimate, const BundleProblem& problem, double rms) {
  const double inflation = kTrackCorrelation * std::max(1.0, rms * rms);
  const double significance = estimate.error.dot(estimate.covariance.ldlt().solve(estimate.error)) / inflation;
  double squares = 0;
  for (const auto& m : problem.measurements)
    squares += squaredSigmas(m.by_calibration * estimate.error, m.normalized, {m.sigma, m.elongation});
  return significance > (estimate.mean.isZero() ? kSureCalibration : kSureRefinement) &&
         squares > kLeastShift * kLeastShift * static_cast<double>(problem.measurements.size());
}

/// What came into the map since the job was taken out of it.
void carryAlong(const BundleJob& job, const Pose& correction, Map& map, InertialMap* inertial) {
  if (map.lastKeyframe() == job.newest_keyframe) return;
  for (auto it = map.keyframes().upper_bound(job.newest_keyframe); it != map.keyframes().end(); ++it) {
    Keyframe& keyframe = map.keyframe(it->first);
    keyframe.T_map_camera = correction * keyframe.T_map_camera;
    if (!inertial) continue;
    const auto state = inertial->states.find(it->first);
    if (state != inertial->states.end()) state->second.velocity = correction.linear() * state->second.velocity;
  }
  for (const LandmarkId id : map.landmarkIds())
    if (id > job.newest_landmark) map.landmark(id).position = correction * map.landmark(id).position;
}

void removeOutliers(const BundleJob& job, Map& map) {
  for (const int m : job.result.outliers) {
    const LandmarkObservation& source = job.sources[m];
    const LandmarkId id = job.landmarks[job.problem.measurements[m].point];
    // The map may have let go of it meanwhile.
    if (!map.hasKeyframe(source.keyframe) || map.keyframe(source.keyframe).observations[source.index].landmark != id)
      continue;
    map.disconnect(source.keyframe, source.index);
    if (!map.hasLandmark(id) || map.landmark(id).observations.size() >= 2) continue;
    const LandmarkObservation& left = map.landmark(id).observations.front();
    if (!(map.keyframe(left.keyframe).observations[left.index].depth > 0)) map.removeLandmark(id);
  }
}

}  // namespace

void BundleJob::solve() {
  if (problem.calibration) {
    BundleProblem calibrated = problem;
    result = solveBundle(calibrated, settings);
    if (result.usable && isSure(*calibrated.calibration, calibrated, result.rms)) {
      problem = std::move(calibrated);
      return;
    }
    problem.calibration.reset();
    result.usable = false;
    if (for_calibration) return;
  }
  result = solveBundle(problem, settings);
}

BundleJob extractBundle(const Map& map, const CameraModel& camera, const std::vector<KeyframeId>& free,
                        const std::vector<KeyframeId>& fixed, const BundleSettings& settings,
                        const InertialMap* inertial) {
  BundleJob job;
  job.settings = settings;
  job.newest_keyframe = map.lastKeyframe();
  job.newest_landmark = map.newestLandmark();
  CameraIndex index;
  addCameras(map, fixed, true, inertial, &index, &job);
  addCameras(map, free, false, inertial, &index, &job);
  if (fixed.empty() && !free.empty()) {
    BundleProblem::Camera& first = job.problem.cameras.front();
    if (inertial) job.problem.anchor = 0;
    first.fixed = !inertial || (!inertial->metric && !first.up_camera);
  }
  if (inertial) {
    job.problem.metric = inertial->metric;
    job.problem.T_camera_imu = inertial->T_camera_imu;
    addLinks(map, *inertial, index, &job.problem);
  }
  for (const LandmarkId id : map.landmarksOf(free)) addLandmark(map, camera, map.landmark(id), index, &job);
  return job;
}

BundleJob extractBundle(const Map& map, const CameraModel& camera, const std::vector<KeyframeId>& free,
                        const std::vector<KeyframeId>& fixed, const BundleSettings& settings,
                        const std::vector<KeyframeLink>& links) {
  BundleJob job = extractBundle(map, camera, free, fixed, settings);
  CameraIndex index;
  for (std::size_t i = 0; i < job.keyframes.size(); ++i) index[job.keyframes[i]] = static_cast<int>(i);
  for (const KeyframeLink& link : links) {
    const auto a = index.find(link.a), b = index.find(link.b);
    if (a != index.end() && b != index.end())
      job.problem.priors.push_back({a->second, b->second, link.T_a_b, squareRoot(link.information), true});
  }
  return job;
}

BundleJob extractWholeMap(const Map& map, const CameraModel& camera, const BundleSettings& settings,
                          const std::vector<KeyframeLink>& links) {
  std::vector<KeyframeId> ids;
  for (const auto& entry : map.keyframes()) ids.push_back(entry.first);
  const std::size_t held = ids.empty() ? 0 : 1;
  return extractBundle(map, camera, {ids.begin() + held, ids.end()}, {ids.begin(), ids.begin() + held}, settings,
                       links);
}

void applyBundle(const BundleJob& job, Map& map, InertialMap* inertial) {
  if (!job.result.usable) return;
  Pose correction = Pose::Identity();
  KeyframeId newest = kNoKeyframe;
  for (std::size_t i = 0; i < job.keyframes.size(); ++i) {
    const KeyframeId id = job.keyframes[i];
    if (!map.hasKeyframe(id)) continue;
    const BundleProblem::Camera& camera = job.problem.cameras[i];
    Keyframe& keyframe = map.keyframe(id);
    if (id > newest) {
      newest = id;
      correction = camera.T_map_camera * keyframe.T_map_camera.inverse();
    }
    // A camera that holds the map has a bias all the same: the next window's chain may begin there.
    if (inertial && !camera.state_fixed) inertial->states[id] = camera.state;
    if (!camera.fixed) keyframe.T_map_camera = camera.T_map_camera;
  }
  for (std::size_t i = 0; i < job.landmarks.size(); ++i)
    if (map.hasLandmark(job.landmarks[i])) map.landmark(job.landmarks[i]).position = job.problem.points[i];
  carryAlong(job, correction, map, inertial);
  removeOutliers(job, map);
}

}  // namespace visual_frontend
