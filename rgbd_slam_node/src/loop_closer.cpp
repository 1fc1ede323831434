#include "loop_closer.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/covariance.h"

namespace rgbd_slam {

using visual_frontend::kNoLandmark;
using visual_frontend::LandmarkTracks;
using visual_frontend::Map;
using visual_frontend::Observation;

namespace {

constexpr double kMovedShift = 0.015, kMovedTurn = 0.008;         // a smaller correction is none [m], [rad]
constexpr double kPositionFloor = 0.005, kRotationFloor = 0.003;  // what inliers share (calibration, depth) [m], [rad]

/// The recognised place as an edge of the pose graph.
visual_frontend::LoopEdge edgeOf(const visual_frontend::PlaceMatch& match, KeyframeId id) {
  visual_frontend::LoopEdge loop;
  loop.a = match.keyframe;
  loop.b = id;
  loop.T_a_b = match.T_place_query;
  // From the axes of the place to those of this camera.
  loop.covariance = air_ground_common::aboutAxes(match.T_place_query.linear().transpose(), match.covariance);
  loop.covariance.diagonal().head<3>().array() += kPositionFloor * kPositionFloor;
  loop.covariance.diagonal().tail<3>().array() += kRotationFloor * kRotationFloor;
  return loop;
}

}  // namespace

void LoopCloser::clear() {
  path_ = 0;
  path_at_.clear();
}

// A camera that sees landmarks of an earlier keyframe lies right beside that one: it can have drifted only as far as
// that one may have, seen from the place. Else it would leave a known bay of shelves for the next one that looks alike.
double LoopCloser::wayBetween(KeyframeId place, KeyframeId id, const std::set<KeyframeId>& near) const {
  double way = path_at_.at(id) - path_at_.at(place);
  for (const KeyframeId other : near) way = std::min(way, std::abs(path_at_.at(other) - path_at_.at(place)));
  return way;
}

// Only places whose view could overlap with this one, were the pose wrong by as much as a loop may correct.
std::vector<KeyframeId> LoopCloser::placesInReach(KeyframeId id, const std::set<KeyframeId>& near,
                                                  const Map& map) const {
  const Pose& now = map.keyframe(id).T_map_camera;
  std::vector<KeyframeId> places;
  for (const auto& [other, keyframe] : map.keyframes()) {
    if (other + settings_.loop_min_gap > id || near.count(other)) continue;
    const double reach =
        settings_.loop_slack + settings_.loop_drift * wayBetween(other, id, near) + 0.7 * settings_.depth.max_range;
    if ((keyframe.T_map_camera.translation() - now.translation()).norm() > reach) continue;
    if (keyframe.T_map_camera.linear().col(2).dot(now.linear().col(2)) > std::cos(0.8 + settings_.loop_max_rotation))
      places.push_back(other);
  }
  return places;
}

LoopCloser::Outcome LoopCloser::close(KeyframeId id, bool level, Map& map, LandmarkTracks& tracks) const {
  std::set<KeyframeId> near;
  for (const auto& c : map.covisible(id, 15)) near.insert(c.keyframe);
  const std::vector<KeyframeId> places = placesInReach(id, near, map);
  if (places.empty()) return Outcome::kNone;
  const visual_frontend::PlaceMatch match =
      visual_frontend::recognizePlace(map, camera_, map.keyframe(id), places, settings_.place);
  if (!match.success || match.inliers < settings_.loop_min_inliers) return Outcome::kNone;

  const Pose& now = map.keyframe(id).T_map_camera;
  const Pose T_map_camera = map.keyframe(match.keyframe).T_map_camera * match.T_place_query;
  const double shift = (T_map_camera.translation() - now.translation()).norm();
  const double turn = air_ground_common::rotationAngle(T_map_camera.linear(), now.linear());
  if (shift > settings_.loop_slack + settings_.loop_drift * wayBetween(match.keyframe, id, near) ||
      turn > settings_.loop_max_rotation)
    return Outcome::kRefused;
  const bool correct = shift > kMovedShift || turn > kMovedTurn;
  if (correct) {
    visual_frontend::PoseGraphSettings graph;
    graph.four_dof = level;
    if (!visual_frontend::closeLoops(map, {edgeOf(match, id)}, 15, visual_frontend::kNoKeyframe, graph).usable)
      return Outcome::kNone;
  }
  mergeLandmarks(id, match.landmarks, map, tracks);
  return correct ? Outcome::kCorrected : Outcome::kMerged;
}

void LoopCloser::mergeLandmarks(KeyframeId id, const std::vector<std::pair<int, LandmarkId>>& seen, Map& map,
                                LandmarkTracks& tracks) const {
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
      o.depth_sigma = settings_.depth.sigma(o.depth);
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

}  // namespace rgbd_slam
