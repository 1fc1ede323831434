// What the localizer says of the MAV's place in the ground robot's map.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>

#include "air_ground_common/geometry.h"
#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl {

enum class Status { kSearching, kAmbiguous, kDegenerate, kConverged };
const char* toString(Status status);

/// All that the verdict on a place is made from.
struct PlaceMeasures {
  double overlap = 0;         ///< share of the verification map's cells
  double cost = 0;            ///< eq. 2 at the place [m^2]
  double rival_ratio = 0;     ///< see VerdictSettings::ambiguity_ratio; infinite without rival
  double rival_distance = 0;  ///< [m]
  double explained = 0;       ///< see Zmssd::explained
  double agreement = 0;       ///< see Agreement::agreeing
  double relief = 0;          ///< smaller one of the two maps' height deviations in the overlap [m]
  double raised = 0;          ///< area of the overlap where something stands on the floor in either map [m^2]
  double probe_ratio = 0;     ///< see VerdictSettings
  Eigen::Vector3d flattest = Eigen::Vector3d::Zero();  ///< move (x, y [m], yaw [rad]) that changes the cost so little
  double evidence_lead = 0;        ///< of the place over its best rival, see VerdictSettings::min_evidence
  double evidence = 0;             ///< that sum
  double guess_evidence = 0;       ///< the same for a guess
  bool particles_agree = false;    ///< their dominant mode is at the place
  double particle_spread = 0;      ///< [m], see ParticleFilter::Spread
  double particle_spread_yaw = 0;  ///< [rad]
  double mode_weight = 0;          ///< share of the particles in the dominant mode
  double mode_spread = 0;          ///< of the position within it [m]
  double mode_spread_yaw = 0;      ///< of the heading within it [rad]
  int maps = 0;                    ///< aerial maps used since the search began
};

struct CoarseEstimate : PlaceMeasures {
  Status status = Status::kSearching;
  std::string reason;  ///< one line: why this status
  bool guess = false;  ///< not CONVERGED, but see VerdictSettings::guess_ratio
  /// False until there is a pose at all (best guess; to be trusted only when status is kConverged).
  bool has_pose = false;
  air_ground_common::Pose T_ground_mav = air_ground_common::Pose::Identity();  ///< mav_map to ground_map, both level;
                                                                               ///< turns about z only
  /// Of the clouds: an aerial point p lies at R_ground_level^-1 * T_ground_mav * (scale * R_level * p) in ground_map.
  double scale = 1;
  double scale_stddev = 0;                                       ///< of it; 0 where the clouds are metric
  Eigen::Matrix3d R_level = Eigen::Matrix3d::Identity();         ///< turns the aerial map's dominant floor level
  Eigen::Matrix3d R_ground_level = Eigen::Matrix3d::Identity();  ///< the ground map's
  /// By how much more its place stands out from the other ones than at the next best scale (logarithm of a likelihood
  /// ratio, times the share explained, summed over pieces of ground); infinite where the clouds are metric.
  double scale_evidence = std::numeric_limits<double>::infinity();
  air_ground_common::Pose similarityPose() const;  ///< of the maps as they are: p_ground = scale * R p + t
  /// 6x6 (x y z rotX rotY rotZ) in the ground frame, of a point at `reference_point` carried by T_ground_mav.
  /// AMBIGUOUS: widened by the way to the rival. DEGENERATE: as wide as the ground map, and pi, along what is not
  /// fixed. SEARCHING: 1e6 I.
  air_ground_common::Matrix6d covariance = 1e6 * air_ground_common::Matrix6d::Identity();
  Eigen::Vector3d reference_point = Eigen::Vector3d::Zero();  ///< centre of the overlap, ground frame [m]
  PlanarPose particle_mean;  ///< of the MAV; as the other statistics of particles, before any are drawn anew
  int restarts = 0;  ///< times all particles were drawn anew: they had lost the overlap or missed the best place
};

}  // namespace heightmap_mcl
