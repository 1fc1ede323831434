// Which images are worth sending with their poses.
#pragma once

#include <cstdint>
#include <optional>
#include <set>

#include "mav_vo/odometry.h"

namespace mav_vo {

/// Of a hovering camera all images show the same, and reconstruction leaves out what lies nearer than a spacing.
class PosedImageSelection {
 public:
  /// spacing: between the camera's positions [m]; 0 selects every image. A map without scale is measured as if what is
  /// in view were 2 m away.
  explicit PosedImageSelection(double spacing) : spacing_(spacing) {}

  /// True for keyframes, for the first image of a map or of its correction, and for those that lie `spacing` or 0.05
  /// rad from the last one selected, or 0.2 s after it. `frame`: in the odometry's own map.
  bool selects(const VoResult& frame);
  /// The poses of images that were selected; `trajectory`: of the present map.
  air_ground_common::Trajectory selected(const air_ground_common::Trajectory& trajectory) const;

 private:
  const double spacing_;
  std::optional<std::uint32_t> map_id_;
  std::uint32_t map_revision_ = 0;
  std::set<double> stamps_;  // of the map's, the newest [s]
  double stamp_ = 0;
  Pose T_map_camera_ = Pose::Identity();
};

}  // namespace mav_vo
