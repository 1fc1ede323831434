// Point-to-plane ICP over rotation, translation and scale as a chain of named stages read from YAML, in the style of
// libpointmatcher (Pomerleau 2011; A-VII).
#pragma once

#include <map>
#include <memory>
#include <string>
#include <utility>

#include "icp_refine/data_filters.h"
#include "icp_refine/icp_stages.h"
#include "icp_refine/localizability.h"

namespace icp_refine {

struct IcpResult {
  enum class Outcome { kConverged, kFailed };
  Outcome outcome = Outcome::kFailed;
  std::string reason;  ///< why it failed; empty when converged
  Similarity T_reference_reading;
  Eigen::Vector3d centre =
      Eigen::Vector3d::Zero();          ///< of the matches, reference frame: covariance is about this point
  Matrix7d hessian = Matrix7d::Zero();  ///< sum w J^T J about centre (translation, rotation, scale)
  /// Translation [m], rotation [rad], relative scale about centre, reference frame; 1e6 I: failed.
  Matrix7d covariance = 1e6 * Matrix7d::Identity();
  bool scale_estimated = false;  ///< false: held at the prior's mean
  Localizability localizability;
  std::size_t inliers = 0;  ///< matches with a weight > 0 in the last iteration
  double overlap = 0;       ///< share of the reading's points that have an inlier match
  double residual_rms = 0;  ///< weighted RMS point-to-plane residual of the inliers [m]
  int iterations = 0;       ///< over all levels
  double seconds = 0;       ///< of align() alone
};

/// A reference cloud after the filters, with the search trees that the levels need. Make it once a change of the map.
class IcpReference {
 public:
  const Cloud& cloud() const { return cloud_; }
  bool empty() const { return cloud_.empty(); }

 private:
  friend class IcpChain;
  Cloud cloud_;
  std::map<float, NeighborSearch> trees_;  // by normal weight
};

/// The chain:
///   reading_filters, reference_filters: lists of data filters
///   levels: coarse to fine; each has reading_filters (optional), matcher, outlier_filters, error_minimizer, checkers
///   localizability, covariance: their settings (optional)
/// A stage is written `Name` or `Name: {parameter: value}`.
class IcpChain {
 public:
  /// Throws ConfigError, naming the stage or parameter, for anything unknown, missing or out of range.
  explicit IcpChain(const YAML::Node& config);
  static IcpChain fromString(const std::string& yaml);
  static IcpChain fromFile(const std::string& path);
  ~IcpChain();
  IcpChain(IcpChain&&) noexcept;
  IcpChain& operator=(IcpChain&&) noexcept;

  IcpReference prepareReference(Cloud reference) const { return searchable(filteredReference(std::move(reference))); }
  /// Its two halves: the filters, and the trees of a cloud that has been through them.
  Cloud filteredReference(Cloud reference) const;
  IcpReference searchable(Cloud filtered) const;
  Cloud prepareReading(Cloud reading) const;

  /// `reading` as prepareReading left it. T_initial: reference <- reading. Never throws for poor data: see outcome,
  /// reason. Same input, same result, whatever the number of threads.
  IcpResult align(const Cloud& reading, const IcpReference& reference, const Similarity& T_initial,
                  const Priors& priors = {}) const;
  /// From the prior's mean scale.
  IcpResult align(const Cloud& reading, const IcpReference& reference, const Pose& T_initial,
                  const Priors& priors = {}) const {
    return align(reading, reference, similarity(T_initial, priors.scale.mean), priors);
  }

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// All stages with their parameters, as text for a person.
std::string describeStages();

}  // namespace icp_refine
