// Places seen before: ORB descriptors, geometric check, pose graph, merging of landmarks, full bundle adjustment.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "slam_impl.h"

namespace rgbd_slam {

void Slam::Impl::fillOrb(const cv::Mat& gray, const cv::Mat& depth, Keyframe& keyframe) const {
  visual_frontend::describeKeyframe(gray, camera, settings.place, keyframe);
  for (std::size_t i = 0; i < keyframe.orb_pixels.size(); ++i) {
    const Observation seen = observe(keyframe.orb_pixels[i], keyframe.orb_normalized[i], depth);
    keyframe.orb_normalized[i] = seen.normalized;
    keyframe.orb_depth.push_back(seen.depth);
  }
}

void Slam::Impl::mergeLandmarks(KeyframeId id, const std::vector<std::pair<int, LandmarkId>>& seen) {
  for (const auto& [orb, landmark] : seen) {
    if (!map.hasLandmark(landmark)) continue;
    const Eigen::Vector2d pixel = map.keyframe(id).orb_pixels[orb];
    int nearest = -1;
    double best = 3.0 * 3.0;
    for (std::size_t i = 0; i < map.keyframe(id).observations.size(); ++i) {
      const Observation& o = map.keyframe(id).observations[i];
      const double d2 = (o.pixel - pixel).squaredNorm();
      if (o.landmark == kNoLandmark || d2 >= best) continue;
      best = d2;
      nearest = static_cast<int>(i);
    }
    if (nearest < 0) {
      // Not tracked here: the ORB feature itself becomes the observation.
      Observation o;
      o.pixel = pixel;
      o.normalized = map.keyframe(id).orb_normalized[orb];
      o.depth = map.keyframe(id).orb_depth[orb];
      o.depth_sigma = settings.depth.sigma(o.depth);
      map.keyframe(id).observations.push_back(o);
      map.connect(id, static_cast<int>(map.keyframe(id).observations.size()) - 1, landmark);
      continue;
    }
    const LandmarkId present = map.keyframe(id).observations[nearest].landmark;
    // Two corners 3 px apart may be two points: only what coincides in space is one.
    const double range = (map.landmark(landmark).position - map.keyframe(id).T_map_camera.translation()).norm();
    if (present == landmark || (map.landmark(present).position - map.landmark(landmark).position).norm() > 0.02 * range)
      continue;
    map.fuse(landmark, present);
    tracks.replace(present, landmark);
  }
}

bool Slam::Impl::closeLoop(KeyframeId id) {
  std::set<KeyframeId> near;
  for (const auto& c : map.covisible(id, 15)) near.insert(c.keyframe);
  // Only places whose view could overlap with this one, were the pose wrong by as much as a loop may correct.
  const Pose& now = map.keyframe(id).T_map_camera;
  std::vector<KeyframeId> places;
  for (const auto& [other, keyframe] : map.keyframes()) {
    if (other + settings.loop_min_gap > id || near.count(other)) continue;
    const double reach = settings.loop_slack + settings.loop_drift * (keyframe_path.at(id) - keyframe_path.at(other)) +
                         0.7 * settings.depth.max_range;
    if ((keyframe.T_map_camera.translation() - now.translation()).norm() > reach) continue;
    if (keyframe.T_map_camera.linear().col(2).dot(now.linear().col(2)) > std::cos(0.8 + settings.loop_max_rotation))
      places.push_back(other);
  }
  if (places.empty()) return false;
  const visual_frontend::PlaceMatch match =
      visual_frontend::recognizePlace(map, camera, map.keyframe(id), places, settings.place);
  if (!match.success || match.inliers < settings.loop_min_inliers) return false;

  const Pose T_map_camera = map.keyframe(match.keyframe).T_map_camera * match.T_place_query;
  const double shift = (T_map_camera.translation() - now.translation()).norm();
  const double turn = air_ground_common::rotationAngle(T_map_camera.linear(), now.linear());
  const double way = keyframe_path.at(id) - keyframe_path.at(match.keyframe);
  if (shift > settings.loop_slack + settings.loop_drift * way || turn > settings.loop_max_rotation) {
    ++counters.loops_refused;
    return false;
  }
  visual_frontend::LoopEdge loop;
  loop.a = match.keyframe;
  loop.b = id;
  loop.T_a_b = match.T_place_query;
  // From the axes of the place to those of this camera; floors for what the inliers share (calibration, depth).
  Matrix6d turn_axes = Matrix6d::Zero();
  turn_axes.topLeftCorner<3, 3>() = turn_axes.bottomRightCorner<3, 3>() = match.T_place_query.linear().transpose();
  loop.covariance = turn_axes * match.covariance * turn_axes.transpose();
  loop.covariance.diagonal().head<3>().array() += 0.005 * 0.005;
  loop.covariance.diagonal().tail<3>().array() += 0.003 * 0.003;
  const bool correct = shift > 0.015 || turn > 0.008;
  if (correct) {
    visual_frontend::PoseGraphSettings graph;
    graph.four_dof = gravity_known;
    if (!visual_frontend::closeLoops(map, {loop}, 15, kNoKeyframe, graph).usable) return false;
  }
  mergeLandmarks(id, match.landmarks);
  ++counters.loops;
  if (!correct) {
    adjustWindow(id);
    return false;
  }
  adjustWhole();
  return true;
}

}  // namespace rgbd_slam
