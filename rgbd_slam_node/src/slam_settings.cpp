#include <stdexcept>

#include "air_ground_common/parameters.h"
#include "rgbd_slam/slam.h"

namespace rgbd_slam {

void describe(air_ground_common::ParameterVisitor& v, SlamSettings& s) {
  v.section("IMU, time");
  v("gravity_timeout", s.gravity_timeout, {0.0, 60.0}, "s",
    "the first image waits this long for the direction of gravity");
  v("use_gravity", s.use_gravity, "roll and pitch of keyframes held by the accelerometer");
  v("gravity_sigma", s.gravity_sigma, {0.001, 0.5}, "rad",
    "standard deviation of these while moving, when accelerations look like tilt");
  double gyro_bias = 2 * s.inertial.initial_gyro_bias, accel_bias = 2 * s.inertial.initial_accel_bias;
  v("max_gyro_bias", gyro_bias, {0.001, 2.0}, "rad/s",
    "two standard deviations of what the gyro may be off by before motion or rest has shown it");
  v("max_accel_bias", accel_bias, {0.001, 5.0}, "m/s^2",
    "the same of the accelerometer; until the robot has turned, the map may lean by it over 9.81");
  s.inertial.initial_gyro_bias = gyro_bias / 2;
  s.inertial.initial_accel_bias = accel_bias / 2;
  v("level_tolerance", s.level_tolerance, {0.001, 0.5}, "rad",
    "the map is levelled anew when it leans by more for certain");
  v("time_offset", s.time_offset, {-1.0, 1.0}, "s", "stamps of the IMU less the true time by the camera's clock");
  v("readout_time", s.readout_time, {-0.1, 0.1}, "s",
    "rolling shutter, first row to last, stamps in the middle; negative: last row first; 0 = global");
  v("readout_time_stddev", s.readout_time_stddev, {0.0, 0.05}, "s",
    "of that figure; it is estimated from there, which needs motion. 0 = exact (a global shutter, say), not estimated");
  v("radial_stddev", s.radial_stddev, {0.0, 0.5}, "",
    "of the colour calibration's first radial coefficient, k1; where the images are sure that it is another one, that "
    "is used. 0 = exact, not estimated");

  v.section("Depth camera: sigma(z) = base + quadratic * z^2");
  v("depth_sigma_base", s.depth.sigma_base, {1e-5, 0.5}, "m", "");
  v("depth_sigma_quadratic", s.depth.sigma_quadratic, {0.0, 0.5}, "1/m", "");
  v("depth_min_range", s.depth.min_range, {0.01, 10.0}, "m", "");
  v("depth_max_range", s.depth.max_range, {0.1, 100.0}, "m", "of depth used for landmarks");

  v.section("Features and tracking");
  describe(v, s.tracker);
  v("pixel_sigma", s.pixel_sigma, {0.05, 10.0}, "px", "of a tracked feature");
  v("min_start_features", s.min_start_features, {10, 1000}, "", "with depth, to start the map");
  v("min_inliers", s.min_inliers, {6, 500}, "", "landmarks that must agree on a pose, else lost");
  v("min_inlier_ratio", s.min_inlier_ratio, {0.0, 0.95}, "", "and their share of the tracked ones");
  v("max_speed", s.max_speed, {0.01, 100.0}, "m/s", "a faster camera is taken for a failure");
  v("relocalization_slack", s.relocalization_slack, {0.0, 100.0}, "m",
    "a place recognised while lost may lie this and max_speed times the time lost away");
  v("relocalization_interval", s.relocalization_interval, {0.0, 60.0}, "s of data",
    "while lost, places are looked up so often");
  v("use_surfaces", s.use_surfaces,
    "surfaces that depth shows bind keyframes to each other, and give the pose where too few landmarks agree (bare "
    "walls, darkness), unless they leave a direction open");
  v("reobserve_every", s.reobserve_every, {0, 1000}, "",
    "frames between searches for landmarks of the local map; 0 = off");
  v("local_keyframes", s.local_keyframes, {1, 100}, "", "the nearest keyframes make the local map");
  v("restart_after", s.restart_after, {0.0, 3600.0}, "s",
    "lost, and for this long images show other places than the map's: begin a new map; dark or covered images do not "
    "count; 0 = wait to be somewhere known again");

  v.section("Keyframes and map");
  v("keyframe_distance", s.keyframe_translation, {0.01, 1.0}, "", "moved, over the scene's median depth");
  v("keyframe_angle", s.keyframe_rotation, {0.02, 1.5}, "rad", "turned");
  v("keyframe_overlap", s.keyframe_overlap, {0.1, 0.95}, "",
    "share of the last keyframe's landmarks still tracked, below: keyframe");
  v("keyframe_min_gap", s.keyframe_min_gap, {1, 100}, "", "frames between keyframes");
  v("max_image_keyframes", s.max_image_keyframes, {1, 100000}, "",
    "keyframes that keep their image for patch search, 0.4 MB each at 640x480; the farthest lose it; at least "
    "local_keyframes");
  v("window", s.window, {2, 50}, "", "keyframes that the local bundle adjustment moves");
  v("window_fixed", s.window_fixed, {1, 100}, "", "others that hold it");
  v("bundle_iterations", s.bundle.max_iterations, {1, 100}, "", "");

  v.section("Loop closure");
  v("loop_closure", s.loop_closure, "");
  v("loop_min_gap", s.loop_min_gap, {2, 1000}, "", "keyframes between the ends of a loop");
  v("loop_min_inliers", s.loop_min_inliers, {10, 500}, "", "recognised points that agree on a pose");
  v("loop_slack", s.loop_slack, {0.01, 10.0}, "m", "a loop may move the camera by this");
  v("loop_drift", s.loop_drift, {0.0, 1.0}, "",
    "plus this share of the way driven between its ends; others are refused");
  v("loop_max_rotation", s.loop_max_rotation, {0.01, 3.2}, "rad", "and may turn it by this");
  v("synchronous", s.synchronous,
    "the adjustment of the whole map that follows on the tracking thread, 2 s at most: frames wait for it");

  v.section("Ground cloud");
  v("voxel", s.cloud.voxel, {0.002, 0.5}, "m", "edge of a voxel, one point each");
  v("cloud_stride", s.cloud.stride, {1, 16}, "", "every n-th row and column of a depth image");
  v("cloud_max_range", s.cloud.max_range, {0.2, 100.0}, "m", "");
  v("cloud_max_incidence", s.cloud.max_incidence, {0.2, 1.55}, "rad",
    "angle between ray and normal; more grazing depth is dropped");
  v("cloud_edge_margin", s.cloud.edge_margin, {0, 10}, "px", "pixels dropped around depth edges");
  v("cloud_fused_frames", s.max_fused_frames, {0, 200}, "", "frames after a keyframe that refine its depth");
  v("cloud_min_confirmations", s.cloud.min_confirmations, {1, 100}, "", "frames that must agree with a point");
  v("cloud_min_weight_share", s.cloud.min_weight_share, {0.0, 0.9}, "",
    "points with less of the weight of the best point within 2 voxels are dropped");
}

void SlamSettings::validate() const {
  air_ground_common::checkRanges(*this);
  tracker.validate();
  depth.validate();
  cloud.validate();
  inertial.validate();
  if (max_image_keyframes < local_keyframes)
    throw std::invalid_argument("SlamSettings: max_image_keyframes must be at least local_keyframes");
}

}  // namespace rgbd_slam
