#include "messages.h"

#include <sensor_msgs/image_encodings.h>

#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/vertical_message.h"

namespace mav_vo {

namespace ros_utils = air_ground_common::ros_utils;

namespace {

std::uint8_t stateOf(OdometryState state) {
  switch (state) {
    case OdometryState::kWaiting:
      return air_ground::VoStatus::STATE_WAITING;
    case OdometryState::kInitializing:
      return air_ground::VoStatus::STATE_INITIALIZING;
    case OdometryState::kScaling:
      return air_ground::VoStatus::STATE_SCALING;
    case OdometryState::kTracking:
      return air_ground::VoStatus::STATE_TRACKING;
    case OdometryState::kLost:
      return air_ground::VoStatus::STATE_LOST;
  }
  return air_ground::VoStatus::STATE_LOST;
}

}  // namespace

std::string adviceFor(OdometryState state, bool use_imu) {
  switch (state) {
    case OdometryState::kInitializing:
      return "move the camera sideways over a scene with texture, sharp and well lit";
    case OdometryState::kScaling:
      return use_imu ? "accelerate the vehicle for some seconds"
                     : "fly over what the ground robot has seen, and turn, which tells what is level (in a city "
                       "nothing is to be done)";
    case OdometryState::kLost:
      return "bring the camera back to where it has been, or to another one: a new map begins there after lost_timeout";
    default:
      return "";
  }
}

air_ground::VoStatus statusMessage(const VoResult& r) {
  air_ground::VoStatus status;
  status.state = stateOf(r.state);
  status.tracked_features = static_cast<std::uint32_t>(r.tracked);
  status.inliers = static_cast<std::uint32_t>(r.inliers);
  status.keyframes = static_cast<std::uint32_t>(r.keyframes);
  status.map_points = static_cast<std::uint32_t>(r.landmarks);
  status.scale = r.scale;
  status.scale_stddev = r.scale_stddev;
  ros_utils::setVertical(r.vertical, &status);
  status.map_revision = r.map_revision;
  status.processing_time = r.seconds;
  status.reason = r.reason;
  return status;
}

ros_utils::Motion motionOf(const VoResult& r) {
  ros_utils::Motion motion;
  if (!r.increment) return motion;
  motion.T_previous_current = r.increment->T_previous_current;
  const Eigen::Matrix4d& c = r.increment->pose_covariance;
  Matrix6d& covariance = motion.covariance.emplace(Matrix6d::Zero());
  covariance.topLeftCorner<3, 3>() = c.topLeftCorner<3, 3>();
  covariance.block<3, 1>(0, 5) = c.topRightCorner<3, 1>();
  covariance.block<1, 3>(5, 0) = c.bottomLeftCorner<1, 3>();
  covariance.diagonal().tail<3>().setConstant(c(3, 3));
  return motion;
}

air_ground::PosedImage posedImage(const cv::Mat& grey, const VoResult& r, int quality) {
  air_ground::PosedImage posed;
  if (quality > 0)
    posed.compressed = ros_utils::compressed(grey, quality, std_msgs::Header());
  else
    posed.image = ros_utils::toMsg(grey, sensor_msgs::image_encodings::MONO8, std_msgs::Header());
  posed.pose.pose = ros_utils::toMsg(r.T_map_camera);
  ros_utils::setCovariance(r.camera_covariance, &posed.pose.covariance);
  posed.depth_min = static_cast<float>(r.depth_min);
  posed.depth_max = static_cast<float>(r.depth_max);
  posed.readout_time = static_cast<float>(r.readout_time);
  posed.keyframe = r.keyframe;
  posed.metric = r.metric;
  posed.map_id = r.map_id;
  posed.map_revision = r.map_revision;
  return posed;
}

air_ground::VoIncrement incrementMessage(const std_msgs::Header& header, const VoResult& r) {
  air_ground::VoIncrement increment;
  increment.header = header;
  increment.previous_stamp = ros::Time(r.increment->previous_stamp);
  increment.relative_pose = ros_utils::toMsg(r.increment->T_previous_current);
  for (int row = 0; row < 4; ++row)
    for (int column = 0; column < 4; ++column)
      increment.covariance[4 * row + column] = r.increment->covariance(row, column);
  increment.metric = r.metric;
  increment.scale_variance = r.scale_deviation * r.scale_deviation;
  increment.inliers = static_cast<std::uint32_t>(r.inliers);
  increment.map_id = r.map_id;
  return increment;
}

}  // namespace mav_vo
