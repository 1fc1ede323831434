#include "heightmap_mcl/localizer_settings.h"

#include <stdexcept>

#include "air_ground_common/parameters.h"

namespace heightmap_mcl {
namespace {

void describeMap(air_ground_common::ParameterVisitor& v, const std::string& group, HeightMapSettings& s) {
  v(group + "/drop_hanging", s.drop_hanging,
    "what begins above the cap with nothing seen below is a ceiling (true) or the top of something high (false); a "
    "ground robot sees ceilings");
  v.choice(group + "/dilation", s.dilation,
           {{"none", Dilation::kNone}, {"holes", Dilation::kHoles}, {"all", Dilation::kAll}},
           "holes: fill missing cells only; all: the paper's 3x3 maximum everywhere");
  v(group + "/height_quantile", s.height_quantile, {0.01, 1.0}, "",
    "of a cell's points; 1 = highest (paper); less suppresses spikes in dense clouds");
  v(group + "/min_points", s.min_points, {1, 1000}, "", "points that a cell needs");
  v(group + "/max_spike", s.max_spike, {0.0, 100.0}, "m",
    "drop cells that stand above all their neighbours by more; 0 = off");
  v(group + "/max_extent", s.max_extent, {1.0, 200.0}, "m",
    "of a larger cloud only the densest region of this edge is used (a warning says which); kept clouds that reach "
    "farther than this with the newest are dropped. Raise it for a larger ground map: memory and time of the search "
    "grow with its square (docs/heightmap_mcl.md, Limits)");
}

}  // namespace

void describe(air_ground_common::ParameterVisitor& v, HeightMapLocalizerSettings& s) {
  v.choice(
      "mode", s.mode, {{"search", Mode::kSearch}, {"paper", Mode::kPaper}},
      "search: every cloud is searched for in the whole map, and the particles say when to believe it. paper: the "
      "particles alone after the first cloud, their mean is the estimate; sets tops highest, accumulate and "
      "verify 1, merge highest, unknown_weight, min_explained, edge_width and mixture_ratio 0, min_maps 4, both sigmas "
      "0.08 and the overlap to that of the aerial map's cells");

  v.section("Height maps (VI-A)");
  HeightMapSettings& air = s.air_map;
  double cells_per_metre = 1 / air.resolution;
  v("cells_per_metre", cells_per_metre, {5, 200}, "", "resolution of both maps; paper: 50");
  s.ground_map.resolution = air.resolution = 1 / cells_per_metre;
  v.choice("tops", air.tops, {{"highest", Tops::kHighest}, {"clipped", Tops::kClipped}, {"bounded", Tops::kBounded}},
           "height of a cell. highest: its highest point (paper). clipped: not above cap. bounded: as far as it was "
           "seen; the end of a wall or an overhang says \"at least so high\", ceilings and lamps say nothing");
  v("cap", air.cap, {0.1, 1000.0}, "m",
    "above the floor, which is found in each map; what reaches it is \"at least so high\". Raise it where the ground "
    "itself rises by more");
  s.ground_map.tops = air.tops;
  s.ground_map.cap = air.cap;
  describeMap(v, "air", s.air_map);
  describeMap(v, "ground", s.ground_map);
  v("accumulate", s.accumulate, {1, 200}, "", "aerial clouds merged into the map that weighs the particles; 1 = paper");
  v("verify", s.verify, {1, 200}, "",
    "aerial clouds merged into the map that refines the estimate and looks for rivals. The MAV's drift over them "
    "should stay below a few cells. At least accumulate");
  v("verify_own_unit", s.own_unit.verify, {1, 200}, "",
    "the same of a MAV without IMU: what a few clouds show fits somewhere at many scales");
  v.choice("merge", s.merge, {{"highest", Merge::kHighest}, {"mean", Merge::kMean}},
           "of the clouds' heights in a cell; the highest of many collects their noise");

  v.section("Cost and search (eq. 2, 3)");
  v("min_overlap", s.min_overlap, {0.05, 1}, "",
    "share of the aerial map's cells (of the ground map's, if those are fewer) that must be defined in both; paper: "
    "0.5");
  v("unknown_weight", s.unknown_weight, {0.0, 2.0}, "",
    "charge for cells of the smaller map without a partner, as a share of what unrelated heights would cost by eq. 2; "
    "0 = paper. A place that explains less than min_explained is charged for its other cells too, up to all of "
    "them");
  v("min_explained", s.min_explained, {0.0, 0.99}, "",
    "share of the heights' variance (of the map that varies more) that the other map explains, see unknown_weight");
  v("edge_width", s.edge_width, {0.0, 0.5}, "m",
    "an aerial cell with a step of more than 0.1 m so near may be as high as anything there: dense reconstruction "
    "draws edges a little beside where they are; 0 = paper. Not for the search among scales");
  v("cutoff", s.cutoff, {0.001, 10.0}, "m",
    "places that eq. 2 finds are compared, refined and judged by how much agrees: a height that differs by more than "
    "this costs no more than that");
  v("max_slope", s.max_slope, {0, 0.3}, "rad",
    "where most of the ground robot's floor is one plane that leans by this or less (a slope, or a map that is not "
    "quite level), heights are compared above each map's own; 0 = paper: above level");
  v("scale_min", s.own_unit.scale_min, {1e-3, 1e3}, "m per unit",
    "of the clouds of a MAV without IMU, whose unit is the distance of what it saw when its map began; the search "
    "takes all from here ...");
  v("scale_max", s.own_unit.scale_max, {1e-3, 1e3}, "m per unit",
    "... to there for equally likely by order of magnitude");
  v("scale_evidence", s.own_unit.scale_evidence, {0, 1000}, "",
    "by how much the place at the best scale must stand out more from the places beside it than at any other scale, "
    "before it is verified; summed over the ground that both maps know");
  v("max_tilt", s.own_unit.max_tilt, {0, 1.1}, "rad",
    "without IMU the dominant plane within this of the map's z axis is made level; 0: the mounting on tf and a level "
    "start are trusted");
  v("headings", s.headings, {8, 720}, "", "headings of the coarse search over the full circle");
  v("coarse_factor", s.coarse_factor, {1, 16}, "",
    "cells of the coarse search are this much larger, of maps with more than 160 of them across more");

  v.section("Particles (eq. 4 to 6)");
  v("seed", s.seed, {0, 1 << 30}, "", "same seed, same input: same output");
  FilterSettings& f = s.filter;
  v("particles", f.particles, {10, 100000}, "", "paper: 200");
  v("sampling_sigma", f.sampling_sigma, {1e-6, 10.0}, "m^2",
    "sigma of eq. 5 for the first distribution. See docs/heightmap_mcl.md for why not 0.08");
  v("weight_sigma", f.weight_sigma, {1e-6, 10.0}, "m^2", "the same for the weights of later maps");
  v("mixture_ratio", f.mixture_ratio, {0.0, 0.9}, "",
    "share of particles drawn anew from the full search at every map; paper: none");
  v("position_noise", f.position_noise, {0.0, 1.0}, "m", "motion noise along each axis for every map");
  v("position_noise_per_metre", f.position_noise_per_metre, {0.0, 1.0}, "m/m", "and for each metre flown");
  v("yaw_noise", f.yaw_noise, {0.0, 0.8}, "rad", "for every map");
  v("yaw_noise_per_metre", f.yaw_noise_per_metre, {0.0, 0.8}, "rad/m", "");

  v.section("Verdict: when the pose is believed");
  v("min_maps", s.verdict.min_maps, {1, 100}, "", "aerial maps before CONVERGED");
  v("min_evidence", s.verdict.min_evidence, {0.1, 1e4}, "",
    "by which the place must lead all others, summed over the maps that had it as their best, each for at most half: "
    "logarithm of how much likelier the heights are there; clear scenes pass with two maps, rooms that look alike "
    "need more");
  v("min_mode_weight", s.verdict.min_mode_weight, {0.05, 1.0}, "", "share of the particles in the dominant mode");
  v("max_spread", s.verdict.max_spread, {0.01, 10.0}, "m", "standard deviation of the position within it");
  v("max_spread_yaw", s.verdict.max_spread_yaw, {0.002, M_PI}, "rad", "of the heading within it");
  v("ambiguity_ratio", s.verdict.ambiguity_ratio, {1.001, 100.0}, "",
    "any other place must cost this many times as much, else AMBIGUOUS");
  v("noise_cost", s.noise_cost, {1e-9, 1.0}, "m^2",
    "added to both sides of a ratio: differences below it mean nothing");
  v("rival_distance", s.rival.distance, {0.05, 10.0}, "m", "a rival lies at least this far away ...");
  v("rival_angle", s.rival.angle, {0.02, M_PI / 2}, "rad", "... or is turned by this");
  v("min_relief", s.verdict.min_relief, {0.0, 10.0}, "m",
    "standard deviation of the heights in the overlap; below: DEGENERATE (flat)");
  v("min_raised", s.verdict.min_raised, {0.0, 100.0}, "m^2",
    "of the overlap, on which something stands in either map; below: DEGENERATE (bare)");
  v("min_agreement", s.verdict.min_agreement, {0.0, 1.0}, "",
    "of what stands on the floor in either map, share whose heights agree (within 0.6 of cutoff)");
  v("probe_distance", s.probe_distance, {0.05, 5.0}, "m", "the cost this far along its flattest direction ...");
  v("probe_ratio", s.verdict.probe_ratio, {1.001, 100.0}, "",
    "... must be this much worse, else DEGENERATE (e.g. along an endless ridge)");
  v("guess_ratio", s.verdict.guess_ratio, {1.001, 100.0}, "",
    "a place that is not CONVERGED but has min_evidence over maps with this instead of ambiguity_ratio and probe_ratio "
    "is a guess for icp_refine, which believes what becomes of it when later clouds confirm it");
  v("guess_agreement", s.verdict.guess_agreement, {0.0, 1.0}, "", "and this instead of min_agreement");

  v.section("Covariance");
  v("independent_area", s.independent_area, {1e-4, 1e3}, "m^2",
    "of the overlap, whose residuals count as one independent measurement, whatever cells_per_metre is");
  v("floor_position", s.covariance.floor_position, {1e-4, 1.0}, "m",
    "standard deviation that no amount of data removes: scale, drift of the merged clouds");
  v("floor_z", s.covariance.floor_z, {1e-4, 1.0}, "m", "");
  v("floor_yaw", s.covariance.floor_yaw, {1e-5, 0.8}, "rad", "");
  v("gravity_sigma", s.covariance.gravity_sigma, {1e-5, 0.8}, "rad", "of each map's vertical");
}

void validate(const HeightMapLocalizerSettings& s) {
  const auto require = [](bool ok, const std::string& text) {
    if (!ok) throw std::invalid_argument("localizer settings: " + text);
  };
  require(s.air_map.resolution == s.ground_map.resolution, "both height maps must have the same resolution");
  require(s.air_map.tops == s.ground_map.tops && s.air_map.cap == s.ground_map.cap,
          "both height maps must have the same tops and cap");
  air_ground_common::checkRanges(s);
  validate(s.air_map);
  validate(s.ground_map);
  validate(CostSettings{s.min_overlap, 0, s.min_explained, s.verdict.min_relief});
  validate(s.filter);
  require(s.own_unit.scale_max >= s.own_unit.scale_min, "scale_max must not be less than scale_min");
  require(std::min(s.verify, s.own_unit.verify) >= s.accumulate,
          "verify and verify_own_unit must not be less than accumulate");
}

HeightMapLocalizerSettings paperSettings(HeightMapLocalizerSettings s) {
  s.mode = Mode::kPaper;
  s.accumulate = s.verify = s.own_unit.verify = 1;
  s.merge = Merge::kHighest;
  s.air_map.tops = s.ground_map.tops = Tops::kHighest;
  s.unknown_weight = s.min_explained = 0;
  s.edge_width = 0;
  s.overlap_of_air = true;
  s.verdict.min_maps = 4;  // particles alone have no other evidence
  s.filter.sampling_sigma = s.filter.weight_sigma = 0.08;
  s.filter.mixture_ratio = 0;
  return s;
}

HeightMapSettings boundedMap(bool drop_hanging) {
  HeightMapSettings settings;
  settings.tops = Tops::kBounded;
  settings.drop_hanging = drop_hanging;
  return settings;
}

}  // namespace heightmap_mcl
