#include "depth_input.h"

#include <sensor_msgs/image_encodings.h>

#include <exception>
#include <utility>

#include "air_ground_common/text.h"
#include "rgbd_slam/depth_model.h"

namespace rgbd_slam {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground_common::CameraModel;
using air_ground_common::Pose;

DepthInput::DepthInput(ros::NodeHandle handle, const std::string& image, const std::string& camera_info,
                       const DepthInputSettings& settings, const ros_utils::Mountings& mountings,
                       ros_utils::NodeHealth& health)
    : settings_(settings),
      mountings_(mountings),
      health_(health),
      image_topic_(handle.resolveName(image)),
      info_topic_(handle.resolveName(camera_info)) {
  if (!settings.registered) health_.expectInput(info_topic_);
  info_subscriber_ = handle.subscribe(camera_info, 20, &DepthInput::onInfo, this);
}

void DepthInput::setColourCamera(const CameraModel& camera, const Pose& T_base_colour) {
  colour_camera_ = camera;
  T_base_colour_ = T_base_colour;
  registration_.reset();
}

void DepthInput::onInfo(const sensor_msgs::CameraInfo::ConstPtr& message) {
  if (!settings_.registered) health_.received(info_topic_, message->header.stamp);
  std::string problem;
  std::optional<ros_utils::Calibration> calibration;
  try {
    const sensor_msgs::CameraInfo info = ros_utils::infoOfImages(*message, image_topic_);
    calibration = ros_utils::Calibration{ros_utils::fromMsg(info), info};
  } catch (const std::exception& e) {
    problem = e.what();
    if (!settings_.registered) health_.count("depth camera calibrations refused: " + problem);
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  problem_ = problem;
  if (calibration) calibration_ = calibration;
}

// Drivers stamp images of two cameras with one frame, and some registered ones with the other calibration.
bool DepthInput::ofColourCamera() {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!calibration_ || seesAlike(calibration_->camera, colour_camera_)) return true;
  const CameraModel& depth = calibration_->camera;
  if (!std::exchange(other_calibration_, true))
    ROS_WARN(
        "%s tells of another camera (%dx%d, f %.0f) than that of the colour images (%dx%d, f %.0f): if the driver does "
        "not register depth images to colour, set depth_registered: false (launch argument ground_depth_registered)",
        info_topic_.c_str(), depth.width, depth.height, depth.fx, colour_camera_.width, colour_camera_.height,
        colour_camera_.fx);
  health_.count("depth images whose calibration is not the colour camera's");
  return false;
}

std::optional<cv::Mat> DepthInput::atColourSize(const cv::Mat& depth, const std::string& frame,
                                                const std::string& colour_frame, std::string* why) {
  const bool same_calibration = ofColourCamera(), same_camera = frame.empty() || frame == colour_frame;
  const std::string doubt = air_ground_common::formatted(
      "depth images are %dx%d in frame '%s', colour images %dx%d in '%s': of another camera? Then depth_registered: "
      "false (launch argument ground_depth_registered), with its camera_info",
      depth.cols, depth.rows, frame.c_str(), colour_camera_.width, colour_camera_.height, colour_frame.c_str());
  if (depth.cols == colour_camera_.width && depth.rows == colour_camera_.height) {
    if (!same_camera) {  // a driver that registers may leave the frame as it was
      health_.count("depth images of the colour images' size in another frame: taken for registered");
      if (!std::exchange(other_frame_, true)) ROS_WARN_STREAM(doubt);
    }
    return depth;
  }
  const auto scaled = depthAtSize(depth, colour_camera_.width, colour_camera_.height);
  if (!scaled || !same_camera || !same_calibration) {
    *why = doubt;
    health_.count("depth images of another size than the colour images', not of its camera");
    return std::nullopt;
  }
  if (!std::exchange(resized_, true))
    ROS_WARN("depth images are %dx%d, colour images %dx%d, both of one camera: the colour's calibration serves, scaled",
             depth.cols, depth.rows, colour_camera_.width, colour_camera_.height);
  return scaled;
}

std::optional<cv::Mat> DepthInput::read(const sensor_msgs::Image& message, const std::string& colour_frame,
                                        std::string* why) {
  const cv::Mat depth = ros_utils::depthFromMsg(message, settings_.unit);
  const double median = medianDepth(depth);
  if (const std::string problem = unitProblem(median); !problem.empty()) {
    health_.count(problem);
    *why = problem;
    return std::nullopt;
  }
  constexpr double kFar = 6;  // [m]; few RGB-D cameras see half of a scene beyond that
  if (!doubted_ && message.encoding != sensor_msgs::image_encodings::TYPE_32FC1 && median > kFar) {
    doubted_ = true;
    const char* doubt =
        "depth images whose unit is in doubt: half of one lies beyond %.1f m, its steps taken for %g m. If what is "
        "seen "
        "is nearer, the map will be too large: say what a step is by depth_unit (launch argument ground_depth_unit; "
        "0.0002 for TUM's PNG images)";
    health_.count(air_ground_common::formatted(doubt, median, settings_.unit));
  }
  if (settings_.registered)
    return atColourSize(depth, air_ground_common::withoutSlash(message.header.frame_id), colour_frame, why);
  std::optional<ros_utils::Calibration> calibration;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    calibration = calibration_;
    *why = problem_.empty() ? "no calibration of the depth camera has come on " + info_topic_ +
                                  ": publish sensor_msgs/CameraInfo there, or remap the topic to where it is"
                            : "the calibration on " + info_topic_ + " cannot be used: " + problem_;
  }
  if (!calibration) return std::nullopt;
  if (!registration_ || !ros_utils::sameCalibration(built_with_, calibration->info)) {
    const auto T_base_depth = mountings_.lookup(
        settings_.T_base_depth, ros_utils::cameraFrame(settings_.frame, *calibration, message), "depth", why);
    if (!T_base_depth) return std::nullopt;
    registration_.emplace(calibration->camera, colour_camera_, T_base_colour_.inverse() * *T_base_depth);
    built_with_ = calibration->info;
  }
  return (*registration_)(depth);
}

}  // namespace rgbd_slam
