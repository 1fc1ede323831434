#include "air_ground_common/ros/compressed_image.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <vector>

#include "air_ground_common/encoded_image.h"
#include "air_ground_common/ros/conversions.h"

namespace air_ground_common::ros_utils {
namespace {

sensor_msgs::CompressedImage compressed(const std::string& format, const std::string& extension, const cv::Mat& image,
                                        std::size_t offset = 0) {
  sensor_msgs::CompressedImage msg;
  msg.header.frame_id = "camera";
  msg.header.stamp = ros::Time(3.5);
  msg.format = format;
  std::vector<unsigned char> bytes;
  cv::imencode(extension, image, bytes);
  msg.data.assign(offset, 0);
  msg.data.insert(msg.data.end(), bytes.begin(), bytes.end());
  return msg;
}

TEST(Decompressed, ImagesOfAnyKind) {
  cv::Mat colour(40, 60, CV_8UC3, cv::Scalar(10, 90, 200));
  auto image = decompressed(compressed("rgb8; jpeg compressed bgr8", ".jpg", colour));
  EXPECT_EQ(image->encoding, "bgr8");
  EXPECT_EQ(image->header.frame_id, "camera");
  EXPECT_EQ(image->header.stamp, ros::Time(3.5));
  const cv::Vec3b pixel = bgrFromMsg(*image).at<cv::Vec3b>(20, 30);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(pixel[c], colour.at<cv::Vec3b>(20, 30)[c], 4);
  const cv::Mat grey(40, 60, CV_8UC1, cv::Scalar(77));
  image = decompressed(compressed("mono8; png compressed mono8", ".png", grey));
  EXPECT_EQ(greyFromMsg(*image).at<std::uint8_t>(5, 5), 77);
  sensor_msgs::CompressedImage broken = compressed("jpeg", ".jpg", colour);
  broken.data.resize(30);
  EXPECT_THROW(decompressed(broken), std::invalid_argument);
  broken.data.clear();
  EXPECT_THROW(decompressed(broken), std::invalid_argument);
}

TEST(Decompressed, AMosaicIsNoGreyImage) {
  for (const int type : {CV_8UC1, CV_16UC1}) {
    const int step = type == CV_8UC1 ? 1 : 257;
    cv::Mat mosaic(40, 60, type, cv::Scalar(40 * step));  // RGGB of an evenly red wall
    for (int v = 0; v < 40; v += 2)
      for (int u = 0; u < 60; u += 2) mosaic(cv::Rect(u, v, 1, 1)) = cv::Scalar(200 * step);
    const std::string encoding = step == 1 ? "bayer_rggb8" : "bayer_rggb16";
    const auto image = decompressed(compressed(encoding + "; png compressed ", ".png", mosaic));
    EXPECT_EQ(image->encoding, encoding);
    cv::Mat grey = greyFromMsg(*image)(cv::Rect(10, 10, 20, 20)).clone();
    double least, most;
    cv::minMaxLoc(grey, &least, &most);
    EXPECT_LT(most - least, 2) << encoding << ": no chequerboard";
    EXPECT_NEAR(least, 0.299 * 200 + 0.701 * 40, 2) << encoding;
  }
  const cv::Mat grey(40, 60, CV_8UC1, cv::Scalar(77)), colour(40, 60, CV_8UC3, cv::Scalar(10, 90, 200));
  EXPECT_EQ(decompressed(compressed("bayer_grbg8; jpeg compressed ", ".jpg", grey))->encoding, "bayer_grbg8");
  EXPECT_EQ(decompressed(compressed("bayer_grbg16; jpeg compressed mono8", ".jpg", grey))->encoding, "mono8");
  EXPECT_EQ(decompressed(compressed("bayer_grbg8; jpeg compressed bgr8", ".jpg", colour))->encoding, "bgr8");
}

TEST(Compressed, PosedImageWhicheverWayItCame) {
  cv::Mat grey(48, 64, CV_8UC1);
  for (int v = 0; v < grey.rows; ++v)
    for (int u = 0; u < grey.cols; ++u) grey.at<std::uint8_t>(v, u) = static_cast<std::uint8_t>(2 * u + v);
  air_ground::PosedImage raw, jpeg;
  raw.image = toMsg(grey, "mono8", std_msgs::Header());
  jpeg.compressed = ros_utils::compressed(grey, 90, std_msgs::Header());
  EXPECT_LT(jpeg.compressed.data.size(), raw.image.data.size() / 2);
  EXPECT_EQ(cv::norm(greyFromMsg(raw), grey, cv::NORM_INF), 0);
  EXPECT_LT(cv::norm(greyFromMsg(jpeg), grey, cv::NORM_INF), 8);
  jpeg.compressed.data.resize(20);
  EXPECT_THROW(greyFromMsg(jpeg), std::invalid_argument);
  EXPECT_THROW(greyFromMsg(air_ground::PosedImage()), std::invalid_argument);
  EXPECT_THROW(ros_utils::compressed(cv::Mat(4, 4, CV_32F), 90, std_msgs::Header()), std::invalid_argument);
}

TEST(Decompressed, Depth) {
  const cv::Mat millimetres(40, 60, CV_16UC1, cv::Scalar(1234));
  for (const std::size_t header : {0, 12}) {
    const auto msg =
        compressed(header ? "16UC1; compressedDepth png" : "16UC1; png compressed ", ".png", millimetres, header);
    EXPECT_NEAR(depthFromMsg(*decompressed(msg)).at<float>(3, 4), 1.234, 1e-6);
  }
  // Inverse depth, as compressed_depth_image_transport quantises it: value = a / z + b.
  const float a = 10000, b = -99;
  auto msg = compressed("32FC1; compressedDepth png", ".png",
                        cv::Mat(40, 60, CV_16UC1, cv::Scalar(std::lround(a / 2.5 + b))), 12);
  std::memcpy(msg.data.data() + 4, &a, 4);
  std::memcpy(msg.data.data() + 8, &b, 4);
  EXPECT_NEAR(depthFromMsg(*decompressed(msg)).at<float>(3, 4), 2.5, 1e-3);
  msg.data.resize(10);
  EXPECT_THROW(decompressed(msg), std::invalid_argument);
}

/// As Wilson's paper describes it: runs of zeros and of differences, in groups of three bits.
std::vector<std::uint8_t> rvlOf(const cv::Mat& depth) {
  std::vector<std::uint32_t> nibbles;
  const auto put = [&nibbles](std::uint32_t value) {
    for (; value > 7; value >>= 3) nibbles.push_back((value & 7) | 8);
    nibbles.push_back(value);
  };
  const auto* pixel = depth.ptr<std::uint16_t>();
  const auto* const end = pixel + depth.total();
  int before = 0;
  while (pixel != end) {
    const auto run = [&](bool of_zeros) {
      std::uint32_t n = 0;
      while (pixel + n != end && (pixel[n] == 0) == of_zeros) ++n;
      return n;
    };
    const std::uint32_t zeros = run(true);
    put(zeros);
    pixel += zeros;
    const std::uint32_t others = run(false);
    put(others);
    for (std::uint32_t i = 0; i < others; ++i, ++pixel) {
      const int difference = *pixel - before;
      put(static_cast<std::uint32_t>(difference < 0 ? -2 * difference - 1 : 2 * difference));
      before = *pixel;
    }
  }
  while (nibbles.size() % 8 != 0) nibbles.push_back(0);
  std::vector<std::uint32_t> words{static_cast<std::uint32_t>(depth.cols), static_cast<std::uint32_t>(depth.rows)};
  for (std::size_t i = 0; i < nibbles.size(); i += 8) {
    words.push_back(0);
    for (std::size_t k = 0; k < 8; ++k) words.back() = words.back() << 4 | nibbles[i + k];
  }
  std::vector<std::uint8_t> bytes(4 * words.size());
  std::memcpy(bytes.data(), words.data(), bytes.size());
  return bytes;
}

TEST(Decompressed, DepthByRunLengths) {
  cv::Mat millimetres(37, 53, CV_16UC1);
  cv::RNG random(7);
  random.fill(millimetres, cv::RNG::UNIFORM, 0, 65536);
  millimetres.rowRange(5, 9) = 0;
  millimetres.rowRange(20, 30) = 1500;
  millimetres.row(36) = 0;
  sensor_msgs::CompressedImage msg;
  msg.format = "16UC1; compressedDepth rvl";
  msg.data.assign(12, 0);
  const std::vector<std::uint8_t> rvl = rvlOf(millimetres);
  msg.data.insert(msg.data.end(), rvl.begin(), rvl.end());
  const auto image = decompressed(msg);
  EXPECT_EQ(image->encoding, "16UC1");
  const cv::Mat read(37, 53, CV_16UC1, image->data.data());
  EXPECT_EQ(cv::norm(read, millimetres, cv::NORM_INF), 0);
  msg.data.resize(msg.data.size() / 2);
  EXPECT_THROW(decompressed(msg), std::invalid_argument);
  msg.data[12 + 3] = 0x7f;  // 2 billion columns
  EXPECT_THROW(decompressed(msg), std::invalid_argument);
}

// The header of a PNG of 65000 x 65000 pixels takes 33 bytes; what it promises 12 GB.
TEST(Conversions, CompressedImagesAreMeasuredBeforeTheyAreDecoded) {
  const cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(10, 100, 200));
  for (const char* extension : {".jpg", ".png"}) {
    sensor_msgs::CompressedImage msg;
    msg.format = extension + 1;
    cv::imencode(extension, picture, msg.data);
    EXPECT_EQ(air_ground_common::encodedSize(msg.data.data(), msg.data.size()), picture.size());
    EXPECT_EQ(decompressed(msg)->width, 64u);
    if (msg.format == "jpg") continue;
    for (const std::size_t at : {16u, 20u}) msg.data[at + 2] = 0xfd, msg.data[at + 3] = 0xe8;
    EXPECT_EQ(air_ground_common::encodedSize(msg.data.data(), msg.data.size()), cv::Size(65000, 65000));
    try {
      decompressed(msg);
      ADD_FAILURE() << "an image of 65000 x 65000 pixels was decoded";
    } catch (const std::invalid_argument& e) {
      EXPECT_NE(std::string(e.what()).find("65000 x 65000"), std::string::npos) << e.what();
    }
  }
}

}  // namespace
}  // namespace air_ground_common::ros_utils
