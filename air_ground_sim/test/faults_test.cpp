// Faults of real recordings, each against what its definition says.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <fstream>

#include "air_ground_sim/recording.h"
#include "small_config.h"

namespace air_ground_sim {
namespace {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

TEST(Faults, NoneByDefaultAndRangesAreChecked) {
  EXPECT_FALSE(FaultsConfig().any());
  EXPECT_TRUE(FaultsConfig::all().any());
  FaultsConfig::all().validate();
  const auto refused = [](const auto& set) {
    FaultsConfig f;
    set(&f);
    EXPECT_TRUE(f.any());
    EXPECT_THROW(f.validate(), std::invalid_argument);
  };
  refused([](FaultsConfig* f) { f->time_offset = 0.6; });
  refused([](FaultsConfig* f) { f->readout_time = -0.01; });
  refused([](FaultsConfig* f) { f->gyro_bias = {0.1, 0.2}; });
  refused([](FaultsConfig* f) { f->gyro_bias = {-0.1}; });
  refused([](FaultsConfig* f) { f->accel_bias = {0, 0, 6}; });
  refused([](FaultsConfig* f) { f->vibration = std::nan(""); });
  refused([](FaultsConfig* f) { f->jpeg_quality = 101; });
  refused([](FaultsConfig* f) { f->focal_error = -0.6; });
  refused([](FaultsConfig* f) { f->lost_images = 1; });
  refused([](FaultsConfig* f) { f->radial_error = 2; });
  refused([](FaultsConfig* f) { f->depth_delay = 0.05; });
}

TEST(Faults, AreReadFromTheWorldFile) {
  const std::string path = testing::TempDir() + "/air_ground_faults.yaml";
  std::ofstream(path) << "lane: {points: [[1, 0], [2, 0], [3, 0]]}\n"
                         "imu: {ground_magnetometer: true}\n"
                         "faults: {time_offset: -0.03, readout_time: 0.025, vibration: 2, gyro_bias: 0.1,\n"
                         "         accel_bias: [0.1, -0.2, 0.3], start_in_motion: true, jpeg_quality: 70,\n"
                         "         radial_error: 0.04, focal_error: -0.01, lost_images: 0.1,\n"
                         "         clock_offset: 1.5, depth_delay: 0.015, tf_static: split}\n";
  const SimConfig c = loadSimConfig(path);
  EXPECT_EQ(c.faults.describe(),
            "time_offset: -0.03\nreadout_time: 0.025\nvibration: 2\ngyro_bias: [0.1]\naccel_bias: [0.1, -0.2, 0.3]\n"
            "start_in_motion: true\njpeg_quality: 70\nradial_error: 0.04\nfocal_error: -0.01\n"
            "lost_images: 0.1\nclock_offset: 1.5\ndepth_delay: 0.015\ntf_static: split\n");
  EXPECT_TRUE(c.imu.ground_magnetometer);
  std::ofstream(path) << "lane: {points: [[1, 0], [2, 0], [3, 0]]}\nfaults: {readout_time: 0.2}\n";
  EXPECT_THROW(loadSimConfig(path), std::invalid_argument);
}

TEST(LostImages, AreAShareInShortGaps) {
  constexpr int kCount = 20000;
  const auto lost = lostImages(0.2, kCount, 1);
  const auto number = std::count(lost.begin(), lost.end(), true);
  EXPECT_NEAR(number, 0.2 * kCount, 5 * std::sqrt(3 * 0.2 * kCount));  // gaps of 3 in the mean
  int longest = 0, now = 0;
  for (const bool l : lost) longest = std::max(longest, now = l ? now + 1 : 0);
  EXPECT_EQ(longest, 5);
  EXPECT_NE(lost, lostImages(0.2, kCount, 2));
  EXPECT_EQ(lostImages(0, 100, 1), std::vector<bool>(100));
}

TEST(Bias, HasTheNormOrTheNumbersAsked) {
  const ImuConfig c;
  FaultsConfig f;
  f.gyro_bias = {0.2};
  f.accel_bias = {0.1, -0.2, 0.4};
  const Imu a(c, Pose::Identity(), 1, f), b(c, Pose::Identity(), 2, f), none(c, Pose::Identity(), 1);
  EXPECT_NEAR(a.gyroBias().norm(), 0.2, 1e-12);
  EXPECT_NEAR(b.gyroBias().norm(), 0.2, 1e-12);
  EXPECT_GT((a.gyroBias() - b.gyroBias()).norm(), 0.01) << "the seed decides the direction";
  EXPECT_NEAR(a.gyroBias().normalized().dot(none.gyroBias().normalized()), 1, 1e-12);
  EXPECT_EQ(a.accelBias(), Eigen::Vector3d(0.1, -0.2, 0.4));
}

// Mean of the product with a tone of the given frequency: its amplitude.
double amplitudeAt(const std::vector<double>& signal, double rate, double frequency) {
  std::complex<double> sum = 0;
  for (std::size_t i = 0; i < signal.size(); ++i)
    sum += signal[i] * std::polar(1.0, -2 * M_PI * frequency * static_cast<double>(i) / rate);
  return 2 * std::abs(sum) / static_cast<double>(signal.size());
}

TEST(Vibration, HasItsRootMeanSquareAndItsBand) {
  const Vibration vibration(1.5, 7);
  const double rate = 2000;
  std::vector<double> x;
  Eigen::Vector3d force2 = Eigen::Vector3d::Zero(), mean = Eigen::Vector3d::Zero();
  double gyro2 = 0;
  const int n = 40000;
  for (int i = 0; i < n; ++i) {
    const Eigen::Vector3d a = vibration.acceleration(i / rate), w = vibration.angularVelocity(i / rate);
    force2 += a.cwiseAbs2() / n;
    mean += a / n;
    gyro2 += w.squaredNorm() / (3 * n);
    x.push_back(a.x());
  }
  for (int k = 0; k < 3; ++k) EXPECT_NEAR(std::sqrt(force2[k]), 1.5, 0.1);
  EXPECT_LT(mean.norm(), 0.01);
  // Rocking by a / 0.1 m / (2 pi f): between the band's ends.
  EXPECT_LT(std::sqrt(gyro2), 1.5 / 0.1 / (2 * M_PI * 30));
  EXPECT_GT(std::sqrt(gyro2), 1.5 / 0.1 / (2 * M_PI * 120));
  double inside = 0, outside = 0;
  for (double f = 2; f < 28; f += 0.1) outside = std::max(outside, amplitudeAt(x, rate, f));
  for (double f = 30; f < 120; f += 0.1) inside = std::max(inside, amplitudeAt(x, rate, f));
  EXPECT_GT(inside, 0.3);
  EXPECT_LT(outside, 0.05 * inside);
}

TEST(Vibration, IsAddedToTheReadingsAndNothingElseChanges) {
  FaultsConfig f;
  f.vibration = 2;
  Imu still(ImuConfig(), Pose::Identity(), 3), shaken(ImuConfig(), Pose::Identity(), 3, f);
  const Vibration vibration(2, mix(3, 51));
  const BodyState rest;
  for (int i = 0; i < 50; ++i) {
    const ImuReading a = still.measure(rest), b = shaken.measure(rest);
    EXPECT_LT((b.specific_force - a.specific_force - vibration.acceleration(i / 200.0)).norm(), 1e-12);
    EXPECT_LT((b.angular_velocity - a.angular_velocity - vibration.angularVelocity(i / 200.0)).norm(), 1e-12);
  }
}

// A camera that slides sideways along a wall of one box: each row sees the box's vertical edge where the camera is at
// that row's time, so the edge leans by speed * f / z a second.
TEST(RollingShutter, EveryRowIsSeenFromItsOwnPose) {
  World world;
  Cuboid box;
  box.T_world_base = air_ground_common::yawPose(0, {2.0005, 1.0, -3.0});
  box.size = {0.001, 2.0, 6.0};  // its face at x = 2, its edge at y = 0
  addCuboid(box, 0.05, &world);
  const Scene scene(world);
  CameraModel camera;
  camera.width = 320;
  camera.height = 240;
  camera.fx = camera.fy = 200;
  camera.cx = 159.5;
  camera.cy = 119.5;
  const Renderer renderer(scene, camera, 1, 1);
  std::vector<Pose> poses;
  for (int row = 0; row < camera.height; ++row) {
    Pose T = Pose::Identity();  // looking along world x, image x along -y
    T.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    T.translation().y() = 0.5 * (static_cast<double>(row) / camera.height - 0.5);
    poses.push_back(T);
  }
  DepthImage depth;
  renderer.depth(poses, 0, &depth);
  std::vector<float> light;
  renderer.light(poses, 1, &light);
  for (int row = 0; row < camera.height; ++row) {
    // The edge at y = 0, 2 m ahead of a camera at y: pixel cx + f y / 2; the box lies left of it.
    const double edge = camera.cx + 200 * poses[row].translation().y() / 2;
    int last = -1;
    for (int x = 0; x < camera.width; ++x)
      if (depth.depth[static_cast<std::size_t>(row) * camera.width + x] > 0) last = x;
    EXPECT_NEAR(last, edge, 1.01) << row;
    EXPECT_NEAR(depth.depth[static_cast<std::size_t>(row) * camera.width + last], 2.0, 2e-3);
  }
  poses.pop_back();
  EXPECT_THROW(renderer.depth(poses, 0, &depth), std::invalid_argument);
  EXPECT_THROW(renderer.light(poses, 1, &light), std::invalid_argument);
}

// The recording's rows: with a readout of 0.1 s the row r of frame i is what a global shutter sees at the row's time.
TEST(RollingShutter, RowsFollowTheDocumentedTime) {
  SimConfig c = smallConfig();
  c.depth.noise = false;
  c.depth.max_range = 10;
  Recording still(c, 4);
  c.faults.readout_time = 0.1;
  c.faults.start_in_motion = true;
  Recording rolling(c, 4);
  RgbdFrame frame;
  rolling.groundImage(0, &frame);
  const int w = c.ground_camera.camera.width, h = c.ground_camera.camera.height;
  const Renderer renderer(rolling.scene(), c.ground_camera.camera, 1, 1);
  int moved = 0;
  for (const int row : {0, 100, 240, 400, 479}) {
    const double time = Recording::frameTime(c.ground_camera, 0) + (row / static_cast<double>(h) - 0.5) * 0.1;
    DepthImage expected, middle;
    renderer.depth(rolling.ground().pose(time) * c.T_ground_base_camera, 0, &expected);
    renderer.depth(rolling.ground().pose(Recording::frameTime(c.ground_camera, 0)) * c.T_ground_base_camera, 0,
                   &middle);
    int different = 0;
    for (int x = 0; x < w; ++x) {
      const std::size_t pixel = static_cast<std::size_t>(row) * w + x;
      const auto mm = [&](const DepthImage& d) {
        return d.depth[pixel] < 0.5f || d.depth[pixel] > 10 ? 0 : std::lround(1000 * d.depth[pixel]);
      };
      different += std::abs(frame.depth_mm[pixel] - mm(expected)) > 1;
      moved += std::abs(mm(middle) - mm(expected)) > 1;
    }
    EXPECT_LE(different, 2) << "row " << row;
  }
  EXPECT_GT(moved, 100) << "the rows' times matter";
}

TEST(DepthDelay, DepthIsThatOfTheLaterPoseAndTheColourAsItWas) {
  SimConfig c = smallConfig();
  c.depth.noise = false;
  c.depth.max_range = 10;
  c.faults.start_in_motion = true;
  Recording together(c, 4);
  c.faults.depth_delay = 0.03;
  Recording late(c, 4);
  RgbdFrame a, b;
  together.groundImage(0, &a);
  late.groundImage(0, &b);
  EXPECT_EQ(a.rgb, b.rgb);
  const Renderer renderer(late.scene(), c.ground_camera.camera, 1, 1);
  const auto differing = [&](const RgbdFrame& frame) {
    DepthImage expected;
    const double time = Recording::frameTime(c.ground_camera, 0) + 0.03;
    renderer.depth(late.ground().pose(time) * c.T_ground_base_camera, 0, &expected);
    int count = 0;
    for (std::size_t i = 0; i < frame.depth_mm.size(); ++i) {
      const float z = expected.depth[i];
      count += std::abs(frame.depth_mm[i] - (z < 0.5f || z > 10 ? 0 : std::lround(1000 * z))) > 1;
    }
    return count;
  };
  EXPECT_LT(differing(b), 300);  // of 307200: rays along an edge
  EXPECT_GT(differing(a), 30000);
}

TEST(StartInMotion, BothRobotsMoveFromTheFirstMomentToTheLast) {
  SimConfig c = smallConfig();
  c.flight.duration = 12;
  const Recording standing(c, 2);
  c.faults.start_in_motion = true;
  const Recording moving(c, 2);
  EXPECT_LT(standing.mav().pathLength(0, 1.0), 1e-6);
  EXPECT_LT(standing.ground().pathLength(0, 0.5), 1e-6);
  EXPECT_GT(moving.mav().pathLength(0, 1.0), 0.1);
  EXPECT_GT(moving.mav().pose(0).translation().z(), 1.5) << "flying, not climbing";
  EXPECT_GT(moving.mav().pathLength(11, 12), 0.1) << "the way is as long as before";
  EXPECT_GT(moving.ground().pathLength(0, 0.5), 0.2);
  EXPECT_NEAR(moving.ground().pathLength(0, 0.5), moving.ground().pathLength(0.5, 1.0), 0.03);
}

}  // namespace
}  // namespace air_ground_sim
