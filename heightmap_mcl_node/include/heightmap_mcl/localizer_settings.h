// Settings of the localizer, by what they are for.
#pragma once

#include <cstdint>

#include "heightmap_mcl/height_map.h"
#include "heightmap_mcl/particle_filter.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace heightmap_mcl {

/// kSearch: every cloud is searched for over the whole map, and the particles say when to believe it. kPaper: the first
/// cloud's cost map seeds the particles, which are then alone, and their mean is the estimate.
enum class Mode { kSearch, kPaper };

/// Settings with tops as far as they were seen.
HeightMapSettings boundedMap(bool drop_hanging);

/// Aerial clouds of a map without scale, see HeightMapLocalizer::setOwnUnit. Its unit is the distance of what the MAV
/// saw at the map's start, and all distances in these bounds are equally likely by order of magnitude.
struct OwnUnitSettings {
  double scale_min = 0.05;      ///< [m per unit]
  double scale_max = 30;        ///< [m per unit]
  double max_tilt = 0.6;        ///< of that map's z axis from the vertical [rad]; 0: it is vertical
  double scale_evidence = 0.1;  ///< see CoarseEstimate: little, since the verdict on the place tells scales apart, too
  int verify = 32;              ///< as HeightMapLocalizerSettings::verify: what few clouds show fits at many scales
};

/// What makes another place of one that was found.
struct RivalSettings {
  double distance = 0.4;  ///< a rival lies at least this far off [m] ...
  double angle = 0.26;    ///< ... or is turned by this [rad]
};

/// What it takes to be believed. Scores are those of the verification map at full resolution.
struct VerdictSettings {
  int min_maps = 2;  ///< aerial maps seen before CONVERGED
  /// By which the place leads all others, summed over the maps that had it as their best (a cumulative sum, Page 1954;
  /// each counts for at most half of it, and nothing in favour while places cannot be told apart): logarithm of how
  /// much likelier the heights are there, n / (2 sigma^2) times the difference of both scores (see agreement.h) over n
  /// independent measurements. 15: the logarithm of some 7e4 places that differ (72 headings, 1000 offsets), and of 50.
  double min_evidence = 15;
  double min_mode_weight = 0.7;  ///< share of the particles in the dominant mode
  double max_spread = 0.20;      ///< of the position within the dominant mode [m]
  double max_spread_yaw = 0.10;  ///< of the heading within the dominant mode [rad]
  double ambiguity_ratio = 1.3;  ///< the best rival place must be this many times as bad, see rivalRatio
  double min_relief = 0.02;      ///< standard deviation of the heights in the overlap [m]; below, the floor is flat ...
  double min_raised = 0.16;      ///< ... or when less than this stands on it in either map [m^2]
  double min_agreement = 0.7;    ///< see Agreement::agreeing
  double probe_ratio = 1.2;      ///< the cost at probe_distance must be this much higher, else a direction is not fixed
  // What it takes to be a guess for a refinement: the evidence, of places that are told apart this much.
  double guess_ratio = 1.1;      ///< instead of ambiguity_ratio and probe_ratio
  double guess_agreement = 0.4;  ///< instead of min_agreement
};

struct CovarianceSettings {
  double floor_position = 0.07;  ///< standard deviation that no amount of data removes [m]
  double floor_yaw = 0.03;       ///< [rad]
  double floor_z = 0.05;         ///< [m]
  double gravity_sigma = 0.01;   ///< of each map's vertical, about x and y [rad]
};

struct HeightMapLocalizerSettings {
  Mode mode = Mode::kSearch;
  HeightMapSettings air_map = boundedMap(false);
  HeightMapSettings ground_map = boundedMap(true);  ///< same resolution, tops and cap as air_map
  int accumulate = 4;  ///< aerial clouds merged into the map that weighs the particles; 1 = paper
  int verify = 8;      ///< aerial clouds merged into the map that checks the result for rivals and refines it
  Merge merge = Merge::kMean;

  double min_overlap = 0.5;     ///< see CostSettings
  bool overlap_of_air = false;  ///< see CostSettings
  double unknown_weight = 1;  ///< CostSettings::unknown_cost as a share of what unrelated heights would cost; 0 = paper
  double min_explained = 0.25;  ///< see Zmssd::explained; the search charges a place with less as if without partners
  double edge_width = 0.04;     ///< by which the aerial map's edges may lie beside where they are [m], see aerialCells
  double cutoff = 0.1;          ///< see agreement.h [m]
  double max_slope = 0.05;      ///< of flat floors, above which heights in metres are compared [rad]; 0: above level
  int headings = 72;            ///< over the full circle, in the coarse search
  int coarse_factor = 4;        ///< cells of the coarse search are this much larger
  FilterSettings filter;
  std::uint64_t seed = 1;
  OwnUnitSettings own_unit;

  // How places are compared.
  RivalSettings rival;
  double noise_cost = 1e-4;        ///< [m^2] added to both sides of a ratio: differences below it mean nothing
  double independent_area = 0.16;  ///< [m^2] whose residuals count as one independent measurement
  double probe_distance = 0.25;    ///< along the flattest direction of the cost, see VerdictSettings::probe_ratio [m]
  VerdictSettings verdict;
  CovarianceSettings covariance;

  /// Aerial clouds that are merged, with or without a scale.
  int verifyFor(bool own_unit_clouds) const { return own_unit_clouds ? own_unit.verify : verify; }
};

/// The filter of the paper: kPaper with single clouds, highest points, sigma 0.08 and an overlap of the aerial map's
/// cells, whatever `s` says of these.
HeightMapLocalizerSettings paperSettings(HeightMapLocalizerSettings s);

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, HeightMapLocalizerSettings& settings);

/// Checks ranges and consistency; throws std::invalid_argument naming the field.
void validate(const HeightMapLocalizerSettings& settings);

}  // namespace heightmap_mcl
