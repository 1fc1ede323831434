// Small worlds with exact truth for tests and statistics: boxes on a floor, what a ground robot with a depth camera 0.5
// m above the floor has seen of them, and noisy aerial clouds in the drifting, slightly mis-scaled frame of a MAV.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "air_ground_common/geometry.h"
#include "air_ground_common/mesh.h"
#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl::synthetic {

/// kRoom: a furnished room with walls of 2.5 m, a door, a lamp and a ceiling, seen from within by both robots.
/// kFewBoxes: three to six of two kinds, on bare floor.
enum class World { kBoxes, kFewBoxes, kIdenticalBoxes, kFlatFloor, kRidge, kRoom };

struct Options {
  World world = World::kBoxes;
  std::uint64_t seed = 1;
  int aerial_clouds = 12;
  double ground_path = 8.0;            ///< length of the ground robot's arc around the scene [m]
  double ground_noise = 1;             ///< of the ground robot's depths, times that of a Kinect
  double scale_error = 0.015;          ///< deviation of the aerial scale from 1
  double cloud_noise = 0.02;           ///< white, along the viewing ray [m]
  double smooth_noise = 0.02;          ///< varying over some 0.5 m [m]
  double hole_share = 0.12;            ///< of the aerial view, in blobs
  double drift_per_metre = 0.01;       ///< of the MAV's position [m/m]
  double yaw_drift_per_metre = 0.002;  ///< [rad/m]
  double tilt = 0;                     ///< of the MAV's map, about a random horizontal axis [rad]
  bool ceiling = true;                 ///< of a room, and its lamp
  bool other_world = false;            ///< the MAV is in another world (another room) than the ground robot
};

struct Run {
  air_ground_common::TriangleMesh mesh;               ///< in the world frame
  std::vector<Eigen::Vector3f> ground;                ///< in ground_map
  air_ground_common::Pose T_ground_robot;             ///< where the ground robot stands at last, in ground_map
  std::vector<AerialCloud> aerial;                    ///< in mav_map
  std::vector<air_ground_common::Pose> T_ground_mav;  ///< what places each aerial cloud rightly, about its reference
};

Run makeRun(const Options& options);

/// A ground map whose second half has drifted, before its loop is closed: 0.5 m and 10 degrees.
std::vector<Eigen::Vector3f> drifted(std::vector<Eigen::Vector3f> ground);

/// What a MAV without IMU makes of a run: its length 1 is `unit` metres, its z axis is tilted.
struct OwnUnit {
  double unit = 1;
  Eigen::Matrix3d R_raw_level = Eigen::Matrix3d::Identity();

  AerialCloud raw(const AerialCloud& cloud) const;
};

/// A box of the given edge lengths, turned by yaw, standing at (x, y) with its lower face at z = bottom.
void addBox(air_ground_common::TriangleMesh& mesh, double x, double y, double bottom, double yaw,
            const Eigen::Vector3d& size);

/// Error of an estimate at the aerial cloud's reference point: horizontal distance [m] and heading [rad].
struct Error {
  double position = 0, yaw = 0, z = 0;
};
Error errorOf(const air_ground_common::Pose& estimate, const air_ground_common::Pose& truth,
              const Eigen::Vector3d& reference);

}  // namespace heightmap_mcl::synthetic
