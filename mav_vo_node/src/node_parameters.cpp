#include "node_parameters.h"

#include "air_ground_common/ros/parameters.h"

namespace mav_vo {

using air_ground_common::ros_utils::ParameterError;
using air_ground_common::ros_utils::Parameters;

NodeSettings readParameters(const ros::NodeHandle& private_handle) {
  Parameters p(private_handle);
  NodeSettings n;
  n.estimator.map_frame = "mav_map";
  n.estimator.odom_frame = "mav_odom";
  n.estimator.base_frame = "mav_base_link";
  air_ground_common::ros_utils::readParameters(p, &n.estimator);
  n.visual_frame = p.text("visual_map_frame", "mav_visual_map");
  n.sparse_cloud_interval = p.number("sparse_cloud_interval", n.sparse_cloud_interval, 0.0, 60.0);
  n.track_image_every = p.integer("track_image_every", n.track_image_every, 1, 1000);

  OdometrySettings& o = n.odometry;
  o.synchronous = false;
  o.use_imu = n.estimator.use_imu;
  o.synchronous = p.flag("synchronous", o.synchronous);
  o.seed = static_cast<unsigned>(p.integer("seed", static_cast<int>(o.seed), 0, 1 << 30));
  o.bootstrap.seed = o.seed;
  o.imu_noise.gyro_density = p.number("gyro_noise_density", o.imu_noise.gyro_density, 1e-7, 1.0);
  o.imu_noise.accel_density = p.number("accel_noise_density", o.imu_noise.accel_density, 1e-6, 10.0);
  o.imu_noise.gyro_bias_walk = p.number("gyro_bias_walk", o.imu_noise.gyro_bias_walk, 1e-9, 1.0);
  o.imu_noise.accel_bias_walk = p.number("accel_bias_walk", o.imu_noise.accel_bias_walk, 1e-8, 10.0);

  o.gyro_alignment.bias_stddev = p.number("gyro_bias_stddev", o.gyro_alignment.bias_stddev, 1e-4, 1.0);
  o.gyro_alignment.time_offset = p.number("time_offset", o.gyro_alignment.time_offset, -1.0, 1.0);
  o.gyro_alignment.time_offset_stddev = p.number("time_offset_stddev", o.gyro_alignment.time_offset_stddev, 0.0, 0.1);
  o.readout_time = p.number("readout_time", o.readout_time, -0.1, 0.1);

  o.tracker.max_features = p.integer("max_features", o.tracker.max_features, 40, 2000);
  o.tracker.min_distance = p.integer("feature_distance", o.tracker.min_distance, 4, 100);
  o.tracker.fast_threshold = p.integer("fast_threshold", o.tracker.fast_threshold, 2, 100);
  o.tracker.clahe = p.flag("clahe", o.tracker.clahe);
  o.pixel_sigma = p.number("pixel_sigma", o.pixel_sigma, 0.05, 10.0);
  o.bootstrap.pixel_sigma = o.pixel_sigma;
  o.bootstrap.min_parallax = p.number("start_parallax", o.bootstrap.min_parallax, 0.005, 1.0);
  const std::string covariance = p.text("increment_covariance", "monte_carlo");
  if (covariance != "monte_carlo" && covariance != "poses") {
    throw ParameterError("parameter increment_covariance: \"" + covariance + "\" is neither monte_carlo nor poses");
  }
  o.increment_covariance = covariance == "poses" ? IncrementCovariance::kPoses : IncrementCovariance::kMonteCarlo;
  o.increment_samples = p.integer("increment_samples", o.increment_samples, 50, 100000);
  o.min_inliers = p.integer("min_inliers", o.min_inliers, 6, 500);
  o.lost_timeout = p.number("lost_timeout", o.lost_timeout, 0.1, 600.0);
  o.max_speed = p.number("max_speed", o.max_speed, 0.01, 100.0);
  o.relocalization_slack = p.number("relocalization_slack", o.relocalization_slack, 0.0, 100.0);
  o.keyframe_distance = p.number("keyframe_distance", o.keyframe_distance, 0.01, 1.0);
  o.keyframe_angle = p.number("keyframe_angle", o.keyframe_angle, 0.02, 1.5);
  o.keyframe_overlap = p.number("keyframe_overlap", o.keyframe_overlap, 0.1, 0.95);
  o.keyframe_max_interval = p.number("keyframe_max_interval", o.keyframe_max_interval, 0.1, 5.0);
  o.reobserve_matches = p.integer("reobserve_matches", o.reobserve_matches, 0, 500);
  o.max_image_keyframes = p.integer("max_image_keyframes", o.max_image_keyframes, 10, 100000);
  o.window = p.integer("window", o.window, 3, 100);
  o.window_fixed = p.integer("window_fixed", o.window_fixed, 0, 200);
  o.full_interval = p.number("full_adjustment_interval", o.full_interval, 0.5, 1e6);
  o.full_max_keyframes = p.integer("full_adjustment_keyframes", o.full_max_keyframes, o.window, 2000);
  o.bundle_threads = p.integer("bundle_threads", o.bundle_threads, 1, 64);
  o.metric_stddev = p.number("metric_stddev", o.metric_stddev, 0.001, 0.2);
  o.scale.start_relative_stddev = p.number("scale_start_stddev", o.scale.start_relative_stddev, 0.001, 0.5);
  o.scale.start_max_nis = p.number("scale_start_max_nis", o.scale.start_max_nis, 1.0, 1000.0);
  o.scale.position_stddev = p.number("scale_position_stddev", o.scale.position_stddev, 1e-5, 0.1);
  o.scale.position_drift = p.number("scale_position_drift", o.scale.position_drift, 0.0, 0.5);
  o.scale.scale_drift = p.number("scale_drift", o.scale.scale_drift, 0.0, 0.1);
  o.scale.accel_bias_stddev = p.number("accel_bias_stddev", o.scale.accel_bias_stddev, 1e-3, 5.0);
  p.finish();
  o.validate();
  return n;
}

}  // namespace mav_vo
