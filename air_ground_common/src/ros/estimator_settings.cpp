// What users set of any estimator's node.
#include "air_ground_common/ros/estimator_shell.h"
#include "air_ground_common/ros/parameters.h"

namespace air_ground_common::ros_utils {

void describe(ParameterVisitor& v, EstimatorSettings& s) {
  v.section("Frames", "map_frame, odom_frame, base_frame and publish_tf are set by the launch file's arguments.");
  v("map_frame", s.map_frame, "gravity-aligned, z up, origin at base_link of the first keyframe, heading 0 there");
  v("odom_frame", s.odom_frame, "");
  v("base_frame", s.base_frame, "");
  v("publish_tf", s.publish_tf, "map -> odom -> base_link");
  v("odom_from_tf", s.odom_from_tf,
    "true: an odometry of the robot's own publishes odom_frame -> base_frame on tf, and this node map -> odom "
    "alone, to fit it at the images' stamps");
  v("camera_frame", s.camera_frame, "optical frame; \"\" = as camera_info says");
  v("imu_frame", s.imu_frame, "\"\" = as the IMU's messages say");
  v("base_camera", s.T_base_camera, "x y z qx qy qz qw of the (colour) camera in base_link [m]; all 0 = from tf");
  v("base_imu", s.T_base_imu, "the same of the IMU");
  v("transform_timeout", s.transform_timeout, {0.0, 600.0}, "s",
    "an image waits so long for its mounting on tf, wall clock");

  v.section("Input");
  v("use_imu", s.use_imu,
    "false: no prior of rotation; the MAV's map has a unit of its own until alignment/refined tells its scale, the "
    "ground robot's base counts as level at the start");
  v("imu_wait", s.imu_wait, {0.0, 10.0}, "s",
    "an image waits for IMU samples until images this much newer have been here for 0.3 s");
  v("queue_size", s.queue_size, {2, 10000}, "", "images kept while the node is behind");
  v("queue_memory", s.queue_memory, {1, 1000000}, "MB", "and no more of them than this, the oldest dropped first");
  v("max_latency", s.max_latency, {0.0, 600.0}, "s",
    "images further behind the newest are dropped, oldest first; 0 = none; replay.launch drops none (player_waits)");
  v("player_waits", s.player_waits, kPlayerWaits);
  v("autosave", s.autosave, kAutosave);
  v("accel_topic", s.accel_topic,
    "sensor_msgs/Imu of an accelerometer that has a topic of its own (a launch argument); \"\" = in the IMU's "
    "messages");
  v("image_transport", s.image_transport,
    "compressed: sensor_msgs/CompressedImage on <topic>/compressed (a launch argument)", {"raw", "compressed"});
}

PosePublisherSettings poseOutput(const EstimatorSettings& settings, const std::string& odometry_topic,
                                 const std::string& path_topic) {
  PosePublisherSettings output;
  output.map_frame = settings.map_frame;
  output.odom_frame = settings.odom_frame;
  output.base_frame = settings.base_frame;
  output.odometry_topic = odometry_topic;
  output.path_topic = path_topic;
  output.publish_tf = settings.publish_tf;
  output.odom_from_tf = settings.odom_from_tf;
  return output;
}

}  // namespace air_ground_common::ros_utils
