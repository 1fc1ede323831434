#include "icp_refine/confirmation.h"

#include "air_ground_common/geometry.h"

namespace icp_refine {
namespace {

constexpr double kSameDistance = 0.06, kSameAngle = 0.03;  // [m], [rad]
constexpr double kMoreCells = 1.25;  // a new cloud is about a sixth of the reading, and shows no less

}  // namespace

bool Confirmation::confirmedBy(const UnconfirmedPose& pose, const Eigen::Vector3d& p_mav_map) {
  const Similarity& T = pose.T_ground_map_mav_map;
  const bool same = first_ && (first_->T_ground_map_mav_map * p_mav_map - T * p_mav_map).norm() < kSameDistance &&
                    air_ground_common::rotationAngle(first_->T_ground_map_mav_map.R, T.R) < kSameAngle;
  if (!same) {
    first_ = pose;
    return false;
  }
  if (pose.stamp <= first_->stamp && pose.relief_cells < kMoreCells * first_->relief_cells) return false;
  first_.reset();
  return true;
}

}  // namespace icp_refine
