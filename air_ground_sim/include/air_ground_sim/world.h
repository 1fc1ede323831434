// Worlds made of textured surface patches: floors, boxes, pallets, debris, rocks, a height field.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "air_ground_common/geometry.h"
#include "air_ground_common/mesh.h"
#include "air_ground_sim/config.h"

namespace air_ground_sim {

enum class Material {
  kConcrete,
  kPlanks,
  kTiles,
  kGravel,
  kCardboard,
  kPaintedBox,
  kWood,
  kBrick,
  kPlaster,
  kRock,
  kPaper,
  kPlain  ///< one grey, without any texture
};

/// A grid of (columns + 1) x (rows + 1) vertices with one texture over it: a rectangle has one cell.
struct Patch {
  int columns = 1, rows = 1;
  std::vector<Eigen::Vector3f>
      vertices;                 ///< row by row, in world [m]; counter-clockwise seen from outside (column x row)
  float width = 1, height = 1;  ///< extent of the texture along columns and rows [m]
  float texel = 0.0025f;        ///< size of a texel [m]
  Material material = Material::kConcrete;
  bool printed = false;      ///< carries marks, text, tape
  bool top = false;          ///< the upper face of a box: tape along it
  std::uint64_t seed = 0;    ///< of its texture
  std::uint64_t object = 0;  ///< texture seed shared by the faces of one object (its base colour)

  std::vector<float> column_at, row_at;  ///< texture coordinates of the grid's lines; empty: evenly spaced
  std::vector<std::uint8_t> holes;       ///< 1 for each cell that is left open, row by row; empty: none
  int light_step = 4;                    ///< texels between samples of the light
  /// Paints the texture in place of the material: CV_8UC3, R G B, row 0 at v = 0.
  std::function<cv::Mat(const Patch&)> painter;

  float columnAt(int c) const {
    return column_at.empty() ? static_cast<float>(c) / static_cast<float>(columns) : column_at[c];
  }
  float rowAt(int r) const { return row_at.empty() ? static_cast<float>(r) / static_cast<float>(rows) : row_at[r]; }
  bool isHole(int c, int r) const { return !holes.empty() && holes[static_cast<std::size_t>(r) * columns + c]; }

  Eigen::Vector3f point(float u, float v) const;  ///< position at texture coordinates in [0, 1]
};

/// A rectangle with corners origin, origin + u, origin + v.
Patch rectanglePatch(const Eigen::Vector3d& origin, const Eigen::Vector3d& u, const Eigen::Vector3d& v);

Material floorMaterial(FloorStyle style);

struct World {
  std::vector<Patch> patches;
  Eigen::Vector2d mav_start = Eigen::Vector2d::Zero();        ///< take-off place, free of obstacles [m]
  LaneConfig lane;                                            ///< the ground robot's way after the seed's variation
  FlightConfig flight;                                        ///< centre after the seed's variation
  std::vector<Eigen::Vector2d> flight_way;                    ///< of the MAV where it flies no loops: in rooms [m]
  std::vector<Eigen::Vector2d> doors;                         ///< centres, in rooms [m]
  Eigen::Vector3f sun = Eigen::Vector3f(0.35f, 0.25f, 0.9f);  ///< direction towards the key light, unit
  float ambient = 0.45f;                                      ///< share of the light that comes from everywhere
  float sky = 0.5f;                                           ///< radiance where a ray meets nothing
  cv::Mat sky_map;                                 ///< its picture (see paintSky), scaled by `sky`; empty: even
  Eigen::Vector3f tint = Eigen::Vector3f::Ones();  ///< colour of the light
  float sun_reach = 4.0f;                          ///< what is farther casts no shadow of the key light [m]
  float ambient_reach = 1.5f;                      ///< what is farther does not shade the surrounding light [m]
  std::shared_ptr<const void> keep_alive;          ///< what the painters refer to
};

/// All patches as one mesh; patch i's triangles follow those of patch i - 1, two a cell.
air_ground_common::TriangleMesh meshOf(const World& world);

/// Oriented cuboid with its base centre at T_world_base: adds its six faces.
struct Cuboid {
  air_ground_common::Pose T_world_base = air_ground_common::Pose::Identity();
  Eigen::Vector3d size = Eigen::Vector3d::Ones();  ///< [m]
  Material material = Material::kCardboard;
  bool printed = true;
  std::uint64_t seed = 0;
};
void addCuboid(const Cuboid& cuboid, double texel, World* world);

}  // namespace air_ground_sim
