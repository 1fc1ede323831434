// Between ROS messages and the libraries' types. Functions that read a message throw std::invalid_argument, with a line
// that names the field, when the message cannot be used; nodes count that and go on.
#pragma once

#include <geometry_msgs/Pose.h>
#include <geometry_msgs/PoseWithCovariance.h>
#include <geometry_msgs/Transform.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud2.h>

#include <opencv2/core/mat.hpp>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "air_ground_common/mesh.h"

namespace air_ground_common::ros_utils {

geometry_msgs::Pose toMsg(const Pose& T);
geometry_msgs::Transform toTransformMsg(const Pose& T);
/// Throws when not finite or the quaternion is far from unit length.
Pose fromMsg(const geometry_msgs::Pose& msg);
Pose fromMsg(const geometry_msgs::Transform& msg);

/// Row-major 6x6 (x y z rotX rotY rotZ).
void setCovariance(const Matrix6d& covariance, boost::array<double, 36>* msg);
Matrix6d covarianceFromMsg(const boost::array<double, 36>& msg);

/// Camera of the image that comes with the message: its roi and binning are applied to the sensor's K. Throws for
/// fx <= 0 (uncalibrated) and for models other than those of CameraModel::setDistortion (or empty without D).
CameraModel fromMsg(const sensor_msgs::CameraInfo& msg);
sensor_msgs::CameraInfo toMsg(const CameraModel& camera, const std_msgs::Header& header);
/// The calibration of the images on `topic`. Rectified ones (image_rect, image_rect_color ...) come beside the
/// camera_info of the raw ones, in which P is theirs, and neither K nor D. So is P where K is left empty.
sensor_msgs::CameraInfo infoOfImages(const sensor_msgs::CameraInfo& info, const std::string& topic);

/// Grey image, 8 bit, from mono8, mono16, bgr8, rgb8, bgra8, rgba8, yuv422, bayer, or 8UC1, 8UC3 (BGR), 8UC4. Owns its
/// pixels.
cv::Mat greyFromMsg(const sensor_msgs::Image& msg);
/// BGR image, 8 bit.
cv::Mat bgrFromMsg(const sensor_msgs::Image& msg);
/// Depth in metres, CV_32F, NaN where unknown, from 16UC1 [steps of `unit`, 0 and 65535 unknown] or 32FC1 [m].
cv::Mat depthFromMsg(const sensor_msgs::Image& msg, double unit = 1e-3);
/// encoding: "mono8", "bgr8", "rgb8", "32FC1", "16UC1".
sensor_msgs::Image toMsg(const cv::Mat& image, const std::string& encoding, const std_msgs::Header& header);

/// Grey clouds have r = g = b.
using CloudPoint = LabeledPoint;

/// Points of a cloud with float x y z and, optionally, packed `rgb`, float `intensity` (0..255), uint8 `source` and
/// float `hidden_from`.
/// `dropped`, if given, receives the number of those left out: not finite, or a coordinate beyond 1000 km, where no map
/// is. Throws when x, y, z are missing or of another type.
std::vector<CloudPoint> cloudFromMsg(const sensor_msgs::PointCloud2& msg, std::size_t* dropped = nullptr);

enum class CloudFields { kXyz, kXyzIntensity, kXyzRgb, kXyzRgbSource, kXyzRgbHidden };
sensor_msgs::PointCloud2 toMsg(const std::vector<CloudPoint>& points, CloudFields fields,
                               const std_msgs::Header& header);

}  // namespace air_ground_common::ros_utils
