#include "heightmap_mcl/coarse_estimate.h"

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

air_ground_common::Pose CoarseEstimate::similarityPose() const {
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  T.linear() = R_ground_level.transpose() * T_ground_mav.linear() * R_level;
  T.translation() = R_ground_level.transpose() * T_ground_mav.translation();
  return T;
}

}  // namespace heightmap_mcl
