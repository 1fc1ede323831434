// Stages inside the iterations: matcher, outlier filters, error minimiser, transformation checkers.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "icp_refine/cloud.h"
#include "icp_refine/stage.h"

namespace icp_refine {

/// One correspondence a reading point; -1 where none was found.
struct Matches {
  std::vector<int> reference_index;  ///< size of the reading
  std::vector<float> weights;        ///< [0, 1], set to 0 where there is no match
};

/// What the outlier filters and the minimiser see: both clouds in the reference frame, matched.
struct MatchedClouds {
  const Cloud& reading;    ///< transformed by the current estimate
  const Cloud& reference;  ///< with normals
  const Matches& matches;

  /// Point-to-plane residual n . (p - q) of reading point i [m].
  float residual(std::size_t i) const {
    const int j = matches.reference_index[i];
    return reference.normals[j].dot(reading.points[i] - reference.points[j]);
  }
};

struct Matcher {
  float max_distance;   ///< [m]
  float normal_weight;  ///< [m/rad]
};

class OutlierFilter {
 public:
  virtual ~OutlierFilter() = default;
  /// Multiplies `weights` (size of the reading); entries without a match are 0 and stay 0.
  virtual void apply(const MatchedClouds& clouds, std::vector<float>& weights) const = 0;
};

/// Gauss-Newton step of a point-to-plane cost: p' = centre + exp(rotation) (p - centre) + translation.
struct Step {
  bool solved = false;
  Vector6d delta = Vector6d::Zero();                 ///< translation [m], rotation vector [rad], in the reference frame
  Matrix6d hessian = Matrix6d::Zero();               ///< sum w J^T J about `centre`, J = [n^T, ((p - centre) x n)^T]
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< weighted centre of the matched reading points
};

class ErrorMinimizer {
 public:
  virtual ~ErrorMinimizer() = default;
  virtual Step solve(const MatchedClouds& clouds, const std::vector<float>& weights, const Pose& T) const = 0;
  /// True when roll and pitch are left as they are.
  virtual bool fourDof() const = 0;
};

enum class Check { kContinue, kConverged, kFailed };

class TransformationChecker {
 public:
  virtual ~TransformationChecker() = default;
  /// Translations are those of `centre`, the middle of the reading in its own frame: the map's origin may be far away.
  virtual void reset(const Pose& T_initial, const Eigen::Vector3d& centre) = 0;
  /// Called after every iteration; `why` is set for kFailed.
  virtual Check check(const Pose& T, std::string& why) = 0;
};

std::vector<StageDoc> matcherDocs();
std::vector<StageDoc> outlierFilterDocs();
std::vector<StageDoc> errorMinimizerDocs();
std::vector<StageDoc> checkerDocs();

/// Factories: throw ConfigError for an unknown name or bad parameters.
Matcher makeMatcher(const std::string& name, const YAML::Node& parameters);
std::unique_ptr<OutlierFilter> makeOutlierFilter(const std::string& name, const YAML::Node& parameters);
std::unique_ptr<ErrorMinimizer> makeErrorMinimizer(const std::string& name, const YAML::Node& parameters);
std::unique_ptr<TransformationChecker> makeChecker(const std::string& name, const YAML::Node& parameters);

/// Nearest neighbours of all reading points (parallel; the result does not depend on the number of threads).
Matches match(const Matcher& matcher, const NeighborSearch& tree, const Cloud& reading);

}  // namespace icp_refine
