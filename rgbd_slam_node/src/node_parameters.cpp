#include "node_parameters.h"

#include "air_ground_common/ros/parameters.h"

namespace rgbd_slam {

using air_ground_common::ros_utils::ParameterError;
using air_ground_common::ros_utils::Parameters;

NodeSettings readParameters(const ros::NodeHandle& private_handle) {
  Parameters p(private_handle);
  NodeSettings n;
  auto& e = n.estimator;
  e.map_frame = "ground_map";
  e.odom_frame = "ground_odom";
  e.base_frame = "ground_base_link";
  e.queue_size = 300;
  air_ground_common::ros_utils::readParameters(p, &e);
  e.sync_tolerance = p.number("sync_tolerance", e.sync_tolerance, 0.0, 1.0);
  e.depth_transport = p.choice("depth_transport", e.depth_transport, {"raw", "compressed"});
  n.depth.registered = p.flag("depth_registered", n.depth.registered);
  n.depth.frame = p.text("depth_frame", n.depth.frame);
  n.depth.T_base_depth = p.pose("base_depth");
  n.cloud_interval = p.number("cloud_interval", n.cloud_interval, 0.1, 600.0);

  SlamSettings& s = n.slam;
  s.gravity_timeout = p.number("gravity_timeout", s.gravity_timeout, 0.0, 60.0);
  s.use_gravity = p.flag("use_gravity", s.use_gravity);
  s.time_offset = p.number("time_offset", s.time_offset, -1.0, 1.0);
  s.readout_time = p.number("readout_time", s.readout_time, -0.2, 0.2);
  s.inertial.initial_gyro_bias = p.number("max_gyro_bias", 2 * s.inertial.initial_gyro_bias, 0.001, 2.0) / 2;
  s.inertial.initial_accel_bias = p.number("max_accel_bias", 2 * s.inertial.initial_accel_bias, 0.001, 5.0) / 2;
  s.level_tolerance = p.number("level_tolerance", s.level_tolerance, 0.001, 0.5);
  s.gravity_sigma = p.number("gravity_sigma", s.gravity_sigma, 0.001, 0.5);

  s.depth.sigma_base = p.number("depth_sigma_base", s.depth.sigma_base, 1e-5, 0.5);
  s.depth.sigma_quadratic = p.number("depth_sigma_quadratic", s.depth.sigma_quadratic, 0.0, 0.5);
  s.depth.min_range = p.number("depth_min_range", s.depth.min_range, 0.01, 10.0);
  s.depth.max_range = p.number("depth_max_range", s.depth.max_range, 0.1, 100.0);

  s.tracker.max_features = p.integer("max_features", s.tracker.max_features, 40, 2000);
  s.tracker.min_distance = p.integer("feature_distance", s.tracker.min_distance, 4, 100);
  s.tracker.fast_threshold = p.integer("fast_threshold", s.tracker.fast_threshold, 2, 100);
  s.tracker.clahe = p.flag("clahe", s.tracker.clahe);
  s.pixel_sigma = p.number("pixel_sigma", s.pixel_sigma, 0.05, 10.0);
  s.min_start_features = p.integer("min_start_features", s.min_start_features, 10, 1000);
  s.min_inliers = p.integer("min_inliers", s.min_inliers, 6, 500);
  s.min_inlier_ratio = p.number("min_inlier_ratio", s.min_inlier_ratio, 0.0, 0.95);
  s.max_speed = p.number("max_speed", s.max_speed, 0.01, 100.0);
  s.relocalization_slack = p.number("relocalization_slack", s.relocalization_slack, 0.0, 100.0);
  s.relocalization_interval = p.number("relocalization_interval", s.relocalization_interval, 0.0, 60.0);
  s.reobserve_every = p.integer("reobserve_every", s.reobserve_every, 0, 1000);
  s.local_keyframes = p.integer("local_keyframes", s.local_keyframes, 1, 100);
  s.restart_after = p.number("restart_after", s.restart_after, 0.0, 3600.0);

  s.keyframe_translation = p.number("keyframe_distance", s.keyframe_translation, 0.01, 1.0);
  s.keyframe_rotation = p.number("keyframe_angle", s.keyframe_rotation, 0.02, 1.5);
  s.keyframe_overlap = p.number("keyframe_overlap", s.keyframe_overlap, 0.1, 0.95);
  s.keyframe_min_gap = p.integer("keyframe_min_gap", s.keyframe_min_gap, 1, 100);
  s.max_image_keyframes = p.integer("max_image_keyframes", s.max_image_keyframes, s.local_keyframes, 100000);
  s.window = p.integer("window", s.window, 2, 50);
  s.window_fixed = p.integer("window_fixed", s.window_fixed, 1, 100);
  s.bundle.max_iterations = p.integer("bundle_iterations", s.bundle.max_iterations, 1, 100);

  s.loop_closure = p.flag("loop_closure", s.loop_closure);
  s.loop_min_gap = p.integer("loop_min_gap", s.loop_min_gap, 2, 1000);
  s.loop_min_inliers = p.integer("loop_min_inliers", s.loop_min_inliers, 10, 500);
  s.loop_slack = p.number("loop_slack", s.loop_slack, 0.01, 10.0);
  s.loop_drift = p.number("loop_drift", s.loop_drift, 0.0, 1.0);
  s.loop_max_rotation = p.number("loop_max_rotation", s.loop_max_rotation, 0.01, 3.2);

  s.cloud.voxel = p.number("voxel", s.cloud.voxel, 0.002, 0.5);
  s.cloud.stride = p.integer("cloud_stride", s.cloud.stride, 1, 16);
  s.cloud.max_range = p.number("cloud_max_range", s.cloud.max_range, 0.2, 100.0);
  s.cloud.max_incidence = p.number("cloud_max_incidence", s.cloud.max_incidence, 0.2, 1.55);
  s.cloud.edge_margin = p.integer("cloud_edge_margin", s.cloud.edge_margin, 0, 10);
  s.cloud.min_confirmations = p.integer("cloud_min_confirmations", s.cloud.min_confirmations, 1, 100);
  s.cloud.min_weight_share = p.number("cloud_min_weight_share", s.cloud.min_weight_share, 0.0, 0.9);
  s.max_fused_frames = p.integer("cloud_fused_frames", s.max_fused_frames, 0, 200);
  p.finish();
  if (s.depth.max_range <= s.depth.min_range)
    throw ParameterError("parameter depth_max_range must be greater than depth_min_range");
  s.validate();
  return n;
}

}  // namespace rgbd_slam
