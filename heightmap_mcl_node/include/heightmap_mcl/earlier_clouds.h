// Clouds that the MAV has left behind: the ground robot may come to where it was.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "air_ground_common/map_correction.h"
#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

/// Keeps the clouds of the MAV's map and searches them in groups of `verify`, from the newest that HeightMapLocalizer
/// no longer holds, whenever the ground map has grown or shrunk by a tenth since a group was searched last, or was
/// corrected. A group is one more
/// HeightMapLocalizer's, whose verdict counts. Not thread-safe.
class EarlierClouds {
 public:
  explicit EarlierClouds(const HeightMapLocalizerSettings& settings);
  ~EarlierClouds();

  /// In mav_map, stamped later than the one before. `searched`: by HeightMapLocalizer, in the ground
  /// map of now.
  void add(AerialCloud cloud, bool searched = true);
  /// What clouds have gone through since they were published.
  void correct(const air_ground_common::CloudCorrections& corrections);
  /// In ground_map [m]. `corrected` as a whole (a loop closed): what has been searched is searched again.
  void setGround(std::vector<Eigen::Vector3f> points, std::size_t defined_cells, bool corrected = false);
  void forgetAerial();
  void forgetGround();
  /// As HeightMapLocalizer's; what has been searched is searched again.
  void setPrior(const Prior& prior);
  void setOwnUnit(bool own_unit);
  void setVertical(const air_ground_common::Vertical& vertical) { vertical_ = vertical; }

  /// Whether a group is worth a search.
  bool pending() const;

  struct Found {
    std::int64_t stamp;  ///< of the newest cloud of the group [ns]
    CoarseEstimate estimate;
    Eigen::Vector3d reference;  ///< position of the MAV at that cloud, in mav_map
  };
  /// Takes one cloud further, which takes as long as it does in HeightMapLocalizer. The place of a group that is
  /// CONVERGED; then nothing is pending until the ground map changes.
  std::optional<Found> step();

 private:
  struct Kept {
    AerialCloud cloud;
    std::size_t searched;  // ground cells when it was searched last; 0: never
    bool passed_by;        // HeightMapLocalizer never had it
  };
  /// One past the newest cloud of the next group; 0: none.
  std::size_t nextGroup() const;
  void begin(std::size_t end);
  void searchAgain();

  HeightMapLocalizerSettings settings_;
  std::size_t in_group_;
  std::deque<std::pair<std::int64_t, Kept>> clouds_;  // by stamp [ns], the oldest first
  air_ground_common::CloudCorrections corrections_;   // so far: a cloud may come after what it has gone through
  std::vector<Eigen::Vector3f> ground_;
  std::size_t ground_cells_ = 0;
  bool ground_is_new_ = false;  // to the localizer
  Prior prior_;
  bool own_unit_ = false;
  air_ground_common::Vertical vertical_;

  std::unique_ptr<HeightMapLocalizer> localizer_;  // null until a group is searched
  std::vector<std::int64_t> group_;                // stamps that are left of the present one, the oldest last
};

}  // namespace heightmap_mcl
