// Every shipped world: loads, leaves the robots' ways free, differs between seeds; bad files are refused by name.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "air_ground_sim/build_world.h"
#include "air_ground_sim/height_lookup.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/texture.h"
#include "air_ground_sim/trajectory.h"
#include "air_ground_sim/world.h"

namespace air_ground_sim {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> shippedWorlds() {
  std::vector<std::string> files;
  for (const auto& entry : fs::directory_iterator(AIR_GROUND_WORLDS))
    if (entry.path().stem().string().rfind("street", 0) != 0 && entry.path().stem().string().rfind("rooms", 0) != 0)
      files.push_back(entry.path().string());  // those have tests of their own
  std::sort(files.begin(), files.end());
  return files;
}

class ShippedWorld : public testing::TestWithParam<std::string> {};

TEST_P(ShippedWorld, LeavesBothWaysFree) {
  const SimConfig config = loadSimConfig(GetParam());
  for (std::uint64_t seed : {1, 2, 101}) {
    const World world = buildWorld(config, seed);
    const auto mesh = meshOf(world);
    const HeightLookup heights(mesh);
    const BodyTrajectory drive = makeDrive(world.lane, config.flight.duration, mix(seed, 12));
    const BodyTrajectory flight = makeFlight(world.flight, world.mav_start, heights, mix(seed, 11));
    EXPECT_GT(drive.pathLength(0, config.flight.duration), 7.0);
    EXPECT_LT(drive.pathLength(0, config.flight.duration), 10.0);
    EXPECT_GT(flight.pathLength(0, config.flight.duration), 20.0);
    EXPECT_LT(flight.pathLength(0, config.flight.duration), 26.0);
    for (double t = 0; t < config.flight.duration; t += 0.25) {
      const Eigen::Vector3d ground = drive.pose(t).translation(), mav = flight.pose(t).translation();
      EXPECT_LT(heights(ground.head<2>(), 0.2), 0.06) << "in the ground robot's way at " << t << " s, seed " << seed;
      EXPECT_GT(mav.z() - heights(mav.head<2>(), 0.3), t < 8 ? 0.05 : 0.45)
          << "the MAV nearly touches at " << t << " s, seed " << seed;
      EXPECT_LT(mav.z(), 3.1);
    }
    // Height matters where the world has structure, and only there.
    const double highest = heights(Eigen::Vector2d::Zero(), 3.0);
    if (config.world.kind == WorldKind::kFlat) {
      EXPECT_EQ(highest, 0);
    } else {
      EXPECT_GT(highest, 0.4);
      EXPECT_LT(highest, 1.8);
    }
  }
}

TEST_P(ShippedWorld, VariesWithTheSeedAndOnlyWithIt) {
  const SimConfig config = loadSimConfig(GetParam());
  const auto a = meshOf(buildWorld(config, 7)), b = meshOf(buildWorld(config, 7)), c = meshOf(buildWorld(config, 8));
  ASSERT_EQ(a.vertices.size(), b.vertices.size());
  for (std::size_t i = 0; i < a.vertices.size(); ++i) ASSERT_EQ(a.vertices[i], b.vertices[i]);
  const bool layout_is_fixed = config.world.kind == WorldKind::kFlat || config.world.kind == WorldKind::kGrid;
  EXPECT_EQ(layout_is_fixed, a.vertices == c.vertices);
}

INSTANTIATE_TEST_SUITE_P(All, ShippedWorld, testing::ValuesIn(shippedWorlds()),
                         [](const auto& info) { return fs::path(info.param).stem().string(); });

TEST(Patches, FaceOutwards) {
  World world;
  Cuboid c;
  c.T_world_base = air_ground_common::yawPose(0.3, {1, 2, 0.5});
  c.size = {0.4, 0.5, 0.6};
  addCuboid(c, 0.02, &world);
  ASSERT_EQ(world.patches.size(), 6u);
  const auto mesh = meshOf(world);
  EXPECT_NEAR(mesh.area(), 2 * (0.4 * 0.5 + 0.4 * 0.6 + 0.5 * 0.6), 1e-5);
  const Eigen::Vector3f middle = (c.T_world_base * Eigen::Vector3d(0, 0, 0.3)).cast<float>();
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3f &a = mesh.vertices[t[0]], n = (mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a);
    EXPECT_GT(n.dot(a - middle), 0);
  }
}

TEST(Textures, HaveContrastEverywhere) {
  for (const Material m :
       {Material::kConcrete, Material::kPlanks, Material::kTiles, Material::kGravel, Material::kCardboard,
        Material::kPaintedBox, Material::kWood, Material::kBrick, Material::kPlaster, Material::kRock}) {
    Patch p;
    p.vertices = {{0, 0, 0}, {0.6f, 0, 0}, {0, 0.5f, 0}, {0.6f, 0.5f, 0}};
    p.width = 0.6f;
    p.height = 0.5f;
    p.texel = 0.004f;
    p.material = m;
    p.seed = p.object = 3;
    const cv::Mat image = paintPatch(p);
    ASSERT_EQ(image.cols, 150);
    ASSERT_EQ(image.rows, 125);
    // Every 15 x 15 texels (6 cm) hold at least 2 grey values of standard deviation.
    for (int y = 0; y + 15 <= image.rows; y += 15)
      for (int x = 0; x + 15 <= image.cols; x += 15) {
        double sum = 0, sum2 = 0;
        for (int dy = 0; dy < 15; ++dy)
          for (int dx = 0; dx < 15; ++dx) {
            const double g = image.at<cv::Vec3b>(y + dy, x + dx)[1];
            sum += g / 225;
            sum2 += g * g / 225;
          }
        EXPECT_GT(std::sqrt(std::max(0.0, sum2 - sum * sum)), 2)
            << "material " << static_cast<int>(m) << " at " << x << ' ' << y;
      }
  }
}

class WorldFile : public testing::Test {
 protected:
  std::string write(const std::string& text) {
    const std::string path = testing::TempDir() + "/air_ground_world_" + std::to_string(++count_) + ".yaml";
    std::ofstream(path) << text;
    return path;
  }
  std::string errorOf(const std::string& text) {
    try {
      loadSimConfig(write(text));
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "";
  }
  int count_ = 0;
  const std::string lane_ = "lane: {points: [[1, 0], [2, 0], [3, 0]]}\n";
};

TEST_F(WorldFile, ErrorsNameTheKey) {
  EXPECT_EQ(errorOf(lane_), "");
  EXPECT_NE(errorOf(lane_ + "flight: {speeed: 0.4}").find("'speeed' is not a parameter"), std::string::npos);
  EXPECT_NE(errorOf(lane_ + "flight: {speed: 40}").find("outside [0.1, 5]"), std::string::npos);
  EXPECT_NE(errorOf(lane_ + "flight: {speed: fast}").find("must be a number"), std::string::npos);
  EXPECT_NE(errorOf(lane_ + "world: {floor: lava}").find("must be one of"), std::string::npos);
  EXPECT_NE(errorOf("lane: {points: [[1, 0]]}").find("at least three"), std::string::npos);
  EXPECT_NE(errorOf(lane_ + "world: {clusters: [{center: [1]}]}").find("[x, y]"), std::string::npos);
  EXPECT_NE(errorOf("a: [").find("cannot read"), std::string::npos);
  EXPECT_THROW(loadSimConfig("/no/such/file.yaml"), std::invalid_argument);
}

}  // namespace
}  // namespace air_ground_sim
