#include "bundle_job.h"

#include <unordered_map>

namespace mav_vo {

using air_ground_common::Pose;
using visual_frontend::KeyframeId;
using visual_frontend::LandmarkId;

namespace {

/// Inertial motion between the keyframes of the problem; `index`: of their cameras.
void addLinks(const visual_frontend::Map& map, const InertialMap& inertial_map, const std::map<KeyframeId, int>& index,
              InertialBundleProblem* problem) {
  for (const auto& entry : index) {
    const auto link = inertial_map.links.find(entry.first);
    if (link == inertial_map.links.end()) continue;
    // The link starts at the keyframe before this one in the map, which must be in the problem too.
    const auto in_map = map.keyframes().find(entry.first);
    if (in_map == map.keyframes().begin()) continue;
    const auto previous = index.find(std::prev(in_map)->first);
    if (previous == index.end()) continue;
    if (problem->visual.cameras[previous->second].fixed && problem->visual.cameras[entry.second].fixed) continue;
    problem->links.push_back({previous->second, entry.second, link->second});
  }
}

}  // namespace

BundleJob makeBundleJob(const visual_frontend::Map& map, const InertialMap& inertial_map,
                        const std::vector<KeyframeId>& free, const std::vector<KeyframeId>& fixed,
                        const visual_frontend::CameraModel& camera, double pixel_sigma, bool metric,
                        const Pose& T_camera_imu) {
  BundleJob job;
  job.newest_keyframe = map.lastKeyframe();
  auto& problem = job.problem;
  problem.metric = metric;
  problem.T_camera_imu = T_camera_imu;
  std::map<KeyframeId, int> index;
  const auto addCamera = [&](KeyframeId id, bool held) {
    if (!index.emplace(id, static_cast<int>(job.keyframes.size())).second) return;
    const auto& keyframe = map.keyframe(id);
    visual_frontend::BundleProblem::Camera view;
    view.T_map_camera = keyframe.T_map_camera;
    view.fixed = held;
    view.up_camera = keyframe.up_camera;
    view.up_sigma = keyframe.up_sigma;
    problem.visual.cameras.push_back(view);
    const auto state = inertial_map.states.find(id);
    problem.states.push_back(state != inertial_map.states.end() ? state->second : InertialState{});
    problem.state_fixed.push_back(held);
    job.keyframes.push_back(id);
  };
  for (const KeyframeId id : fixed) addCamera(id, true);
  for (const KeyframeId id : free) addCamera(id, false);
  if (fixed.empty() && !free.empty()) {
    problem.anchor = 0;
    if (!metric && !problem.visual.cameras.front().up_camera) problem.visual.cameras.front().fixed = true;
  }
  addLinks(map, inertial_map, index, &problem);
  for (const LandmarkId id : map.landmarksOf(free)) {
    const auto& landmark = map.landmark(id);
    int views = 0;
    for (const auto& o : landmark.observations) views += index.count(o.keyframe) > 0;
    if (views < 2) continue;
    const int point = static_cast<int>(job.landmarks.size());
    job.landmarks.push_back(id);
    problem.visual.points.push_back(landmark.position);
    for (const auto& o : landmark.observations) {
      const auto it = index.find(o.keyframe);
      if (it == index.end()) continue;
      const Eigen::Vector2d& normalized = map.keyframe(o.keyframe).observations[o.index].normalized;
      const auto noise = camera.normalizedNoise(normalized, pixel_sigma);
      problem.visual.measurements.push_back({it->second, point, normalized, noise.sigma, 0, 0, noise.elongation});
      job.sources.push_back(o);
    }
  }
  const auto ids = map.landmarkIds();
  if (!ids.empty()) job.newest_landmark = ids.back();
  return job;
}

void BundleJob::solve() {
  auto result = solveInertialBundle(problem, settings);
  usable = result.usable;
  seconds = result.seconds;
  rms = result.rms;
  outliers = std::move(result.outliers);
}

void applyBundleJob(const BundleJob& job, visual_frontend::Map& map, InertialMap& inertial_map) {
  if (!job.usable) return;
  Pose correction = Pose::Identity();
  KeyframeId newest = visual_frontend::kNoKeyframe;
  for (std::size_t i = 0; i < job.keyframes.size(); ++i) {
    const KeyframeId id = job.keyframes[i];
    if (!map.hasKeyframe(id)) continue;
    auto& keyframe = map.keyframe(id);
    if (id > newest) {
      newest = id;
      correction = job.problem.visual.cameras[i].T_map_camera * keyframe.T_map_camera.inverse();
    }
    // A camera that holds the map has a bias all the same: the next window's chain may begin there.
    if (!job.problem.state_fixed[i]) inertial_map.states[id] = job.problem.states[i];
    if (!job.problem.visual.cameras[i].fixed) keyframe.T_map_camera = job.problem.visual.cameras[i].T_map_camera;
  }
  for (std::size_t i = 0; i < job.landmarks.size(); ++i)
    if (map.hasLandmark(job.landmarks[i])) map.landmark(job.landmarks[i]).position = job.problem.visual.points[i];
  for (const auto& entry : map.keyframes()) {
    if (entry.first <= job.newest_keyframe) continue;
    auto& keyframe = map.keyframe(entry.first);
    keyframe.T_map_camera = correction * keyframe.T_map_camera;
    const auto state = inertial_map.states.find(entry.first);
    if (state != inertial_map.states.end()) state->second.velocity = correction.linear() * state->second.velocity;
  }
  if (map.lastKeyframe() != job.newest_keyframe) {
    for (const LandmarkId id : map.landmarkIds())
      if (id > job.newest_landmark) map.landmark(id).position = correction * map.landmark(id).position;
  }
  for (const int m : job.outliers) {
    const auto& source = job.sources[m];
    if (!map.hasKeyframe(source.keyframe)) continue;
    const auto& observation = map.keyframe(source.keyframe).observations[source.index];
    const LandmarkId landmark = job.landmarks[job.problem.visual.measurements[m].point];
    if (observation.landmark != landmark) continue;
    map.disconnect(source.keyframe, source.index);
    if (map.hasLandmark(landmark) && map.landmark(landmark).observations.size() < 2) map.removeLandmark(landmark);
  }
}

}  // namespace mav_vo
