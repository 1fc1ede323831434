// Measurements come late and out of order; the filter wants them in time. Tracker keeps the last seconds of odometry
// with a snapshot of the filter at each step, puts every measurement in at its own stamp, and replays from there: the
// result is that of processing all in order.
#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "ekf_tracker/pose_filter.h"

namespace ekf_tracker {

struct TrackerSettings {
  FilterSettings filter;
  double history = 30;      ///< odometry kept for late measurements [s]
  double max_ahead = 15;    ///< a measurement further ahead of the newest odometry is refused as from the future [s]
  double same_time = 1e-3;  ///< a measurement this close to an odometry stamp counts as simultaneous [s]
  // Stands in for an increment's covariance that is not one (NaN, not positive definite).
  double default_translation_stddev = 0.2;  ///< share of the increment's length, plus the filter's floor
  double default_yaw_stddev = 0.02;         ///< [rad]
};

/// What a user may set, the filter's too.
void describe(air_ground_common::ParameterVisitor& visitor, TrackerSettings& settings);

/// Throws std::invalid_argument that names the field out of range.
void check(const TrackerSettings& settings);

enum class IncrementResult {
  kUsed,
  kUsedAfterGap,  ///< the odometry was silent before: bridged with a broad motion of zero mean
  kNewUnit,       ///< the odometry's unit became unknown (a new map): until two fixes give it, only the turns are used
  kOutOfOrder,    ///< its time is covered already, or runs backwards
  kInvalid,       ///< not finite, or longer than any step
};

/// Mean motion over the newest step of odometry, in the levelled body frame at its begin.
struct Rate {
  Vector4d value =
      Vector4d::Zero();  ///< velocity [m/s], yaw rate [rad/s]; the velocity is zero while the scale is unknown
  Matrix4d covariance =
      Matrix4d::Zero();  ///< from the step's covariance and the scale's; kUnknownVariance where nothing is known
};
constexpr double kUnknownVariance = 1e6;

/// What the tracker publishes.
struct PoseEstimate {
  double stamp = 0;                  ///< [s]
  Vector4d pose = Vector4d::Zero();  ///< x y z [m], yaw [rad] in `world`
  Matrix4d covariance = Matrix4d::Identity();
  bool scale_known = true;             ///< false: the odometry began anew in an unknown unit
  double scale = 1, scale_stddev = 0;  ///< of the odometry, absolute
  int support = 0;                     ///< fixes fused since the start or the last recovery
};

class Tracker {
 public:
  /// Throws std::invalid_argument for settings out of range.
  explicit Tracker(const TrackerSettings& settings = TrackerSettings());

  /// Odometry, in order. `covariance_replaced`, if given, tells whether the default covariance had to stand in.
  IncrementResult addIncrement(const Increment& increment, bool* covariance_replaced = nullptr);

  /// Any order. What it did is known when the odometry has reached its stamp: see popOutcomes().
  void addMeasurement(const Measurement& measurement);

  /// What the measurements decided since the last call did, in the order in which they were decided. One whose result a
  /// late measurement changed comes again, marked as revised: the last word counts.
  std::vector<Outcome> popOutcomes();

  /// At the newest odometry stamp; empty before the start.
  std::optional<PoseEstimate> latest() const;
  /// At any buffered stamp (interpolated between steps); empty outside the history or before the start.
  std::optional<PoseEstimate> at(double stamp) const;

  /// Empty before the start.
  std::optional<Rate> rate() const;

  const PoseFilter& filter() const { return now_; }
  /// Measurements that wait for odometry.
  std::size_t waiting() const { return waiting_.size(); }

  void reset();

 private:
  struct Kept {
    Measurement measurement;
    double delay = 0;
    Outcome outcome;                 ///< by the filter as it passed
    std::optional<Result> reported;  ///< last result reported
  };
  struct Step {
    Increment increment;  ///< that led here; of the first step only the stamp counts
    std::vector<Kept> measurements;
    PoseFilter before;  ///< before the step's measurements are applied
  };

  void begin(const Increment& first);
  void append(const Increment& increment);
  void insert(const Kept& kept);
  void replay(std::size_t first);
  void report(const Measurement& m, Result result, double delay);
  void reportChanges();

  TrackerSettings settings_;
  std::deque<Step> steps_;
  PoseFilter now_;  ///< after the newest step and its measurements
  std::vector<Kept> waiting_;
  std::vector<Outcome> outcomes_;
  unsigned map_id_ = 0;
  bool metric_ = true;
};

}  // namespace ekf_tracker
