// Stages inside the iterations: matcher, outlier filters, error minimiser, transformation checkers.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "icp_refine/neighbor_search.h"
#include "icp_refine/stage.h"

namespace icp_refine {

/// One correspondence a reading point; -1 where none was found.
struct Matches {
  std::vector<int> reference_index;           ///< size of the reading
  std::vector<float> weights;                 ///< [0, 1], set to 0 where there is no match
  std::vector<NeighborSearch::Trace> traces;  ///< of the searches
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

/// Which components of the alignment a level estimates.
struct ErrorMinimizer {
  int dof;  ///< 4: x y z yaw; 6: translation and rotation; 7: and scale
};

/// Normal equations of the weighted squares of n . (p - q), p' = centre + exp(scale) exp(rotation) (p - centre) +
/// translation: J = [n^T, ((p - centre) x n)^T, n . (p - centre)].
struct NormalEquations {
  std::size_t used = 0;   ///< matches with a weight > 0; with fewer than 6 all else is zero
  double weight = 0;      ///< sum w
  double square = 0;      ///< sum w r^2 [m^2]
  double mean_range = 0;  ///< weighted mean distance from the centre [m]
  /// Derivative of the gradient over the Hessian, as a mean: a robust kernel that falls off with r makes the sum of
  /// w r J change less than w would (Huber 1981, covariance of M-estimates). Cauchy's: d(w r)/dr = w (2 w - 1).
  double slope = 1;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< weighted centre of the matched reading points
  Matrix7d hessian = Matrix7d::Zero();               ///< sum w J^T J
  Vector7d gradient = Vector7d::Zero();              ///< sum w r J
};

/// Derivative of the residual of reading point i.
Vector7d jacobian(const MatchedClouds& clouds, std::size_t i, const Eigen::Vector3d& centre);

NormalEquations normalEquations(const MatchedClouds& clouds, const std::vector<float>& weights);

enum class Check { kContinue, kConverged, kFailed };

class TransformationChecker {
 public:
  virtual ~TransformationChecker() = default;
  /// Translations are those of `centre`, the middle of the reading in its own frame: the map's origin may be far away.
  virtual void reset(const Similarity& T_initial, const Eigen::Vector3d& centre) = 0;
  /// Called after every iteration; `why` is set for kFailed.
  virtual Check check(const Similarity& T, std::string& why) = 0;
};

std::vector<StageDoc> matcherDocs();
std::vector<StageDoc> outlierFilterDocs();
std::vector<StageDoc> errorMinimizerDocs();
std::vector<StageDoc> checkerDocs();

/// Factories: throw ConfigError for an unknown name or bad parameters.
Matcher makeMatcher(const std::string& name, const YAML::Node& parameters);
std::unique_ptr<OutlierFilter> makeOutlierFilter(const std::string& name, const YAML::Node& parameters);
ErrorMinimizer makeErrorMinimizer(const std::string& name, const YAML::Node& parameters);
std::unique_ptr<TransformationChecker> makeChecker(const std::string& name, const YAML::Node& parameters);

/// Nearest neighbours of all reading points (parallel; the result does not depend on the number of threads). `matches`
/// holds those of the iteration before, whose traces shorten the searches, or nothing.
void match(const Matcher& matcher, const NeighborSearch& tree, const Cloud& reading, Matches& matches);

}  // namespace icp_refine
