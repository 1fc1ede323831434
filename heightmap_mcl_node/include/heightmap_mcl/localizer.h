// Global localization of the MAV in the ground robot's map from height maps: search, particles, and an honest verdict.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "air_ground_common/map_correction.h"
#include "air_ground_common/vertical.h"
#include "heightmap_mcl/aerial_cloud.h"
#include "heightmap_mcl/coarse_estimate.h"
#include "heightmap_mcl/localizer_settings.h"
#include "heightmap_mcl/particle_filter.h"

namespace heightmap_mcl {

class Comparison;
class EvidenceSum;
class GroundModel;
class KeptMaps;
class PlaceSearch;
class ScaleSearch;
struct FoundPlace;

/// Conducts: what comes in goes to the parts named above and to the particles, and what they say becomes the estimate.
/// Not thread-safe: one worker owns it.
class HeightMapLocalizer {
 public:
  /// Throws std::invalid_argument, see validate.
  explicit HeightMapLocalizer(const HeightMapLocalizerSettings& settings);
  ~HeightMapLocalizer();

  /// Replaces the ground map. Where it is larger or smaller by a tenth than when the last search was made, the place of
  /// that agrees more or less by a tenth (what is CONVERGED: less), or the map was `corrected` as a whole (a loop
  /// closed), the search is made again at once, else at the next aerial cloud; one that has not converged begins anew
  /// on the kept aerial maps, and may converge on them. Returns false (and forgets the ground map) when the cloud
  /// defines no cell. `cropped`: see buildHeightMap.
  bool setGround(const std::vector<Eigen::Vector3f>& points, std::size_t* cropped = nullptr, bool corrected = false);

  /// Adds an aerial cloud and updates the particles. Earlier ones that together with it would exceed air_map.max_extent
  /// are dropped. Returns false, changing nothing, when the cloud defines no cell or the reference is not finite.
  bool addAerial(const AerialCloud& cloud, std::size_t* cropped = nullptr);
  /// As setGround and addAerial, but leave the search to the aerial cloud that comes next: what is CONVERGED needs none
  /// for each.
  bool keepGround(const std::vector<Eigen::Vector3f>& points, std::size_t* cropped = nullptr);
  bool keepAerial(const AerialCloud& cloud, std::size_t* cropped = nullptr);

  /// What clouds of the MAV's map have gone through since they were published: those at hand follow, and those to come.
  /// Where one moved by more than a cell, the search begins anew on them: evidence was gathered where they lay.
  void correct(const air_ground_common::CloudCorrections& corrections);

  /// The verdict for the present maps; `has_pose` false while one of them is missing.
  const CoarseEstimate& estimate() const { return estimate_; }

  /// Begins the global search again, that of the scale, too. Aerial maps are kept unless `forget_aerial` (new mav_map).
  void restart(bool forget_aerial);
  void forgetGround();

  /// The aerial clouds are of a map in a unit of its own that is level only within max_tilt: their scale is searched
  /// for too, and they are turned so that their dominant floor is level. Forgets the aerial clouds if that is new.
  void setOwnUnit(bool own_unit);

  /// What the MAV knows of up in the map of such clouds, from the next cloud on; until then, and with a `stddev` of 0,
  /// its z axis within max_tilt.
  void setVertical(const air_ground_common::Vertical& vertical);

  /// Used from the next (re)start on; pass {} to search everywhere.
  void setPrior(const Prior& prior);

  bool hasGround() const { return ground_ != nullptr; }
  bool hasAerial() const;
  /// Position of the MAV at the newest cloud, in mav_map as it is now; zero without one.
  Eigen::Vector3d reference() const;
  /// Aerial maps dropped so far because the newest lay too far away.
  std::size_t farMapsDropped() const;
  const ParticleFilter& filter() const { return filter_; }
  const HeightMap& groundMap() const;
  /// The map that weighs the particles: the last `accumulate` clouds, at the estimate's scale.
  const HeightMap& aerialMap() const { return filter_map_; }
  /// Full-resolution cost map of the aerial map at the estimate's heading; poses refer to *pivot. Empty without maps.
  CostMap costMap(Eigen::Vector2d* pivot);

 private:
  Comparison comparison() const;
  PlaceSearch search() const;
  /// Of the last `verify` clouds in the present ground map.
  const CostVolume& verifyVolume(const HeightMap& verify_map);
  /// Whether another scale of the aerial clouds may still be right.
  bool scaleIsOpen() const;
  /// Whether the last estimate needs no other search in the ground map of now.
  bool stillStands() const;
  void drawFromKeptMaps();
  /// Where nothing has been heard for a place that now speaks for itself (the ground map came, grew or moved after the
  /// MAV's last cloud), or only what makes it a guess: takes the kept maps once more, one by one, as if they came now.
  void hearKeptMaps();
  bool keep(const AerialCloud& cloud, std::size_t* cropped);
  void useNewestMap();
  void dropFarMaps();
  /// Turns the ground map's floor level, if it is flat. The points, or what takes their place in `turned`.
  const std::vector<Eigen::Vector3f>& levelGround(const std::vector<Eigen::Vector3f>& points,
                                                  std::vector<Eigen::Vector3f>* turned);
  void updateLevel();
  void updateScale();
  void updateFloor();
  void updateFilter();
  /// `new_map`: its evidence has not been gathered yet.
  void updateEstimate(bool new_map);
  std::string missing() const;  ///< for an estimate; empty: nothing
  void estimateFromPlaces(bool new_map);
  void believe(const FoundPlace& found, bool new_map);
  void renewParticles(const CostVolume& volume);

  HeightMapLocalizerSettings settings_;
  Prior prior_;
  std::unique_ptr<GroundModel> ground_;  // null without a ground map
  bool ground_is_flat_ = false;
  Eigen::Matrix3d R_ground_level_ = Eigen::Matrix3d::Identity();
  std::unique_ptr<KeptMaps> kept_;
  air_ground_common::CloudCorrections corrections_;
  std::unique_ptr<ScaleSearch> scale_;
  std::unique_ptr<EvidenceSum> evidence_;
  ParticleFilter filter_;
  HeightMap filter_map_;
  bool weighed_ = false;  // the particles carry weights that the next resampling consumes
  int maps_ = 0, restarts_ = 0;
  std::vector<Placement> floor_rivals_;      // the best placements with other floors
  std::optional<CostVolume> verify_volume_;  // once computed
  CoarseEstimate estimate_;
  double score_ = kInfinity;        // of the estimate's place [m^2]
  std::size_t searched_cells_ = 0;  // of the ground map in which it was found
};

}  // namespace heightmap_mcl
