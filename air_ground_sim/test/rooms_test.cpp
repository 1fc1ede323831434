// The worlds with walls: both robots' ways are free and lead through doors, they see about half of the same, and the
// shapes that matter to height maps are there: walls, lintels, lamps above tables.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <set>

#include "air_ground_common/mesh.h"
#include "air_ground_sim/build_world.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/rooms/rooms.h"
#include "air_ground_sim/texture.h"

namespace air_ground_sim {
namespace {

using air_ground_common::MeshScene;
using air_ground_common::Pose;
using Eigen::Vector2d;
using Eigen::Vector3d;

struct Flat {
  SimConfig config;
  World world;
  MeshScene mesh;
  BodyTrajectory flight, drive;

  Flat(const SimConfig& c, std::uint64_t seed)
      : config(c),
        world(buildRooms(c, seed)),
        mesh(meshOf(world)),
        flight(makeRoomsFlight(world.flight, world.flight_way, world.doors, mix(seed, 11))),
        drive(makeDrive(world.lane, c.flight.duration, mix(seed, 12))) {}

  // Distance to the first surface; 100 m where there is none.
  double range(const Vector3d& from, const Vector3d& direction) const {
    const auto hit = mesh.cast(from.cast<float>(), direction.normalized().cast<float>());
    return hit ? hit->distance : 100;
  }
  int doorAt(const Vector3d& p) const {
    for (std::size_t i = 0; i < world.doors.size(); ++i)
      if ((world.doors[i] - p.head<2>()).norm() < 0.3) return static_cast<int>(i);
    return -1;
  }
};

SimConfig shipped(const std::string& name) {
  return loadSimConfig(std::string(AIR_GROUND_WORLDS) + "/" + name + ".yaml");
}

class RoomsOfSeed : public testing::TestWithParam<int> {
 protected:
  Flat flat_{shipped("rooms"), static_cast<std::uint64_t>(GetParam())};
};

TEST_P(RoomsOfSeed, TheMavFliesClearOfEverythingThroughDoors) {
  const double duration = flat_.config.flight.duration;
  EXPECT_GT(flat_.flight.pathLength(0, duration), 20);
  EXPECT_LT(flat_.flight.pathLength(0, duration), 27);
  std::set<int> doors;
  for (double t = 0; t < duration; t += 0.2) {
    const Vector3d p = flat_.flight.pose(t).translation();
    if (t > 8.5) {
      EXPECT_GT(p.z(), 1.2) << t;
      EXPECT_LT(p.z(), 1.9) << t;
    }
    doors.insert(flat_.doorAt(p));
    double nearest = 100;
    for (int i = 0; i < 300; ++i) {  // directions spread over the sphere; until it flies not towards the floor
      const double z = 1 - 2 * (i + 0.5) / 300, a = i * M_PI * (3 - std::sqrt(5.0)), r = std::sqrt(1 - z * z);
      if (t < 8.5 && z < -0.2) continue;
      nearest = std::min(nearest, flat_.range(p, {r * std::cos(a), r * std::sin(a), z}));
    }
    EXPECT_GT(nearest, 0.27) << "at " << t << " s, " << p.transpose();
    const Vector3d next = flat_.flight.pose(t + 0.2).translation();
    EXPECT_GT(flat_.range(p, next - p), (next - p).norm()) << "through a wall at " << t << " s";
  }
  doors.erase(-1);
  EXPECT_GE(doors.size(), 2u);
}

TEST_P(RoomsOfSeed, TheGroundRobotDrivesClearOfEverythingThroughDoors) {
  const double duration = flat_.config.flight.duration;
  EXPECT_GT(flat_.drive.pathLength(0, duration), 6);
  EXPECT_LT(flat_.drive.pathLength(0, duration), 16);
  std::set<int> doors;
  for (double t = 0; t < duration; t += 0.25) {
    const Vector3d p = flat_.drive.pose(t).translation();
    doors.insert(flat_.doorAt(p));
    for (const double z : {0.05, 0.2, 0.45, 0.6})
      for (int i = 0; i < 36; ++i) {
        const double a = i * M_PI / 18;
        EXPECT_GT(flat_.range({p.x(), p.y(), z}, {std::cos(a), std::sin(a), 0}), 0.25) << "at " << t << " s";
      }
  }
  doors.erase(-1);
  EXPECT_EQ(doors.size(), 2u);
}

// Places in columns of 10 cm that a robot's camera sees within `reach` [m].
std::set<std::pair<int, int>> seen(const Flat& flat, const BodyTrajectory& body, const Pose& T_base_camera,
                                   const air_ground_common::CameraModel& camera, double reach) {
  std::set<std::pair<int, int>> cells;
  for (double t = 0; t < flat.config.flight.duration; t += 0.5) {
    const Pose T = body.pose(t) * T_base_camera;
    for (int y = 0; y < camera.height; y += 30)
      for (int x = 0; x < camera.width; x += 30) {
        const Vector3d ray = T.linear() * camera.ray({x, y});
        const double range = flat.range(T.translation(), ray);
        if (range > reach) continue;
        const Vector3d p = T.translation() + range * ray;
        cells.insert({static_cast<int>(std::floor(p.x() / 0.1)), static_cast<int>(std::floor(p.y() / 0.1))});
      }
  }
  return cells;
}

TEST_P(RoomsOfSeed, BothRobotsSeeAboutHalfOfTheSame) {
  const SimConfig& c = flat_.config;
  const auto air = seen(flat_, flat_.flight, c.T_mav_base_camera, c.mav_camera.camera, 4.0);
  const auto ground = seen(flat_, flat_.drive, c.T_ground_base_camera, c.ground_camera.camera, 4.0);
  int both = 0;
  for (const auto& cell : air) both += static_cast<int>(ground.count(cell));
  const double share = static_cast<double>(both) / static_cast<double>(air.size());
  EXPECT_GT(share, 0.3);
  EXPECT_LT(share, 0.75);
  RecordProperty("share", std::to_string(share));
}

TEST_P(RoomsOfSeed, WallsLintelsAndLampsAreWhereTheyBelong) {
  float highest = 0;
  for (const auto& v : meshOf(flat_.world).vertices) highest = std::max(highest, v.z());
  EXPECT_FLOAT_EQ(highest, 2.5f);
  for (const Vector2d& d : flat_.world.doors) {
    EXPECT_NEAR(flat_.range({d.x(), d.y(), 1.0}, {0, 0, 1}), 1.0, 1e-4) << "the lintel's lower edge at 2 m";
    EXPECT_NEAR(flat_.range({d.x(), d.y(), 1.0}, {0, 0, -1}), 1.0, 1e-4) << "nothing stands in the door";
  }
  int lamps = 0;  // places where a lamp ends below 1.8 m and a table top is 0.5 m or more below it
  for (double x = -4.6; x < 4.6; x += 0.1)
    for (double y = -3.5; y < 3.5; y += 0.1) {
      const double up = flat_.range({x, y, 1.3}, {0, 0, 1}), down = flat_.range({x, y, 1.3}, {0, 0, -1});
      lamps += up > 0.04 && up < 0.21 && down > 0.3 && down < 0.6;
    }
  EXPECT_GT(lamps, 8);
}

INSTANTIATE_TEST_SUITE_P(Seeds, RoomsOfSeed, testing::Values(1, 2, 3, 101, 102, 103));

TEST(Rooms, TheSeedDecidesTheLayoutUnlessToldOtherwise) {
  SimConfig c = shipped("rooms");
  const auto a = meshOf(buildWorld(c, 7)), same = meshOf(buildWorld(c, 7)), b = meshOf(buildWorld(c, 8));
  EXPECT_TRUE(a.vertices == same.vertices);
  EXPECT_FALSE(a.vertices == b.vertices);
  c.world.vary_layout = false;
  EXPECT_TRUE(meshOf(buildWorld(c, 7)).vertices == meshOf(buildWorld(c, 8)).vertices);
}

TEST(Rooms, ThePlainFloorHasNoTexture) {
  const World plain = buildRooms(shipped("rooms_plain"), 1), planks = buildRooms(shipped("rooms"), 1);
  EXPECT_TRUE(meshOf(plain).vertices == meshOf(planks).vertices);
  const auto contrast = [](Patch floor) {
    floor.texel = 0.02f;
    cv::Scalar mean, stddev;
    cv::meanStdDev(paintPatch(floor), mean, stddev);
    return stddev[1];
  };
  EXPECT_EQ(contrast(plain.patches.front()), 0);
  EXPECT_GT(contrast(planks.patches.front()), 5);
}

// The MAV's camera: 0.6 rad from straight down to the front, image right is the body's right.
TEST(Rooms, TheCameraLooksDownAndAhead) {
  const SimConfig c = shipped("rooms");
  const Eigen::Matrix3d R = c.T_mav_base_camera.linear();
  EXPECT_LT((R.col(2) - Vector3d(std::sin(0.6), 0, -std::cos(0.6))).norm(), 1e-12);
  EXPECT_LT((R.col(0) - Vector3d(0, -1, 0)).norm(), 1e-12);
  EXPECT_NEAR(R.determinant(), 1, 1e-12);
}

}  // namespace
}  // namespace air_ground_sim
