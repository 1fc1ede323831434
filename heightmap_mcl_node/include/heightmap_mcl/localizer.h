// Global localization of the MAV in the ground robot's map from height maps: search, particles, and an honest verdict.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"
#include "heightmap_mcl/fft_cost.h"
#include "heightmap_mcl/particle_filter.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace heightmap_mcl {

enum class Status { kSearching, kAmbiguous, kDegenerate, kConverged };
const char* toString(Status status);

/// kSearch: every cloud is searched for over the whole map, and the particles say when to believe it. kPaper: the first
/// cloud's cost map seeds the particles, which are then alone, and their mean is the estimate.
enum class Mode { kSearch, kPaper };

/// Settings with tops as far as they were seen.
HeightMapSettings boundedMap(bool drop_hanging);

struct HeightMapLocalizerSettings {
  Mode mode = Mode::kSearch;
  HeightMapSettings air_map = boundedMap(false);
  HeightMapSettings ground_map = boundedMap(true);  ///< same resolution, tops and cap as air_map
  double min_overlap = 0.5;                         ///< see CostSettings
  bool overlap_of_air = false;                      ///< see CostSettings
  double unknown_weight = 1;  ///< CostSettings::unknown_cost as a share of what unrelated heights would cost; 0 = paper
  double edge_width = 0.04;   ///< by which the aerial map's edges may lie beside where they are [m], see aerialCells
  double cutoff = 0.1;        ///< see agreement.h [m]
  FilterSettings filter;
  std::uint64_t seed = 1;

  // Aerial clouds of a map without scale, see HeightMapLocalizer::setOwnUnit. Its unit is the distance of what the MAV
  // saw at the map's start, and all distances in these bounds are equally likely by order of magnitude.
  double scale_min = 0.3;       ///< [m per unit]
  double scale_max = 30;        ///< [m per unit]
  double max_tilt = 0.6;        ///< of that map's z axis from the vertical [rad]; 0: it is vertical
  double scale_evidence = 0.1;  ///< see CoarseEstimate: little, since the verdict on the place tells scales apart, too
  int headings = 72;            ///< over the full circle, in the coarse search
  int coarse_factor = 4;        ///< cells of the coarse search are this much larger
  int accumulate = 4;           ///< aerial clouds merged into the map that weighs the particles; 1 = paper
  int verify = 8;               ///< aerial clouds merged into the map that checks the result for rivals and refines it
  Merge merge = Merge::kMean;

  // What it takes to be believed. Scores are those of the verification map at full resolution.
  int min_maps = 2;  ///< aerial maps seen before CONVERGED
  /// By which the place leads all others, summed over the maps that had it as their best (a cumulative sum, Page 1954;
  /// each counts for at most half of it, and nothing in favour while places cannot be told apart): logarithm of how
  /// much likelier the heights are there, n / (2 sigma^2) times the difference of both scores (see agreement.h) over n
  /// independent cells. 15: the logarithm of some 7e4 places that differ (72 headings, 1000 offsets), and of 50.
  double min_evidence = 15;
  double min_mode_weight = 0.7;  ///< share of the particles in the dominant mode
  double max_spread = 0.20;      ///< of the position within the dominant mode [m]
  double max_spread_yaw = 0.10;  ///< of the heading within the dominant mode [rad]
  double ambiguity_ratio = 1.3;  ///< the best rival place must be this many times as bad, see rivalRatio
  double noise_cost = 1e-4;      ///< [m^2] added to both sides of a ratio: differences below it mean nothing
  double rival_distance = 0.4;   ///< a rival lies at least this far off [m] ...
  double rival_angle = 0.26;     ///< ... or is turned by this [rad]
  double min_relief = 0.02;      ///< standard deviation of the heights in the overlap [m]; below, the floor is flat ...
  double min_raised = 0.16;      ///< ... or when less than this stands on it in either map [m^2]
  double min_explained = 0.25;   ///< see Zmssd::explained; the search charges a place with less as if without partners
  double min_agreement = 0.7;    ///< see Agreement::agreeing
  double probe_distance = 0.25;  ///< the cost this far along its flattest direction ... [m]
  double probe_ratio = 1.2;      ///< ... must be this much higher, else the direction is not fixed
  // What it takes to be a guess for a refinement: the evidence, of places that are told apart this much.
  double guess_ratio = 1.1;      ///< instead of ambiguity_ratio and probe_ratio
  double guess_agreement = 0.4;  ///< instead of min_agreement

  // Covariance.
  double cells_per_independent = 400;  ///< cells whose residuals count as one independent measurement
  double floor_position = 0.07;        ///< standard deviation that no amount of data removes [m]
  double floor_yaw = 0.03;             ///< [rad]
  double floor_z = 0.05;               ///< [m]
  double gravity_sigma = 0.01;         ///< of each map's vertical, about x and y [rad]
};

/// The filter of the paper: kPaper with single clouds, highest points, sigma 0.08 and an overlap of the aerial map's
/// cells, whatever `s` says of these.
HeightMapLocalizerSettings paperSettings(HeightMapLocalizerSettings s);

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, HeightMapLocalizerSettings& settings);

/// Checks ranges and consistency; throws std::invalid_argument naming the field.
void validate(const HeightMapLocalizerSettings& settings);

/// One aerial point cloud.
struct AerialCloud {
  std::vector<Eigen::Vector3f> points;                  ///< in mav_map [m]; points that are not finite are ignored
  Eigen::Vector3d reference = Eigen::Vector3d::Zero();  ///< position of the MAV in mav_map [m]
};

struct CoarseEstimate {
  Status status = Status::kSearching;
  std::string reason;  ///< one line: why this status
  /// False until there is a pose at all (best guess; to be trusted only when status is kConverged).
  bool has_pose = false;
  air_ground_common::Pose T_ground_mav =
      air_ground_common::Pose::Identity();  ///< mav_map to ground_map; turns about z only
  /// Of the aerial clouds: a point p of theirs lies at T_ground_mav * (scale * R_level * p).
  double scale = 1;
  double scale_stddev = 0;                                ///< of it; 0 where the clouds are metric
  Eigen::Matrix3d R_level = Eigen::Matrix3d::Identity();  ///< turns their dominant floor level
  /// By how much more its place stands out from the other ones than at the next best scale (logarithm of a likelihood
  /// ratio, times the share explained, summed over pieces of ground); infinite where the clouds are metric.
  double scale_evidence = std::numeric_limits<double>::infinity();
  air_ground_common::Pose similarityPose() const;  ///< T_ground_mav * R_level: p_ground = scale * R p + t
  /// 6x6 (x y z rotX rotY rotZ) in the ground frame, of a point at `reference_point` carried by T_ground_mav.
  /// AMBIGUOUS: widened by the way to the rival. DEGENERATE: as wide as the ground map, and pi, along what is not
  /// fixed. SEARCHING: 1e6 I.
  air_ground_common::Matrix6d covariance = 1e6 * air_ground_common::Matrix6d::Identity();
  Eigen::Vector3d reference_point = Eigen::Vector3d::Zero();  ///< centre of the overlap, ground frame [m]
  double particle_spread = 0;                                 ///< [m], see ParticleFilter::Spread
  double particle_spread_yaw = 0;                             ///< [rad]
  PlanarPose particle_mean;    ///< of the MAV; as the other statistics of particles, before any are drawn anew
  double mode_weight = 0;      ///< share of the particles in the dominant mode
  double mode_spread = 0;      ///< of the position within it [m]
  double mode_spread_yaw = 0;  ///< of the heading within it [rad]
  double overlap = 0;          ///< share of the verification map's cells
  double cost = 0;             ///< eq. 2 at the estimate [m^2]
  double rival_ratio = 0;      ///< see HeightMapLocalizerSettings::ambiguity_ratio; infinite without rival
  double rival_distance = 0;   ///< [m]
  double explained = 0;        ///< see Zmssd::explained
  double agreement = 0;        ///< see Agreement::agreeing
  double evidence_lead = 0;    ///< of the place over its best rival, see HeightMapLocalizerSettings::min_evidence
  double evidence = 0;         ///< that sum
  double relief = 0;           ///< smaller one of the two maps' height deviations in the overlap [m]
  double raised = 0;           ///< area of the overlap where something stands on the floor in either map [m^2]
  double probe_ratio = 0;      ///< see HeightMapLocalizerSettings
  bool guess = false;          ///< not CONVERGED, but see HeightMapLocalizerSettings::guess_ratio
  int maps = 0;                ///< aerial maps used since the search began
  int restarts = 0;  ///< times all particles were drawn anew: they had lost the overlap or missed the best place
};

/// Not thread-safe: one worker owns it.
class HeightMapLocalizer {
 public:
  explicit HeightMapLocalizer(const HeightMapLocalizerSettings& settings);
  ~HeightMapLocalizer();

  /// Replaces the ground map. Where it is larger or smaller by a tenth than when the last search was made, or what was
  /// CONVERGED no longer agrees, the search is made again at once, else at the next aerial cloud; one that has not
  /// converged begins anew on the kept aerial maps, and may converge on them. Returns false (and forgets the ground
  /// map) when the cloud defines no cell. `cropped`: see buildHeightMap.
  bool setGround(const std::vector<Eigen::Vector3f>& points, std::size_t* cropped = nullptr);

  /// Adds an aerial cloud and updates the particles. Earlier ones that together with it would exceed air_map.max_extent
  /// are dropped. Returns false, changing nothing, when the cloud defines no cell or the reference is not finite.
  bool addAerial(const AerialCloud& cloud, std::size_t* cropped = nullptr);

  /// The verdict for the present maps; `has_pose` false while one of them is missing.
  const CoarseEstimate& estimate() const { return estimate_; }

  /// Begins the global search again. Aerial maps are kept unless `forget_aerial` (new mav_map).
  void restart(bool forget_aerial);
  void forgetGround();

  /// The aerial clouds are of a map in a unit of its own that is level only within max_tilt: their scale is searched
  /// for too, and they are turned so that their dominant floor is level. Forgets the aerial clouds if that is new.
  void setOwnUnit(bool own_unit);

  /// Used from the next (re)start on; pass {} to search everywhere.
  void setPrior(const Prior& prior) {
    prior_ = prior;
    verify_volume_.reset();
  }

  bool hasGround() const { return direct_ != nullptr; }
  bool hasAerial() const { return !aerial_.empty(); }
  /// Aerial maps dropped so far because the newest lay too far away.
  std::size_t farMapsDropped() const { return far_maps_dropped_; }
  const ParticleFilter& filter() const { return filter_; }
  const HeightMap& groundMap() const { return ground_; }
  /// The map that weighs the particles: the last `accumulate` clouds, at the estimate's scale.
  const HeightMap& aerialMap() const { return filter_map_; }
  /// Full-resolution cost map of the aerial map at the estimate's heading; poses refer to *pivot. Empty without maps.
  CostMap costMap(Eigen::Vector2d* pivot);

 private:
  struct Kept {
    HeightMap map;                        // level, at scale_
    Eigen::Vector3d reference;            // as given
    std::vector<Eigen::Vector3f> points;  // as given; for clouds in a unit of their own
  };
  HeightMap mapOf(const std::vector<Eigen::Vector3f>& points, const LevelHistogram& earlier,
                  std::size_t* cropped = nullptr) const;
  /// A point of the aerial map, level and in metres.
  Eigen::Vector3d inMetres(const Eigen::Vector3d& p) const { return scale_ * (R_level_ * p); }
  void drawFromKeptMaps();
  /// Where nothing has been heard for a place that now speaks for itself (the ground map came, grew or moved after the
  /// MAV's last cloud): takes the kept maps once more, one by one, as if they came now.
  void hearKeptMaps();
  void useNewestMap();
  /// Drops the oldest maps: a bound on the memory of the merged map and of the search over it.
  void boundKeptMaps();
  void updateFilter();
  void updateEstimate();
  /// own_unit.cpp, scale_search.cpp: level and scale at which the kept clouds fit best, over all scales, or around the
  /// present one once an estimate has converged; the kept maps are made anew where these have changed.
  void updateScale();
  /// Chooses among the places of the floor that the maps allow, by the best placement of each.
  void updateFloor();
  Placement bestPlacement(const HeightMap& map, const CostVolume& volume) const;
  bool updateLevel();
  void searchScales();
  std::vector<double> scalesToTry(double extent);
  std::vector<Eigen::Vector3f> kept(const std::vector<Eigen::Vector3f>& points) const;
  struct RawCloud;
  struct ScaleTrial;
  struct PlaceOnFloor {
    PlanarPose pose;                                          // of the kept clouds' centre
    double floor = std::numeric_limits<double>::quiet_NaN();  // of the aerial map [unit]; NaN: its own lowest surface
  };
  struct GroundLevel {
    HeightMap map;  // of larger cells
    std::unique_ptr<DirectCost> direct;
    std::unique_ptr<FftCost> fft;  // where it was needed
  };
  RawCloud rawCloud(std::size_t most) const;
  struct ScaledMap;
  ScaledMap scaledMap(double scale, const RawCloud& raw, int cells_across, int least_factor);
  ScaleTrial placeAnywhere(double scale, const RawCloud& raw);
  ScaleTrial placeNear(double scale, const RawCloud& raw, int cells_across, const PlaceOnFloor& start);
  void judgeTrial(ScaleTrial* trial, const ScaledMap& map, const HeightMap& lifted, const Agreement& there);
  double fitOf(const ScaleTrial& trial, bool charged = false) const;
  static double bendOf(const ScaleTrial& before, const ScaleTrial& middle, const ScaleTrial& after, double step);
  ScaleTrial bestOfScales(const RawCloud& raw);
  void refineScale(ScaleTrial* trial, const RawCloud& raw, double step);
  void settleScale(ScaleTrial* trial);
  double scaleDeviation(const ScaleTrial& trial) const;
  GroundLevel& groundLevel(int factor);
  int coarseFactor() const;
  double groundPiece();
  void remakeKeptMaps();
  Eigen::Vector2d lastReference() const { return inMetres(aerial_.back().reference).head<2>(); }
  /// Whether the last estimate needs no other search in the ground map of now.
  bool stillStands() const;
  /// The estimate of Mode::kPaper.
  void estimateFromParticles();
  /// The best place of the whole search.
  void estimateFromPlaces(const ParticleMode& mode);
  std::vector<Placement> findPlaces(const CostVolume& volume, const AerialCells& cells, const CostSettings& cost,
                                    const Placement& mode) const;
  Eigen::Vector2d overlapCenter(const AerialCells& cells, const PlanarPose& pose) const;
  bool isSame(const PlanarPose& a, const PlanarPose& b) const;
  Placement compareWithRivals(const Placement& best, const std::vector<Placement>& places);
  /// verdict.cpp. Sets status and reason. Returns the flattest direction of the cost at `best`: (x, y [m], yaw [rad])
  /// of the cells' reference.
  Eigen::Vector3d judge(const Placement& best, const AerialCells& cells, const CostSettings& cost,
                        bool particles_agree);
  Eigen::Vector3d probe(const Placement& best, const AerialCells& cells, const CostSettings& cost);
  /// There is relief, what stands on it agrees, and nowhere else as well.
  bool toldApart(double agreement, double rival_ratio) const;
  /// All that a map must show to count in favour: of CONVERGED, of a guess.
  bool speaksFor() const;
  bool speaksForGuess() const;
  bool isGuess() const;
  void gatherEvidence();  ///< adds a new map's lead
  /// To be called with the verdict known.
  void setCovariance(const Placement& best, const Placement& rival, const AerialCells& cells, const CostSettings& cost,
                     const ParticleMode& mode, const Eigen::Vector3d& flattest);
  /// Logarithm of how much likelier the heights are at a place than at another one of that score [m^2].
  double evidenceLead(const Agreement& place, double other_score) const;
  double independentCells(const Agreement& place) const;
  /// The same for mean squared residuals that are less by `cost_less` [m^2] over that many independent measurements.
  double logLikelihoodRatio(double independent, double cost_less) const;
  double unknownShare() const;  ///< see CostSettings
  double nothingKnown() const;  ///< score of a placement without partners [m^2]
  /// The best one that is not at `pose`; without a finite score where there is none.
  Placement bestElsewhere(const std::vector<Placement>& places, const PlanarPose& pose) const;
  std::vector<const HeightMap*> keptMaps(int count) const;
  HeightMap lastMaps(int count) const;
  CostVolume coarseVolume(const HeightMap& map) const;
  const CostVolume& verifyVolume(const HeightMap& verify_map);
  /// Cells of an aerial map, edges as wide as the settings say.
  AerialCells cellsOf(const HeightMap& air, const Eigen::Vector2d& reference) const;
  CostSettings costFor(const HeightMap& air) const;
  /// How many times as bad as the best place another one is: the own cost and what the other's score is higher.
  double rivalRatio(const Agreement& other, const Agreement& best) const;

  HeightMapLocalizerSettings settings_;
  Prior prior_;
  ParticleFilter filter_;
  HeightMap ground_, filter_map_;
  double ground_variance_ = 0;  // of the ground map's heights [m^2]
  double ground_raised_ = 0;    // see raisedShare
  std::unique_ptr<DirectCost> direct_;
  std::unique_ptr<FftCost> coarse_fft_, full_fft_;
  std::deque<Kept> aerial_;
  std::optional<CostVolume> verify_volume_;  // of the last `verify` clouds in the present ground map, once computed
  CoarseEstimate estimate_;
  double score_ = kInfinity;             // of the estimate's place [m^2]
  std::size_t searched_cells_ = 0;       // of the ground map in which it was found
  double floor_ = 0;                     // of the aerial maps [m]; NaN: as merged
  std::vector<Placement> floor_rivals_;  // the best placements with other floors
  bool own_unit_ = false;
  double scale_ = 1, scale_stddev_ = 0, scale_evidence_ = 0;
  double scale_floor_ = std::numeric_limits<double>::quiet_NaN();  // see PlaceOnFloor
  std::vector<double> scale_peaks_;                                // the last grid's best scales
  int grids_ = 0, clouds_since_grid_ = 0;
  Eigen::Matrix3d R_level_ = Eigen::Matrix3d::Identity();
  std::map<int, std::unique_ptr<GroundLevel>> ground_levels_;  // by the factor of their cells
  double ground_piece_ = 0;  // area over which the ground map's heights are alike [m^2]; 0: not known yet
  int maps_ = 0, restarts_ = 0;
  std::size_t far_maps_dropped_ = 0;
  // Gathered for the place before, for CONVERGED and for a guess.
  double evidence_ = 0, guess_evidence_ = 0;
  std::optional<air_ground_common::Pose> place_before_;  // T_ground_mav
  bool new_map_ = false;                                 // whose evidence has not been gathered yet
  bool weighed_ = false;  // the particles carry weights that the next resampling consumes
};

}  // namespace heightmap_mcl
