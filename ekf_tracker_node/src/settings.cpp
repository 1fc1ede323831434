#include <stdexcept>

#include "air_ground_common/parameters.h"
#include "ekf_tracker/tracker.h"

namespace ekf_tracker {

void describe(air_ground_common::ParameterVisitor& v, FilterSettings& f) {
  v.section("Motion by visual odometry");
  v("covariance_factor", f.covariance_factor, {0.01, 100}, "",
    "multiplies the covariance that increments state; 0.1: the five-point samples of mav_vo scatter more than its "
    "poses. 1 for an odometry whose covariances are honest");
  v("min_translation_stddev", f.min_translation_stddev, {1e-6, 1}, "m, or the odometry's unit",
    "standard deviation that each 1/20 s adds to what increments state");
  v("min_yaw_stddev", f.min_yaw_stddev, {1e-7, 0.1}, "rad", "the same of the heading");
  v("metric_scale_stddev", f.metric_scale_stddev, {0.001, 0.9}, "",
    "relative error of odometry that is metric and states no scale_variance");
  v("scale_drift", f.scale_drift, {0, 0.5}, "", "relative, per square root of metre travelled");
  v("max_initial_scale_stddev", f.max_initial_scale_stddev, {0.01, 1}, "",
    "two fixes must give the scale of non-metric odometry this well (relative)");
  v("gap_speed_stddev", f.gap_speed_stddev, {0.01, 50}, "m/s", "how fast it may fly while the odometry is silent");
  v("gap_yaw_rate_stddev", f.gap_yaw_rate_stddev, {0.001, 10}, "rad/s", "");

  v.section("Gate, start, recovery, delays");
  v("gate_probability", f.gate_probability, {0.9, 0.999999}, "",
    "a good measurement passes with this probability. The bound on the normalised innovation squared is the chi-square "
    "quantile: 16.3 for a fix (4 degrees of freedom), 14.2 for GPS (3), 9.0 for heading and barometer (1)");
  v("pairing_time", f.pairing_time, {1, 3600}, "s",
    "fixes that agree start the tracker; one that no other has joined is forgotten: with odometry in an unknown unit "
    "after this time, ...");
  v("pairing_drift", f.pairing_drift, {0.1, 100}, "m",
    "... with metric odometry, however long that takes, once it may be off by this since, as after a gap (1 sigma)");
  v("max_false_start", f.max_false_start, {1e-12, 1}, "",
    "probability that the fixes which start or replace the state are wrong ones that agree by chance: precise fixes "
    "need "
    "two, the paper's three or four");
  v("wrong_fix_spread", f.wrong_fix_spread, {1, 10000}, "m", "for that: wrong fixes lie anywhere within this radius");
  v("unscaled_start_fixes", f.unscaled_start_fixes, {2, 20}, "",
    "at least, with odometry in an unknown unit: two give the scale (as in the paper), but some scale fits many a pair "
    "with a wrong one; a third confirms it");
  v("recovery_fixes", f.recovery_fixes, {2, 20}, "", "refused fixes that must agree before they replace the state");
  v("max_hypotheses", f.max_hypotheses, {1, 20}, "", "rival hypotheses kept");
  v("barometer_drift", f.barometer_drift, {0, 10}, "m", "of the barometer's offset, per square root of second");
}

void describe(air_ground_common::ParameterVisitor& v, TrackerSettings& t) {
  describe(v, t.filter);
  v("history", t.history, {1, 600}, "s", "fixes may be this late");
  v("max_ahead", t.max_ahead, {0.1, 600}, "s",
    "fixes may wait this long for odometry; beyond, they are from the future");
}

void check(const FilterSettings& settings) { air_ground_common::checkRanges(settings); }

void check(const TrackerSettings& settings) {
  air_ground_common::checkRanges(settings);
  if (!(settings.same_time >= 0 && settings.same_time < 0.02))
    throw std::invalid_argument("ekf_tracker settings: same_time must lie between 0 and 0.02 s");
  if (!(settings.default_translation_stddev > 0 && settings.default_yaw_stddev > 0))
    throw std::invalid_argument("ekf_tracker settings: the default covariance must be positive");
}

}  // namespace ekf_tracker
