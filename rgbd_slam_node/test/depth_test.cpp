// Depth sampling, the ground cloud, and pairing of images.
#include <gtest/gtest.h>

#include "rgbd_slam/depth_model.h"
#include "rgbd_slam/ground_cloud.h"
#include "synthetic.h"

namespace rgbd_slam {
namespace {

namespace synthetic = visual_frontend::synthetic;
using air_ground_common::Pose;

TEST(SampleDepth, MedianOfTheKnownAndNothingAtEdges) {
  const DepthModel model;
  cv::Mat depth(20, 20, CV_32F, cv::Scalar(2.0f));
  depth.at<float>(5, 5) = NAN;
  depth.at<float>(5, 6) = 2.01f;
  ASSERT_TRUE(sampleDepth(depth, {5.2, 4.9}, model));
  EXPECT_NEAR(*sampleDepth(depth, {5.2, 4.9}, model), 2.0, 1e-6);
  depth.colRange(10, 20) = 2.4f;
  EXPECT_FALSE(sampleDepth(depth, {10, 8}, model));
  EXPECT_TRUE(sampleDepth(depth, {13, 8}, model));
  depth.setTo(NAN);
  EXPECT_FALSE(sampleDepth(depth, {10, 8}, model));
  depth.setTo(9.0f);
  EXPECT_FALSE(sampleDepth(depth, {10, 8}, model));  // out of range
  EXPECT_FALSE(sampleDepth(depth, {0, 8}, model));   // at the border
  DepthModel bad;
  bad.max_range = 0.1;
  EXPECT_THROW(bad.validate(), std::invalid_argument);
}

struct FloorView {
  cv::Mat gray, depth;
};
FloorView floorView(const air_ground_common::CameraModel& camera, const Pose& T, double noise, unsigned seed) {
  static const cv::Mat texture = synthetic::texture(800, 2);
  FloorView v;
  v.gray = synthetic::renderPlane(camera, T, texture, 8, &v.depth);
  synthetic::Random random(seed);
  const DepthModel model;
  for (int i = 0; i < v.depth.rows; ++i) {
    for (int k = 0; k < v.depth.cols; ++k) {
      float& z = v.depth.at<float>(i, k);
      z = z > 0 ? z + static_cast<float>(random.gauss(noise * model.sigma(z))) : NAN;
    }
  }
  return v;
}

TEST(KeyframeDepth, FusedFramesLowerTheNoise) {
  const auto camera = synthetic::camera(false);
  const DepthModel model;
  CloudSettings settings;
  const Pose T_key = synthetic::above(0, 0, 2, 0, 0.5);
  const auto rms = [&](int frames) {
    const FloorView key = floorView(camera, T_key, 1, 1);
    KeyframeDepth depth(camera, key.depth, key.gray, model, settings);
    for (int i = 1; i <= frames; ++i) {
      const Pose T = synthetic::above(0.03 * i, 0.01 * i, 2, 0.02 * i, 0.5);
      depth.fuse(camera, floorView(camera, T, 1, 1 + i).depth, T.inverse() * T_key, model, settings);
    }
    double sum = 0;
    const auto points = depth.points(model, settings);
    EXPECT_GT(points.size(), 5000u);
    for (const auto& p : points) {
      const double height = (T_key * p.position.cast<double>()).z();
      sum += height * height;
    }
    return std::sqrt(sum / points.size());
  };
  EXPECT_LT(rms(8), 0.5 * rms(0));
}

TEST(KeyframeDepth, DropsEdgesAndWhatOthersSeeThrough) {
  const auto camera = synthetic::camera(false);
  const DepthModel model;
  const CloudSettings settings;
  cv::Mat depth(480, 640, CV_32F, cv::Scalar(2.0f)), gray(480, 640, CV_8UC1, cv::Scalar(77));
  depth(cv::Rect(200, 150, 100, 100)) = 1.4f;
  KeyframeDepth key(camera, depth, gray, model, settings);
  for (const auto& p : key.points(model, settings)) {
    const double u = camera.fx * p.position.x() / p.position.z() + camera.cx;
    EXPECT_TRUE(std::abs(u - 199.5) > 1.4 || p.position.y() * camera.fy / p.position.z() + camera.cy < 146 ||
                p.position.y() * camera.fy / p.position.z() + camera.cy > 254);
    EXPECT_EQ(p.bgr[0], 77);
  }
  // The box was a passing person: the frames after it see the wall behind.
  const cv::Mat wall(480, 640, CV_32F, cv::Scalar(2.0f));
  for (int i = 0; i < 3; ++i) key.fuse(camera, wall, Pose::Identity(), model, settings);
  for (const auto& p : key.points(model, settings)) EXPECT_GT(p.position.z(), 1.9);
}

TEST(FusePoints, OnePointAVoxelWeightedByPrecision) {
  auto points = std::make_shared<std::vector<KeyframeDepth::Point>>();
  KeyframeDepth::Point p;
  p.bgr[0] = p.bgr[1] = p.bgr[2] = 10;
  p.weight = 9;
  p.position = {0.001f, 0.001f, 1.001f};
  points->push_back(p);
  p.weight = 1;
  p.position.x() = 0.011f;
  p.bgr[0] = 110;
  points->push_back(p);
  CloudSettings settings;
  settings.voxel = 0.02;
  const auto cloud = fusePoints({{Pose::Identity(), points}}, settings);
  ASSERT_EQ(cloud.size(), 1u);
  EXPECT_NEAR(cloud[0].position.x(), 0.002, 1e-6);
  EXPECT_EQ(cloud[0].bgr[0], 20);
  // Moved as a whole by the keyframe's pose.
  const auto moved = fusePoints({{air_ground_common::yawPose(M_PI / 2, {1, 0, 0}), points}}, settings);
  ASSERT_EQ(moved.size(), 1u);
  EXPECT_NEAR(moved[0].position.y(), 0.002, 1e-5);
  EXPECT_TRUE(fusePoints({}, settings).empty());
}

}  // namespace
}  // namespace rgbd_slam
