// A cadastral 3D city model as one triangle mesh in the local frame, read from CityGML, CityJSON or OBJ.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/geodesy.h"
#include "air_ground_common/mesh.h"

namespace streetview_localizer {

/// What a triangle belongs to. `kOther`: doors, windows, balconies and whatever else is fixed to a building, and
/// bridges.
enum class Surface : std::uint8_t { kWall = 0, kRoof = 1, kGround = 2, kOther = 3 };

struct CityModel {
  air_ground_common::TriangleMesh mesh;   ///< in world [m]; normals point out of the building where the file tells
  std::vector<Surface> surface;           ///< of each triangle
  std::vector<int> building;              ///< of each triangle: index into building_ids, -1 for terrain and roads
  std::vector<std::string> building_ids;  ///< gml:id, CityJSON key, or OBJ object/group name

  /// Horizontal system that the frame was made from, "EPSG:2056"; empty for a model in a local frame of its own: then
  /// world is the file's frame minus `origin`.
  std::string crs;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();            ///< of world: (easting, northing, height) in crs [m]
  std::shared_ptr<const air_ground_common::LocalFrame> frame;  ///< null where crs is empty
  bool turned = false;     ///< y was up in the file (CityModelOptions::y_up); false for a model out of a database
  double height_unit = 1;  ///< of the file's heights [m]; mesh, origin and world are in metres, whatever it is

  /// What the coordinates of the files were taken as, "east, north" or "north, east"; empty without crs, and of a model
  /// out of a database.
  std::string axis_order;
  /// Tells the model from any other, whatever files it was read from and wherever world's origin is: counts, heights, a
  /// checksum of its coordinates in crs. Empty for a model out of a database.
  std::string identity;

  std::vector<std::string> remarks;  ///< one line each: what was odd in the file and what was done about it

  /// Between crs (x easting, y northing, z height) and world. Throw std::invalid_argument outside the system's domain.
  Eigen::Vector3d worldFromCrs(const Eigen::Vector3d& point) const;
  Eigen::Vector3d crsFromWorld(const Eigen::Vector3d& point) const;

  bool isBuilding(int triangle) const { return building[triangle] >= 0 && surface[triangle] != Surface::kGround; }
};

struct CityModelOptions {
  /// "EPSG:2056"; overrides what the file says. Needed for an OBJ in a geographic system; empty = the file's own, or
  /// none.
  std::string crs;
  /// Of world, in the file's coordinates (with `offset`; height in its unit, to which height_offset is not added);
  /// empty = the middle of the model in plan and its lowest point, rounded to whole metres (a local model without crs
  /// keeps its own origin).
  std::optional<Eigen::Vector3d> origin;
  /// Level of detail to take where a building has several; -1 = the finest.
  int lod = -1;
  /// Added to the file's heights [m], for models in another vertical datum than the geotags.
  double height_offset = 0;
  /// Of the file's heights [m]; 0 = as its vertical system says, metres where it names none. Without crs only metres
  /// are taken: nothing converts the plan.
  double height_unit = 0;
  /// Of the files' coordinates, added before all else, in their units: (easting, northing, height) of the place that an
  /// exporter took for the origin.
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
  /// OBJ alone: y is up and z comes towards the viewer, as in most programs that render; else z is up.
  bool y_up = false;
};

/// Reads one file, by its contents: CityGML 1.0-3.0 (LoD1-3), CityJSON 1.0-2.0, Wavefront OBJ; or every such file of a
/// folder and the folders in it, merged into one model: what else lies there is passed over with a remark. Throws
/// std::runtime_error with one line: the file, what is wrong, what to do.
CityModel readCityModel(const std::string& path, const CityModelOptions& options = {});

}  // namespace streetview_localizer
