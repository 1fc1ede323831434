#include "air_ground_common/ros/conversions.h"

#include <cv_bridge/cv_bridge.h>
#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <regex>
#include <stdexcept>

#include "air_ground_common/encoded_image.h"

namespace air_ground_common::ros_utils {
namespace {

Pose makePose(const Eigen::Vector3d& t, const Eigen::Quaterniond& q) {
  if (!t.allFinite() || !q.coeffs().allFinite()) throw std::invalid_argument("pose: a number is not finite");
  if (std::abs(q.norm() - 1) > 0.01) throw std::invalid_argument("pose: the quaternion is not of unit length");
  Pose T = Pose::Identity();
  T.linear() = q.normalized().toRotationMatrix();
  T.translation() = t;
  return T;
}

// cv_bridge multiplies the sizes in 32 bits and matches the encoding by std::regex, which recurses for each letter.
void checkSize(const sensor_msgs::Image& msg) {
  constexpr std::size_t kLongestEncoding = 32;
  if (msg.encoding.size() > kLongestEncoding) throw std::invalid_argument("image: its encoding is no name of one");
  if (msg.width == 0 || msg.height == 0) throw std::invalid_argument("image: it has no pixels");
  if (std::uint64_t{msg.step} * msg.height != msg.data.size() || msg.step < msg.width)
    throw std::invalid_argument("image: its data do not fit its size");
}

/// What cv_bridge takes as colour: numpy and OpenCV give images the names of their types.
const char* colourOf(const std::string& encoding) {
  namespace enc = sensor_msgs::image_encodings;
  if (encoding == enc::TYPE_8UC1) return enc::MONO8.c_str();
  if (encoding == enc::TYPE_8UC3) return enc::BGR8.c_str();
  if (encoding == enc::TYPE_8UC4) return enc::BGRA8.c_str();
  if (encoding == enc::TYPE_16UC1) return enc::MONO16.c_str();
  return nullptr;
}

/// By the name that image_proc and the drivers give them.
bool isRectified(const std::string& topic) {
  static const std::regex kRectified("(^|[/_])rect(ified)?([/_]|$)");
  return std::regex_search(topic, kRectified);
}

/// The order Y U Y V that most web cameras send, which cv_bridge does not know; it knows U Y V Y.
bool isYuy2(const std::string& encoding) { return encoding == "yuv422_yuy2" || encoding == "yuyv"; }

sensor_msgs::Image bytesSwapped(const sensor_msgs::Image& msg) {
  sensor_msgs::Image swapped = msg;
  swapped.is_bigendian = 0;
  for (std::size_t i = 1; i < swapped.data.size(); i += 2) std::swap(swapped.data[i - 1], swapped.data[i]);
  return swapped;
}

cv::Mat convert(const sensor_msgs::Image& msg, const std::string& encoding) {
  checkSize(msg);
  const char* colour = colourOf(msg.encoding);
  if (colour && encoding != msg.encoding) {
    sensor_msgs::Image named = msg;
    named.encoding = colour;
    return convert(named, encoding);
  }
  if (isYuy2(msg.encoding)) {
    sensor_msgs::Image swapped = bytesSwapped(msg);
    swapped.encoding = sensor_msgs::image_encodings::YUV422;
    return convert(swapped, encoding);
  }
  try {
    const int bits = sensor_msgs::image_encodings::bitDepth(msg.encoding);
    if (msg.is_bigendian && bits > 8) {  // cv_bridge makes two channels of a pixel's two bytes
      if (bits != 16) throw std::invalid_argument("image: big-endian pixels of " + std::to_string(bits) + " bits");
      return convert(bytesSwapped(msg), encoding);
    }
    cv_bridge::CvImagePtr image = cv_bridge::toCvCopy(msg, encoding);
    if (image->image.empty()) throw std::invalid_argument("image: it has no pixels");
    return image->image;
  } catch (const std::runtime_error& e) {
    throw std::invalid_argument("image: encoding " + msg.encoding + " cannot be read as " + encoding + " (" + e.what() +
                                ")");
  } catch (const cv::Exception& e) {
    throw std::invalid_argument("image: encoding " + msg.encoding + " cannot be read as " + encoding + " (" + e.err +
                                ")");
  }
}

struct FieldOffsets {
  int x = -1, y = -1, z = -1, rgb = -1, intensity = -1, source = -1, hidden = -1;
};

// Only fields that lie within a point are found.
FieldOffsets findFields(const sensor_msgs::PointCloud2& msg) {
  FieldOffsets o;
  for (const auto& f : msg.fields) {
    const bool is_float = f.datatype == sensor_msgs::PointField::FLOAT32;
    const std::size_t size = f.datatype == sensor_msgs::PointField::UINT8 ? 1 : 4;
    if (f.offset + size > msg.point_step) continue;
    const int offset = static_cast<int>(f.offset);
    if (f.name == "x" && is_float) o.x = offset;
    if (f.name == "y" && is_float) o.y = offset;
    if (f.name == "z" && is_float) o.z = offset;
    if ((f.name == "rgb" || f.name == "rgba") && (is_float || f.datatype == sensor_msgs::PointField::UINT32))
      o.rgb = offset;
    if (f.name == "intensity" && is_float) o.intensity = offset;
    if (f.name == "hidden_from" && is_float) o.hidden = offset;
    if (f.name == "source" && f.datatype == sensor_msgs::PointField::UINT8) o.source = offset;
  }
  if (o.x < 0 || o.y < 0 || o.z < 0)
    throw std::invalid_argument("point cloud: it needs float32 fields x, y, z within point_step");
  if (msg.is_bigendian) throw std::invalid_argument("point cloud: big-endian data is not supported");
  return o;
}

void addField(sensor_msgs::PointCloud2* msg, const std::string& name, std::uint8_t type, std::uint32_t size) {
  sensor_msgs::PointField f;
  f.name = name;
  f.offset = msg->point_step;
  f.datatype = type;
  f.count = 1;
  msg->fields.push_back(f);
  msg->point_step += size;
}

}  // namespace

geometry_msgs::Pose toMsg(const Pose& T) {
  const Eigen::Quaterniond q(T.linear());
  geometry_msgs::Pose msg;
  msg.position.x = T.translation().x();
  msg.position.y = T.translation().y();
  msg.position.z = T.translation().z();
  msg.orientation.x = q.x();
  msg.orientation.y = q.y();
  msg.orientation.z = q.z();
  msg.orientation.w = q.w();
  return msg;
}

geometry_msgs::Transform toTransformMsg(const Pose& T) {
  const geometry_msgs::Pose p = toMsg(T);
  geometry_msgs::Transform msg;
  msg.translation.x = p.position.x;
  msg.translation.y = p.position.y;
  msg.translation.z = p.position.z;
  msg.rotation = p.orientation;
  return msg;
}

Pose fromMsg(const geometry_msgs::Pose& m) {
  return makePose({m.position.x, m.position.y, m.position.z},
                  {m.orientation.w, m.orientation.x, m.orientation.y, m.orientation.z});
}

Pose fromMsg(const geometry_msgs::Transform& m) {
  return makePose({m.translation.x, m.translation.y, m.translation.z},
                  {m.rotation.w, m.rotation.x, m.rotation.y, m.rotation.z});
}

void setCovariance(const Matrix6d& covariance, boost::array<double, 36>* msg) {
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) (*msg)[6 * r + c] = covariance(r, c);
}

Matrix6d covarianceFromMsg(const boost::array<double, 36>& msg) {
  Matrix6d covariance;
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) covariance(r, c) = msg[6 * r + c];
  if (!covariance.allFinite()) throw std::invalid_argument("pose covariance: a number is not finite");
  return covariance;
}

CameraModel fromMsg(const sensor_msgs::CameraInfo& msg) {
  CameraModel c;
  c.width = static_cast<int>(msg.width);
  c.height = static_cast<int>(msg.height);
  c.fx = msg.K[0];
  c.fy = msg.K[4];
  c.cx = msg.K[2];
  c.cy = msg.K[5];
  c.setDistortion(msg.distortion_model, msg.D);
  c.validate();
  // K, width and height are those of the whole sensor; roi and binning tell which part of it the image is. Zeros stand
  // for the whole sensor and for no binning.
  const bool whole = msg.roi.width == 0 || msg.roi.height == 0;
  c = c.window(static_cast<int>(msg.roi.x_offset), static_cast<int>(msg.roi.y_offset),
               static_cast<int>(whole ? msg.width : msg.roi.width),
               static_cast<int>(whole ? msg.height : msg.roi.height), static_cast<int>(std::max(1u, msg.binning_x)),
               static_cast<int>(std::max(1u, msg.binning_y)));
  if (std::int64_t{c.width} * c.height > kMaxImagePixels)  // tables of this size are made before an image has come
    throw std::invalid_argument("camera calibration: it states " + std::to_string(c.width) + " x " +
                                std::to_string(c.height) + " pixels, more than any camera has");
  return c;
}

sensor_msgs::CameraInfo infoOfImages(const sensor_msgs::CameraInfo& info, const std::string& topic) {
  const auto zero = [](double d) { return d == 0; };
  const bool distorted = !std::all_of(info.D.begin(), info.D.end(), zero);
  const bool empty = std::all_of(info.K.begin(), info.K.end(), zero) && !distorted;
  if (info.P[0] <= 0 || !(empty || (distorted && isRectified(topic)))) return info;
  sensor_msgs::CameraInfo own = info;
  own.K = {info.P[0], info.P[1], info.P[2], info.P[4], info.P[5], info.P[6], info.P[8], info.P[9], info.P[10]};
  own.R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  own.distortion_model = "plumb_bob";
  own.D.assign(5, 0.0);
  return own;
}

sensor_msgs::CameraInfo toMsg(const CameraModel& c, const std_msgs::Header& header) {
  sensor_msgs::CameraInfo msg;
  msg.header = header;
  msg.width = static_cast<std::uint32_t>(c.width);
  msg.height = static_cast<std::uint32_t>(c.height);
  msg.distortion_model = c.distortionName();
  msg.D = c.distortionCoefficients();
  msg.K = {c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1};
  msg.R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  msg.P = {c.fx, 0, c.cx, 0, 0, c.fy, c.cy, 0, 0, 0, 1, 0};
  return msg;
}

cv::Mat greyFromMsg(const sensor_msgs::Image& msg) { return convert(msg, sensor_msgs::image_encodings::MONO8); }

cv::Mat bgrFromMsg(const sensor_msgs::Image& msg) { return convert(msg, sensor_msgs::image_encodings::BGR8); }

cv::Mat depthFromMsg(const sensor_msgs::Image& msg, double unit) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  cv::Mat depth;
  if (msg.encoding == "16UC1" || msg.encoding == "mono16") {
    const cv::Mat steps = convert(msg, msg.encoding);
    steps.convertTo(depth, CV_32F, unit);
    depth.setTo(nan, steps == 0);
    depth.setTo(nan, steps == 65535);
  } else if (msg.encoding == "32FC1") {
    depth = convert(msg, msg.encoding);
    for (int r = 0; r < depth.rows; ++r) {
      float* row = depth.ptr<float>(r);
      for (int c = 0; c < depth.cols; ++c)
        if (!(row[c] > 0) || !std::isfinite(row[c])) row[c] = nan;
    }
  } else {
    throw std::invalid_argument("depth image: encoding " + msg.encoding + " is neither 16UC1 [mm] nor 32FC1 [m]");
  }
  return depth;
}

sensor_msgs::Image toMsg(const cv::Mat& image, const std::string& encoding, const std_msgs::Header& header) {
  sensor_msgs::Image msg;
  cv_bridge::CvImage(header, encoding, image).toImageMsg(msg);
  return msg;
}

std::vector<CloudPoint> cloudFromMsg(const sensor_msgs::PointCloud2& msg, std::size_t* dropped) {
  constexpr float kFarthest = 1e6f;  // [m]; cells of any size that a map has can still be counted by integers
  const FieldOffsets o = findFields(msg);
  const std::size_t count = static_cast<std::size_t>(msg.width) * msg.height;
  if (msg.data.size() < static_cast<std::size_t>(msg.row_step) * msg.height ||
      msg.row_step < static_cast<std::size_t>(msg.point_step) * msg.width)
    throw std::invalid_argument("point cloud: its data is shorter than its size says");
  std::vector<CloudPoint> points;
  points.reserve(count);
  for (std::uint32_t r = 0; r < msg.height; ++r)
    for (std::uint32_t c = 0; c < msg.width; ++c) {
      const std::uint8_t* p =
          &msg.data[static_cast<std::size_t>(r) * msg.row_step + static_cast<std::size_t>(c) * msg.point_step];
      CloudPoint point;
      std::memcpy(&point.position[0], p + o.x, 4);
      std::memcpy(&point.position[1], p + o.y, 4);
      std::memcpy(&point.position[2], p + o.z, 4);
      if (!point.position.allFinite() || point.position.cwiseAbs().maxCoeff() > kFarthest) continue;
      if (o.rgb >= 0) {
        point.rgb << p[o.rgb + 2], p[o.rgb + 1], p[o.rgb];
      } else if (o.intensity >= 0) {
        float intensity;
        std::memcpy(&intensity, p + o.intensity, 4);
        point.rgb.setConstant(
            static_cast<std::uint8_t>(std::isfinite(intensity) ? std::min(255.f, std::max(0.f, intensity)) : 0.f));
      }
      if (o.source >= 0) point.source = p[o.source];
      if (o.hidden >= 0) std::memcpy(&point.hidden_from, p + o.hidden, 4);
      points.push_back(point);
    }
  if (dropped) *dropped = count - points.size();
  return points;
}

sensor_msgs::PointCloud2 toMsg(const std::vector<CloudPoint>& points, CloudFields fields,
                               const std_msgs::Header& header) {
  using Field = sensor_msgs::PointField;
  sensor_msgs::PointCloud2 msg;
  msg.header = header;
  msg.height = 1;
  msg.width = static_cast<std::uint32_t>(points.size());
  msg.is_dense = true;
  for (const char* axis : {"x", "y", "z"}) addField(&msg, axis, Field::FLOAT32, 4);
  if (fields == CloudFields::kXyzIntensity) addField(&msg, "intensity", Field::FLOAT32, 4);
  const bool rgb = fields != CloudFields::kXyz && fields != CloudFields::kXyzIntensity;
  if (rgb) addField(&msg, "rgb", Field::FLOAT32, 4);
  if (fields == CloudFields::kXyzRgbSource) addField(&msg, "source", Field::UINT8, 1);
  if (fields == CloudFields::kXyzRgbHidden) addField(&msg, "hidden_from", Field::FLOAT32, 4);
  msg.row_step = msg.point_step * msg.width;
  msg.data.assign(msg.row_step, 0);
  std::uint8_t* out = msg.data.data();
  for (const auto& p : points) {
    std::memcpy(out, p.position.data(), 12);
    if (fields == CloudFields::kXyzIntensity) {
      const float intensity = (p.rgb[0] + p.rgb[1] + p.rgb[2]) / 3.f;
      std::memcpy(out + 12, &intensity, 4);
    }
    if (rgb) {
      out[12] = p.rgb[2];
      out[13] = p.rgb[1];
      out[14] = p.rgb[0];
    }
    if (fields == CloudFields::kXyzRgbSource) out[16] = p.source;
    if (fields == CloudFields::kXyzRgbHidden) std::memcpy(out + 16, &p.hidden_from, 4);
    out += msg.point_step;
  }
  return msg;
}

}  // namespace air_ground_common::ros_utils
