// Results that one look at the data does not prove.
#pragma once

#include <cstdint>
#include <optional>

#include "icp_refine/similarity.h"

namespace icp_refine {

/// Where a refinement from an unsure start led, and what it rests on.
struct UnconfirmedPose {
  std::int64_t stamp = 0;  ///< of the newest aerial cloud [ns]
  int relief_cells = 0;    ///< columns off the floor that both robots saw
  Similarity T_ground_map_mav_map;
};

/// Believes a pose once other data have led to the same place: a newer aerial cloud, or, where a MAV that has landed
/// sends none, a ground map that shows a quarter more.
class Confirmation {
 public:
  /// True, and forgets it, where an earlier pose leads to the same place (0.06 m, 0.03 rad) at `p_mav_map` [m]. Else
  /// the pose waits for the next.
  bool confirmedBy(const UnconfirmedPose& pose, const Eigen::Vector3d& p_mav_map);
  /// What waits for the next; null: nothing.
  UnconfirmedPose* first() { return first_ ? &*first_ : nullptr; }
  void clear() { first_.reset(); }

 private:
  std::optional<UnconfirmedPose> first_;
};

}  // namespace icp_refine
