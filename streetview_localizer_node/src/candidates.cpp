#include "candidates.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "air_ground_common/text.h"
#include "air_ground_common/units.h"

namespace streetview_localizer {
namespace {

using air_ground_common::formatted;
using air_ground_common::kDegree;
constexpr double kGravityGate = 4;  // standard deviations

// Index of the most frequent value; the first of equals.
int mostFrequent(const std::map<int, int>& counts) {
  int best = -1, most = 0;
  for (const auto& [value, count] : counts)
    if (count > most) best = value, most = count;
  return best;
}

// `why` empty: nothing speaks against it.
void refuse(const std::string& why, Candidate* c) {
  if (why.empty()) return;
  c->acceptance.accepted = false;
  c->acceptance.score = 0;
  c->acceptance.reason = why;
}

// The paper's covariance in place of the estimate's.
void useMonteCarlo(Candidate* c) {
  if (c->pose.monte_carlo_covariance)
    c->pose.covariance = *c->pose.monte_carlo_covariance;
  else if (c->acceptance.accepted)
    refuse(formatted("only %d samples of five matches give a plausible pose: no Monte Carlo covariance",
                     c->pose.monte_carlo_plausible),
           c);
}

// Gravity is part of the estimate; matches that pull away from it all the same belong to another attitude.
std::string againstGravity(const PosePrior& prior, const PoseResult& pose) {
  const Eigen::Vector3d up = pose.T_world_camera.linear() * prior.up_camera->normalized();
  const double angle = std::acos(std::clamp(up.z(), -1.0, 1.0)), bound = kGravityGate * prior.up_stddev;
  if (angle <= bound) return "";
  return formatted("the attitude is %.1f degrees off the direction of gravity, at most %.1f", angle / kDegree,
                   bound / kDegree);
}

}  // namespace

std::vector<Candidate> CandidateFinder::find(std::vector<ViewMatches> parts, const Features& query,
                                             const CameraModel& camera, const PosePrior& prior) const {
  std::vector<Candidate> candidates;
  for (const Group& group : grouped(std::move(parts))) candidates.push_back(locate(group, query, camera, prior));
  return candidates;
}

// One group for all panoramas of well-known pose, one for each of the others: their errors, a decimetre, are common
// to the points of one and would set those of two against each other.
std::vector<Group> CandidateFinder::grouped(std::vector<ViewMatches> parts) const {
  std::vector<Group> groups;
  std::map<int, std::size_t> group_of;
  for (ViewMatches& part : parts) {
    if (static_cast<int>(part.matches.size()) < settings_.min_view_matches) continue;
    const int p = view(part.view).panorama;
    const bool exact = panorama(p).position_stddev <= settings_.merge_position_stddev &&
                       panorama(p).orientation_stddev <= settings_.merge_orientation_stddev;
    const auto [it, is_new] = group_of.try_emplace(exact ? -1 : p, groups.size());
    if (is_new) groups.emplace_back();
    groups[it->second].parts.push_back(std::move(part));
  }
  std::stable_sort(groups.begin(), groups.end(), [](const Group& a, const Group& b) { return a.size() > b.size(); });
  return groups;
}

// The matches that were kept, then those that k-VLD dropped, and the rays of their panoramas.
std::vector<ViewRay> CandidateFinder::gather(const Group& group, const Features& query, Candidate* c) const {
  std::vector<ViewRay> rays;
  std::map<int, int> matches_of_panorama;
  const auto add = [&](const ViewMatches& part, const Match& m, double quality) {
    const View& from = view(part.view);
    const auto q = static_cast<std::size_t>(m.query), v = static_cast<std::size_t>(m.view);
    Correspondence corr;
    corr.pixel = {query.keypoints[q].pt.x, query.keypoints[q].pt.y};
    corr.view_pixel = {from.features.keypoints[v].pt.x, from.features.keypoints[v].pt.y};
    corr.p_world = from.points[v].cast<double>();
    corr.normal = from.normals[v].cast<double>();
    corr.view_centre = from.T_world_camera.translation();
    corr.quality = quality;
    c->correspondences.push_back(corr);
    c->views.push_back(part.view);
    rays.push_back({from.T_world_camera.translation(), 1 / from.camera.fx, panorama(from.panorama).position_stddev});
  };
  for (const ViewMatches& part : group.parts) {
    matches_of_panorama[view(part.view).panorama] += static_cast<int>(part.matches.size());
    for (std::size_t i = 0; i < part.matches.size(); ++i)
      add(part, part.matches[i], part.supporters[i] * (1 - part.matches[i].ratio));
  }
  c->kept = c->correspondences.size();
  for (const ViewMatches& part : group.parts)
    for (const Match& m : part.dropped) add(part, m, 0);
  c->panorama = mostFrequent(matches_of_panorama);
  return rays;
}

Candidate CandidateFinder::locate(const Group& group, const Features& query, const CameraModel& camera,
                                  const PosePrior& prior) const {
  Candidate c;
  const std::vector<ViewRay> rays = gather(group, query, &c);
  PointSource source = sourceOf(c.panorama);
  c.pose = estimatePose(c.correspondences, camera, source, prior, settings_.pose, c.kept);
  if (c.pose.success) {
    // The panorama that the pose rests on.
    std::map<int, int> inliers_of_panorama, inliers_of_view;
    for (const int i : c.pose.inliers) {
      const int v = c.views[static_cast<std::size_t>(i)];
      ++inliers_of_view[v];
      ++inliers_of_panorama[view(v).panorama];
    }
    c.panorama = mostFrequent(inliers_of_panorama);
    c.view = mostFrequent(inliers_of_view);
    source = sourceOf(c.panorama);
    if (inliers_of_panorama.size() > 1) refine(camera, prior, rays, &c);
  }
  c.acceptance = judge(c.pose, c.correspondences, camera, source, settings_.pose, settings_.acceptance, c.kept);
  if (c.acceptance.accepted && prior.up_camera) refuse(againstGravity(prior, c.pose), &c);
  if (c.acceptance.accepted) refuse(againstModel(c), &c);
  if (settings_.covariance == CovarianceKind::kMonteCarlo) useMonteCarlo(&c);
  c.correspondences.resize(c.kept);
  c.views.resize(c.kept);
  return c;
}

PointSource CandidateFinder::sourceOf(int index) const {
  PointSource source;
  const Panorama& p = panorama(index);
  source.position = p.T_world_panorama.translation();
  source.position_stddev = p.position_stddev;
  source.orientation_stddev = p.orientation_stddev;
  source.model_lateral_stddev = settings_.model_lateral_stddev;
  source.model_relief_stddev = settings_.model_relief_stddev;
  source.model_height_stddev = settings_.model_height_stddev;
  return source;
}

// Several panoramas see the same points: their rays fix them better than the model. Only a pose that the matches
// support as well, and near what was found without, takes the place of the first.
void CandidateFinder::refine(const CameraModel& camera, const PosePrior& prior, const std::vector<ViewRay>& rays,
                             Candidate* c) const {
  const auto fused = fusePoints(c->correspondences, rays, c->pose.inliers, settings_.fusion);
  const FusedRefinement refined = refineOnFusedPoints(fused, camera, prior, c->pose.T_world_camera, settings_.fusion);
  if (!refined.converged) return;
  const Pose& from = c->pose.T_world_camera;
  const Eigen::Vector3d moved = refined.T_world_camera.translation() - from.translation();
  const Eigen::Vector3d turned = air_ground_common::logSO3(refined.T_world_camera.linear() * from.linear().transpose());
  const auto deviations = [](const Eigen::Vector3d& e, const Eigen::Matrix3d& covariance) {
    return std::sqrt(e.dot(covariance.llt().solve(e)));
  };
  if (!(deviations(moved, c->pose.covariance.topLeftCorner<3, 3>()) <= settings_.max_fusion_shift) ||
      !(deviations(turned, c->pose.covariance.bottomRightCorner<3, 3>()) <= settings_.max_fusion_shift))
    return;
  const auto kept =
      onMovedWalls({c->correspondences.begin(), c->correspondences.begin() + static_cast<long>(c->kept)}, c->pose);
  PoseHypothesis scored = scorePose(refined.T_world_camera, kept, camera, settings_.pose);
  if (static_cast<double>(scored.inliers.size()) <
      settings_.min_fusion_inliers * static_cast<double>(c->pose.inliers.size()))
    return;
  static_cast<PoseHypothesis&>(c->pose) = std::move(scored);
  c->pose.covariance += refined.covariance - c->pose.image_covariance;
  c->pose.image_covariance = refined.covariance;
}

// A camera stands above the ground, outside of buildings, and sees what it matched.
std::string CandidateFinder::againstModel(const Candidate& c) const {
  const Eigen::Vector3d centre = c.pose.T_world_camera.translation();
  const auto below = projector_.cast(centre, -Eigen::Vector3d::UnitZ());
  const auto above = projector_.cast(centre, Eigen::Vector3d::UnitZ());
  const CityModel& model = projector_.model();
  const bool over_ground = below && !model.isBuilding(below->triangle);
  if (over_ground && below->distance < settings_.min_height)
    return formatted("%.2f m above the ground of the model, at least %.2f", below->distance, settings_.min_height);
  // The underside of a bridge, a passage or an oriel is a ground surface too, but of a building.
  if (above && model.building[above->triangle] < 0 && model.surface[above->triangle] == Surface::kGround)
    return "the camera would be below the ground of the model";
  int visible = 0;
  for (const int i : c.pose.inliers) {
    const Correspondence& corr = c.correspondences[static_cast<std::size_t>(i)];
    const Eigen::Vector3d ray = corr.p_world - centre;
    const auto hit = projector_.cast(centre, ray);
    // Half a metre of tolerance: the model's own error, seen obliquely.
    visible += !hit || hit->distance > ray.norm() - 0.5 - 0.03 * ray.norm();
  }
  const double share =
      static_cast<double>(visible) / static_cast<double>(std::max<std::size_t>(c.pose.inliers.size(), 1));
  if (share >= settings_.min_visible_share) return "";
  return formatted("only %.0f %% of the matched points are visible from the pose, at least %.0f %%", 100 * share,
                   100 * settings_.min_visible_share);
}

}  // namespace streetview_localizer
