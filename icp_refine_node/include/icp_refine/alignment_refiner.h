// When to refine, from which guess, and whether to believe the result: the decisions of the node, without ROS.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <string>

#include "air_ground_common/map_correction.h"
#include "icp_refine/aerial_clouds.h"
#include "icp_refine/confirmation.h"
#include "icp_refine/height_check.h"
#include "icp_refine/icp.h"
#include "icp_refine/known_alignment.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace icp_refine {

struct RefinerSettings {
  int recent_clouds = 6;            ///< aerial clouds in a row that make up the reading
  double accumulation_leaf = 0.03;  ///< each cloud is thinned to this when it comes in [m]
  int min_points = 300;             ///< aerial or ground points that a refinement needs after the filters
  int retries = 6;                  ///< starts around a coarse or manual guess that is rejected
  double retry_distance = 0.3;      ///< [m]
  double retry_angle = 0.1;         ///< of heading [rad]
  double min_overlap = 0.08;        ///< smallest share of the aerial map that overlaps the ground map, by columns
  double max_rms = 0.05;            ///< largest RMS point-to-plane residual [m]
  double min_agreement = 0.7;       ///< smallest share of relief cells without contradiction (height_check.h)
  double guess_agreement = 0.85;  ///< instead of min_agreement: for what began at a guess, or far from the tracked pose
  /// Instead of min_agreement: for keeping a tracked pose (not for believing one) where the images lead to it as well.
  double held_agreement = 0.5;
  double max_sigma = 0.15;        ///< largest standard deviation of the position, any direction [m]
  double max_sigma_angle = 0.09;  ///< and of the rotation, any axis [rad]
  int lost_after = 3;             ///< refinements in a row that contradict the tracked pose end tracking
  /// Largest squared distance, in sigmas of both, from the pose that images or the coarse alignment tell: 99 % of six
  /// degrees of freedom. Wrong minima of little overlap were seen at 4.6 and 4.7 sigma, right poses within 2.1.
  double known_squared_sigmas = 16.8;
  double coarse_distance = 0.5;  ///< a coarse pose this far from the refined one disagrees [m]
  double coarse_angle = 0.26;    ///< or this far in heading [rad]
  int coarse_disagreements = 3;  ///< in a row: then the coarse pose is tried against the refined one
  ScalePrior scale;              ///< of the aerial map, about 1; the odometry may state a larger deviation
  double tilt_stddev = 0.002;    ///< by which maps lean apart beyond what their robots state [rad]
  HeightCheckSettings height_check;
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, RefinerSettings& settings);

enum class RefineStatus { kSearching, kDegenerate, kConverged, kRejected };

struct RefineOutcome {
  RefineStatus status = RefineStatus::kSearching;
  std::string reason;  ///< one line for a person
  Similarity T_ground_map_mav_map;
  /// About reference_point, in ground_map, the scale marginalised; 1e6 I for SEARCHING and REJECTED, wide along missing
  /// directions for DEGENERATE.
  Matrix6d covariance = 1e6 * Matrix6d::Identity();
  double scale_stddev = 0;                                    ///< of T_ground_map_mav_map.scale; 0: nothing is known
  Eigen::Vector3d reference_point = Eigen::Vector3d::Zero();  ///< in ground_map [m]
  double overlap = 0;       ///< share of the aerial map's columns that the ground map has too
  double residual_rms = 0;  ///< [m]
  int iterations = 0;
  std::int64_t stamp = 0;     ///< of the newest aerial cloud [ns]
  bool contradicted = false;  ///< rejected by data that speak against the pose, not for want of data
  bool tracking = false;      ///< started from the last refined pose
  bool seen = false;          ///< agrees with what the images tell
  double view_sigmas = 0;     ///< how far it differs from that
  bool instead = false;       ///< of the tracked pose, which the coarse alignment contradicted
  bool held = false;          ///< directions that the geometry does not fix are known from the coarse alignment
  bool kept = false;          ///< the pose is the tracked one: the newest clouds agree, and tell less of it
  bool lost = false;          ///< it was one contradiction too many: no pose is tracked any more
  HeightCheck heights;
  IcpResult icp;
};

/// Not thread-safe: one caller.
class AlignmentRefiner {
 public:
  AlignmentRefiner(IcpChain chain, const RefinerSettings& settings);

  /// Replaces the ground map (ground_map frame); filters and trees are made at the next refine().
  void setGround(Cloud cloud);
  /// While a pose is tracked, filters of the ground map and its normals ahead of the refinement that needs them: to be
  /// called when there is nothing else to do.
  void prepareGround();
  /// Greatest z in ground_map of the camera that made the ground map, as that is now [m]: what is higher it cannot have
  /// seen from above, and where that is a ceiling (ceilings.h) the map counts without it.
  void setGroundCamera(double z);
  bool knowsGroundCamera() const { return std::isfinite(ground_camera_); }
  /// Adds one aerial cloud (mav_map frame), stamp in nanoseconds.
  void addAerial(std::int64_t stamp, Cloud cloud);
  /// Coarse pose of a global localization. Not `sure`: a guess that the heights do not fix sharply; what is refined
  /// from it is believed when another aerial cloud, or a ground map that shows a quarter more of what stands there,
  /// confirms it from a coarse pose of its own.
  void setCoarse(const Similarity& T_ground_map_mav_map, bool sure = true);
  void setCoarse(const Pose& T_ground_map_mav_map, bool sure = true) {
    setCoarse(similarity(T_ground_map_mav_map), sure);
  }
  /// A sure one, and how well its stage knows it: directions that the geometry does not fix stay where it has them, and
  /// are known as well as there.
  void setCoarse(const KnownAlignment& coarse);
  /// What the robots' images tell: tried before the coarse pose. An alignment that agrees with it needs neither
  /// geometry that fixes all directions nor heights that prove it.
  void setViews(const KnownAlignment& views);
  /// The images tell nothing any more: nor does a pose stand that rests on them alone.
  void withdrawViews();
  /// The height maps tell no place from another any more: where they put it last is neither tried nor holds anything.
  void withdrawCoarse() {
    coarse_.reset();
    coarse_known_.reset();
  }
  /// A person's guess of x, y and heading, tried once: replaces what is tracked when it converges. The height is taken
  /// from the maps.
  void setManual(const Pose& T_ground_map_mav_map);
  /// What the MAV's odometry says of its scale: relative standard deviation. Counts when it is larger than the
  /// settings'.
  void setScaleDeviation(double stddev);
  /// Of an aerial map that was made metric by what another stage knows of its scale: what is left for it, and how well
  /// that stage knows it (relative).
  void setScalePrior(double mean, double stddev);
  /// What the robots know of gravity in their maps: where both do, the maps' verticals are parallel as surely as that.
  void setAerialVertical(const Vertical& vertical) { aerial_vertical_ = vertical; }
  void setGroundVertical(const Vertical& vertical) { ground_vertical_ = vertical; }
  /// The aerial map was corrected: its clouds follow, and each pose stays right where the clouds lie that it was found
  /// with (where those are not followed any longer: at the newest).
  void correctAerial(const air_ground_common::CloudCorrections& corrections);
  /// What was made of the aerial map is off in itself: forgets the clouds so far, and what others said on such ones.
  void forgetAerial();
  /// The ground map was corrected as a whole (a loop closed): the last pose may be off by more than ICP reaches.
  /// `at_hand`: the ground map that was set last shows it already; else the next one does.
  void groundMoved(bool at_hand = false);
  /// Forgets all but the ground map: another aerial map has begun.
  void startMap();
  /// Forgets the ground map and all poses, not the aerial clouds: another ground map has begun.
  void startGround();
  /// Forgets everything.
  void reset();

  /// Refines when there is a guess and data, else says what is missing. Never throws for poor data.
  RefineOutcome refine();

  bool tracking() const { return tracked_.has_value(); }
  /// The tracked pose may be of before a correction of the ground map: until one has converged on the corrected map, or
  /// two such maps have come.
  bool groundHasMoved() const { return moved_grounds_ > 0; }
  /// The ground map was corrected, and no refinement has converged on it since.
  bool unproven() const { return tracked_ && unproven_; }
  /// Last believed pose.
  std::optional<Similarity> refined() const {
    return tracked_ ? std::make_optional(tracked_->T_ground_map_mav_map) : std::nullopt;
  }

 private:
  void forgetPoses();
  void makeReference();
  std::string missing() const;  ///< what a refinement waits for; empty: nothing
  Priors priors() const;
  Cloud prepareReading();
  RefineOutcome refineGuessed(const Cloud& reading);
  void compareWithViews(RefineOutcome& out) const;
  void compareWithCoarse(RefineOutcome& out) const;
  void countDisagreement(const Eigen::Vector3d& centre);
  RefineOutcome refineTracked(const Cloud& reading);
  /// Puts the outcome back to the tracked pose where it agrees with that, which is known much better, unless the
  /// heights of the newest clouds contradict it.
  void keepIfKnownBetter(const Cloud& reading, RefineOutcome* out) const;
  bool contradict(const HeightCheck& heights) const;
  void follow(bool from_tracking, RefineOutcome* out);
  /// Heights that contradict the tracked pose do not end it.
  bool imagesHold(const RefineOutcome& out) const;
  /// Farther from the tracked pose than refinements of a right one move.
  bool leaps(const RefineOutcome& out, const Eigen::Vector3d& centre) const;
  /// Takes the result back, unless other data have led to the same place. `what` it is: for the reason.
  void demandConfirmation(const char* what, const Eigen::Vector3d& centre, RefineOutcome* out);
  RefineOutcome attempt(const Cloud& reading, const Similarity& guess);
  /// `until_converged`: tries starts around the guess also where the geometry leaves its first result open.
  RefineOutcome attemptFromGuess(const Cloud& reading, const Similarity& guess, bool until_converged = false);
  /// With the scale that is the likeliest; the guess is right at the point, of the aerial map.
  Similarity startAt(const Pose& guess, const Eigen::Vector3d& point) const;
  /// Why the result is not to be believed, if so: sets status and reason.
  void judge(RefineOutcome& out) const;

  IcpChain chain_;
  RefinerSettings settings_;
  Cloud ground_;
  double ground_camera_ = std::numeric_limits<double>::infinity();  // not known
  std::optional<IcpReference> reference_;
  std::optional<GroundHeights> heights_;  ///< of the reference
  AerialClouds aerial_;
  std::int64_t reading_stamp_ = 0;  ///< of the newest cloud that is refined [ns]
  std::optional<Similarity> coarse_;
  std::optional<Pose> manual_;
  bool coarse_sure_ = true;
  std::optional<KnownAlignment> coarse_known_;
  std::int64_t coarse_stamp_ = 0;  ///< of the newest cloud when that came [ns]
  Confirmation unconfirmed_;       ///< refined from a guess, or far from the last pose
  std::optional<KnownAlignment> views_;
  std::optional<KnownAlignment> tracked_;
  std::int64_t tracked_stamp_ = 0;  ///< of the newest cloud that it was refined with [ns]
  bool rests_on_views_ = false;     ///< the tracked pose: neither geometry nor heights prove it
  ScalePrior scale_;
  Vertical aerial_vertical_, ground_vertical_;
  int rejections_ = 0, disagreements_ = 0;
  std::int64_t contradicted_stamp_ = 0;  ///< of the newest cloud of the last contradiction [ns]
  static constexpr int kMovedGrounds = 2;
  int moved_grounds_ = 0;      ///< corrected maps yet to be refined on for which the ground counts as moved
  bool new_ground_ = false;    ///< not refined on so far
  bool stale_ground_ = false;  ///< of before the last correction
  bool unproven_ = false;      ///< the tracked pose: the ground map has moved since it was found
};

}  // namespace icp_refine
