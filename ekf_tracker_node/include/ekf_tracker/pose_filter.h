// The Kalman filter of paper B, section III, with the odometry's scale and the barometer's offset as further states,
// and with competing hypotheses from which it starts and recovers. A plain value: copies are snapshots.
#pragma once

#include <optional>
#include <vector>

#include "ekf_tracker/motion_model.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace ekf_tracker {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

struct FilterSettings {
  // Gates: a measurement inside holds this probability if the filter is right (chi-square, as many degrees of freedom
  // as the measurement has components: 4 for a fix, 3 for GPS, 1 for heading and barometer). 0.9973 is 3 sigma in one
  // dimension.
  double gate_probability = 0.9973;
  // Scale of the odometry.
  double metric_scale_stddev = 0.05;  ///< relative, of odometry that calls itself metric and gives no variance
  double scale_drift = 0.01;          ///< relative, per square root of metre travelled
  double max_initial_scale_stddev =
      0.3;  ///< relative: fixes too close together to give the scale better than this must wait
  // Odometry.
  double covariance_factor = 1;  ///< multiplies the covariance that increments state
  // Random walk added to what increments state: their variance grows by the square of these each 1/20 s.
  double min_translation_stddev = 0.001;  ///< [m, or the odometry's unit]
  double min_yaw_stddev = 1e-4;           ///< [rad]
  double gap_speed_stddev = 1.5;          ///< velocity while the odometry is silent [m/s]
  double gap_yaw_rate_stddev = 0.3;       ///< [rad/s]
  // Barometer.
  double barometer_drift = 0.25;  ///< of its offset, per square root of second [m]
  // Start and recovery.
  // A fix that no other has joined is forgotten ...
  double pairing_time = 60;  ///< ... with odometry in an unknown unit after this time [s]
  double pairing_drift = 5;  ///< ... with metric odometry once that may be off by more than this, as after a gap [m]
  int unscaled_start_fixes =
      3;  ///< agreeing fixes for a start in an unknown unit: two give the scale, a third confirms it
  double max_false_start = 1e-5;  ///< probability that fixes which start or replace the state agree by chance
  double wrong_fix_spread = 50;   ///< wrong ones lie anywhere within this radius [m]
  int recovery_fixes = 3;         ///< this many refused fixes that agree with each other replace the filter's state
  int max_hypotheses = 4;         ///< kept beside the state
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, FilterSettings& settings);

/// Throws std::invalid_argument that names the field out of range.
void check(const FilterSettings& settings);

enum class Source { kFix, kHeading, kGps, kBarometer };

/// value: kFix x y z yaw; kHeading yaw; kGps x y z, or x y; kBarometer height above any fixed level [m, rad; world].
struct Measurement {
  Source source = Source::kFix;
  double stamp = 0;  ///< [s]
  Vector4d value = Vector4d::Zero();
  Matrix4d covariance = Matrix4d::Identity();  ///< leading size() x size() block
  bool plan_only = false;                      ///< kGps: the datum of its height is not known, x and y count
  unsigned place = 0;                          ///< kFix: number of the panorama behind it; 0: not known
  int size() const { return source == Source::kFix ? 4 : source != Source::kGps ? 1 : plan_only ? 2 : 3; }
};

enum class Result {
  kFused,
  kRefusedByGate,  ///< outside the gate (a fix then supports or founds a hypothesis)
  kWaiting,        ///< a fix kept until others agree: nothing is known yet, or since a gap too little to judge it by
  kNotStarted,     ///< not a fix, and no state to correct
  kInitialised,    ///< it agrees with those kept before: the filter starts, or goes on after a gap, with them
  kRecovered,      ///< the fixes of a hypothesis agreed and replaced the state
  // Found by Tracker before the filter sees the measurement:
  kInvalid,     ///< not finite, or no positive definite covariance
  kTooOld,      ///< before the buffered history
  kFromFuture,  ///< too far ahead of the odometry
  kDuplicate,   ///< same source and stamp as one already taken
  // Found by Tracker, which looks back:
  kAgreed,  ///< kept or refused at first; a later fix agreed with it, and the state rests on both
};
const char* describe(Result result);
/// True when the measurement is part of a state: fused, or by a start or a recovery.
bool isUsed(Result result);

/// What a measurement did.
struct Outcome {
  Measurement measurement;
  Result result = Result::kInvalid;
  int dof = 0;
  double gate = 0;                                ///< chi-square bound of nis
  double nis = 0;                                 ///< normalised innovation squared; NaN where there was no prediction
  Vector4d innovation = Vector4d::Zero();         ///< measurement minus prediction, angles wrapped
  Vector4d innovation_stddev = Vector4d::Zero();  ///< predicted
  double delay = 0;                               ///< newest odometry stamp minus its own, when it was taken [s]
  bool revised = false;                           ///< a late measurement changed what had been told of this one before
  std::vector<double> joined;  ///< stamps of earlier fixes that entered the state together with this one [s]
};

/// A panorama whose fixes a state rests on.
struct UsedPlace {
  unsigned place = 0;  ///< as in Measurement
  double age = 0;      ///< since its last fix [s]
};

/// Estimate of one hypothesis. x: position [m], yaw [rad] in `world`, scale of the odometry, offset of the barometer
/// [m].
struct State {
  Vector6d x = Vector6d::Zero();
  Matrix6d covariance = Matrix6d::Identity();
  bool barometer_known = false;
  bool scale_known = true;        ///< false: the odometry began anew in an unknown unit, only its turns are used
  int support = 0;                ///< fixes that speak for it
  unsigned place = 0;             ///< of the first of these whose panorama is known; 0: none is
  bool several_places = false;    ///< another of these is of another panorama
  std::vector<UsedPlace> places;  ///< of the last minute, as far as they are known
  std::optional<Eigen::Vector3d> field_at;  ///< where a magnetometer's reading last told anything that was new [m]

  /// Of all fixes that speak for it and whose panorama is known.
  bool ofOnePlace() const { return place != 0 && !several_places; }
};

/// Covariance that a step of odometry is predicted with: the stated one by the factor, the floors, and what a tilt that
/// is off does to the motion.
Matrix4d noiseOf(const Increment& increment, const FilterSettings& settings);

class PoseFilter {
 public:
  explicit PoseFilter(const FilterSettings& settings = FilterSettings());

  /// Equations 7 and 8. Symmetric positive definite covariance in and out.
  void predict(const Increment& increment);

  /// Equations 12 and 13 with the gate, or the start (B-III.E; after a gap, too), or a step towards recovery.
  Outcome correct(const Measurement& measurement);

  /// Forgets the pose. `metric`, `scale_stddev`: of the odometry to come, which fixes before its first step must know.
  void restart(bool metric, double scale_stddev);

  bool started() const { return state_.has_value(); }
  /// Only when started().
  const State& state() const { return *state_; }
  int recoveries() const { return recoveries_; }
  int starts() const { return starts_; }
  /// Hypotheses beside the state, and fixes the strongest of them holds.
  int hypotheses() const { return static_cast<int>(hypotheses_.size()); }
  int strongestHypothesis() const;

 private:
  // Of where the vehicle is: rests on the fix that founded it and the odometry since. Its scale is free until two of
  // its fixes give it.
  struct Hypothesis {
    State state;                 ///< its scale_known is false until a second fix gives the scale
    double log_odds = 0;         ///< that its fixes are right, against that wrong ones agree by chance
    double age = 0;              ///< since the anchor [s]
    std::vector<double> stamps;  ///< of its fixes [s]
    Vector4d anchor = Vector4d::Zero();
    Matrix4d anchor_covariance = Matrix4d::Identity();
    Vector4d travelled = Vector4d::Zero();  ///< since the anchor, in its body frame, in the odometry's unit
    Matrix4d travelled_covariance = Matrix4d::Zero();
  };

  void becomeMetric();
  void takeStatedScale(State* state) const;
  void loseScale();
  void propagate(State* state, const Increment& increment) const;
  Increment coast(const Increment& gap) const;
  Outcome test(const State& state, const Measurement& m) const;
  Outcome unpredicted(const Measurement& m, Result result) const;
  Outcome correctByPart(const Measurement& m);
  Outcome correctByFix(const Measurement& m);
  static void fuse(State* state, const Measurement& m);
  static void fuseAgain(State* state, const Measurement& fix);
  static void fuseHeading(State* state, const Measurement& m);
  static void supportBy(const Measurement& fix, State* state);
  enum class Solution { kNone, kContradiction, kFound };
  Solution solveScale(Hypothesis* h, const Measurement& fix) const;
  double logOdds(double log_density) const;
  double logOdds(const State& state, const Measurement& fix, double nis) const;
  bool needsAnother(const Measurement& fix, double nis) const;
  void judgeRivals(const Measurement& fix, double log_odds);
  Hypothesis* correctBestHypothesis(const Measurement& fix);
  Hypothesis hypothesisFrom(const Measurement& fix) const;
  Hypothesis* addHypothesis(const Measurement& fix);
  bool isTrusted(const Hypothesis& h, Result latest) const;
  double priorScaleStddev() const;

  FilterSettings settings_;
  double gates_[5] = {};  ///< by degrees of freedom
  std::optional<State> state_;
  std::vector<Hypothesis> hypotheses_;
  bool metric_ = true;
  double scale_stddev_ = 0;
  Eigen::Vector3d velocity_ = Eigen::Vector3d::Zero();  ///< of the last odometry, in its unit per second, body frame
  double silent_ = 0;                                   ///< since then [s]
  int recoveries_ = 0, starts_ = 0;
};

/// Value that a chi-square variable with `dof` degrees of freedom stays below with probability p.
double chiSquareQuantile(int dof, double p);

}  // namespace ekf_tracker
