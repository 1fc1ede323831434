// Depth sampling, the ground cloud, and pairing of images.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <map>

#include "rgbd_slam/depth_model.h"
#include "rgbd_slam/depth_registration.h"
#include "rgbd_slam/ground_cloud.h"
#include "rgbd_slam/rotation_check.h"
#include "synthetic.h"

namespace rgbd_slam {
namespace {

namespace synthetic = visual_frontend::synthetic;
using air_ground_common::CameraModel;
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

TEST(UnitProblem, NamesMillimetresAndMetresTakenForEachOther) {
  cv::Mat depth(60, 80, CV_32F, cv::Scalar(1.5f));
  depth.rowRange(0, 20) = NAN;
  EXPECT_EQ(unitProblem(medianDepth(depth)), "");
  EXPECT_NE(unitProblem(medianDepth(1000 * depth)).find("1500 m"), std::string::npos)
      << unitProblem(medianDepth(1000 * depth));
  EXPECT_NE(unitProblem(medianDepth(0.001 * depth)).find("0.0015 m"), std::string::npos)
      << unitProblem(medianDepth(0.001 * depth));
  depth.setTo(NAN);
  EXPECT_EQ(unitProblem(medianDepth(depth)), "");
}

// Turns about all axes, seen with noise, felt with bias.
TEST(RotationCheck, NamesSwappedAxesAndUnits) {
  synthetic::Random random(5);
  const auto verdict = [&](const Eigen::Matrix3d& axes, bool level) {
    RotationCheck check;
    for (int i = 0; i < 120; ++i) {
      Eigen::Vector3d turn = 0.1 * Eigen::Vector3d(0.2 * std::sin(1.3 * i), 0.3 * std::cos(0.7 * i), 0.5);
      if (level) turn.head<2>().setZero();
      check.add(turn + random.gaussVector(0.004), axes * turn + 0.1 * Eigen::Vector3d(0.1, -0.1, 0.1), 0.1);
    }
    return check.problem();
  };
  Eigen::Matrix3d z_to_x, y_flipped = Eigen::Vector3d(1, -1, -1).asDiagonal();
  z_to_x << 0, 0, 1, 0, 1, 0, -1, 0, 0;
  for (const bool level : {false, true}) {
    EXPECT_EQ(verdict(Eigen::Matrix3d::Identity(), level), "");
    EXPECT_EQ(verdict(0.6 * Eigen::Matrix3d::Identity(), level), "") << "a scale error is no wrong unit";
    EXPECT_NE(verdict(z_to_x, level).find("about +z of the base come from the IMU as turns about +x"),
              std::string::npos)
        << verdict(z_to_x, level);
    EXPECT_NE(verdict(y_flipped, level).find("about +z of the base come from the IMU as turns about -z"),
              std::string::npos)
        << verdict(y_flipped, level);
    EXPECT_NE(verdict(180 / M_PI * Eigen::Matrix3d::Identity(), level).find("unit"), std::string::npos);
  }
}

TEST(RotationCheck, NamesAGyroThatMeasuresNothing) {
  synthetic::Random random(6);
  const auto verdict = [&](double gain, double rate, double noise, const Eigen::Vector3d& bias, double fps) {
    RotationCheck check;
    for (int i = 0; i < 10 * fps; ++i) {
      const Eigen::Vector3d turn = rate / fps * Eigen::Vector3d(0.2 * std::sin(0.3 * i), 0, 1);
      check.add(turn + random.gaussVector(noise), gain * turn + bias / fps, 1 / fps);
    }
    return check.problem();
  };
  const Eigen::Vector3d none(0, 0, 0), large(0, 0, -0.2);  // [rad/s]
  for (const double fps : {10.0, 30.0}) {
    EXPECT_NE(verdict(0, 0.5, 0.002, none, fps).find("the gyro by 0 times"), std::string::npos);
    EXPECT_NE(verdict(1e-3, 0.5, 0.002, none, fps).find("check its unit"), std::string::npos) << "not in mrad/s";
    EXPECT_EQ(verdict(0, 0, 0.002, none, fps), "") << "it stands";
    EXPECT_EQ(verdict(1, 0, 0.002, large, fps), "") << "with a bias";
    for (const double rate : {0.1, 0.25, 0.3, 0.35, 1.0}) EXPECT_EQ(verdict(1, rate, 0.002, large, fps), "") << rate;
  }
}

// A wall 2 m before the depth camera with a plate 1 m before it, seen by a colour camera of twice the focal length,
// 0.1 m to the right: positions and depths by hand.
TEST(DepthRegistration, SeesWhatTheColourCameraSees) {
  air_ground_common::CameraModel depth_camera, colour_camera;
  depth_camera.width = 160, depth_camera.height = 120;
  depth_camera.fx = depth_camera.fy = 100, depth_camera.cx = 79.5, depth_camera.cy = 59.5;
  colour_camera.width = 200, colour_camera.height = 150;
  colour_camera.fx = colour_camera.fy = 200, colour_camera.cx = 99.5, colour_camera.cy = 74.5;
  Pose T_colour_depth = Pose::Identity();
  T_colour_depth.translation() = Eigen::Vector3d(-0.1, 0, 0.05);
  const DepthRegistration registration(depth_camera, colour_camera, T_colour_depth);
  cv::Mat depth(120, 160, CV_32F, cv::Scalar(2.0f));
  depth(cv::Range(50, 70), cv::Range(70, 90)) =
      1.0f;  // |x|, |y| <= 0.1 m: of the colour camera x in [-0.2, 0] at 1.05 m
  depth(cv::Range(0, 60), cv::Range(0, 30)).setTo(NAN);
  const cv::Mat registered = registration(depth);
  ASSERT_EQ(registered.size(), cv::Size(200, 150));
  // The plate's borders: x = 99.5 + 200 * (-0.2 .. 0) / 1.05 = 61.4 .. 99.5, y = 74.5 -+ 19.05.
  EXPECT_FLOAT_EQ(registered.at<float>(74, 64), 1.05f);
  EXPECT_FLOAT_EQ(registered.at<float>(74, 97), 1.05f);
  EXPECT_FLOAT_EQ(registered.at<float>(58, 80), 1.05f);
  EXPECT_FLOAT_EQ(registered.at<float>(91, 80), 1.05f);
  EXPECT_FLOAT_EQ(registered.at<float>(74, 58), 2.05f);
  EXPECT_FLOAT_EQ(registered.at<float>(52, 80), 2.05f);
  // The depth camera did not see the wall behind the plate on this side: x from 99.5 to 99.5 + 200 * 0.1 / 2.05.
  EXPECT_TRUE(std::isnan(registered.at<float>(74, 105)));
  EXPECT_FLOAT_EQ(registered.at<float>(74, 112), 2.05f);
  EXPECT_EQ(cv::countNonZero(registered(cv::Range(60, 90), cv::Range(64, 96)) != 1.05f), 0) << "no holes";
  EXPECT_THROW(registration(depth.rowRange(0, 100)), std::invalid_argument);

  // A distorted depth camera: a point is where its own ray says.
  depth_camera.setDistortion("rational_polynomial", {0.4, 0.1, 0.001, -0.002, 0.02, 0.7, 0.2, 0.05});
  const DepthRegistration distorted(depth_camera, colour_camera, T_colour_depth);
  cv::Mat single(120, 160, CV_32F, cv::Scalar(NAN));
  const Eigen::Vector3d p(0.3, -0.2, 1.5);
  const Eigen::Vector2d at = *depth_camera.project(p), seen = *colour_camera.project(T_colour_depth * p);
  single.at<float>(static_cast<int>(std::lround(at.y())), static_cast<int>(std::lround(at.x()))) = 1.5f;
  const cv::Mat alone = distorted(single);
  cv::Point found;
  cv::minMaxLoc(alone == alone, nullptr, nullptr, nullptr, &found);
  EXPECT_NEAR(found.x, seen.x(), 2.0);
  EXPECT_NEAR(found.y, seen.y(), 2.0);
}

TEST(SeesAlike, TellsCamerasApartByTheirCalibration) {
  const auto camera = [](int width, int height, double f, double cx, double cy) {
    CameraModel c;
    c.width = width;
    c.height = height;
    c.fx = c.fy = f;
    c.cx = cx;
    c.cy = cy;
    return c;
  };
  const CameraModel colour = camera(1280, 720, 912, 640, 362);
  EXPECT_TRUE(seesAlike(colour, colour));
  EXPECT_TRUE(seesAlike(camera(640, 360, 456, 319.75, 180.75), colour));
  // A D435's depth camera: nearly the same proportions, another field of view.
  EXPECT_FALSE(seesAlike(camera(848, 480, 421, 424, 240), colour));
  EXPECT_FALSE(seesAlike(camera(1280, 720, 912, 600, 362), colour));
}

TEST(DepthAtSize, TakesEachPixelFromWhereItIsSeen) {
  cv::Mat half(60, 80, CV_32F);
  for (int v = 0; v < half.rows; ++v)
    for (int u = 0; u < half.cols; ++u) half.at<float>(v, u) = static_cast<float>(1000 * v + u);
  const auto whole = depthAtSize(half, 160, 120);
  ASSERT_TRUE(whole);
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 160; ++u) EXPECT_EQ(whole->at<float>(v, u), static_cast<float>(1000 * (v / 2) + u / 2));
  const auto fewer = depthAtSize(*whole, 80, 60);
  ASSERT_TRUE(fewer);
  EXPECT_EQ(cv::countNonZero(*fewer != half), 0);
  EXPECT_FALSE(depthAtSize(half, 160, 90)) << "cut out, or of another camera";
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

TEST(KeyframeDepth, LargeImagesGiveNoMoreCells) {
  const auto cells = [](int width, int height, int stride) {
    air_ground_common::CameraModel camera;
    camera.width = width;
    camera.height = height;
    camera.fx = camera.fy = 0.8 * width;
    camera.cx = 0.5 * width;
    camera.cy = 0.5 * height;
    CloudSettings settings;
    settings.stride = stride;
    const cv::Mat depth(height, width, CV_32F, cv::Scalar(2)), grey(height, width, CV_8U, cv::Scalar(100));
    return KeyframeDepth(camera, depth, grey, DepthModel(), settings).cells();
  };
  EXPECT_NEAR(cells(640, 480, 3), 632 * 472 / 9.0, 300) << "as told";
  EXPECT_GT(cells(640, 480, 1), 290000u);
  EXPECT_NEAR(cells(3840, 2160, 3), 3840 * 2160 / 36.0, 3000);
}

TEST(KeyframeDepth, RowsLieWhereTheyWereSeenFrom) {
  const auto camera = synthetic::camera(false);
  const DepthModel model;
  const CloudSettings settings;
  const cv::Mat texture = synthetic::texture(400, 2);
  constexpr double kReadout = 0.03;
  const Eigen::Vector3d rate(1.0, -0.7, 0.5), velocity(0.3, -0.2, 0.6);
  const auto moving = [&](const Pose& T, int row) {
    const double t = ((row + 0.5) / camera.height - 0.5) * kReadout;
    Pose T_middle_row = Pose::Identity();
    T_middle_row.linear() = air_ground_common::expSO3(rate * t);
    T_middle_row.translation() = velocity * t;
    return Pose(T * T_middle_row);
  };
  visual_frontend::RollingShutter rows(camera, kReadout);
  rows.setMotion(rate, velocity);
  const Pose T_key = synthetic::above(0, 0, 2, 0, 0.5), T_next = synthetic::above(0.05, 0.02, 2.02, 0.02, 0.52);
  cv::Mat depth, next;
  const auto view = [&](const Pose& T, cv::Mat* z) {
    return synthetic::renderPlaneByRows(
        camera, [&](int row) { return moving(T, row); }, texture, 8, z);
  };
  const cv::Mat gray = view(T_key, &depth);
  view(T_next, &next);
  const auto rms = [&](const visual_frontend::RollingShutter* shutter) {
    KeyframeDepth key(camera, depth, gray, model, settings, shutter);
    for (int i = 0; i < 3; ++i) key.fuse(camera, next, T_next.inverse() * T_key, model, settings, shutter);
    double sum = 0;
    const auto points = key.points(model, settings);
    EXPECT_GT(points.size(), 5000u);
    for (const auto& p : points) sum += std::pow((T_key * p.position.cast<double>()).z(), 2);
    return std::sqrt(sum / points.size());
  };
  EXPECT_GT(rms(nullptr), 0.01);
  EXPECT_LT(rms(&rows), 0.002);
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

/// What fusePoints is to compute, written plainly: the weighted mean of each voxel, less the faint.
std::vector<CloudPoint> plainFusion(const std::vector<PosedPoints>& keyframes, const CloudSettings& settings) {
  struct Sum {
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
    double weight = 0;
  };
  std::map<std::array<int, 3>, Sum> voxels;
  for (const PosedPoints& k : keyframes) {
    for (const auto& point : *k.points) {
      const Eigen::Vector3f p =
          k.T_map_camera.linear().cast<float>() * point.position + k.T_map_camera.translation().cast<float>();
      std::array<int, 3> v;
      for (int i = 0; i < 3; ++i) v[i] = static_cast<int>(std::floor(p[i] * static_cast<float>(1 / settings.voxel)));
      voxels[v].position += point.weight * p.cast<double>();
      voxels[v].weight += point.weight;
    }
  }
  std::vector<CloudPoint> cloud;
  for (const auto& [v, sum] : voxels) {
    double best = 0;
    for (int i = 0; i < 125; ++i) {
      const auto it = voxels.find({v[0] + i % 5 - 2, v[1] + i / 5 % 5 - 2, v[2] + i / 25 - 2});
      if (it != voxels.end()) best = std::max(best, it->second.weight);
    }
    if (sum.weight >= settings.min_weight_share * best)
      cloud.push_back({(sum.position / sum.weight).cast<float>(), {0, 0, 0}, static_cast<float>(sum.weight)});
  }
  return cloud;
}

std::vector<CloudPoint> sorted(std::vector<CloudPoint> cloud) {
  std::sort(cloud.begin(), cloud.end(), [](const CloudPoint& a, const CloudPoint& b) {
    return std::lexicographical_compare(a.position.data(), a.position.data() + 3, b.position.data(),
                                        b.position.data() + 3);
  });
  return cloud;
}

void expectSame(const std::vector<CloudPoint>& a, const std::vector<CloudPoint>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_LT((a[i].position - b[i].position).norm(), 2e-6f) << i;
    ASSERT_NEAR(a[i].weight, b[i].weight, 1e-4 * b[i].weight) << i;
  }
}

/// Keyframes along a floor with a step, near and far, so that faint voxels are dropped.
std::vector<PosedPoints> floorKeyframes(int count, unsigned seed) {
  synthetic::Random random(seed);
  std::vector<PosedPoints> keyframes;
  for (int k = 0; k < count; ++k) {
    auto points = std::make_shared<std::vector<KeyframeDepth::Point>>();
    for (int i = 0; i < 3000; ++i) {
      const double range = random.uniform(0.5, 4), sigma = DepthModel().sigma(i % 10 == 0 ? 4 : 0.5);
      KeyframeDepth::Point p;
      p.position = Eigen::Vector3d(random.uniform(-0.3, 0.3), range, random.gauss(sigma)).cast<float>();
      p.bgr[0] = p.bgr[1] = p.bgr[2] = 50;
      p.weight = static_cast<float>(1 / (sigma * sigma));
      points->push_back(p);
    }
    keyframes.push_back({air_ground_common::yawPose(0.3 * k, {-0.2 * k, 0.1 * k, 0}), points, k});
  }
  return keyframes;
}

TEST(GroundCloud, EqualsThePlainFusion) {
  const CloudSettings settings;
  const auto keyframes = floorKeyframes(6, 1);
  const auto cloud = fusePoints(keyframes, settings), plain = plainFusion(keyframes, settings);
  std::size_t voxels = 0;
  CloudSettings all;
  all.min_weight_share = 0;
  voxels = fusePoints(keyframes, all).size();
  EXPECT_LT(plain.size(), voxels);  // some were too faint
  expectSame(sorted(cloud), sorted(plain));
}

TEST(GroundCloud, FusesOnlyWhatChangedAndEqualsTheBatch) {
  const CloudSettings settings;
  auto keyframes = floorKeyframes(12, 2);
  GroundCloud cloud(settings, 0);
  std::vector<PosedPoints> present(keyframes.begin(), keyframes.begin() + 8);
  EXPECT_EQ(cloud.update(present), 8);
  EXPECT_EQ(cloud.update(present), 0);
  present.assign(keyframes.begin(), keyframes.end());
  EXPECT_EQ(cloud.update(present), 4);
  expectSame(cloud.points(), fusePoints(present, settings));
  // A loop moves three keyframes, one has other points, one is gone; many times, so that remainders would show.
  for (int i = 0; i < 20; ++i) {
    for (int k = 2; k < 5; ++k)
      present[k].T_map_camera = present[k].T_map_camera * air_ground_common::yawPose(0.01, {0.02, 0.01, 0.005});
    EXPECT_EQ(cloud.update(present), 3);
  }
  present[6].points = floorKeyframes(1, 9)[0].points;
  present.erase(present.begin() + 9);
  EXPECT_EQ(cloud.update(present), 1);
  expectSame(cloud.points(), fusePoints(present, settings));
  cloud.clear();
  EXPECT_TRUE(cloud.points().empty());
  present.push_back(present.front());
  EXPECT_THROW(cloud.update(present), std::invalid_argument);
}

TEST(GroundCloud, SmallMovesWait) {
  const CloudSettings settings;
  auto keyframes = floorKeyframes(3, 3);
  GroundCloud cloud(settings);
  cloud.update(keyframes);
  keyframes[1].T_map_camera.translation().x() += 0.1 * settings.voxel;
  EXPECT_EQ(cloud.update(keyframes), 0);
  // Small moves add up: what counts is the distance from where the points were fused.
  keyframes[1].T_map_camera.translation().x() += 0.15 * settings.voxel;
  EXPECT_EQ(cloud.update(keyframes), 1);
  keyframes[2].T_map_camera.linear() *= Eigen::AngleAxisd(0.002, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  EXPECT_EQ(cloud.update(keyframes), 1);  // 8 mm at 4 m
}

}  // namespace
}  // namespace rgbd_slam
