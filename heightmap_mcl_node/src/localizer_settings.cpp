#include <stdexcept>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

const char* toString(Status status) {
  switch (status) {
    case Status::kSearching:
      return "SEARCHING";
    case Status::kAmbiguous:
      return "AMBIGUOUS";
    case Status::kDegenerate:
      return "DEGENERATE";
    case Status::kConverged:
      return "CONVERGED";
  }
  return "";
}

void validate(const LocalizerSettings& s) {
  const auto require = [](bool ok, const std::string& text) {
    if (!ok) throw std::invalid_argument("localizer settings: " + text);
  };
  validate(s.air_map);
  validate(s.ground_map);
  validate(CostSettings{s.min_overlap, 0, s.min_explained, s.min_relief});
  require(s.unknown_weight >= 0 && s.unknown_weight <= 2, "unknown_weight must be in [0, 2]");
  validate(s.filter);
  require(s.air_map.resolution == s.ground_map.resolution, "both height maps must have the same resolution");
  require(s.air_map.tops == s.ground_map.tops && s.air_map.cap == s.ground_map.cap,
          "both height maps must have the same tops and cap");
  require(s.scale_sigma >= 0 && s.scale_sigma <= 0.5, "scale_sigma must be in [0, 0.5]");
  require(s.headings >= 8 && s.headings <= 720, "headings must be 8 to 720");
  require(s.coarse_factor >= 1 && s.coarse_factor <= 16, "coarse_factor must be 1 to 16");
  require(s.accumulate >= 1, "accumulate must be at least 1");
  require(s.verify >= s.accumulate, "verify must not be less than accumulate");
  require(s.min_maps >= 1, "min_maps must be at least 1");
  require(s.min_evidence > 0, "min_evidence must be positive");
  require(s.min_mode_weight > 0 && s.min_mode_weight <= 1, "min_mode_weight must be in (0, 1]");
  require(s.max_spread > 0 && s.max_spread_yaw > 0, "max_spread and max_spread_yaw must be positive");
  require(s.ambiguity_ratio > 1 && s.probe_ratio > 1, "ambiguity_ratio and probe_ratio must be greater than 1");
  require(s.noise_cost > 0, "noise_cost must be positive [m^2]");
  require(s.rival_distance > 0 && s.rival_angle > 0, "rival_distance and rival_angle must be positive");
  require(s.min_relief >= 0 && s.probe_distance > 0, "min_relief must not be negative, probe_distance positive [m]");
  require(s.min_explained >= 0 && s.min_explained < 1, "min_explained must be in [0, 1)");
  require(s.cells_per_independent >= 1, "cells_per_independent must be at least 1");
  require(s.floor_position > 0 && s.floor_yaw > 0 && s.floor_z > 0 && s.gravity_sigma > 0, "floors must be positive");
}

LocalizerSettings paperSettings(LocalizerSettings s) {
  s.mode = Mode::kPaper;
  s.accumulate = s.verify = 1;
  s.merge = Merge::kHighest;
  s.air_map.tops = s.ground_map.tops = Tops::kHighest;
  s.unknown_weight = s.min_explained = 0;
  s.overlap_of_air = true;
  s.min_maps = 4;  // particles alone have no other evidence
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
