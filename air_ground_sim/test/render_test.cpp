// Geometry of the rendered images: frames, projection with distortion, depth, against analytic answers.
#include <gtest/gtest.h>
#include <omp.h>

#include <cmath>
#include <fstream>

#include "air_ground_common/mesh.h"
#include "air_ground_sim/recording.h"
#include "small_config.h"

namespace air_ground_sim {
namespace {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

// Floor 12 x 12 m at z = 0 (top of a slab) and one box of 0.8 x 0.6 x 0.7 m.
World boxWorld() {
  World w;
  Cuboid floor;
  floor.T_world_base.translation().z() = -0.1;
  floor.size = {12, 12, 0.1};
  floor.material = Material::kConcrete;
  floor.printed = false;
  addCuboid(floor, 0.05, &w);
  Cuboid box;
  box.T_world_base = air_ground_common::yawPose(0.4, {0.3, -0.2, 0});
  box.size = {0.8, 0.6, 0.7};
  addCuboid(box, 0.02, &w);
  return w;
}

struct View {
  CameraModel camera;
  Pose T_world_camera;
};

View mavView() {
  const SimConfig c = SimConfig::defaults();
  Pose T_world_base = air_ground_common::yawPose(1.1, {-0.3, 0.2, 2.2});
  T_world_base.linear() =
      T_world_base.linear() * Eigen::AngleAxisd(0.08, Eigen::Vector3d(1, -1, 0).normalized()).toRotationMatrix();
  return {c.mav_camera.camera, T_world_base * c.T_mav_base_camera};
}

View groundView() {
  const SimConfig c = SimConfig::defaults();
  return {c.ground_camera.camera, air_ground_common::yawPose(0.2, {-2.0, -0.5, 0}) * c.T_ground_base_camera};
}

TEST(Mounts, MavLooksDownGroundLooksAheadAndDown) {
  const SimConfig c = SimConfig::defaults();
  EXPECT_LT((c.T_mav_base_camera.linear().col(2) + Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  EXPECT_LT((c.T_mav_base_camera.linear().col(0) + Eigen::Vector3d::UnitY()).norm(), 1e-12);
  EXPECT_NEAR(c.T_mav_base_camera.linear().determinant(), 1, 1e-12);
  const Eigen::Vector3d axis = c.T_ground_base_camera.linear().col(2);
  EXPECT_GT(axis.x(), 0.9);
  EXPECT_NEAR(std::asin(-axis.z()) * 180 / M_PI, 17, 1e-6);
  EXPECT_LT((c.T_ground_base_camera.linear().col(0) + Eigen::Vector3d::UnitY()).norm(), 1e-12);
  // About 90 to 100 degrees across.
  const CameraModel& m = c.mav_camera.camera;
  const double left = std::atan(-m.unproject({0, m.cy}).x()), right = std::atan(m.unproject({m.width - 1.0, m.cy}).x());
  EXPECT_GT((left + right) * 180 / M_PI, 90);
  EXPECT_LT((left + right) * 180 / M_PI, 100);
}

TEST(Cameras, TheWorldFileMayNameACalibration) {
  const std::string folder = testing::TempDir(), world = folder + "/air_ground_fisheye_world.yaml";
  std::ofstream(folder + "/air_ground_fisheye.yaml")
      << std::ifstream(std::string(AIR_GROUND_WORLDS) + "/../cameras/fisheye_150.yaml").rdbuf();
  const std::string start =
      "world: {kind: indoor}\nlane: {points: [[2, -1], [2, 0], [2, 1]]}\nmav_camera: {calibration: air_ground_";
  std::ofstream(world) << start << "fisheye.yaml}\n";
  const CameraModel camera = loadSimConfig(world).mav_camera.camera;
  EXPECT_EQ(camera.model, air_ground_common::DistortionModel::kEquidistant);
  const double left = std::atan(-camera.unproject({-0.5, camera.cy}).x()),
               right = std::atan(camera.unproject({camera.width - 0.5, camera.cy}).x());
  EXPECT_NEAR((left + right) * 180 / M_PI, 150, 1);
  std::ofstream(world) << start << "no_such.yaml}\n";
  EXPECT_THROW(loadSimConfig(world), std::runtime_error);
}

TEST(Renderer, DepthAgreesWithSingleRaysThroughTheDistortedCamera) {
  const World world = boxWorld();
  const Scene scene(world);
  const air_ground_common::MeshScene reference(meshOf(world));
  View wide = mavView();
  wide.camera.fx = wide.camera.fy = 289;
  wide.camera.setDistortion("equidistant", {-0.0121, 0.0234, -0.0194, 0.0051});
  for (const View& view : {mavView(), groundView(), wide}) {
    const Renderer renderer(scene, view.camera, 1, 1);
    DepthImage image;
    renderer.depth(view.T_world_camera, 0, &image);
    Rng rng(2);
    int different = 0, hits = 0;
    for (int k = 0; k < 4000; ++k) {
      const int x = rng.integer(view.camera.width), y = rng.integer(view.camera.height);
      const Eigen::Vector3d ray = view.camera.ray({x, y});
      if (!ray.allFinite()) {  // outside the image circle
        EXPECT_EQ(image.depth[static_cast<std::size_t>(y) * view.camera.width + x], 0);
        continue;
      }
      const auto hit = reference.cast(view.T_world_camera.translation().cast<float>(),
                                      (view.T_world_camera.linear() * ray).cast<float>());
      const float expected = hit ? static_cast<float>(hit->distance * ray.z()) : 0;
      hits += hit.has_value();
      different += std::abs(image.depth[static_cast<std::size_t>(y) * view.camera.width + x] - expected) >
                   1e-3f * (1 + expected);
    }
    EXPECT_GT(hits, 2000);
    EXPECT_LE(different, 4) << "rays along an edge may go either way";
  }
}

TEST(Renderer, DepthOfTheFloorIsTheAnalyticPlane) {
  const World world = boxWorld();
  const Scene scene(world);
  const View view = mavView();
  const Renderer renderer(scene, view.camera, 1, 1);
  DepthImage image;
  renderer.depth(view.T_world_camera, 0, &image);
  for (const auto& [x, y] : {std::pair<int, int>{3, 5}, {748, 4}, {2, 470}, {745, 476}}) {
    const Eigen::Vector2d n = view.camera.unproject({x, y});
    const Eigen::Vector3d d = view.T_world_camera.linear() * Eigen::Vector3d(n.x(), n.y(), 1);
    const double z = -view.T_world_camera.translation().z() / d.z();
    EXPECT_NEAR(image.depth[static_cast<std::size_t>(y) * view.camera.width + x], z, 1e-4 * z);
    EXPECT_NEAR(image.cosine[static_cast<std::size_t>(y) * view.camera.width + x], std::abs(d.normalized().z()), 1e-4);
  }
}

// The box's top face: a pixel and a half inside its projected outline the depth is the face's, outside it is not.
TEST(Renderer, KnownCornersLandOnTheirPixels) {
  const World world = boxWorld();
  const Scene scene(world);
  const View view = mavView();
  const Renderer renderer(scene, view.camera, 1, 1);
  DepthImage image;
  renderer.depth(view.T_world_camera, 0, &image);
  const Pose T_world_box = air_ground_common::yawPose(0.4, {0.3, -0.2, 0});
  const Pose T_camera_box = view.T_world_camera.inverse() * T_world_box;
  const auto pixel = [&](double x, double y) {
    return *view.camera.project(T_camera_box * Eigen::Vector3d(0.4 * x, 0.3 * y, 0.7));
  };
  const Eigen::Vector2d center = pixel(0, 0);
  int checked = 0;
  for (double s = -0.9; s <= 0.9; s += 0.1)
    for (const auto& [x, y] : {std::pair<double, double>{s, 1}, {s, -1}, {1, s}, {-1, s}}) {
      const Eigen::Vector2d edge = pixel(x, y), outwards = (pixel(1.01 * x, 1.01 * y) - edge).normalized();
      ASSERT_TRUE(view.camera.contains(edge, 5)) << "the view should show the whole box";
      const double top = (T_camera_box * Eigen::Vector3d(0.4 * x, 0.3 * y, 0.7)).z();
      const auto depthAt = [&](const Eigen::Vector2d& p) {
        return image.depth[static_cast<std::size_t>(std::lround(p.y())) * view.camera.width + std::lround(p.x())];
      };
      EXPECT_NEAR(depthAt(edge - 1.5 * outwards), top, 0.01) << center.transpose();
      EXPECT_GT(depthAt(edge + 1.5 * outwards), top + 0.003);
      ++checked;
    }
  EXPECT_GT(checked, 70);
}

TEST(Renderer, ProjectorShadowLiesOnTheProjectorsFarSide) {
  const World world = boxWorld();
  const Scene scene(world);
  const View view = groundView();
  const Renderer renderer(scene, view.camera, 1, 1);
  DepthImage image;
  renderer.depth(view.T_world_camera, 0.075f, &image);
  // Projector to the right: what it cannot see but the camera can lies left of the box. Box at the image's middle.
  const Eigen::Vector2d box = *view.camera.project(view.T_world_camera.inverse() * Eigen::Vector3d(0.3, -0.2, 0.35));
  int left = 0, right = 0;
  for (std::size_t i = 0; i < image.lit.size(); ++i)
    if (image.depth[i] > 0 && !image.lit[i]) (static_cast<double>(i % view.camera.width) < box.x() ? left : right) += 1;
  EXPECT_GT(left, 300);
  EXPECT_LT(right, left / 20);
}

TEST(Renderer, MotionSpreadsAnEdgeOverTheExposure) {
  const World world = boxWorld();
  const Scene scene(world);
  const View view = groundView();
  const Renderer renderer(scene, view.camera, 8, 1);
  std::vector<float> sharp, blurred;
  renderer.light(std::vector<Pose>(8, view.T_world_camera), 1, &sharp);
  std::vector<Pose> moving;
  for (int s = 0; s < 8; ++s)
    moving.push_back(air_ground_common::yawPose(0.06 * ((s + 0.5) / 8 - 0.5), Eigen::Vector3d::Zero()) *
                     view.T_world_camera);
  renderer.light(moving, 1, &blurred);
  const auto gradient = [&](const std::vector<float>& image) {
    double sum = 0;
    for (std::size_t i = 1; i < image.size(); ++i) sum += std::pow(image[i] - image[i - 1], 2);
    return sum;
  };
  EXPECT_LT(gradient(blurred), 0.7 * gradient(sharp));
  EXPECT_THROW(renderer.light({view.T_world_camera}, 1, &sharp), std::invalid_argument);
}

TEST(Scene, BoxCastsShadowAwayFromTheLight) {
  World world = boxWorld();
  world.sun = Eigen::Vector3f(0.7f, 0, 0.7f).normalized();
  const Scene scene(world);
  CameraModel camera;
  camera.width = camera.height = 200;
  camera.fx = camera.fy = 100;
  camera.cx = camera.cy = 99.5;
  Pose T_world_camera = Pose::Identity();  // looking down, image x along world x
  T_world_camera.linear() = Eigen::Vector3d(1, -1, -1).asDiagonal();
  T_world_camera.translation() = Eigen::Vector3d(0.3, -0.2, 3);
  const Renderer renderer(scene, camera, 4, 1);
  std::vector<float> light;
  renderer.light(std::vector<Pose>(4, T_world_camera), 1, &light);
  const auto mean = [&](double world_x) {  // around (world_x, -0.2)
    const auto p = *camera.project(T_world_camera.inverse() * Eigen::Vector3d(world_x, -0.2, 0));
    double sum = 0;
    for (int dy = -2; dy <= 2; ++dy)
      for (int dx = -2; dx <= 2; ++dx) sum += light[(std::lround(p.y()) + dy) * 200 + std::lround(p.x()) + dx] / 25;
    return sum;
  };
  EXPECT_LT(mean(0.3 - 0.8), 0.7 * mean(0.3 + 0.8));
}

struct Sample {
  std::vector<std::uint8_t> mav;
  RgbdFrame ground;
  Eigen::Vector3d force;
};

Sample record(std::uint64_t seed, int threads) {
  omp_set_num_threads(threads);
  Recording r(smallConfig(), seed);
  Sample s;
  Imu imu = r.makeMavImu();
  for (int i = 0; i < 3; ++i) {
    r.mavImage(i, &s.mav);
    r.groundImage(i, &s.ground);
    s.force = imu.measure(r.mav().state(0.005 * i)).specific_force;
  }
  return s;
}

TEST(Recording, SameSeedSameDataForAnyNumberOfThreads) {
  const Sample a = record(5, 1), b = record(5, 2), other = record(6, 2);
  EXPECT_EQ(a.mav, b.mav);
  EXPECT_EQ(a.ground.rgb, b.ground.rgb);
  EXPECT_EQ(a.ground.depth_mm, b.ground.depth_mm);
  EXPECT_EQ(a.force, b.force);
  EXPECT_NE(a.mav, other.mav);
  EXPECT_NE(a.ground.depth_mm, other.ground.depth_mm);
  EXPECT_NE(a.force, other.force);
}

}  // namespace
}  // namespace air_ground_sim
