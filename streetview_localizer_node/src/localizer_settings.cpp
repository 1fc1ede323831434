#include <stdexcept>

#include "air_ground_common/parameters.h"
#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

void describe(air_ground_common::ParameterVisitor& v, StreetviewLocalizerSettings& l) {
  v.section("Search near a prediction");
  v("near_panoramas", l.near_panoramas, {1, 1000}, "",
    "the nearest that show what would be seen from there, which are searched then; the paper: 4 to 8");
  v("max_prior_stddev", l.max_prior_stddev, {0.1, 10000}, "m",
    "a prediction worse than this in x or y is not used for the search");

  v.section("Matching (steps 1 to 5)");
  bool virtual_views = !l.features.views.empty();
  v("virtual_views", virtual_views, "also match what cameras below, above and beside would see");
  if (!virtual_views) l.features.views.clear();
  v("quick_inliers", l.quick_inliers, {0, 100000}, "",
    "the image's strongest features come first; all of them only where those give no accepted pose with so many "
    "distinct inliers; virtual views where those give none either; 0: always everything");
  v("quick_features", l.quick_features, {1, 1000000}, "", "of the image, the strongest, used in that first attempt");
  v("quick_views", l.quick_views, {1, 1000}, "", "of the database, matched pairwise in it");
  v.choice("index", l.index.method,
           {{"hnsw", IndexMethod::kHnsw}, {"flann", IndexMethod::kFlann}, {"brute_force", IndexMethod::kBruteForce}},
           "over the whole database; flann as the paper (the default without hnswlib), brute_force: exact");
  v("index_threads", l.index.build_threads, {0, 256}, "",
    "for building it; 0: all; with more than 1 it depends on their timing");
  v("hnsw_search", l.index.hnsw_search, {1, 100000}, "",
    "candidates kept while searching: more is slower and finds more");
  v("flann_checks", l.index.flann_checks, {1, 1000000}, "", "leaves visited: the same");
  v("search_features", l.search_features, {0, 1000000}, "",
    "of an image, the strongest, looked for in the whole database; 0: all");
  v("neighbors", l.neighbors, {2, 1000}, "", "found of each");
  v("max_features", l.features.original.max_features, {0, 1000000}, "", "of the image itself, the strongest; 0: all");
  v("max_views", l.max_views, {1, 1000}, "", "of the database, matched pairwise with an image");
  v("max_ratio", l.pairwise.max_ratio, {0.1, 1}, "", "distance of the best match over that of the second best place");
  v("kvld_supporters", l.kvld.min_supporters, {0, 100}, "", "matches that must agree with a match along virtual lines");
  v("min_view_matches", l.min_view_matches, {1, 10000}, "", "a view with fewer is dropped");
  v("merge_position_stddev", l.merge_position_stddev, {0, 100}, "m",
    "panoramas, or photographs, known better than this, ...");
  v.degrees("merge_orientation_stddev", l.merge_orientation_stddev, {0, 45},
            "... and this, are matched as one, and their common points placed by all of them");

  v.section("Pose");
  v("inlier_threshold", l.pose.inlier_threshold, {0.1, 100}, "px", "reprojection error");
  v("pixel_stddev", l.pose.pixel_stddev, {0.01, 100}, "px", "least noise of a match that is believed");
  v("max_iterations", l.pose.max_iterations, {10, 1000000}, "", "of RANSAC");
  v("surface_stddev", l.fusion.surface_stddev, {0.001, 10}, "m",
    "of facades about the model's walls, where several panoramas see a point");
  v("max_fusion_shift", l.max_fusion_shift, {0.1, 1000}, "",
    "a pose from such points, in standard deviations from the first one, ...");
  v("min_fusion_inliers", l.min_fusion_inliers, {0, 1}, "",
    "... and its share of that one's inliers: otherwise the first one stays");
  v("model_lateral_stddev", l.model_lateral_stddev, {0, 10}, "m", "of the city model's walls; Zurich: 0.1");
  v("model_relief_stddev", l.model_relief_stddev, {0, 10}, "m",
    "of reveals, balconies and ledges that the model lacks, over patches of 2 m; 0: the model has them");
  v("model_height_stddev", l.model_height_stddev, {0, 10}, "m", "of its heights; Zurich: 0.5");
  v.choice("covariance", l.covariance,
           {{"refined", CovarianceKind::kRefined}, {"monte_carlo", CovarianceKind::kMonteCarlo}},
           "of the published pose: refined (of the estimate), or monte_carlo (the paper's scatter of minimal samples, "
           "metres where the estimate errs by decimetres)");
  int samples = l.pose.monte_carlo_samples > 0 ? l.pose.monte_carlo_samples : 1000;
  v("monte_carlo_samples", samples, {10, 1000000}, "", "of five matches");
  if (l.covariance == CovarianceKind::kMonteCarlo) l.pose.monte_carlo_samples = samples;

  v.section("Acceptance: only what passes all of it is published on streetview/pose");
  AcceptanceSettings& a = l.acceptance;
  v("accept/min_inliers", a.min_inliers, {5, 10000}, "", "");
  v("accept/max_rms", a.max_rms, {0.1, 100}, "px", "reprojection error");
  v("accept/max_range", a.max_range, {0.1, 1000}, "m", "from the camera to the panorama (the paper's 15 m rule)");
  v("accept/min_score", a.min_score, {0, 0.999999}, "", "calibrated probability that the pose is right");
  v("accept/by_all", a.by_all, {-1000, 1000}, "",
    "that probability's logit, by all matches: factors of 1, the inliers' share of them, ln(position_stddev / m), the "
    "competitor's share, ln(cells); `rosrun air_ground fit_acceptance` fits them to recorded evidence");
  v("accept/by_kept", a.by_kept, {-1000, 1000}, "", "the same by the matches that k-VLD kept; the larger one counts");
  v("accept/max_competitor_share", a.max_competitor_share, {0.01, 10}, "",
    "inliers of the best other pose over those of this: repeated windows");
  v("accept/max_position_stddev", a.max_position_stddev, {0.001, 100}, "m", "from image noise alone");
  v.degrees("accept/max_angle_stddev", a.max_angle_stddev, {0.01, 90}, "");
  v("accept/min_height", l.min_height, {-100, 100}, "m", "of the camera above the model's ground");
  v("accept/min_visible_share", l.min_visible_share, {0, 1}, "",
    "of the matched points that the model does not hide from the pose");
  v("accept/max_disagreement", l.max_disagreement, {0.01, 1000}, "m",
    "poses from two panoramas, both accepted, that lie farther apart contradict each other, unless the panoramas' own "
    "standard deviations explain it");
  v("accept/min_rival_share", l.min_rival_share, {0, 10}, "",
    "a panorama with fewer than this share of the best one's inliers has no say in that");
}

void StreetviewLocalizerSettings::validate() const {
  air_ground_common::checkRanges(*this);
  if (!(max_turn > 0)) throw std::invalid_argument("localizer: max_turn must be positive");
  if (covariance == CovarianceKind::kMonteCarlo && pose.monte_carlo_samples <= 0)
    throw std::invalid_argument("localizer: the Monte Carlo covariance needs pose.monte_carlo_samples");
  pose.validate();
  acceptance.validate();
  fusion.validate();
}

}  // namespace streetview_localizer
