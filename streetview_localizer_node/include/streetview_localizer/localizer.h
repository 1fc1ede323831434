// The whole of paper B, II: an image in, a camera pose in the city out, or an honest refusal. ROS-free and
// deterministic.
#pragma once

#include <array>
#include <cmath>
#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "streetview_localizer/acceptance.h"
#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/database.h"
#include "streetview_localizer/descriptor_index.h"
#include "streetview_localizer/kvld.h"
#include "streetview_localizer/pairwise.h"
#include "streetview_localizer/point_fusion.h"
#include "streetview_localizer/pose_estimation.h"
#include "streetview_localizer/virtual_views.h"
#include "streetview_localizer/voting.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace streetview_localizer {

/// Of the pose that is handed out: the estimate's own, or the paper's scatter of minimal samples
/// (docs/streetview_pose.md).
enum class CovarianceKind { kRefined, kMonteCarlo };

struct StreetviewLocalizerSettings {
  VirtualViewSettings features;
  IndexSettings index;
  VotingSettings voting;
  PairwiseSettings pairwise;
  KvldSettings kvld;
  PoseSettings pose;
  AcceptanceSettings acceptance;
  PointFusionSettings fusion;

  std::string
      index_file;  ///< the index over the database is read from here, or built and kept here; empty: in memory alone
  /// The image's strongest features and the likeliest views come first; all features and views only where that gives no
  /// accepted pose with so many distinct inliers; the image's virtual views where those give none either. 0: always
  /// everything.
  int quick_inliers = 60;
  int quick_features = 1500;     ///< then
  int quick_views = 5;           ///< then
  int search_features = 2000;    ///< of the query, the strongest, looked for in the whole database; 0: all
  int neighbors = 12;            ///< found of each
  int max_views = 8;             ///< of the database, matched pairwise with an image
  int near_panoramas = 6;        ///< that show the place, searched where the prior tells it; the paper: 4 to 8
  double max_prior_stddev = 15;  ///< a prior position worse than this is not used for the search [m]
  int min_view_matches = 6;      ///< a view with fewer matches after k-VLD is dropped
  /// Panoramas with poses better than these are matched as one: a point of the facade gets its place from several of
  /// them.
  double merge_position_stddev = 0.03;                   ///< [m]
  double merge_orientation_stddev = 0.115 * M_PI / 180;  ///< [rad]
  double model_lateral_stddev = 0.1;                     ///< of the city model's walls [m] (paper B, II.B)
  double model_relief_stddev = 0.1;                      ///< of patches of a wall that the model takes for flat [m]
  double model_height_stddev = 0.5;                      ///< [m]
  CovarianceKind covariance = CovarianceKind::kRefined;  ///< kMonteCarlo needs pose.monte_carlo_samples
  /// A pose from fused points takes the place of the first one if it moved by no more than this in position and in
  /// attitude, each in standard deviations, and keeps this share of the inliers.
  double max_fusion_shift = 4;
  double min_fusion_inliers = 0.9;  ///< [0, 1]
  double min_height = 0.2;          ///< of the camera above the model's ground, where it has one [m]
  double min_visible_share = 0.7;   ///< of the inliers' points not hidden by the model from the estimated pose [0, 1]
  /// Between poses from different panoramas that are both accepted [m]; three standard deviations of what the
  /// panoramas state are allowed where that is more.
  double max_disagreement = 1.0;
  double min_rival_share = 0.25;  ///< a panorama with fewer of the best one's inliers has no say in this [0, 1]
  double max_turn = 0.1;          ///< the same for the attitude [rad]

  /// Throws std::invalid_argument, naming the field, when a value cannot work.
  void validate() const;
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, StreetviewLocalizerSettings& settings);

enum class LocalizerStatus { kAccepted, kRefused, kNoPose, kNoMatch };
const char* nameOf(LocalizerStatus status);  ///< "accepted", "refused", "no_pose", "no_match"

/// Steps as in the paper's figure 4, and the pose.
enum class Step { kFeatures, kSearch, kVoting, kMatching, kVerification, kPose };
constexpr int kSteps = 6;
const char* nameOf(Step step);

struct LocalizerResult {
  LocalizerStatus status = LocalizerStatus::kNoMatch;
  std::string reason;  ///< one line for a person
  PoseResult
      pose;  ///< its indices count `correspondences`; those of its competitor may reach beyond, to dropped matches
  Acceptance acceptance;
  std::vector<Correspondence>
      correspondences;                 ///< after k-VLD, of the panoramas behind the pose; of the best match without one
  std::vector<int> views;              ///< of each correspondence: index of the database's view
  int panorama = -1;                   ///< index of the panorama with the most inliers, or matches without a pose
  int view = -1;                       ///< its best view
  std::vector<int> searched;           ///< panoramas matched pairwise, best first
  bool used_prior = false;             ///< the prior chose them
  bool contradicted = false;           ///< poses, or the mirror image, speak against each other: nothing more was tried
  bool quick = false;                  ///< no virtual views were made: the image itself was enough, or hopeless
  int features = 0;                    ///< of the image and, where made, its virtual views
  int matches = 0;                     ///< after k-VLD, all views together
  std::array<double, kSteps> times{};  ///< [s]
  double total_time = 0;               ///< [s]

  bool accepted() const { return status == LocalizerStatus::kAccepted; }
};

/// Thread-safe. Holds the search index and small caches.
class StreetviewLocalizer {
 public:
  /// Throws std::invalid_argument for bad settings or a database without views, features or images.
  StreetviewLocalizer(std::shared_ptr<const StreetviewDatabase> database,
                      const StreetviewLocalizerSettings& settings = {});
  ~StreetviewLocalizer();

  /// `image`: 8-bit, grey or BGR, as recorded with `camera`; of wide-angle cameras (rational_polynomial, equidistant)
  /// the central 100 degrees are used, as a pinhole's view. One of much finer resolution than the database's views is
  /// reduced to 1.5 times their focal length; the result's matches are in pixels of `image`, its thresholds and
  /// pose.rms in those of the reduced one. Throws std::invalid_argument when they do not fit together,
  /// or the prior is not finite or its covariance not positive definite; everything that an image can show is answered
  /// in the result.
  LocalizerResult localize(const cv::Mat& image, const CameraModel& camera, const PosePrior& prior = {}) const;

  const StreetviewDatabase& database() const;
  const BackProjector& projector() const;
  const StreetviewLocalizerSettings& settings() const;
  /// One line on how the search index came to be: read, or built and kept, or why not.
  const std::string& indexRemark() const;

 private:
  struct Impl;
  class Query;
  std::unique_ptr<Impl> impl_;
};

}  // namespace streetview_localizer
