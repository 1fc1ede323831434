// Runs the odometry over a bag, synchronously and as fast as it goes, or as the node does at the bag's own rate: writes
// the trajectory (TUM) and, where the bag holds ground truth, prints the absolute trajectory error and the scale error.
#include <geometry_msgs/PoseStamped.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <tf2_msgs/TFMessage.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <deque>
#include <iostream>
#include <map>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/trajectory.h"
#include "mav_vo/odometry.h"

namespace {

using air_ground_common::Alignment;
using air_ground_common::Pose;
namespace ros_utils = air_ground_common::ros_utils;

void printError(const char* name, const air_ground_common::Trajectory& truth,
                const air_ground_common::Trajectory& estimate) {
  if (estimate.size() < 10) return;
  const auto yaw = air_ground_common::absoluteTrajectoryError(truth, estimate, Alignment::kYawTranslation);
  const auto rigid = air_ground_common::absoluteTrajectoryError(truth, estimate, Alignment::kRigid);
  const auto similar = air_ground_common::absoluteTrajectoryError(truth, estimate, Alignment::kSimilarity);
  std::printf(
      "%s: %zu poses over %.2f m; ATE RMSE yaw-aligned %.4f m (%.3f %% of path), rigid %.4f m (%.3f %%), max %.4f m; "
      "similarity %.4f m, scale error %+.3f %%\n",
      name, yaw.pairs, yaw.path_length, yaw.rmse, 100 * yaw.rmse / yaw.path_length, rigid.rmse,
      100 * rigid.rmse / rigid.path_length, rigid.max, similar.rmse, 100 * (similar.reference_from_estimate.scale - 1));
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Visual odometry over a bag"};
  std::string bag_path, out, image_topic = "/mav/camera/image_raw", info_topic = "/mav/camera/camera_info",
                             imu_topic = "/mav/imu/data", truth_topic = "/ground_truth/mav", base = "mav_base_link";
  double duration = 0, start = 0;
  bool verbose = false, live = false;
  std::vector<double> calibration;
  mav_vo::OdometrySettings settings;
  app.add_option("bag", bag_path, "bag file")->required();
  app.add_option("--out", out, "TUM file for the camera's trajectory");
  app.add_option("--image", image_topic, "image topic");
  app.add_option("--info", info_topic, "calibration topic");
  app.add_option("--imu", imu_topic, "IMU topic");
  app.add_option("--truth", truth_topic, "ground truth topic (pose of base_link)");
  app.add_option("--base", base, "base frame");
  app.add_option("--start", start, "skip so much of the bag [s]");
  app.add_option("--duration", duration, "stop after so much of the bag [s]; 0 = all");
  app.add_option("--calibration", calibration, "fx fy cx cy k1 k2 p1 p2 k3 instead of the bag's")->expected(9);
  app.add_flag("--verbose", verbose, "a line a second");
  app.add_flag("--live", live,
               "at the bag's rate, with the bundle adjustment on a thread of its own, as the node runs");
  app.add_option("--seed", settings.seed, "seed");
  app.add_option("--metric-stddev", settings.metric_stddev, "relative scale deviation at which the map becomes metric");
  app.add_option("--reobserve", settings.reobserve_matches, "old landmarks looked for in an image");
  app.add_option("--features", settings.tracker.max_features, "features");
  app.add_option("--pixel-sigma", settings.pixel_sigma, "of a feature [px]");
  app.add_option("--keyframe-distance", settings.keyframe_distance, "over the scene's distance");
  app.add_option("--full-interval", settings.full_interval, "between adjustments of the whole map [s]");
  app.add_option("--window", settings.window, "keyframes in the local adjustment");
  app.add_option("--gyro-noise", settings.imu_noise.gyro_density, "[rad/s/sqrt(Hz)]");
  app.add_option("--accel-noise", settings.imu_noise.accel_density, "[m/s^2/sqrt(Hz)]");
  app.add_option("--position-drift", settings.scale.position_drift, "of the visual position [m/sqrt(s)]");
  app.add_option("--start-stddev", settings.scale.start_relative_stddev,
                 "relative scale deviation at which the scale filter starts");
  app.add_flag("--imu-off{false}", settings.use_imu, "without IMU");
  CLI11_PARSE(app, argc, argv);
  settings.synchronous = !live;

  rosbag::Bag bag(bag_path, rosbag::bagmode::Read);
  std::optional<air_ground_common::CameraModel> camera;
  Pose T_base_camera = Pose::Identity(), T_base_imu = Pose::Identity();
  std::map<std::string, Pose> fixed;
  std::string camera_frame, imu_frame;
  for (const rosbag::MessageInstance& m :
       rosbag::View(bag, rosbag::TopicQuery({"/tf_static", info_topic, imu_topic}))) {
    if (const auto tf = m.instantiate<tf2_msgs::TFMessage>())
      for (const auto& t : tf->transforms)
        if (t.header.frame_id == base) fixed[t.child_frame_id] = ros_utils::fromMsg(t.transform);
    if (const auto info = m.instantiate<sensor_msgs::CameraInfo>(); info && !camera) {
      camera = ros_utils::fromMsg(*info);
      camera_frame = info->header.frame_id;
    }
    if (const auto imu = m.instantiate<sensor_msgs::Imu>(); imu && imu_frame.empty()) imu_frame = imu->header.frame_id;
    if (camera && !imu_frame.empty() && fixed.count(camera_frame) && fixed.count(imu_frame)) break;
  }
  if (!camera || !fixed.count(camera_frame)) {
    std::cerr << "no calibration on " << info_topic << " or no static transform " << base << " <- '" << camera_frame
              << "'\n";
    return 1;
  }
  if (!calibration.empty()) {
    const auto& c = calibration;
    camera = air_ground_common::CameraModel{camera->width, camera->height, c[0], c[1], c[2], c[3],
                                            c[4],          c[5],           c[6], c[7], c[8]};
  }
  T_base_camera = fixed[camera_frame];
  if (fixed.count(imu_frame)) T_base_imu = fixed[imu_frame];

  mav_vo::Odometry odometry(*camera, T_base_camera, T_base_imu, settings);
  std::deque<sensor_msgs::ImageConstPtr> images;
  air_ground_common::Trajectory truth, online;
  double newest_imu = -1, first_stamp = -1, metric_at = -1, worst = 0, total = 0, next_line = 0, late = 0;
  std::size_t frames = 0, located = 0;
  std::vector<double> times;
  const auto drain = [&](bool all) {
    while (!images.empty() && (all || !settings.use_imu || newest_imu >= images.front()->header.stamp.toSec())) {
      const auto image = images.front();
      images.pop_front();
      const double stamp = image->header.stamp.toSec();
      if (first_stamp < 0) first_stamp = stamp;
      const auto r = odometry.process(stamp, ros_utils::greyFromMsg(*image));
      ++frames;
      located += r.pose_valid;
      total += r.seconds;
      times.push_back(r.seconds);
      worst = std::max(worst, r.seconds);
      if (r.metric && metric_at < 0) metric_at = stamp - first_stamp;
      if (r.metric && r.pose_valid) online.push_back({stamp, r.T_map_base});
      if (verbose && stamp >= next_line) {
        next_line = stamp + 1.0;
        std::printf(
            "%6.2f %-12s map %u tracked %3d inliers %3d keyframes %3zu landmarks %4zu scale %.4f +- %.4f  %.1f ms  "
            "%s\n",
            stamp - first_stamp, mav_vo::toString(r.state), r.map_id, r.tracked, r.inliers, r.keyframes, r.landmarks,
            r.scale, r.scale_stddev, 1e3 * r.seconds, r.reason.c_str());
      }
    }
  };
  const ros::Time begin = rosbag::View(bag).getBeginTime() + ros::Duration(start);
  const auto played = std::chrono::steady_clock::now();
  const ros::Time end = duration > 0 ? begin + ros::Duration(duration) : ros::TIME_MAX;
  for (const rosbag::MessageInstance& m :
       rosbag::View(bag, rosbag::TopicQuery({image_topic, imu_topic, truth_topic}), begin, end)) {
    if (live) {
      const auto due = played + std::chrono::duration<double>((m.getTime() - begin).toSec());
      const std::chrono::duration<double> behind = std::chrono::steady_clock::now() - due;
      late = std::max(late, behind.count());
      std::this_thread::sleep_for(-behind);
    }
    if (const auto image = m.instantiate<sensor_msgs::Image>()) images.push_back(image);
    if (const auto imu = m.instantiate<sensor_msgs::Imu>()) {
      mav_vo::ImuSample sample;
      sample.stamp = newest_imu = imu->header.stamp.toSec();
      sample.angular_velocity = {imu->angular_velocity.x, imu->angular_velocity.y, imu->angular_velocity.z};
      sample.specific_force = {imu->linear_acceleration.x, imu->linear_acceleration.y, imu->linear_acceleration.z};
      odometry.addImu(sample);
    }
    if (const auto pose = m.instantiate<geometry_msgs::PoseStamped>())
      truth.push_back({pose->header.stamp.toSec(), ros_utils::fromMsg(pose->pose)});
    drain(false);
  }
  drain(true);
  odometry.finish();
  auto camera_poses = odometry.trajectory(), final_poses = camera_poses;
  for (auto& p : final_poses) p.T_map_body = p.T_map_body * T_base_camera.inverse();
  std::sort(times.begin(), times.end());
  std::printf(
      "%zu images, %zu localised, map %u, %zu keyframes, metric after %.2f s; %.2f ms a frame (median %.2f, 95 %% "
      "%.2f, worst %.1f)\n",
      frames, located, odometry.mapId(), odometry.map().keyframeCount(), metric_at,
      1e3 * total / std::max<std::size_t>(1, frames), times.empty() ? 0 : 1e3 * times[times.size() / 2],
      times.empty() ? 0 : 1e3 * times[times.size() * 95 / 100], 1e3 * worst);
  if (live) std::printf("live: at most %.2f s behind the bag\n", late);
  if (!truth.empty()) {
    printError("as published", truth, online);
    printError("final       ", truth, final_poses);
  }
  if (!out.empty()) air_ground_common::writeTum(out, camera_poses);
  return 0;
}
