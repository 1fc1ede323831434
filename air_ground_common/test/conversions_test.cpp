#include "air_ground_common/ros/conversions.h"

#include <gtest/gtest.h>

#include <boost/make_shared.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "air_ground_common/ros/pixel_range.h"
#include "air_ground_common/ros/vertical_message.h"

namespace air_ground_common::ros_utils {
namespace {

TEST(Conversions, PoseRoundTripAndRefusal) {
  const Pose T = yawPose(0.4, {1, 2, 3});
  EXPECT_LT((fromMsg(toMsg(T)).matrix() - T.matrix()).norm(), 1e-12);
  EXPECT_LT((fromMsg(toTransformMsg(T)).matrix() - T.matrix()).norm(), 1e-12);
  geometry_msgs::Pose bad = toMsg(T);
  bad.orientation.w = bad.orientation.z = 0;
  EXPECT_THROW(fromMsg(bad), std::invalid_argument);
  bad = toMsg(T);
  bad.position.x = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(fromMsg(bad), std::invalid_argument);
}

TEST(Conversions, CameraInfoWithoutCalibrationIsRefused) {
  sensor_msgs::CameraInfo info;
  info.width = 640;
  info.height = 480;
  info.distortion_model = "plumb_bob";
  EXPECT_THROW(fromMsg(info), std::invalid_argument);
  CameraModel camera;
  camera.width = 640;
  camera.height = 480;
  camera.fx = 500;
  camera.fy = 501;
  camera.cx = 320;
  camera.cy = 240;
  camera.p2 = 0.01;
  info = toMsg(camera, std_msgs::Header());
  EXPECT_EQ(fromMsg(info).p2, 0.01);
  EXPECT_EQ(fromMsg(info).fy, 501);
  info.width = 0;
  EXPECT_THROW(fromMsg(info), std::invalid_argument);
}

sensor_msgs::CameraInfo cameraInfo(const std::string& model, const std::vector<double>& D) {
  sensor_msgs::CameraInfo info;
  info.width = 1280;
  info.height = 960;
  info.K = {600, 0, 639.5, 0, 610, 479.5, 0, 0, 1};
  info.distortion_model = model;
  info.D = D;
  return info;
}

// As image_proc leaves it: one camera_info for image_raw and image_rect.
TEST(Conversions, RectifiedImagesAreDescribedByP) {
  auto info = cameraInfo("plumb_bob", {-0.2, 0.05, 0.001, 0.002, 0.003});
  info.P = {500, 0, 630, 0, 0, 505, 470, 0, 0, 0, 1, 0};
  for (const std::string topic :
       {"/camera/rgb/image_rect_color", "/left/image_rect", "/k/qhd/image_color_rect", "/a/rectified/image"}) {
    const CameraModel c = fromMsg(infoOfImages(info, topic));
    EXPECT_EQ(c.fx, 500) << topic;
    EXPECT_EQ(c.cy, 470) << topic;
    EXPECT_FALSE(c.hasDistortion()) << topic;
  }
  for (const std::string topic : {"/camera/rgb/image_raw", "/direct/image", "/corrected_image"}) {
    EXPECT_EQ(fromMsg(infoOfImages(info, topic)).fx, 600) << topic;
    EXPECT_TRUE(fromMsg(infoOfImages(info, topic)).hasDistortion()) << topic;
  }
  auto undistorted = cameraInfo("plumb_bob", {0, 0, 0, 0, 0});
  EXPECT_EQ(fromMsg(infoOfImages(undistorted, "/image_rect_raw")).fx, 600);
  undistorted.P = info.P;
  undistorted.K.assign(0);
  EXPECT_EQ(fromMsg(infoOfImages(undistorted, "/image_raw")).fx, 500);
  info.K.assign(0);
  EXPECT_THROW(fromMsg(infoOfImages(info, "/image_raw")), std::invalid_argument);
}

TEST(Conversions, CameraInfoOfEveryModelSurvivesTheRoundTrip) {
  const std::vector<std::pair<std::string, std::vector<double>>> models = {
      {"plumb_bob", {-0.2, 0.05, 0.001, 0.002, 0.003}},
      {"rational_polynomial", {0.4, -0.1, 1e-4, 2e-4, 0.01, 0.7, 0.02, 0.003}},
      {"equidistant", {0.01, -0.02, 0.003, -0.001}}};
  for (const auto& [name, D] : models) {
    const auto info = toMsg(fromMsg(cameraInfo(name, D)), std_msgs::Header());
    EXPECT_EQ(info.distortion_model, name);
    EXPECT_EQ(info.D, D);
  }
}

TEST(Conversions, BinningAndRegionOfInterestAreAppliedToTheSensorsCalibration) {
  auto info = cameraInfo("equidistant", {0.01, -0.02, 0.003, -0.001});
  const CameraModel sensor = fromMsg(info);
  info.binning_x = 2;
  info.binning_y = 3;
  info.roi.x_offset = 101;
  info.roi.y_offset = 60;
  info.roi.width = 800;
  info.roi.height = 600;
  const CameraModel c = fromMsg(info);
  EXPECT_EQ(c.width, 400);
  EXPECT_EQ(c.height, 200);
  EXPECT_DOUBLE_EQ(c.fx, 300);
  EXPECT_DOUBLE_EQ(c.fy, 610 / 3.);
  // The image's first pixel is the mean of the sensor's columns 101 and 102, rows 60 to 62: its centre is (101.5, 61).
  // The principal point lies 639.5 - 101.5 = 538 and 479.5 - 61 = 418.5 sensor pixels from there.
  EXPECT_DOUBLE_EQ(c.cx, 269);
  EXPECT_DOUBLE_EQ(c.cy, 139.5);
  EXPECT_LT((c.ray({0, 0}) - sensor.ray({101.5, 61})).norm(), 1e-12);
  // Binning 0 and 1 are the same, and a region of size 0 is the whole sensor.
  info.roi = sensor_msgs::RegionOfInterest();
  info.binning_x = info.binning_y = 1;
  EXPECT_EQ(fromMsg(info).K(), sensor.K());
  EXPECT_EQ(fromMsg(info).width, 1280);
  info.roi.x_offset = 1000;
  info.roi.width = info.roi.height = 300;
  EXPECT_THROW(fromMsg(info), std::invalid_argument);
  info.roi.x_offset = 0;
  info.binning_x = 301;  // no pixel would be left
  EXPECT_THROW(fromMsg(info), std::invalid_argument);
}

TEST(Conversions, CamerasLargerThanAnyAreRefused) {
  auto info = cameraInfo("plumb_bob", {});
  info.width = info.height = 40000;
  EXPECT_THROW(fromMsg(info), std::invalid_argument);
  info.binning_x = info.binning_y = 8;
  EXPECT_EQ(fromMsg(info).width, 5000);
}

TEST(Conversions, UnknownModelsAreRefusedByNameWithTheKnownOnes) {
  try {
    fromMsg(cameraInfo("mei_unified", {0.1}));
    FAIL() << "an unknown model was accepted";
  } catch (const std::invalid_argument& e) {
    for (const char* word : {"mei_unified", "plumb_bob", "rational_polynomial", "equidistant"})
      EXPECT_NE(std::string(e.what()).find(word), std::string::npos) << e.what();
  }
}

TEST(Conversions, BigEndianPixelsOf16BitsAreRead) {
  const cv::Mat pixels = (cv::Mat_<std::uint16_t>(2, 3) << 1, 2, 3, 4, 5, 1500);
  sensor_msgs::Image msg = toMsg(pixels, "16UC1", std_msgs::Header());
  for (std::size_t i = 1; i < msg.data.size(); i += 2) std::swap(msg.data[i - 1], msg.data[i]);
  msg.is_bigendian = 1;
  EXPECT_FLOAT_EQ(depthFromMsg(msg).at<float>(1, 2), 1.5f);
  msg.encoding = "32FC1";
  msg.width = 1;
  EXPECT_THROW(depthFromMsg(msg), std::invalid_argument);
}

TEST(Conversions, PixelsAsCamerasSendThemBecomeGrey) {
  const std::uint16_t high = 200 * 257;
  const std::vector<std::pair<std::string, cv::Mat>> images = {
      {"yuv422", cv::Mat(4, 6, CV_8UC2, cv::Scalar(128, 200))},       // U Y V Y
      {"yuv422_yuy2", cv::Mat(4, 6, CV_8UC2, cv::Scalar(200, 128))},  // Y U Y V
      {"16UC1", cv::Mat(4, 6, CV_16UC1, cv::Scalar(high))},
      {"bayer_rggb8", cv::Mat(4, 6, CV_8UC1, cv::Scalar(200))},
      {"bayer_grbg16", cv::Mat(4, 6, CV_16UC1, cv::Scalar(high))},
      {"mono16", cv::Mat(4, 6, CV_16UC1, cv::Scalar(high))},
      {"rgba8", cv::Mat(4, 6, CV_8UC4, cv::Scalar(200, 200, 200, 255))},
      {"8UC1", cv::Mat(4, 6, CV_8UC1, cv::Scalar(200))},
      {"8UC3", cv::Mat(4, 6, CV_8UC3, cv::Scalar(200, 200, 200))}};
  for (const auto& [encoding, pixels] : images) {
    const cv::Mat grey = greyFromMsg(toMsg(pixels, encoding, std_msgs::Header()));
    ASSERT_EQ(grey.size(), pixels.size()) << encoding;
    EXPECT_NEAR(grey.at<std::uint8_t>(2, 3), 200, 16) << encoding;  // video range of yuv422: 16 to 235
  }
}

TEST(Conversions, ACameraOfTwelveBitsIsAsBrightAsOneOfEight) {
  PixelRange range;
  const auto grey = [&](int brightest, int centre, const std::string& encoding = "mono16", bool big_endian = false) {
    cv::Mat pixels(4, 6, CV_16UC1, cv::Scalar(centre));
    pixels.at<std::uint16_t>(0, 0) = static_cast<std::uint16_t>(brightest);
    sensor_msgs::Image msg = toMsg(pixels, encoding, std_msgs::Header());
    msg.is_bigendian = big_endian;
    if (big_endian)
      for (std::size_t i = 1; i < msg.data.size(); i += 2) std::swap(msg.data[i - 1], msg.data[i]);
    const cv::Mat image = greyFromMsg(*range.full(boost::make_shared<sensor_msgs::Image>(msg)));
    return static_cast<int>(image.at<std::uint8_t>(2, 3));
  };
  EXPECT_NEAR(grey(4000, 2048), 128, 1);
  EXPECT_NEAR(grey(900, 512), 32, 1) << "a darker image of the same camera stays darker";
  EXPECT_NEAR(grey(4000, 2048, "mono16", true), 128, 1);
  EXPECT_NEAR(grey(4000, 2048, "bayer_rggb16"), 128, 1);
  EXPECT_NEAR(grey(16000, 8192), 128, 1) << "14 bits after all";
  EXPECT_NEAR(grey(60000, 200 * 257), 200, 1);
  EXPECT_NEAR(grey(4000, 200 * 16), 12, 1) << "16 bits: as it stands";
  const sensor_msgs::Image eight = toMsg(cv::Mat(4, 6, CV_8UC1, cv::Scalar(3)), "mono8", std_msgs::Header());
  EXPECT_EQ(greyFromMsg(*PixelRange().full(boost::make_shared<sensor_msgs::Image>(eight))).at<std::uint8_t>(2, 3), 3);
}

/// A picture of 96 x 64 pixels whose counts lie evenly between two.
cv::Mat countsBetween(int low, int high) {
  cv::Mat pixels(64, 96, CV_16UC1);
  for (int i = 0; i < 64 * 96; ++i)
    pixels.at<std::uint16_t>(i / 96, i % 96) =
        static_cast<std::uint16_t>(low + (i * 7919 % 6144) * (high - low) / 6143);
  return pixels;
}

cv::Mat greyThrough(PixelRange* range, const cv::Mat& pixels) {
  return greyFromMsg(*range->full(boost::make_shared<sensor_msgs::Image>(toMsg(pixels, "mono16", std_msgs::Header()))));
}

double contrastOf(const cv::Mat& grey) {
  cv::Scalar mean, deviation;
  cv::meanStdDev(grey, mean, deviation);
  return deviation[0];
}

TEST(Conversions, AThermalCameraShowsWhatItSees) {
  PixelRange range;
  const cv::Mat first = greyThrough(&range, countsBetween(7400, 7900));
  EXPECT_GT(contrastOf(first), 50) << "1.3 when moved up by two bits";
  // Drivers fill up rows, with zeros.
  auto padded = boost::make_shared<sensor_msgs::Image>(toMsg(countsBetween(7400, 7900), "mono16", std_msgs::Header()));
  std::vector<std::uint8_t> rows;
  for (std::size_t row = 0; row < padded->height; ++row) {
    rows.insert(rows.end(), &padded->data[row * padded->step], &padded->data[row * padded->step] + padded->step);
    rows.resize(rows.size() + 16, 0);
  }
  padded->data = rows;
  padded->step += 16;
  EXPECT_EQ(cv::norm(greyFromMsg(*PixelRange().full(padded)), first, cv::NORM_INF), 0);
  // It warms up, and by and by sees more: no leap from image to image, and what it sees stays in the window.
  cv::Mat pattern = countsBetween(0, 500);
  double before = cv::mean(first)[0];
  for (int i = 0; i < 150; ++i) {
    cv::Mat pixels;
    pattern.convertTo(pixels, CV_16U, 1 + 0.01 * i, 7400 + 4 * i);
    const cv::Mat grey = greyThrough(&range, pixels);
    EXPECT_NEAR(cv::mean(grey)[0], before, 12) << i;
    EXPECT_GT(contrastOf(grey), 40) << i;
    before = cv::mean(grey)[0];
  }
  // A window that would miss what there is goes there at once.
  EXPECT_GT(contrastOf(greyThrough(&range, countsBetween(11000, 11500))), 50);
}

TEST(Conversions, ContrastChangesSlowly) {
  PixelRange range;
  cv::Mat grey = greyThrough(&range, countsBetween(100, 3900));
  EXPECT_EQ(grey.at<std::uint8_t>(0, 0), 100 >> 4) << "as the shift by four bits has it";
  double contrast = contrastOf(greyThrough(&range, countsBetween(1000, 1400)));
  EXPECT_LT(contrast, 10);
  for (int i = 0; i < 100; ++i) {
    const double now = contrastOf(greyThrough(&range, countsBetween(1000, 1400)));
    EXPECT_LT(now, 1.06 * contrast + 0.5) << i;
    contrast = now;
  }
  EXPECT_GT(contrast, 50);
  // An even grey tells nothing; the whole range, when it is there again, does at once.
  EXPECT_NEAR(greyThrough(&range, cv::Mat(64, 96, CV_16UC1, cv::Scalar(1200))).at<std::uint8_t>(9, 9), 128, 3);
  for (int i = 0; i < 2; ++i) grey = greyThrough(&range, countsBetween(100, 3900));
  EXPECT_EQ(grey.at<std::uint8_t>(0, 0), 100 >> 4);
}

TEST(Conversions, AHotPixelDoesNotDarkenACamera) {
  PixelRange range, other;
  cv::Mat pixels = countsBetween(0, 4095);
  const cv::Mat without = greyThrough(&other, pixels).clone();
  pixels.at<std::uint16_t>(30, 40) = 65535;
  for (int i = 0; i < 3; ++i) {
    const cv::Mat grey = greyThrough(&range, pixels);
    EXPECT_EQ(grey.at<std::uint8_t>(30, 40), 255) << "the hot one itself is white";
    EXPECT_LE(cv::countNonZero(grey != without), 1);
  }
}

TEST(Conversions, ImagesWhoseSizeIsALieAreRefused) {
  sensor_msgs::Image msg;
  msg.encoding = "mono8";
  msg.width = msg.height = msg.step = 65536;  // 2^32 bytes: none, in 32 bits
  EXPECT_THROW(greyFromMsg(msg), std::invalid_argument);
  msg.width = msg.height = msg.step = 4;
  msg.data.resize(16);
  EXPECT_EQ(greyFromMsg(msg).size(), cv::Size(4, 4));
  msg.encoding = "8UC" + std::string(1000000, '1');
  EXPECT_THROW(greyFromMsg(msg), std::invalid_argument);
}

TEST(Conversions, DepthInMillimetresBecomesMetresAndZeroBecomesNaN) {
  cv::Mat mm = (cv::Mat_<std::uint16_t>(1, 3) << 0, 1500, 65535);
  const cv::Mat depth = depthFromMsg(toMsg(mm, "16UC1", std_msgs::Header()));
  EXPECT_FLOAT_EQ(depthFromMsg(toMsg(mm, "16UC1", std_msgs::Header()), 2e-4).at<float>(0, 1), 0.3f);
  EXPECT_TRUE(std::isnan(depth.at<float>(0, 0)));
  EXPECT_FLOAT_EQ(depth.at<float>(0, 1), 1.5f);
  EXPECT_TRUE(std::isnan(depth.at<float>(0, 2)));
  cv::Mat m = (cv::Mat_<float>(1, 3) << -1.f, 2.5f, std::numeric_limits<float>::infinity());
  const cv::Mat metric = depthFromMsg(toMsg(m, "32FC1", std_msgs::Header()));
  EXPECT_TRUE(std::isnan(metric.at<float>(0, 0)));
  EXPECT_FLOAT_EQ(metric.at<float>(0, 1), 2.5f);
  EXPECT_TRUE(std::isnan(metric.at<float>(0, 2)));
  EXPECT_THROW(depthFromMsg(toMsg(cv::Mat(1, 1, CV_8U), "mono8", std_msgs::Header())), std::invalid_argument);
}

TEST(Conversions, CloudRoundTripKeepsColourAndDropsWhatIsNowhere) {
  std::vector<CloudPoint> points(3);
  points[0].position = {1, 2, 3};
  points[0].rgb << 200, 100, 50;
  points[0].source = 1;
  points[1].position.x() = std::numeric_limits<float>::quiet_NaN();
  points[2].position.z() = -2e6f;
  std::size_t dropped = 0;
  auto read = cloudFromMsg(toMsg(points, CloudFields::kXyzRgbSource, std_msgs::Header()), &dropped);
  ASSERT_EQ(read.size(), 1u);
  EXPECT_EQ(dropped, 2u);
  EXPECT_EQ(read[0].rgb, points[0].rgb);
  EXPECT_EQ(read[0].source, 1);
  points[0].rgb.setConstant(77);
  read = cloudFromMsg(toMsg(points, CloudFields::kXyzIntensity, std_msgs::Header()));
  EXPECT_EQ(read[0].rgb[1], 77);
  EXPECT_TRUE(std::isnan(read[0].hidden_from));
  points[0].hidden_from = 0.7f;
  read = cloudFromMsg(toMsg(points, CloudFields::kXyzRgbHidden, std_msgs::Header()));
  EXPECT_EQ(read[0].hidden_from, 0.7f);
  EXPECT_EQ(read[0].rgb[1], 77);
  EXPECT_TRUE(cloudFromMsg(toMsg({}, CloudFields::kXyz, std_msgs::Header())).empty());
  sensor_msgs::PointCloud2 broken = toMsg(points, CloudFields::kXyz, std_msgs::Header());
  broken.data.resize(3);
  EXPECT_THROW(cloudFromMsg(broken), std::invalid_argument);
  EXPECT_THROW(cloudFromMsg(sensor_msgs::PointCloud2()), std::invalid_argument);

  // Fields that would be read beyond a point.
  broken = toMsg(points, CloudFields::kXyz, std_msgs::Header());
  broken.fields[2].offset = broken.point_step - 2;
  EXPECT_THROW(cloudFromMsg(broken), std::invalid_argument);
  broken = toMsg(points, CloudFields::kXyz, std_msgs::Header());
  broken.point_step = 0;
  EXPECT_THROW(cloudFromMsg(broken), std::invalid_argument);
  broken = toMsg(points, CloudFields::kXyz, std_msgs::Header());
  broken.fields.push_back(broken.fields[0]);
  broken.fields.back().name = "rgb";
  broken.fields.back().offset = broken.point_step;
  EXPECT_EQ(cloudFromMsg(broken).size(), 1u) << "a colour outside is left out";
  broken.is_bigendian = true;
  EXPECT_THROW(cloudFromMsg(broken), std::invalid_argument);
}

TEST(Conversions, AVerticalIsKnownOnlyWhereItIsStatedAndADirection) {
  air_ground::VoStatus status;
  EXPECT_EQ(verticalFromMsg(status).stddev, 0) << "not stated";
  const Eigen::Vector3d up = Eigen::Vector3d(0.2, -0.9, 0.3).normalized();
  setVertical({up, 0.03}, &status);
  EXPECT_EQ(verticalFromMsg(status).stddev, 0.03);
  EXPECT_TRUE(verticalFromMsg(status).up.isApprox(up));
  status.up = {};
  EXPECT_EQ(verticalFromMsg(status).up, Eigen::Vector3d::UnitZ()) << "as far as the map is level";
  EXPECT_EQ(verticalFromMsg(status).stddev, 0.03);
  status.up.x = 1e-3;
  EXPECT_EQ(verticalFromMsg(status).stddev, 0) << "no direction";
  status.up.x = std::nan("");
  EXPECT_EQ(verticalFromMsg(status).stddev, 0);
  setVertical({up, std::numeric_limits<double>::infinity()}, &status);
  EXPECT_EQ(verticalFromMsg(status).stddev, 0);
}

}  // namespace
}  // namespace air_ground_common::ros_utils
