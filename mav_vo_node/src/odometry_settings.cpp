#include <stdexcept>

#include "air_ground_common/parameters.h"
#include "mav_vo/odometry.h"

namespace mav_vo {

void describe(air_ground_common::ParameterVisitor& v, OdometrySettings& o) {
  v.section("IMU");
  v("gyro_noise_density", o.imu_noise.gyro_density, {1e-7, 1.0}, "rad/s/sqrt(Hz)",
    "data sheet value, or up to twice that");
  v("accel_noise_density", o.imu_noise.accel_density, {1e-6, 10.0}, "m/s^2/sqrt(Hz)",
    "more is used where its samples show more");
  v("gyro_bias_walk", o.imu_noise.gyro_bias_walk, {1e-9, 1.0}, "rad/s^2/sqrt(Hz)", "");
  v("accel_bias_walk", o.imu_noise.accel_bias_walk, {1e-8, 10.0}, "m/s^3/sqrt(Hz)", "");
  v("accel_bias_stddev", o.scale.accel_bias_stddev, {1e-3, 5.0}, "m/s^2",
    "of the accelerometer's bias before the flight, per axis");
  v("accel_scale_stddev", o.accel_scale_stddev, {0.0, 0.2}, "",
    "of the accelerometer's scale factor, relative (data sheet: sensitivity tolerance); the scale that is published "
    "cannot be known better");
  v("gyro_bias_stddev", o.gyro_alignment.bias_stddev, {1e-4, 1.0}, "rad/s",
    "of the gyro's bias before the first image, per axis");
  v("time_offset", o.gyro_alignment.time_offset, {-1.0, 1.0}, "s",
    "t_imu = t_image + time_offset: stamps of the same instant on both clocks; positive: the image's stamp is the "
    "smaller one");
  v("time_offset_stddev", o.gyro_alignment.time_offset_stddev, {0.0, 0.1}, "s",
    "of that figure; it is estimated from there. 0 = exact, not estimated");
  v("readout_time", o.readout_time, {-0.1, 0.1}, "s",
    "rolling shutter: row r of h is exposed at stamp + (r / h - 0.5) * readout_time, so the stamp is the middle row's; "
    "negative: bottom row first");
  v("readout_time_stddev", o.readout_time_stddev, {0.0, 0.05}, "s",
    "of that figure; it is estimated from there, which needs turns. 0 = exact (a global shutter, say), not estimated");
  v("imu_rotation_stddev", o.imu_rotation_stddev, {0.0, 0.1}, "rad",
    "of the rotation between camera and IMU as they are mounted, per axis; where turns are sure that it is another "
    "one, that is used. 0 = exact, not estimated");
  v("radial_stddev", o.radial_stddev, {0.0, 0.5}, "",
    "of the calibration's first radial coefficient, k1; where the images are sure that it is another one, that is "
    "used. "
    "0 = exact, not estimated");

  v.section("Features");
  describe(v, o.tracker);
  v("pixel_sigma", o.pixel_sigma, {0.05, 10.0}, "px", "of a tracked feature");

  v.section("Start, loss");
  v("start_parallax", o.bootstrap.min_parallax, {0.005, 1.0}, "rad",
    "median angle between the rays of the first views");
  v("min_inliers", o.min_inliers, {6, 500}, "", "landmarks that must agree on a pose");
  v("lost_timeout", o.lost_timeout, {0.1, 600.0}, "s",
    "lost for so long in images that show something: start a new map; one that waits for its scale is waited for no "
    "longer than it lived, dark images or not");
  v("max_speed", o.max_speed, {0.01, 100.0}, "m/s",
    "bounds, with the next one, how far a place recognised while lost can lie");
  v("relocalization_slack", o.relocalization_slack, {0.0, 100.0}, "m", "added to max_speed times the time lost");

  v.section("Keyframes and map");
  v("keyframe_distance", o.keyframe_distance, {0.01, 1.0}, "", "moved, over the scene's distance");
  v("keyframe_angle", o.keyframe_angle, {0.02, 1.5}, "rad", "turned");
  v("keyframe_overlap", o.keyframe_overlap, {0.1, 0.95}, "",
    "share of the last keyframe's landmarks still in view, below: keyframe");
  v("keyframe_max_interval", o.keyframe_max_interval, {0.1, 5.0}, "s", "while moving");
  v("reobserve_matches", o.reobserve_matches, {0, 500}, "", "old landmarks looked for in an image; 0 = off");
  v("max_image_keyframes", o.max_image_keyframes, {10, 100000}, "",
    "keyframes that keep their image for patch search, 0.5 MB each at 752x480; the farthest lose it");
  v("window", o.window, {3, 100}, "", "keyframes that the local bundle adjustment moves");
  v("window_duration", o.window_duration, {0.0, 100.0}, "s",
    "that they span where the IMU holds the scale, as far as twice as many keyframes do");
  v("window_fixed", o.window_fixed, {0, 200}, "", "older keyframes that hold it");
  v("full_adjustment_interval", o.full_interval, {0.5, 1e6}, "s",
    "between adjustments of the whole map, at least (without IMU twice that): one of many keyframes is adjusted every "
    "0.16 s a keyframe");
  v("full_adjustment_keyframes", o.full_max_keyframes, {3, 2000}, "", "the newest of them move in it; at least window");
  v("bundle_threads", o.bundle_threads, {1, 64}, "", "of Ceres");
  v("synchronous", o.synchronous,
    "bundle adjustment on the tracking thread: each image has the newest map, and waits for it");

  v.section("Scale");
  v("metric_stddev", o.metric_stddev, {0.001, 0.2}, "",
    "relative standard deviation below which the map is made metric; grows from 5 s on, up to 2.5 times after 12.5 s");
  v("scale_start_stddev", o.scale.start_relative_stddev, {0.001, 0.5}, "",
    "relative standard deviation at which the scale filter starts");
  v("scale_start_max_nis", o.scale.start_max_nis, {1.0, 1000.0}, "",
    "mean squared normalised innovation above which a start is refused: images and IMU contradict each other; 1 "
    "expected");
  v("scale_position_stddev", o.scale.position_stddev, {1e-5, 0.1}, "",
    "white noise of the visual position over the scene's distance");
  v("scale_position_drift", o.scale.position_drift, {0.0, 0.5}, "m/sqrt(s)", "its random walk");
  v("scale_drift", o.scale.scale_drift, {0.0, 0.1}, "1/sqrt(s)", "random walk of the logarithm of the scale");

  v.section("Increments (mav/vo_increment)");
  v.choice("increment_covariance", o.increment_covariance,
           {{"monte_carlo", IncrementCovariance::kMonteCarlo}, {"poses", IncrementCovariance::kPoses}},
           "monte_carlo: scatter of five-point solutions (paper B, III.B), cautious; poses: image noise of both poses");
  v("increment_samples", o.increment_samples, {50, 100000}, "", "of five correspondences each, for monte_carlo");

  v("seed", o.seed, {0, 1 << 30}, "", "of all random sampling");
}

void OdometrySettings::validate() const {
  const auto require = [](bool good, const char* what) {
    if (!good) throw std::invalid_argument(std::string("OdometrySettings: ") + what);
  };
  air_ground_common::checkRanges(*this);
  tracker.validate();
  imu_noise.validate();
  require(gyro_prior_sigma > 0, "gyro_prior_sigma must be positive");
  require(triangulation_parallax > 0, "triangulation_parallax must be positive");
  require(full_max_keyframes >= window, "full_adjustment_keyframes must be at least window");
}

}  // namespace mav_vo
