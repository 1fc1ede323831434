#include "node_parameters.h"

#include <cmath>

namespace heightmap_mcl {
namespace {

using air_ground_common::ros_utils::Parameters;

void readHeightMap(Parameters& p, const std::string& prefix, HeightMapSettings& s) {
  const std::string tops = p.choice("tops", "bounded", {"highest", "clipped", "bounded"});
  s.tops = tops == "highest" ? Tops::kHighest : tops == "clipped" ? Tops::kClipped : Tops::kBounded;
  s.cap = p.number("cap", s.cap, 0.1, 1000.0);
  s.drop_hanging = p.flag(prefix + "drop_hanging", s.drop_hanging);
  s.resolution = 1.0 / p.number("cells_per_metre", 1.0 / s.resolution, 5, 200);
  const std::string dilation = p.choice(prefix + "dilation", "all", {"none", "holes", "all"});
  s.dilation = dilation == "none" ? Dilation::kNone : dilation == "holes" ? Dilation::kHoles : Dilation::kAll;
  s.height_quantile = p.number(prefix + "height_quantile", s.height_quantile, 0.01, 1.0);
  s.min_points = p.integer(prefix + "min_points", s.min_points, 1, 1000);
  s.max_spike = p.number(prefix + "max_spike", s.max_spike, 0.0, 100.0);
  s.max_extent = p.number(prefix + "max_extent", s.max_extent, 1.0, 200.0);
}

}  // namespace

NodeSettings readParameters(Parameters& p) {
  NodeSettings n;
  LocalizerSettings& s = n.localizer;
  n.ground_map_frame = p.text("ground_map_frame", "");
  n.mav_map_frame = p.text("mav_map_frame", "");
  n.publish_tf = p.flag("publish_tf", false);
  n.tf_rate = p.number("tf_rate", n.tf_rate, 0.1, 1000);
  n.cloud_queue = p.integer("cloud_queue", n.cloud_queue, 1, 10000);
  n.odometry_gap = p.number("odometry_gap", n.odometry_gap, 0.01, 10.0);

  readHeightMap(p, "air/", s.air_map);
  readHeightMap(p, "ground/", s.ground_map);
  s.accumulate = p.integer("accumulate", s.accumulate, 1, 200);
  s.verify = p.integer("verify", s.verify, 1, 200);
  s.merge = p.choice("merge", "mean", {"highest", "mean"}) == "mean" ? Merge::kMean : Merge::kHighest;

  s.min_overlap = p.number("min_overlap", s.min_overlap, 0.05, 1.0);
  s.unknown_weight = p.number("unknown_weight", s.unknown_weight, 0.0, 2.0);
  s.headings = p.integer("headings", s.headings, 8, 720);
  s.coarse_factor = p.integer("coarse_factor", s.coarse_factor, 1, 16);
  const std::string heading_mode = p.choice("heading_mode", "search", {"search", "prior", "compass"});
  n.compass = heading_mode == "compass";
  if (heading_mode == "prior") n.prior.yaw = 0.0;
  const double yaw = p.number("heading_prior", 0.0, -M_PI, M_PI);
  n.prior.yaw_sigma = p.number("heading_sigma", 0.17, 0.002, M_PI);
  if (n.prior.yaw) n.prior.yaw = yaw;

  FilterSettings& f = s.filter;
  s.seed = static_cast<std::uint64_t>(p.integer("seed", 1, 0, 1 << 30));
  f.particles = p.integer("particles", f.particles, 10, 100000);
  f.sampling_sigma = p.number("sampling_sigma", f.sampling_sigma, 1e-6, 10.0);
  f.weight_sigma = p.number("weight_sigma", f.weight_sigma, 1e-6, 10.0);
  f.mixture_ratio = p.number("mixture_ratio", f.mixture_ratio, 0.0, 0.9);
  f.position_noise = p.number("position_noise", f.position_noise, 0.0, 1.0);
  f.position_noise_per_metre = p.number("position_noise_per_metre", f.position_noise_per_metre, 0.0, 1.0);
  f.yaw_noise = p.number("yaw_noise", f.yaw_noise, 0.0, 0.8);
  f.yaw_noise_per_metre = p.number("yaw_noise_per_metre", f.yaw_noise_per_metre, 0.0, 0.8);

  s.min_maps = p.integer("min_maps", s.min_maps, 1, 100);
  s.min_evidence = p.number("min_evidence", s.min_evidence, 0.1, 1e4);
  s.min_mode_weight = p.number("min_mode_weight", s.min_mode_weight, 0.05, 1.0);
  s.max_spread = p.number("max_spread", s.max_spread, 0.01, 10.0);
  s.max_spread_yaw = p.number("max_spread_yaw", s.max_spread_yaw, 0.002, M_PI);
  s.ambiguity_ratio = p.number("ambiguity_ratio", s.ambiguity_ratio, 1.001, 100.0);
  s.noise_cost = p.number("noise_cost", s.noise_cost, 1e-9, 1.0);
  s.rival_distance = p.number("rival_distance", s.rival_distance, 0.05, 10.0);
  s.rival_angle = p.number("rival_angle", s.rival_angle, 0.02, M_PI / 2);
  s.min_relief = p.number("min_relief", s.min_relief, 0.0, 10.0);
  s.min_explained = p.number("min_explained", s.min_explained, 0.0, 0.99);
  s.probe_distance = p.number("probe_distance", s.probe_distance, 0.05, 5.0);
  s.probe_ratio = p.number("probe_ratio", s.probe_ratio, 1.001, 100.0);

  s.cells_per_independent = p.number("cells_per_independent", s.cells_per_independent, 1.0, 1e6);
  s.floor_position = p.number("floor_position", s.floor_position, 1e-4, 1.0);
  s.floor_z = p.number("floor_z", s.floor_z, 1e-4, 1.0);
  s.floor_yaw = p.number("floor_yaw", s.floor_yaw, 1e-5, 0.8);
  s.gravity_sigma = p.number("gravity_sigma", s.gravity_sigma, 1e-5, 0.8);
  n.search_radius = p.number("search_radius", n.search_radius, 0.5, 100.0);
  if (p.choice("mode", "search", {"search", "paper"}) == "paper") s = paperSettings(s);
  p.finish();
  try {
    validate(s);
  } catch (const std::invalid_argument& e) {
    throw air_ground_common::ros_utils::ParameterError(e.what());
  }
  return n;
}

}  // namespace heightmap_mcl
