// From the simulated sensors' readings to ROS messages.
#pragma once

#include <geometry_msgs/TransformStamped.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/FluidPressure.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/MagneticField.h>
#include <sensor_msgs/NavSatFix.h>

#include <cstdint>
#include <string>
#include <vector>

#include "air_ground_common/geodesy.h"
#include "air_ground_sim/sensors.h"

namespace air_ground_sim {

sensor_msgs::Imu imuMessage(const std_msgs::Header& header, const ImuReading& reading, const ImuConfig& config);
sensor_msgs::MagneticField magneticMessage(const std_msgs::Header& header, const Eigen::Vector3d& field, double noise);
/// `place.height` lies `undulation` below the ellipsoidal height [m].
sensor_msgs::NavSatFix fixMessage(const std_msgs::Header& header, const air_ground_common::Geodetic& place,
                                  double undulation, double stated_stddev);
sensor_msgs::FluidPressure pressureMessage(const std_msgs::Header& header, double pressure, double noise);
geometry_msgs::TransformStamped transformMessage(const std_msgs::Header& header, const std::string& child,
                                                 const air_ground_common::Pose& T);

/// An image of the camera's size that takes over its pixels.
sensor_msgs::Image imageMessage(const sensor_msgs::CameraInfo& info, const std::string& encoding, int bytes_per_pixel,
                                std::vector<std::uint8_t> pixels);
/// JPEG of a mono8 or rgb8 image, as image_transport's compressed plugin names it.
sensor_msgs::CompressedImage jpegMessage(const sensor_msgs::Image& image, int quality);

}  // namespace air_ground_sim
