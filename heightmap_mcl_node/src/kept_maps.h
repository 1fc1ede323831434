// The MAV's last clouds, level and in metres, and what they are together.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <deque>
#include <limits>
#include <utility>
#include <vector>

#include "air_ground_common/map_correction.h"
#include "air_ground_common/vertical.h"
#include "heightmap_mcl/aerial_cloud.h"
#include "heightmap_mcl/localizer_settings.h"

namespace heightmap_mcl {

/// Points of all kept clouds, level, in their own unit.
struct LevelCloud {
  std::vector<Eigen::Vector3f> points;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double extent = 0;  ///< longer edge in plan
};

/// Keeps the last `verify` clouds as height maps (of clouds in a unit of their own `own_unit.verify`), and their
/// points, of which the maps are made anew where level or scale change; a point p of theirs lies at scale() * level() *
/// p.
class KeptMaps {
 public:
  struct Cloud {
    HeightMap map;      ///< level [m]
    AerialCloud given;  ///< or fewer of its points
  };

  explicit KeptMaps(const HeightMapLocalizerSettings& settings) : settings_(settings) {}

  /// Forgets clouds, level, scale and floor; not how many were dropped.
  void clear();
  /// Whether the clouds to come are in a unit of their own; forgets those at hand.
  void setOwnUnit(bool own_unit);
  bool ownUnit() const { return own_unit_; }

  /// Height map of a cloud in mav_map, on the floor of those before it; drops the oldest one beyond `verify`. Returns
  /// false, changing nothing, when it defines no cell. `cropped`: see buildHeightMap.
  bool add(const AerialCloud& cloud, std::size_t* cropped);
  /// What clouds have gone through, by their stamps; maps are made anew. Returns by how much the points of one moved on
  /// average at the most, in metres; more than any where one was given up.
  double correct(const air_ground_common::CloudCorrections& since);
  /// Drops the oldest clouds that together with the newest exceed air_map.max_extent: a bound on the memory of the
  /// merged map and of the search over it.
  void dropFar();
  std::size_t farDropped() const { return far_dropped_; }
  /// Takes the clouds away, to be given back one by one as if they came now.
  std::deque<Cloud> takeAll();
  void giveBack(Cloud cloud) { clouds_.push_back(std::move(cloud)); }

  bool empty() const { return clouds_.empty(); }
  std::size_t size() const { return clouds_.size(); }
  const AerialCloud& newestCloud() const { return clouds_.back().given; }
  /// Defined cells of the largest map.
  double largest() const;
  /// Position of the MAV at the newest cloud, level [m].
  Eigen::Vector2d reference() const;
  /// Of the newest `count` ones, on the floor that was set.
  HeightMap merged(int count) const;
  /// Of all.
  HeightMap merged() const { return merged(count()); }
  /// Of all, on the floor that they show themselves.
  HeightMap mergedOnOwnFloor() const;
  /// z of the floor of merged maps [m]; NaN: their own.
  void setFloor(double floor) { floor_ = floor; }

  double scale() const { return scale_; }  ///< [m per unit]
  const Eigen::Matrix3d& level() const { return R_level_; }
  /// What the MAV knows of up in its map, of clouds in a unit of their own; its z axis until then.
  void setVertical(const air_ground_common::Vertical& vertical) { vertical_ = vertical; }
  /// Turns the clouds' dominant floor level; where there is none, what the MAV takes for level. Clouds in metres: only
  /// where the ground map's floor is flat, too. Returns false where that is level already: remake() else.
  bool updateLevel(bool ground_is_flat);
  /// All height maps anew, at that scale and the present level.
  void remake(double scale);
  void remake() { remake(scale_); }
  /// Thinned evenly to `most` points or fewer. Empty where no cloud has kept points.
  LevelCloud levelCloud(std::size_t most) const;

 private:
  int count() const { return static_cast<int>(clouds_.size()); }
  /// False where the present level is about that one.
  bool turnTo(const Eigen::Matrix3d& R_level);
  HeightMap mapOf(const std::vector<Eigen::Vector3f>& points, const LevelHistogram& earlier,
                  std::size_t* cropped = nullptr) const;
  std::vector<const HeightMap*> newest(int count) const;

  HeightMapLocalizerSettings settings_;
  std::deque<Cloud> clouds_;
  bool own_unit_ = false;
  air_ground_common::Vertical vertical_;
  double scale_ = 1;
  Eigen::Matrix3d R_level_ = Eigen::Matrix3d::Identity();
  double floor_ = std::numeric_limits<double>::quiet_NaN();
  std::size_t far_dropped_ = 0;
};

}  // namespace heightmap_mcl
