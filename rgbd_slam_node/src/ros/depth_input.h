// Depth images as the SLAM needs them: registered to the colour camera by the driver, or here.
#pragma once

#include <ros/node_handle.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include <mutex>
#include <optional>
#include <string>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/mountings.h"
#include "air_ground_common/ros/sensor_input.h"
#include "rgbd_slam/depth_registration.h"

namespace rgbd_slam {

struct DepthInputSettings {
  double unit = 1e-3;                                   ///< of 16UC1 [m]
  bool registered = true;                               ///< by the driver
  std::string frame;                                    ///< of the depth camera; empty: as its calibration says
  std::optional<air_ground_common::Pose> T_base_depth;  ///< instead of tf
};

/// What registration here needs is the calibration of the depth camera (of `image`), on `camera_info`, and its
/// mounting, from tf.
class DepthInput {
 public:
  DepthInput(ros::NodeHandle handle, const std::string& image, const std::string& camera_info,
             const DepthInputSettings& settings, const air_ground_common::ros_utils::Mountings& mountings,
             air_ground_common::ros_utils::NodeHealth& health);

  /// The colour camera that depth is registered to from now on; call before `read`.
  void setColourCamera(const air_ground_common::CameraModel& camera, const air_ground_common::Pose& T_base_colour);

  /// Depth [m], CV_32F, of the colour camera's size. Empty while calibration or mounting are not known: `why` says what
  /// to do. Throws std::invalid_argument for an image that cannot be read or is not of the calibration's size.
  std::optional<cv::Mat> read(const sensor_msgs::Image& message, const std::string& colour_frame, std::string* why);

 private:
  void onInfo(const sensor_msgs::CameraInfo::ConstPtr& message);
  /// False: a calibration of the depth images has come, and it is another camera's.
  bool ofColourCamera();
  std::optional<cv::Mat> atColourSize(const cv::Mat& depth, const std::string& frame, const std::string& colour_frame,
                                      std::string* why);

  const DepthInputSettings settings_;
  const air_ground_common::ros_utils::Mountings& mountings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  std::string image_topic_, info_topic_;
  air_ground_common::CameraModel colour_camera_;
  air_ground_common::Pose T_base_colour_;
  std::optional<DepthRegistration> registration_;
  sensor_msgs::CameraInfo built_with_;  ///< what that was made with
  bool doubted_ = false;                ///< its unit, on the console
  bool resized_ = false;                ///< said so on the console
  bool other_frame_ = false;            ///< likewise
  bool other_calibration_ = false;      ///< likewise

  std::mutex mutex_;  // of the next two
  std::optional<air_ground_common::ros_utils::Calibration> calibration_;
  std::string problem_;  ///< of the last one, if it was refused
  ros::Subscriber info_subscriber_;
};

}  // namespace rgbd_slam
