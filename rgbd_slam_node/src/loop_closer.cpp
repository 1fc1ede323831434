#include "loop_closer.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "air_ground_common/covariance.h"
#include "air_ground_common/linear_algebra.h"

namespace rgbd_slam {

using visual_frontend::kNoLandmark;
using visual_frontend::LandmarkTracks;
using visual_frontend::Map;
using visual_frontend::Observation;

namespace {

constexpr double kMovedShift = 0.015, kMovedTurn = 0.008;         // a smaller correction is none [m], [rad]
constexpr double kPositionFloor = 0.005, kRotationFloor = 0.003;  // what inliers share (calibration, depth) [m], [rad]

constexpr double kStep = 0.05;         // the way is counted by: the noise of a camera that stands is none [m]
constexpr double kMinLead = 1.4;       // inliers of a place over those of another that may be the right one as well
constexpr double kNoise = 12.6;        // 95 % of the squared errors of six numbers lie below, over their covariance
constexpr double kChance = 22.5;       // likewise 99.9 %
constexpr double kOverconfidence = 6;  // of covariances along a chain: 17 where 3 are expected, over a flat floor
constexpr int kMoreEvidence = 2;       // times the inliers where a correction is larger than chance makes it
constexpr int kMoreCandidates = 2;     // times the places that are verified, of those that may contradict

/// Least distance of two ways, of which each is ascending [m].
double leastBetween(const std::vector<double>& a, const std::vector<double>& b) {
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0, k = 0; i < a.size() && k < b.size();) {
    least = std::min(least, std::abs(a[i] - b[k]));
    a[i] < b[k] ? ++i : ++k;
  }
  return least;
}

/// Adds what inliers share to the covariance of a recognised place.
Matrix6d withFloor(Matrix6d covariance) {
  covariance.diagonal().head<3>().array() += kPositionFloor * kPositionFloor;
  covariance.diagonal().tail<3>().array() += kRotationFloor * kRotationFloor;
  return covariance;
}

/// The recognised place as an edge of the pose graph.
visual_frontend::LoopEdge edgeOf(const visual_frontend::PlaceMatch& match, KeyframeId id) {
  visual_frontend::LoopEdge loop;
  loop.a = match.keyframe;
  loop.b = id;
  loop.T_a_b = match.T_place_query;
  // From the axes of the place to those of this camera.
  loop.covariance = withFloor(air_ground_common::aboutAxes(match.T_place_query.linear().transpose(), match.covariance));
  return loop;
}

}  // namespace

void LoopCloser::clear() {
  path_ = 0;
  anchor_.reset();
  ways_.clear();
}

void LoopCloser::moveTo(const Eigen::Vector3d& p_map) {
  if (!anchor_) anchor_ = p_map;
  const double way = (p_map - *anchor_).norm();
  if (way <= kStep) return;
  path_ += way;
  anchor_ = p_map;
}

void LoopCloser::replace(KeyframeId from, KeyframeId by) {
  std::vector<double>& ways = ways_.at(by);
  ways.insert(ways.end(), ways_.at(from).begin(), ways_.at(from).end());
  std::sort(ways.begin(), ways.end());
  ways_.erase(from);
}

// A camera that sees landmarks of an earlier keyframe lies right beside that one: it can have drifted only as far as
// that one may have, seen from the place. Else it would leave a known bay of shelves for the next one that looks alike.
double LoopCloser::wayBetween(KeyframeId place, KeyframeId id, const std::set<KeyframeId>& near) const {
  double way = leastBetween(ways_.at(id), ways_.at(place));
  for (const KeyframeId other : near) way = std::min(way, leastBetween(ways_.at(other), ways_.at(place)));
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

LoopCloser::Correction LoopCloser::correctionBy(const visual_frontend::PlaceMatch& match, KeyframeId id,
                                                const std::set<KeyframeId>& near,
                                                const visual_frontend::KeyframeCovariances& covariances,
                                                const Map& map) const {
  const Pose &now = map.keyframe(id).T_map_camera, &T_map_place = map.keyframe(match.keyframe).T_map_camera;
  const Pose T_map_camera = T_map_place * match.T_place_query;
  air_ground_common::Vector6d moved;
  moved << T_map_camera.translation() - now.translation(),
      air_ground_common::logSO3(Eigen::Matrix3d(T_map_camera.linear() * now.linear().transpose()));
  const Matrix6d seen = withFloor(air_ground_common::aboutAxes(T_map_place.linear(), match.covariance)),
                 chain = covariances.at(id, now.translation(), map) +
                         covariances.at(match.keyframe, now.translation(), map);
  Correction correction{};
  correction.shift = moved.head<3>().norm();
  correction.turn = moved.tail<3>().norm();
  correction.explained =
      correction.shift <= settings_.loop_slack + settings_.loop_drift * wayBetween(match.keyframe, id, near) &&
      correction.turn <= settings_.loop_max_rotation;
  correction.expected =
      chain.isZero(0) || air_ground_common::squaredMahalanobis(moved, seen + kOverconfidence * chain) < kChance;
  correction.noise = air_ground_common::squaredMahalanobis(moved, seen) < kNoise;
  return correction;
}

LoopCloser::Outcome LoopCloser::close(KeyframeId id, bool level,
                                      const visual_frontend::KeyframeCovariances& covariances, Map& map,
                                      LandmarkTracks& tracks) const {
  std::set<KeyframeId> near;
  for (const auto& c : map.covisible(id, 15)) near.insert(c.keyframe);
  const std::vector<KeyframeId> places = placesInReach(id, near, map);
  if (places.empty()) return Outcome::kNone;
  const visual_frontend::PlaceMatch match =
      visual_frontend::recognizePlace(map, camera_, map.keyframe(id), places, settings_.place);
  if (!match.success || match.inliers < settings_.loop_min_inliers) return Outcome::kNone;

  const Correction correction = correctionBy(match, id, near, covariances, map);
  if (!correction.explained || (!correction.expected && match.inliers < kMoreEvidence * settings_.loop_min_inliers))
    return Outcome::kRefused;
  visual_frontend::PlaceSettings wider = settings_.place;
  wider.max_candidates *= kMoreCandidates;
  for (const auto& rival : visual_frontend::rivalsOf(match, map, camera_, map.keyframe(id), places, kMinLead, wider))
    if (correctionBy(rival, id, near, covariances, map).explained) return Outcome::kRefused;
  const bool correct = !correction.noise && (correction.shift > kMovedShift || correction.turn > kMovedTurn);
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
