// Parameters of a simulated recording, read from config/worlds/<world>.yaml. Every field has its default and unit here.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "air_ground_sim/faults.h"

namespace air_ground_sim {

enum class WorldKind { kIndoor, kRubble, kFlat, kGrid, kStreet, kRooms };
enum class FloorStyle { kConcrete, kPlanks, kTiles, kGravel, kPlain };

/// A heap of cardboard boxes, pallets and debris around a centre.
struct ClusterConfig {
  Eigen::Vector2d center = Eigen::Vector2d::Zero();  ///< [m]
  double radius = 1.0;                               ///< [m]
  int boxes = 8;                                     ///< on the floor and stacked
  int pallets = 1;
  int debris = 6;           ///< planks, bricks, flat cardboard
  double max_height = 1.4;  ///< of a stack [m]
};

struct WallConfig {
  Eigen::Vector2d from = Eigen::Vector2d::Zero(), to = Eigen::Vector2d::Zero();  ///< [m]
  double height = 1.0;                                                           ///< [m]
};

/// Four rooms around a crossing of walls; both ways follow from the plan.
struct RoomsConfig {
  double size_x = 9.4, size_y = 7.2;  ///< inner extent of all four together [m]
  double wall_thickness = 0.12;       ///< [m]
  double door_width = 1.0;            ///< [m]
  double door_height = 2.0;           ///< [m]
};

struct WorldConfig {
  WorldKind kind = WorldKind::kIndoor;
  FloorStyle floor = FloorStyle::kConcrete;
  double floor_size = 16.0;  ///< edge of the square floor [m]
  double texel = 0.0025;     ///< texture resolution near the centre [m]
  double room_height = 3.0;  ///< outer walls at the floor's edge; 0: none; rooms: of all walls [m]
  bool vary_layout = true;   ///< mirror and jitter the layout with the seed
  std::vector<ClusterConfig> clusters;
  std::vector<WallConfig> walls;
  int rocks = 60;                              ///< rubble only
  double relief = 0.12;                        ///< amplitude of the height field, rubble only [m]
  int grid_rows = 4, grid_columns = 5;         ///< identical boxes only
  double grid_spacing = 1.1, grid_box = 0.45;  ///< [m]
  RoomsConfig rooms;                           ///< rooms only
};

/// A straight street with a row of buildings on either side.
struct StreetLineConfig {
  Eigen::Vector2d from = Eigen::Vector2d::Zero(),
                  to = Eigen::Vector2d::Zero();  ///< ends of the centre line in world [m]
  bool panoramas = true;                         ///< false: a street that the city's panoramas do not cover
};

/// The street world, its cadastral model and its panoramas. `world` is the local east-north-up frame at `origin`.
struct StreetConfig {
  std::string crs = "EPSG:2056";                        ///< a projected system, (easting, northing)
  Eigen::Vector3d origin{2683500.0, 1247800.0, 410.0};  ///< in `crs` [m]
  double geoid_undulation = 47.3;                       ///< ellipsoidal height minus the height used in `origin` [m]
  std::vector<StreetLineConfig> lines;
  double width = 14;                         ///< from facade to facade [m]
  double sidewalk = 2.5;                     ///< [m]
  double grade = 0.04;                       ///< rise of the terrain along the first line
  double relief = 0.6;                       ///< amplitude of its undulation [m]
  double texel = 0.01;                       ///< of the facades [m]
  std::string facade_images;                 ///< folder of photographs to be used as facades; empty: painted ones
  double cars = 14, people = 12, trees = 5;  ///< on 100 m of street

  std::vector<Eigen::Vector2d> route;  ///< of the MAV, along centre lines [m]; empty: the first line there and back
  double route_offset = 2.0;           ///< the way lies so far to the right of the route [m]
  bool camera_looks_left = true;       ///< false: to the right
  double camera_pitch = 0.05;          ///< of the optical axis, upwards positive [rad]

  double panorama_spacing = 12;  ///< [m]
  double panorama_height = 2.5;  ///< above the road [m]
  int panorama_width = 4096;     ///< [px]; the height is half of it
  int panorama_samples = 4;      ///< rays a pixel
  double geotag_position_error =
      3.7;  ///< mean length of the error [m]; heights err half as much as each horizontal axis
  double geotag_orientation_error = 0.0332;  ///< mean angle of the error [rad]
  double geotag_correlation = 0.5;           ///< share of the position error's variance that neighbours have in common
  double model_lateral_stddev = 0.1;         ///< of each building, east and north [m]
  double model_height_stddev = 0.5;          ///< of each building [m]
};

/// Satellite positioning between facades: echoes shift the position for tens of seconds and let it jump.
struct GpsConfig {
  double rate = 0;                 ///< [Hz]; 0: no receiver
  double horizontal_stddev = 2.8;  ///< of the slow error, each axis [m]
  double vertical_stddev = 8.0;    ///< [m]
  double correlation_time = 25;    ///< of the slow error [s]
  double jump_interval = 15;       ///< mean time between changes of the echo [s]
  double jump_stddev = 2.5;        ///< horizontal, each axis [m]; three times as much in height
  double noise = 0.4;              ///< white [m]
  double stated_stddev = 2.5;      ///< what the receiver believes, horizontally [m]; twice as much in height
};

struct BarometerConfig {
  double rate = 0;              ///< [Hz]; 0: none
  double noise = 1.2;           ///< [Pa], 8.4 Pa a metre
  double drift = 0.3;           ///< [Pa/sqrt(s)]
  double weather_stddev = 400;  ///< deviation from the standard atmosphere [Pa]
};

struct FlightConfig {
  double stand_still = 1.5;                          ///< on the floor before take-off [s]
  double duration = 58.0;                            ///< of the whole recording [s]
  double speed = 0.42;                               ///< mean along the path after take-off [m/s]
  double min_height = 1.7, max_height = 2.7;         ///< of the loops above the floor [m]
  double clearance = 0.8;                            ///< above the highest thing within 0.6 m [m]
  double loop_x = 1.7, loop_y = 1.4;                 ///< half axes of the loops [m]
  Eigen::Vector2d center = Eigen::Vector2d::Zero();  ///< of the loops [m]
  double start_radius = 2.6;                         ///< distance of the take-off place from the centre [m]
  double sway = 0.10;                                ///< amplitude of the pilot's corrections [m]
  double sway_period = 2.6;                          ///< [s]
  double camera_tilt = 0;                            ///< of the optical axis from straight down to the front [rad]
};

struct LaneConfig {
  std::vector<Eigen::Vector2d> points;                ///< the ground robot's way, smoothed [m]
  Eigen::Vector2d look_at = Eigen::Vector2d::Zero();  ///< what it faces on average [m]
  double stand_still = 1.0;                           ///< [s]
  double heading_swing = 0.3;                         ///< amplitude around that direction [rad]
  double half_width = 0.4;                            ///< kept free of obstacles [m]
  bool look_ahead = false;                            ///< face along the way instead of look_at
};

/// Noise of an inertial unit; the defaults are those of a consumer MEMS unit (InvenSense MPU-9250 data sheet rev 1.1:
/// 0.01 deg/s/sqrt(Hz), 300 ug/sqrt(Hz)), bias walks as found by Allan variance for this class.
struct ImuConfig {
  double rate = 200;                 ///< [Hz]
  double gyro_noise = 1.7e-4;        ///< [rad/s/sqrt(Hz)]
  double accel_noise = 2.9e-3;       ///< [m/s^2/sqrt(Hz)]
  double gyro_bias_walk = 2.0e-5;    ///< [rad/s^2/sqrt(Hz)]
  double accel_bias_walk = 6e-4;     ///< [m/s^3/sqrt(Hz)]
  double gyro_bias = 0.01;           ///< standard deviation of the initial bias [rad/s]
  double accel_bias = 0.06;          ///< standard deviation of the initial bias [m/s^2]
  double mag_rate = 50;              ///< [Hz]
  double mag_noise = 3e-7;           ///< [T]
  double mag_disturbance = 0;        ///< by iron nearby, root mean square of each axis [T]; changes over a few metres
  bool ground_magnetometer = false;  ///< the ground robot carries one, too
};

struct ImagerConfig {
  air_ground_common::CameraModel camera;
  double rate = 20;             ///< [Hz]
  int samples = 4;              ///< rays a pixel, spread over the exposure
  double target_mean = 0.42;    ///< mean grey value the exposure control aims at, of 1
  double min_exposure = 0.001;  ///< [s]
  double max_exposure = 0.008;  ///< [s]
  double sensitivity = 300;     ///< signal of a white surface in full light per second of exposure, of full well [1/s]
  double response = 0.7;        ///< exponent of the response curve (1: linear)
  double vignetting = 0.35;     ///< light lost in the corner, of 1
  double full_well = 9000;      ///< electrons at white
  double read_noise = 12;       ///< electrons
};

/// Kinect noise: Nguyen, Izadi, Lovell 2012 (axial), Khoshelham, Elberink 2012 (quantised disparity).
struct DepthConfig {
  double min_range = 0.5, max_range = 4.5;  ///< [m]
  double focal = 580;                       ///< of the infrared camera [px]
  double baseline = 0.075;                  ///< projector to infrared camera [m]
  double subpixel = 8;                      ///< disparity steps per pixel
  double lateral = 0.5;                     ///< standard deviation of the lookup [px]
  double dropout = 0.003;                   ///< share of pixels lost at random
  bool noise = true;
};

struct SimConfig {
  std::string name = "world";
  WorldConfig world;
  StreetConfig street;
  FlightConfig flight;
  LaneConfig lane;
  ImagerConfig mav_camera;
  ImagerConfig ground_camera;
  DepthConfig depth;
  ImuConfig imu;
  GpsConfig gps;
  BarometerConfig barometer;
  FaultsConfig faults;
  air_ground_common::Pose T_mav_base_camera = air_ground_common::Pose::Identity();
  air_ground_common::Pose T_mav_base_imu = air_ground_common::Pose::Identity();
  air_ground_common::Pose T_ground_base_camera = air_ground_common::Pose::Identity();
  air_ground_common::Pose T_ground_base_imu = air_ground_common::Pose::Identity();

  /// The street is flown by the MAV alone.
  bool hasGroundRobot() const { return world.kind != WorldKind::kStreet; }
  bool hasCity() const { return world.kind == WorldKind::kStreet; }

  /// Cameras and mounts of the suite's two robots.
  static SimConfig defaults();
};

/// Reads a world file; unknown keys and values out of range throw std::invalid_argument naming file and key.
SimConfig loadSimConfig(const std::string& yaml_path);

}  // namespace air_ground_sim
