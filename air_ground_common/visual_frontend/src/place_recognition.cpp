#include "visual_frontend/place_recognition.h"

#include <algorithm>
#include <cmath>
#include <opencv2/features2d.hpp>
#include <stdexcept>

#include "air_ground_common/text.h"
#include "hamming.h"

namespace visual_frontend {

void describeKeyframe(const cv::Mat& gray, const CameraModel& camera, const PlaceSettings& settings,
                      Keyframe& keyframe) {
  if (gray.empty() || gray.type() != CV_8UC1) throw std::invalid_argument("describeKeyframe: needs a CV_8UC1 image");
  const cv::Ptr<cv::ORB> orb =
      cv::ORB::create(settings.orb_features, 1.2f, settings.orb_levels, 19, 0, 2, cv::ORB::HARRIS_SCORE, 31, 12);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  orb->detectAndCompute(gray, cv::noArray(), keypoints, descriptors);
  keyframe.orb_descriptors = cv::Mat();
  keyframe.orb_pixels.clear();
  keyframe.orb_normalized.clear();
  keyframe.orb_angle.clear();
  keyframe.orb_octave.clear();
  keyframe.orb_depth.clear();
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    const cv::KeyPoint& k = keypoints[i];
    // The rim of a fisheye's image circle is no place; from the image's edge ORB keeps 19 px away by itself.
    constexpr double kBorder = 15;
    if (!camera.contains({k.pt.x, k.pt.y}, kBorder)) continue;
    keyframe.orb_pixels.emplace_back(k.pt.x, k.pt.y);
    keyframe.orb_normalized.push_back(camera.unproject(keyframe.orb_pixels.back()));
    keyframe.orb_descriptors.push_back(descriptors.row(static_cast<int>(i)));
    keyframe.orb_angle.push_back(static_cast<float>(k.angle * M_PI / 180));
    keyframe.orb_octave.push_back(k.octave);
  }
}

std::vector<std::pair<int, int>> matchDescriptors(const cv::Mat& a, const cv::Mat& b, const PlaceSettings& settings) {
  std::vector<std::pair<int, int>> matches;
  if (a.rows < 2 || b.rows < 2) return matches;
  std::vector<int> nearest(a.rows), distance(a.rows), second(a.rows);
  nearestHamming(a.data, a.step, a.rows, b.data, b.step, b.rows, nearest.data(), distance.data(), second.data());
  for (int i = 0; i < a.rows; ++i) {
    if (distance[i] > settings.max_hamming || distance[i] > settings.max_ratio * second[i]) continue;
    // The other way only for those that are left: a few of a hundred.
    int back, back_distance, back_second;
    nearestHamming(b.ptr(nearest[i]), b.step, 1, a.data, a.step, a.rows, &back, &back_distance, &back_second);
    if (back == i) matches.emplace_back(i, nearest[i]);
  }
  return matches;
}

namespace {

/// Index into observations of the landmark nearest to a pixel, within 3 px; -1 when there is none.
int observationNear(const Keyframe& keyframe, const Eigen::Vector2d& pixel) {
  int best = -1;
  double best2 = 9;
  for (std::size_t i = 0; i < keyframe.observations.size(); ++i) {
    if (keyframe.observations[i].landmark == kNoLandmark) continue;
    const double d2 = (keyframe.observations[i].pixel - pixel).squaredNorm();
    if (d2 < best2) {
      best2 = d2;
      best = static_cast<int>(i);
    }
  }
  return best;
}

void setNoise(const CameraModel& camera, double pixel_sigma, PoseCorrespondence* c) {
  const NormalizedNoise noise = camera.normalizedNoise(c->normalized, pixel_sigma);
  c->sigma = noise.sigma;
  c->elongation = noise.elongation;
}

PoseResult solve(const std::vector<PoseCorrespondence>& correspondences, const PlaceSettings& settings) {
  RansacSettings ransac;
  ransac.min_inliers = std::min(settings.min_inliers, 12);
  ransac.threshold = 3;
  PoseResult pose = ransacPose(correspondences, ransac);
  if (!pose.success) return pose;
  RefineSettings refine;
  refine.use_depth = false;
  return refinePose(correspondences, pose.T_map_camera, refine, pose.inliers);
}

Matrix6d covarianceOfInverse(const Pose& T, const Matrix6d& covariance) {
  Matrix6d J = Matrix6d::Zero();
  const Eigen::Matrix3d R = T.inverse().linear();
  J.topLeftCorner<3, 3>() = -R;
  J.topRightCorner<3, 3>() = -R * air_ground_common::skew(T.translation());
  J.bottomRightCorner<3, 3>() = -R;
  return J * covariance * J.transpose();
}

PlaceMatch verify(const Map& map, const CameraModel& camera, const Keyframe& query, const Keyframe& place,
                  const std::vector<std::pair<int, int>>& matches, const PlaceSettings& settings) {
  PlaceMatch result;
  result.keyframe = place.id;
  result.matches = static_cast<int>(matches.size());
  const Pose T_place_map = place.T_map_camera.inverse();
  std::vector<PoseCorrespondence> forward, backward;
  std::vector<std::pair<int, LandmarkId>> forward_landmark;
  for (const auto& [q, p] : matches) {
    const int near = observationNear(place, place.orb_pixels[p]);
    const LandmarkId landmark = near >= 0 ? place.observations[near].landmark : kNoLandmark;
    PoseCorrespondence c;
    c.normalized = query.orb_normalized[q];
    setNoise(camera, settings.pixel_sigma * std::pow(1.2, query.orb_octave[q]), &c);
    if (!place.orb_depth.empty() && place.orb_depth[p] > 0) {
      c.p_map = place.orb_depth[p] * place.orb_normalized[p].homogeneous();
      forward.push_back(c);
      forward_landmark.emplace_back(q, landmark);
    } else if (landmark != kNoLandmark) {
      c.p_map = T_place_map * map.landmark(landmark).position;
      forward.push_back(c);
      forward_landmark.emplace_back(q, landmark);
    }
    if (!query.orb_depth.empty() && query.orb_depth[q] > 0) {
      c.p_map = query.orb_depth[q] * query.orb_normalized[q].homogeneous();
      c.normalized = place.orb_normalized[p];
      setNoise(camera, settings.pixel_sigma * std::pow(1.2, place.orb_octave[p]), &c);
      backward.push_back(c);
    }
  }
  const bool use_forward = static_cast<int>(forward.size()) >= settings.min_inliers;
  const std::vector<PoseCorrespondence>& used = use_forward ? forward : backward;
  if (static_cast<int>(used.size()) < settings.min_inliers) {
    result.reason = "only " + std::to_string(used.size()) + " matches with depth";
    return result;
  }
  const PoseResult pose = solve(used, settings);
  result.inliers = pose.inlier_count;
  if (!pose.success || pose.inlier_count < settings.min_inliers) {
    result.reason = pose.success ? "only " + std::to_string(pose.inlier_count) + " inliers" : pose.reason;
    return result;
  }
  result.success = true;
  result.covariance = pose.covariance;
  result.T_place_query = pose.T_map_camera;
  if (use_forward) {
    for (std::size_t i = 0; i < forward.size(); ++i) {
      if (pose.inliers[i] && forward_landmark[i].second != kNoLandmark) result.landmarks.push_back(forward_landmark[i]);
    }
  } else {
    // Solved for the place in the query's frame: turn it round, and the covariance with it.
    result.T_place_query = pose.T_map_camera.inverse();
    result.covariance = covarianceOfInverse(pose.T_map_camera, pose.covariance);
  }
  return result;
}

/// The places by how many of a quarter of the query's descriptors find a partner there, one way only; most first. Most
/// places fall out by that.
std::vector<KeyframeId> rankedPlaces(const Map& map, const Keyframe& query, const std::vector<KeyframeId>& places,
                                     const PlaceSettings& settings) {
  std::vector<std::pair<int, KeyframeId>> coarse;
  const cv::Mat& q = query.orb_descriptors;
  constexpr int kStep = 4;
  const int rows = q.rows / kStep;
  std::vector<int> nearest(rows), distance(rows), second(rows);
  for (const KeyframeId id : places) {
    const cv::Mat& p = map.keyframe(id).orb_descriptors;
    if (rows < 1 || p.rows < 2) continue;
    nearestHamming(q.data, kStep * q.step, rows, p.data, p.step, p.rows, nearest.data(), distance.data(),
                   second.data());
    int close = 0;
    for (int i = 0; i < rows; ++i)
      close += distance[i] <= settings.max_hamming && distance[i] <= settings.max_ratio * second[i];
    coarse.emplace_back(-close, id);
  }
  std::sort(coarse.begin(), coarse.end());
  std::vector<KeyframeId> ranked;
  for (const auto& [score, id] : coarse) ranked.push_back(id);
  return ranked;
}

/// The best candidates with what their geometric check gave, most descriptor matches first, at least `least` of them.
/// `matches`: the most that any had.
std::vector<PlaceMatch> checkedPlaces(const Map& map, const CameraModel& camera, const Keyframe& query,
                                      std::vector<KeyframeId> ranked, int least, const PlaceSettings& settings,
                                      int* matches) {
  struct Scored {
    KeyframeId keyframe;
    std::vector<std::pair<int, int>> matches;
  };
  if (ranked.size() > static_cast<std::size_t>(2 * settings.max_candidates)) ranked.resize(2 * settings.max_candidates);
  std::vector<Scored> scored;
  *matches = 0;
  for (const KeyframeId id : ranked) {
    Scored s{id, matchDescriptors(query.orb_descriptors, map.keyframe(id).orb_descriptors, settings)};
    *matches = std::max(*matches, static_cast<int>(s.matches.size()));
    if (static_cast<int>(s.matches.size()) >= least) scored.push_back(std::move(s));
  }
  std::stable_sort(scored.begin(), scored.end(),
                   [](const Scored& a, const Scored& b) { return a.matches.size() > b.matches.size(); });
  if (static_cast<int>(scored.size()) > settings.max_candidates) scored.resize(settings.max_candidates);
  std::vector<PlaceMatch> checked;
  for (const Scored& s : scored)
    checked.push_back(verify(map, camera, query, map.keyframe(s.keyframe), s.matches, settings));
  return checked;
}

PlaceMatch bestOf(std::vector<PlaceMatch> checked, int matches) {
  PlaceMatch best;
  best.reason = "no place has enough matching descriptors";
  best.matches = matches;
  for (PlaceMatch& match : checked) {
    if ((match.success && !best.success) || (match.success == best.success && match.inliers >= best.inliers))
      best = std::move(match);
  }
  return best;
}

Pose poseIn(const Map& map, const PlaceMatch& match) {
  return map.keyframe(match.keyframe).T_map_camera * match.T_place_query;
}

/// A place where the camera cannot be is none.
void refuseWhere(const RelocalizationGate& gate, const Map& map, PlaceMatch& m) {
  if (!m.success) return;
  const auto refuse = [&m](const char* format, auto... values) {
    m.success = false;
    m.reason = air_ground_common::formatted(format, values...);
  };
  const Pose T = poseIn(map, m);
  const double jump = (T.translation() - gate.T_map_last.translation()).norm();
  if (jump > gate.max_distance)
    return refuse("a place was recognised, but it is %.2f away and only %.2f can lie behind", jump, gate.max_distance);
  if (gate.up_camera) {
    const double tilt =
        std::acos(std::clamp(gate.up_camera->dot(T.linear().transpose() * Eigen::Vector3d::UnitZ()), -1.0, 1.0));
    if (tilt > gate.max_tilt) return refuse("a place was recognised, but gravity contradicts it by %.2f rad", tilt);
  }
  if (gate.R_map_camera) {
    const double turn = air_ground_common::rotationAngle(*gate.R_map_camera, T.linear());
    if (turn > gate.max_turn) return refuse("a place was recognised, but the gyro contradicts it by %.2f rad", turn);
  }
}

/// Of what a keyframe sees [map unit]: its landmarks, else its depths; 1 without any.
double sceneDepth(const Map& map, const Keyframe& keyframe) {
  double depth = 0;
  int seen = 0;
  const Pose T_camera_map = keyframe.T_map_camera.inverse();
  for (const auto& o : keyframe.observations) {
    if (o.landmark == kNoLandmark) continue;
    depth += (T_camera_map * map.landmark(o.landmark).position).z();
    ++seen;
  }
  if (seen == 0) {
    for (const double z : keyframe.orb_depth) {
      if (!(z > 0)) continue;
      depth += z;
      ++seen;
    }
  }
  return seen > 0 && depth > 0 ? depth / seen : 1;
}

/// The best places among those that do not see what the camera sees at T: neighbours of one place would take all the
/// candidates, and a twin of it would never be heard.
std::vector<KeyframeId> elsewhere(const Map& map, const std::vector<KeyframeId>& ranked, const Pose& T, double depth) {
  constexpr double kSameShift = 0.5, kSameTurn = 0.6;  // of the depth; [rad]
  std::vector<KeyframeId> others;
  for (const KeyframeId id : ranked) {
    const Pose& place = map.keyframe(id).T_map_camera;
    if ((place.translation() - T.translation()).norm() > kSameShift * depth ||
        air_ground_common::rotationAngle(place.linear(), T.linear()) > kSameTurn)
      others.push_back(id);
  }
  return others;
}

/// The best among the places that do not see what the camera sees by `best`, with what their geometric check gave.
std::vector<PlaceMatch> checkedElsewhere(const PlaceMatch& best, const Map& map, const CameraModel& camera,
                                         const Keyframe& query, const std::vector<KeyframeId>& ranked, double min_lead,
                                         const PlaceSettings& settings) {
  const int least = std::max(settings.min_matches, static_cast<int>(best.inliers / min_lead));
  const double depth = sceneDepth(map, map.keyframe(best.keyframe));
  int ignored = 0;
  return checkedPlaces(map, camera, query, elsewhere(map, ranked, poseIn(map, best), depth), least, settings, &ignored);
}

/// `best` has no lead over a place that puts the camera elsewhere, by more than a fifth of the way to what it sees.
bool contests(const PlaceMatch& match, const PlaceMatch& best, const Map& map, double min_lead) {
  if (!match.success || best.inliers > min_lead * match.inliers) return false;
  const Pose T = poseIn(map, match), T_best = poseIn(map, best);
  return (T.translation() - T_best.translation()).norm() > 0.2 * sceneDepth(map, map.keyframe(best.keyframe)) ||
         air_ground_common::rotationAngle(T.linear(), T_best.linear()) > 0.2;
}

}  // namespace

PlaceMatch recognizePlace(const Map& map, const CameraModel& camera, const Keyframe& query,
                          const std::vector<KeyframeId>& places, const PlaceSettings& settings) {
  int matches = 0;
  const auto ranked = rankedPlaces(map, query, places, settings);
  return bestOf(checkedPlaces(map, camera, query, ranked, settings.min_matches, settings, &matches), matches);
}

std::vector<PlaceMatch> rivalsOf(const PlaceMatch& best, const Map& map, const CameraModel& camera,
                                 const Keyframe& query, const std::vector<KeyframeId>& places, double min_lead,
                                 const PlaceSettings& settings) {
  const auto ranked = rankedPlaces(map, query, places, settings);
  auto rivals = checkedElsewhere(best, map, camera, query, ranked, min_lead, settings);
  rivals.erase(std::remove_if(rivals.begin(), rivals.end(),
                              [&](const PlaceMatch& m) { return !contests(m, best, map, min_lead); }),
               rivals.end());
  return rivals;
}

PlaceMatch relocalize(const Map& map, const CameraModel& camera, const Keyframe& query, const RelocalizationGate& gate,
                      const PlaceSettings& settings) {
  std::vector<KeyframeId> places = gate.places;
  if (places.empty())
    for (const auto& entry : map.keyframes()) places.push_back(entry.first);
  int matches = 0;
  const auto ranked = rankedPlaces(map, query, places, settings);
  auto checked = checkedPlaces(map, camera, query, ranked, settings.min_matches, settings, &matches);
  for (PlaceMatch& m : checked) refuseWhere(gate, map, m);
  PlaceMatch best = bestOf(checked, matches);
  if (!best.success) return best;
  for (PlaceMatch& m : checkedElsewhere(best, map, camera, query, ranked, gate.min_lead, settings)) {
    refuseWhere(gate, map, m);
    checked.push_back(std::move(m));
  }
  for (const PlaceMatch& m : checked) {
    if (!contests(m, best, map, gate.min_lead)) continue;
    best.success = false;
    best.ambiguous = true;
    best.reason = "two places look alike (" + std::to_string(best.inliers) + " and " + std::to_string(m.inliers) +
                  " points agree)";
    break;
  }
  return best;
}

}  // namespace visual_frontend
