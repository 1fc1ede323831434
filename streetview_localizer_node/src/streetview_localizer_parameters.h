// Parameters of streetview_localizer_node; config/streetview_localizer.yaml is their manual.
#pragma once

#include <cmath>
#include <string>

#include "air_ground_common/ros/parameters.h"
#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

struct NodeSettings {
  std::string database, world_frame, base_frame, camera_frame;
  std::string image_transport = "raw";  ///< or "compressed"
  bool use_prior = true, use_gravity = true, display = true;
  int prior_misses = 3;
  double min_period = 0, prior_max_age = 1, prior_speed = 3, gravity_max_age = 0.1, gravity_wait = 0.3,
         gravity_stddev = 0.02;
  double model_spacing = 0.2;  ///< [m]
  int model_max_points = 400000, display_width = 480, cameras_shown = 500;
  DatabaseLoadOptions load;
  LocalizerSettings localizer;
};

/// `Source`: air_ground_common::ros_utils::Parameters, or what has the same getters.
template <typename Source>
NodeSettings readSettings(Source& p) {
  constexpr double kDegree = M_PI / 180;
  NodeSettings s;
  s.database = p.text("database", "");
  const Eigen::Vector2d centre(p.number("region/easting", 0, -1e8, 1e8), p.number("region/northing", 0, -1e8, 1e8));
  const double radius = p.number("region/radius", 0, 0, 1e6);
  if (radius > 0) s.load.centre = centre, s.load.radius = radius;
  s.world_frame = p.text("world_frame", "world");
  s.base_frame = p.text("base_frame", "mav_base_link");
  s.camera_frame = p.text("camera_frame", "");
  s.image_transport = p.choice("image_transport", s.image_transport, {"raw", "compressed"});
  s.min_period = p.number("min_period", s.min_period, 0, 3600);

  s.use_prior = p.flag("use_prior", s.use_prior);
  s.prior_max_age = p.number("prior_max_age", s.prior_max_age, 0.01, 60);
  s.prior_speed = p.number("prior_speed", s.prior_speed, 0, 100);
  s.prior_misses = p.integer("prior_misses", s.prior_misses, 1, 1000000);
  s.use_gravity = p.flag("use_gravity", s.use_gravity);
  s.gravity_max_age = p.number("gravity_max_age", s.gravity_max_age, 0.001, 10);
  s.gravity_wait = p.number("gravity_wait", s.gravity_wait, 0, 10);
  s.gravity_stddev = kDegree * p.number("gravity_stddev", s.gravity_stddev / kDegree, 0.01, 45);

  LocalizerSettings& l = s.localizer;
  l.index.method = indexMethodFromString(p.choice("index", toString(l.index.method), {"hnsw", "flann", "brute_force"}));
  l.index.hnsw_search = p.integer("hnsw_search", l.index.hnsw_search, 1, 100000);
  l.index.flann_checks = p.integer("flann_checks", l.index.flann_checks, 1, 1000000);
  l.index.build_threads = p.integer("index_threads", l.index.build_threads, 0, 256);
  if (p.flag("keep_index", true)) l.index_file = indexFileOf(s.database, s.load);
  l.search_features = p.integer("search_features", l.search_features, 0, 1000000);
  l.neighbors = p.integer("neighbors", l.neighbors, 2, 1000);
  l.max_views = p.integer("max_views", l.max_views, 1, 1000);
  l.near_panoramas = p.integer("near_panoramas", l.near_panoramas, 1, 1000);
  l.max_prior_stddev = p.number("max_prior_stddev", l.max_prior_stddev, 0.1, 10000);
  l.min_view_matches = p.integer("min_view_matches", l.min_view_matches, 1, 10000);
  l.features.original.max_features = p.integer("max_features", l.features.original.max_features, 0, 1000000);
  if (!p.flag("virtual_views", true)) l.features.views.clear();
  l.quick_inliers = p.integer("quick_inliers", l.quick_inliers, 0, 100000);
  l.quick_features = p.integer("quick_features", l.quick_features, 1, 1000000);
  l.quick_views = p.integer("quick_views", l.quick_views, 1, 1000);
  l.pairwise.max_ratio = p.number("max_ratio", l.pairwise.max_ratio, 0.1, 1);
  l.kvld.min_supporters = p.integer("kvld_supporters", l.kvld.min_supporters, 0, 100);
  l.merge_position_stddev = p.number("merge_position_stddev", l.merge_position_stddev, 0, 100);
  l.merge_orientation_stddev =
      kDegree * p.number("merge_orientation_stddev", l.merge_orientation_stddev / kDegree, 0, 45);

  l.pose.inlier_threshold = p.number("inlier_threshold", l.pose.inlier_threshold, 0.1, 100);
  l.pose.pixel_stddev = p.number("pixel_stddev", l.pose.pixel_stddev, 0.01, 100);
  l.pose.max_iterations = p.integer("max_iterations", l.pose.max_iterations, 10, 1000000);
  l.fusion.surface_stddev = p.number("surface_stddev", l.fusion.surface_stddev, 0.001, 10);
  l.max_fusion_shift = p.number("max_fusion_shift", l.max_fusion_shift, 0.1, 1000);
  l.min_fusion_inliers = p.number("min_fusion_inliers", l.min_fusion_inliers, 0, 1);
  l.model_lateral_stddev = p.number("model_lateral_stddev", l.model_lateral_stddev, 0, 10);
  l.model_height_stddev = p.number("model_height_stddev", l.model_height_stddev, 0, 10);

  const bool monte_carlo = p.choice("covariance", "refined", {"refined", "monte_carlo"}) == "monte_carlo";
  const int samples = p.integer("monte_carlo_samples", 1000, 10, 1000000);
  if (monte_carlo) l.covariance = CovarianceKind::kMonteCarlo, l.pose.monte_carlo_samples = samples;

  AcceptanceSettings& a = l.acceptance;
  a.min_inliers = p.integer("accept/min_inliers", a.min_inliers, 5, 10000);
  a.max_rms = p.number("accept/max_rms", a.max_rms, 0.1, 100);
  a.max_range = p.number("accept/max_range", a.max_range, 0.1, 1000);
  a.min_score = p.number("accept/min_score", a.min_score, 0, 0.999999);
  a.max_competitor_share = p.number("accept/max_competitor_share", a.max_competitor_share, 0.01, 10);
  a.max_position_stddev = p.number("accept/max_position_stddev", a.max_position_stddev, 0.001, 100);
  a.max_angle_stddev = kDegree * p.number("accept/max_angle_stddev", a.max_angle_stddev / kDegree, 0.01, 90);
  l.min_height = p.number("accept/min_height", l.min_height, -100, 100);
  l.min_visible_share = p.number("accept/min_visible_share", l.min_visible_share, 0, 1);
  l.min_rival_share = p.number("accept/min_rival_share", l.min_rival_share, 0, 10);
  l.max_disagreement = p.number("accept/max_disagreement", l.max_disagreement, 0.01, 1000);

  s.display = p.flag("display", s.display);
  s.display_width = p.integer("display_width", s.display_width, 64, 4096);
  s.model_spacing = p.number("model_spacing", s.model_spacing, 0.01, 100);
  s.model_max_points = p.integer("model_max_points", s.model_max_points, 1000, 100000000);
  s.cameras_shown = p.integer("cameras_shown", s.cameras_shown, 1, 100000);
  return s;
}

inline NodeSettings readParameters(const ros::NodeHandle& private_handle) {
  air_ground_common::ros_utils::Parameters p(private_handle);
  const NodeSettings s = readSettings(p);
  p.finish();
  if (s.database.empty())
    throw air_ground_common::ros_utils::ParameterError(
        "parameter database is empty: name the file that build_streetview_db made (database:=city.gpkg)");
  return s;
}

}  // namespace streetview_localizer
