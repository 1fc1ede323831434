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
  air_ground_common::Pose T = T_ground_mav;
  T.linear() = T_ground_mav.linear() * R_level;
  return T;
}

}  // namespace heightmap_mcl
