#include "air_ground_common/ros/compressed_image.h"

#include <sensor_msgs/image_encodings.h>

#include <boost/make_shared.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>

#include "air_ground_common/encoded_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/rvl.h"

namespace air_ground_common::ros_utils {
namespace {

/// What compressed_depth_image_transport writes before the image.
struct DepthHeader {
  std::int32_t format = 0;
  float quantization[2] = {0, 0};  ///< inverse depth of 32FC1: z = [0] / (value - [1])
};

cv::Mat decoded(const std::uint8_t* data, std::size_t size) {
  if (size == 0 || size > static_cast<std::size_t>(std::numeric_limits<int>::max()))
    throw std::invalid_argument("compressed image: it has no data");
  const cv::Size stated = encodedSize(data, size);
  if (stated.empty()) throw std::invalid_argument("compressed image: it is neither JPEG nor PNG");
  if (std::int64_t{stated.width} * stated.height > kMaxImagePixels)
    throw std::invalid_argument("compressed image: it states " + std::to_string(stated.width) + " x " +
                                std::to_string(stated.height) + " pixels, more than any camera has");
  cv::Mat image;
  try {
    image = cv::imdecode(cv::Mat(1, static_cast<int>(size), CV_8UC1, const_cast<std::uint8_t*>(data)),
                         cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception& e) {
    throw std::invalid_argument(std::string("compressed image: ") + e.what());
  }
  if (image.empty()) throw std::invalid_argument("compressed image: it cannot be decoded");
  return image;
}

sensor_msgs::Image::Ptr depthImage(const sensor_msgs::CompressedImage& msg) {
  DepthHeader header;
  if (msg.data.size() <= sizeof header) throw std::invalid_argument("compressed depth: it has no data");
  std::memcpy(&header, msg.data.data(), sizeof header);
  const std::uint8_t* data = msg.data.data() + sizeof header;
  const std::size_t size = msg.data.size() - sizeof header;
  const bool rvl = msg.format.find("compressedDepth rvl") != std::string::npos;
  const cv::Mat image = rvl ? decodeRvl(data, size) : decoded(data, size);
  if (image.type() != CV_16UC1) throw std::invalid_argument("compressed depth: not an image of 16 bits");
  const bool metres = msg.format.rfind(sensor_msgs::image_encodings::TYPE_32FC1, 0) == 0;
  if (!metres)
    return boost::make_shared<sensor_msgs::Image>(toMsg(image, sensor_msgs::image_encodings::TYPE_16UC1, msg.header));
  cv::Mat depth(image.size(), CV_32FC1);
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) {
      const std::uint16_t value = image.at<std::uint16_t>(v, u);
      const float z = header.quantization[0] / (static_cast<float>(value) - header.quantization[1]);
      depth.at<float>(v, u) = value != 0 && std::isfinite(z) ? z : std::numeric_limits<float>::quiet_NaN();
    }
  return boost::make_shared<sensor_msgs::Image>(toMsg(depth, sensor_msgs::image_encodings::TYPE_32FC1, msg.header));
}

/// A mosaic is compressed as if it were grey; `format` of image_transport begins with what it was. Empty: none of so
/// many bits.
std::string mosaicOf(const std::string& format, int bits) {
  namespace enc = sensor_msgs::image_encodings;
  const std::string encoding = format.substr(0, format.find(';'));
  return enc::isBayer(encoding) && enc::bitDepth(encoding) == bits ? encoding : "";
}

}  // namespace

sensor_msgs::Image::Ptr decompressed(const sensor_msgs::CompressedImage& msg) {
  namespace enc = sensor_msgs::image_encodings;
  if (msg.format.find("compressedDepth") != std::string::npos) return depthImage(msg);
  const cv::Mat image = decoded(msg.data.data(), msg.data.size());
  std::string encoding = image.channels() == 1 ? mosaicOf(msg.format, image.depth() == CV_8U ? 8 : 16) : "";
  if (encoding.empty() && image.type() == CV_8UC1) encoding = enc::MONO8;
  if (encoding.empty() && image.type() == CV_16UC1)
    encoding = msg.format.rfind(enc::MONO16, 0) == 0 ? enc::MONO16 : enc::TYPE_16UC1;
  if (image.type() == CV_8UC3) encoding = enc::BGR8;
  if (image.type() == CV_8UC4) encoding = enc::BGRA8;
  if (encoding.empty()) throw std::invalid_argument("compressed image: its pixels are of no known kind");
  return boost::make_shared<sensor_msgs::Image>(toMsg(image, encoding, msg.header));
}

sensor_msgs::CompressedImage compressed(const cv::Mat& image, int quality, const std_msgs::Header& header) {
  if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_8UC3))
    throw std::invalid_argument("an image to be compressed must be grey or BGR, 8 bit");
  sensor_msgs::CompressedImage msg;
  msg.header = header;
  msg.format = "jpeg";
  cv::imencode(".jpg", image, msg.data, {cv::IMWRITE_JPEG_QUALITY, quality});
  return msg;
}

cv::Mat greyFromMsg(const air_ground::PosedImage& msg) {
  return msg.compressed.data.empty() ? greyFromMsg(msg.image) : greyFromMsg(*decompressed(msg.compressed));
}

}  // namespace air_ground_common::ros_utils
