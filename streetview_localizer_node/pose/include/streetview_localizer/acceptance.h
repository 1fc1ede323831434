// Is a pose right? The test that stands between an estimate and its publication (paper B: 100 % precision first).
#pragma once

#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "streetview_localizer/pose_estimation.h"

namespace streetview_localizer {

/// What the decision is made from.
struct PoseEvidence {
  int inliers = 0;              ///< distinct ones: several matches of one pixel or of one point count once
  double inlier_share = 0;      ///< of the distinct matches [0, 1]
  double kept_share = 0;        ///< of those that no filter dropped [0, 1]
  double log_false_alarms = 0;  ///< log10 of the number of such consensus sets expected among random matches
  double hull_share = 0;        ///< convex hull of the inliers over the image's area [0, 1]
  int cells = 0;                ///< occupied cells of an 8 x 6 grid over the image
  double extent_long = 0;       ///< standard deviations of the inliers' points along their first two principal axes [m]
  double extent_short = 0;
  double view_angle = 0;            ///< short extent (+-2 standard deviations) over the distance of the points [rad]
  double rms = 0;                   ///< [px]
  double range = 0;                 ///< camera to panorama [m]
  double facing = 1;                ///< share of the inliers whose wall faces the camera [0, 1]
  double alternative_margin = 0;    ///< log-likelihood ratio over the plane's other pose
  double alternative_distance = 0;  ///< between the two poses' positions [m]; 0 without alternative
  double competitor_share = 0;      ///< inliers of the competitor over those of the pose
  double position_stddev = 0;       ///< largest axis, image noise only [m]
  double angle_stddev = 0;          ///< largest axis, image noise only [rad]
};

struct AcceptanceSettings {
  int min_inliers = 12;
  double max_log_false_alarms = -6;
  double min_hull_share = 0.03;
  int min_cells = 4;
  double min_view_angle = 0.08;  ///< [rad]
  double max_rms = 4.0;          ///< [px]
  double max_range = 15.0;       ///< paper B, III.C [m]
  double min_facing = 0.9;
  double min_alternative_margin = 8;  ///< natural logarithm
  double harmless_alternative = 0.3;  ///< poses closer than this need no choice [m]
  double max_competitor_share = 0.5;
  double max_position_stddev = 0.3;             ///< image noise only [m]
  double max_angle_stddev = 0.69 * M_PI / 180;  ///< image noise only [rad]
  double min_score = 0.9;
  /// Logits of two logistic regressions, in all matches and in those that a filter kept: the score is the larger one's
  /// probability. Factors of 1, the inliers' share of them, ln(position_stddev / m), competitor_share, ln(cells).
  std::vector<double> by_all{-4.78, 7.41, -0.896, -3.90, 1.19}, by_kept{-15.68, 14.14, -2.15, -7.34, 0.14};

  /// Throws std::invalid_argument, naming the field, when a value cannot work.
  void validate() const;
};

struct Acceptance {
  bool accepted = false;
  double score = 0;    ///< calibrated probability that the pose is right [0, 1]
  std::string reason;  ///< one line: what failed first, with the figure and its bound; "accepted" otherwise
  PoseEvidence evidence;
};

/// Evidence of a pose that succeeded; all zero otherwise.
PoseEvidence gatherEvidence(const PoseResult& result, const std::vector<Correspondence>& correspondences,
                            const CameraModel& camera, const PointSource& source, const PoseSettings& pose_settings,
                            std::size_t first_dropped = std::numeric_limits<std::size_t>::max());

/// `correspondences`, camera, source, pose settings and `first_dropped` as given to estimatePose. Give all matches that
/// pass the ratio test, not only those that a filter such as k-VLD kept: the wrong ones are evidence, too.
Acceptance judge(const PoseResult& result, const std::vector<Correspondence>& correspondences,
                 const CameraModel& camera, const PointSource& source, const PoseSettings& pose_settings,
                 const AcceptanceSettings& settings,
                 std::size_t first_dropped = std::numeric_limits<std::size_t>::max());

}  // namespace streetview_localizer
