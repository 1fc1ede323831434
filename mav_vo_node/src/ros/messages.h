// What mav_vo_node says of an image.
#pragma once

#include <air_ground/PosedImage.h>
#include <air_ground/VoIncrement.h>
#include <air_ground/VoStatus.h>

#include <string>

#include "air_ground_common/ros/pose_publisher.h"
#include "mav_vo/odometry.h"

namespace mav_vo {

/// What a user can do about an odometry that is in this state.
std::string adviceFor(OdometryState state, bool use_imu);

air_ground::VoStatus statusMessage(const VoResult& r);

/// The increment's image noise; roll and pitch, which its covariance leaves out, taken like the heading.
air_ground_common::ros_utils::Motion motionOf(const VoResult& r);

/// Image and pose in the odometry's own map; header and calibration are left to the caller. grey: 8 bit; quality: of
/// its JPEG, 1..100, or 0: uncompressed.
air_ground::PosedImage posedImage(const cv::Mat& grey, const VoResult& r, int quality);

/// `r` has an increment.
air_ground::VoIncrement incrementMessage(const std_msgs::Header& header, const VoResult& r);

}  // namespace mav_vo
