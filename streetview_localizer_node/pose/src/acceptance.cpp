#include "streetview_localizer/acceptance.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <set>
#include <stdexcept>

#include "air_ground_common/covariance.h"
#include "air_ground_common/text.h"

namespace streetview_localizer {

namespace {

using air_ground_common::formatted;

/// Matches that say something of their own: no two of one pixel (2 px) or of one point (5 cm).
std::vector<int> distinct(const std::vector<int>& indices, const std::vector<Correspondence>& correspondences) {
  std::set<std::pair<long, long>> pixels;
  std::set<std::array<long, 3>> points;
  std::vector<int> kept;
  for (const int i : indices) {
    const Correspondence& c = correspondences[i];
    if (!c.pixel.allFinite() || !c.p_world.allFinite()) continue;
    const Eigen::Vector2d a = c.pixel / 2;
    const Eigen::Vector3d b = c.p_world / 0.05;
    const bool new_pixel = pixels.emplace(std::lround(a.x()), std::lround(a.y())).second;
    const bool new_point = points.insert({std::lround(b.x()), std::lround(b.y()), std::lround(b.z())}).second;
    if (new_pixel && new_point) kept.push_back(i);
  }
  return kept;
}

double hullArea(const std::vector<int>& indices, const std::vector<Correspondence>& correspondences) {
  std::vector<cv::Point2f> pixels, hull;
  for (const int i : indices)
    pixels.emplace_back(static_cast<float>(correspondences[i].pixel.x()),
                        static_cast<float>(correspondences[i].pixel.y()));
  if (pixels.size() < 3) return 0;
  cv::convexHull(pixels, hull);
  return cv::contourArea(hull);
}

double log10Binomial(int n, int k) {
  return (std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0)) / M_LN10;
}

double logistic(double x) { return 1 / (1 + std::exp(-x)); }

/// Either regression may vouch for a pose (docs/streetview_pose.md says what they were fitted to).
double scoreOf(const PoseEvidence& e, const AcceptanceSettings& s) {
  const auto logit = [&](const std::vector<double>& w, double share) {
    return w[0] + w[1] * share + w[2] * std::log(std::max(0.02, e.position_stddev)) + w[3] * e.competitor_share +
           w[4] * std::log(std::max(1, e.cells));
  };
  return logistic(std::max(logit(s.by_all, e.inlier_share), logit(s.by_kept, e.kept_share)));
}

}  // namespace

void AcceptanceSettings::validate() const {
  const auto require = [](bool good, const char* what) {
    if (!good) throw std::invalid_argument(std::string("acceptance: ") + what);
  };
  require(min_inliers >= 5, "min_inliers must be at least 5");
  require(max_range > 0, "max_range must be positive");
  require(max_rms > 0, "max_rms must be positive");
  require(max_position_stddev > 0 && max_angle_stddev > 0, "max_position_stddev and max_angle_stddev must be positive");
  require(min_score >= 0 && min_score < 1, "min_score must lie in [0, 1)");
  require(min_facing >= 0 && min_facing <= 1, "min_facing must lie in [0, 1]");
  require(by_all.size() == 5 && by_kept.size() == 5, "by_all and by_kept must hold 5 numbers each");
  require(max_competitor_share > 0, "max_competitor_share must be positive");
}

namespace {

/// How the inliers lie in the image and in space, seen from `centre`.
void describeSpread(const std::vector<int>& inliers, const std::vector<Correspondence>& correspondences,
                    const CameraModel& camera, const Eigen::Vector3d& centre, PoseEvidence* e) {
  const double k = static_cast<double>(inliers.size());
  std::set<std::pair<int, int>> cells;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  int known = 0, facing = 0;
  for (const int i : inliers) {
    const Correspondence& c = correspondences[i];
    cells.emplace(static_cast<int>(8 * c.pixel.x() / camera.width), static_cast<int>(6 * c.pixel.y() / camera.height));
    mean += c.p_world / k;
    if (c.normal.allFinite() && c.normal.squaredNorm() > 0.25) {
      ++known;
      facing += c.normal.dot(centre - c.p_world) > 0;
    }
  }
  e->cells = static_cast<int>(cells.size());
  e->facing = known > 0 ? static_cast<double>(facing) / known : 1;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const int i : inliers)
    scatter += (correspondences[i].p_world - mean) * (correspondences[i].p_world - mean).transpose() / k;
  const Eigen::Vector3d values = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter, Eigen::EigenvaluesOnly)
                                     .eigenvalues()
                                     .cwiseMax(0)
                                     .cwiseSqrt();
  e->extent_long = values[2];
  e->extent_short = values[1];
  e->view_angle = 4 * values[1] / std::max(1e-6, (mean - centre).norm());
}

}  // namespace

PoseEvidence gatherEvidence(const PoseResult& result, const std::vector<Correspondence>& correspondences,
                            const CameraModel& camera, const PointSource& source, const PoseSettings& pose_settings,
                            std::size_t first_dropped) {
  PoseEvidence e;
  if (!result.success) return e;
  std::vector<int> all(correspondences.size());
  for (std::size_t i = 0; i < all.size(); ++i) all[i] = static_cast<int>(i);
  const std::vector<int> matches = distinct(all, correspondences), inliers = distinct(result.inliers, correspondences);
  const int n = static_cast<int>(matches.size()), k = static_cast<int>(inliers.size());
  e.inliers = k;
  if (n == 0 || k == 0) return e;
  // Of all matches: some that a filter dropped agree with the pose all the same.
  const std::vector<Correspondence> moved = onMovedWalls(correspondences, result);
  const int agreeing = static_cast<int>(
      distinct(scorePose(result.T_world_camera, moved, camera, pose_settings).inliers, correspondences).size());
  e.inlier_share = std::min(1.0, static_cast<double>(agreeing) / n);
  all.resize(std::min(all.size(), first_dropped));
  e.kept_share = std::min(1.0, static_cast<double>(k) / static_cast<double>(distinct(all, correspondences).size()));

  // A contrario (Moisan, Moulon, Monasse 2012): sets of k random matches that some sample of three, with up to four
  // poses, brings within the threshold, when pixels fall anywhere in the matches' hull.
  const double image = static_cast<double>(camera.width) * camera.height;
  const double area = std::max(0.05 * image, hullArea(matches, correspondences));
  const double chance = std::min(1.0, M_PI * pose_settings.inlier_threshold * pose_settings.inlier_threshold / area);
  e.log_false_alarms = k <= 3 ? 0
                              : std::log10(4.0 * std::max(1, n - 3)) + log10Binomial(std::max(n, k), k) +
                                    log10Binomial(k, 3) + (k - 3) * std::log10(chance);

  e.hull_share = hullArea(inliers, correspondences) / image;
  const Eigen::Vector3d centre = result.T_world_camera.translation();
  describeSpread(inliers, correspondences, camera, centre, &e);
  e.rms = result.rms;
  e.range = (centre - source.position).norm();
  e.alternative_margin = result.alternative_margin;
  if (result.alternative) e.alternative_distance = (result.alternative->T_world_camera.translation() - centre).norm();
  if (result.competitor)
    e.competitor_share = static_cast<double>(distinct(result.competitor->inliers, correspondences).size()) / k;
  e.position_stddev = air_ground_common::largestStddev(result.image_covariance.topLeftCorner<3, 3>());
  e.angle_stddev = air_ground_common::largestStddev(result.image_covariance.bottomRightCorner<3, 3>());
  return e;
}

Acceptance judge(const PoseResult& result, const std::vector<Correspondence>& correspondences,
                 const CameraModel& camera, const PointSource& source, const PoseSettings& pose_settings,
                 const AcceptanceSettings& s, std::size_t first_dropped) {
  s.validate();
  Acceptance a;
  if (!result.success) {
    a.reason = result.reason.empty() ? "no pose" : result.reason;
    return a;
  }
  a.evidence = gatherEvidence(result, correspondences, camera, source, pose_settings, first_dropped);
  const PoseEvidence& e = a.evidence;
  a.score = scoreOf(e, s);
  const double deg = 180 / M_PI;
  if (e.inliers < s.min_inliers)
    a.reason = formatted("%d distinct inliers, %d needed", e.inliers, s.min_inliers);
  else if (!(e.log_false_alarms <= s.max_log_false_alarms))
    a.reason = formatted("so many inliers arise by chance: 10^%.1f false alarms expected, at most 10^%.1f",
                         e.log_false_alarms, s.max_log_false_alarms);
  else if (!(e.rms <= s.max_rms))
    a.reason = formatted("reprojection error %.2f px, at most %.2f", e.rms, s.max_rms);
  else if (!(e.range <= s.max_range))
    a.reason = formatted("%.1f m from the panorama, at most %.1f", e.range, s.max_range);
  else if (!(e.facing >= s.min_facing))
    a.reason = formatted("%.0f %% of the walls face the camera, at least %.0f", 100 * e.facing, 100 * s.min_facing);
  else if (!(e.hull_share >= s.min_hull_share))
    a.reason =
        formatted("inliers cover %.1f %% of the image, at least %.1f", 100 * e.hull_share, 100 * s.min_hull_share);
  else if (e.cells < s.min_cells)
    a.reason = formatted("inliers in %d cells of the image, at least %d", e.cells, s.min_cells);
  else if (!(e.view_angle >= s.min_view_angle))
    a.reason =
        formatted("the inliers' points span %.1f degrees, at least %.1f", deg * e.view_angle, deg * s.min_view_angle);
  else if (!(e.position_stddev <= s.max_position_stddev))
    a.reason = formatted("position uncertain to %.2f m, at most %.2f", e.position_stddev, s.max_position_stddev);
  else if (!(e.angle_stddev <= s.max_angle_stddev))
    a.reason = formatted("orientation uncertain to %.2f degrees, at most %.2f", deg * e.angle_stddev,
                         deg * s.max_angle_stddev);
  else if (e.alternative_distance > s.harmless_alternative && !(e.alternative_margin >= s.min_alternative_margin))
    a.reason = formatted("the plane's other pose is nearly as likely: log-ratio %.1f, at least %.1f",
                         e.alternative_margin, s.min_alternative_margin);
  else if (!(e.competitor_share <= s.max_competitor_share))
    a.reason = formatted("the matches support another place: %.2f of the inliers, at most %.2f", e.competitor_share,
                         s.max_competitor_share);
  else if (!(a.score >= s.min_score))
    a.reason = formatted("score %.3f, at least %.3f", a.score, s.min_score);
  else {
    a.accepted = true;
    a.reason = "accepted";
  }
  return a;
}

}  // namespace streetview_localizer
