#include "sensor_messages.h"

#include <sensor_msgs/image_encodings.h>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "air_ground_common/ros/conversions.h"

namespace air_ground_sim {
namespace {

geometry_msgs::Vector3 toVector(const Eigen::Vector3d& v) {
  geometry_msgs::Vector3 m;
  m.x = v.x();
  m.y = v.y();
  m.z = v.z();
  return m;
}

}  // namespace

sensor_msgs::Imu imuMessage(const std_msgs::Header& header, const ImuReading& reading, const ImuConfig& c) {
  sensor_msgs::Imu m;
  m.header = header;
  m.orientation_covariance[0] = -1;  // no orientation estimate
  m.angular_velocity = toVector(reading.angular_velocity);
  m.linear_acceleration = toVector(reading.specific_force);
  for (int i = 0; i < 3; ++i) {
    m.angular_velocity_covariance[4 * i] = c.gyro_noise * c.gyro_noise * c.rate;
    m.linear_acceleration_covariance[4 * i] = c.accel_noise * c.accel_noise * c.rate;
  }
  return m;
}

sensor_msgs::MagneticField magneticMessage(const std_msgs::Header& header, const Eigen::Vector3d& field, double noise) {
  sensor_msgs::MagneticField m;
  m.header = header;
  m.magnetic_field = toVector(field);
  for (int i = 0; i < 3; ++i) m.magnetic_field_covariance[4 * i] = noise * noise;
  return m;
}

sensor_msgs::NavSatFix fixMessage(const std_msgs::Header& header, const air_ground_common::Geodetic& place,
                                  double undulation, double stated_stddev) {
  const double variance = stated_stddev * stated_stddev;
  sensor_msgs::NavSatFix m;
  m.header = header;
  m.status.status = sensor_msgs::NavSatStatus::STATUS_FIX;
  m.status.service = sensor_msgs::NavSatStatus::SERVICE_GPS;
  m.latitude = place.latitude;
  m.longitude = place.longitude;
  m.altitude = place.height + undulation;  // above the ellipsoid
  m.position_covariance = {variance, 0, 0, 0, variance, 0, 0, 0, 4 * stated_stddev * stated_stddev};
  m.position_covariance_type = sensor_msgs::NavSatFix::COVARIANCE_TYPE_APPROXIMATED;
  return m;
}

sensor_msgs::FluidPressure pressureMessage(const std_msgs::Header& header, double pressure, double noise) {
  sensor_msgs::FluidPressure m;
  m.header = header;
  m.fluid_pressure = pressure;
  m.variance = noise * noise;
  return m;
}

geometry_msgs::TransformStamped transformMessage(const std_msgs::Header& header, const std::string& child,
                                                 const air_ground_common::Pose& T) {
  geometry_msgs::TransformStamped m;
  m.header = header;
  m.child_frame_id = child;
  m.transform = air_ground_common::ros_utils::toTransformMsg(T);
  return m;
}

sensor_msgs::Image imageMessage(const sensor_msgs::CameraInfo& info, const std::string& encoding, int bytes_per_pixel,
                                std::vector<std::uint8_t> pixels) {
  sensor_msgs::Image m;
  m.header = info.header;
  m.width = info.width;
  m.height = info.height;
  m.encoding = encoding;
  m.step = info.width * bytes_per_pixel;
  m.data.swap(pixels);
  return m;
}

sensor_msgs::CompressedImage jpegMessage(const sensor_msgs::Image& image, int quality) {
  const bool grey = image.encoding == sensor_msgs::image_encodings::MONO8;
  const cv::Mat pixels(static_cast<int>(image.height), static_cast<int>(image.width), grey ? CV_8UC1 : CV_8UC3,
                       const_cast<std::uint8_t*>(image.data.data()), image.step);
  cv::Mat bgr;
  if (!grey) cv::cvtColor(pixels, bgr, cv::COLOR_RGB2BGR);
  sensor_msgs::CompressedImage m;
  m.header = image.header;
  m.format = image.encoding + "; jpeg compressed " + (grey ? "" : "bgr8");
  cv::imencode(".jpg", grey ? pixels : bgr, m.data, {cv::IMWRITE_JPEG_QUALITY, quality});
  return m;
}

}  // namespace air_ground_sim
