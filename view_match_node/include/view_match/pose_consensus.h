// The similarity between two maps, from cameras whose pose is known in both.
#pragma once

#include <limits>
#include <string>
#include <vector>

#include "air_ground_common/similarity.h"

namespace view_match {

using air_ground_common::Matrix6d;
using air_ground_common::Matrix7d;
using air_ground_common::Pose;
using air_ground_common::Similarity;
using air_ground_common::Vector7d;

/// One camera in both maps: T_a_camera as recognised in map a, T_b_camera as the odometry in map b has it.
struct CameraInBoth {
  Pose T_a_camera = Pose::Identity(), T_b_camera = Pose::Identity();
  Matrix6d covariance = Matrix6d::Identity();       ///< of T_a_camera: position, rotation about the axes of a [m, rad]
  Eigen::Vector3d scene = Eigen::Vector3d::Zero();  ///< middle of what it sees, in a [m]
  /// Length in a per length in b, as what both maps hold of its view tells, and its relative standard deviation;
  /// infinite: not known.
  double scale = 1, scale_stddev = std::numeric_limits<double>::infinity();
};

struct ConsensusSettings {
  double max_squared_sigmas = 24.3;  ///< of a camera that agrees: 7 degrees of freedom, 99.9 %
  int iterations = 10;               ///< of the refinement
};

/// The unit of map b: metres to so many parts (finite), or unknown (infinite).
struct ScaleKnowledge {
  double mean = 1, stddev = 0.03;  ///< length in a per length in b; relative
  bool known() const;
};

struct Consensus {
  bool found = false;
  std::string reason;  ///< why not; empty when found
  Similarity T_a_b;
  std::vector<int> agreeing;  ///< indices of the cameras behind it, ascending
  Eigen::Vector3d centre =
      Eigen::Vector3d::Zero();  ///< middle of what they see, in a: the covariance is about this point
  Matrix7d covariance = Matrix7d::Zero();
};

/// The similarity that most cameras agree with, then least squares over these: residuals of position and rotation
/// weighed by `covariance`, and of the scale where a camera tells it; its own covariance is scaled by max(1, chi^2 per
/// degree of freedom). Where neither `scale` nor a camera tells the scale, two cameras apart are needed. Never throws
/// for poor data.
Consensus consensusOf(const std::vector<CameraInBoth>& cameras, const ScaleKnowledge& scale,
                      const ConsensusSettings& settings = {});

}  // namespace view_match
