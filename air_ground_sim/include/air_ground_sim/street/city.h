// What a city gives to a localizer, as files: panoramas with geotags, the cadastral model, and the truth to compare
// with.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "air_ground_common/geodesy.h"
#include "air_ground_sim/recording.h"
#include "air_ground_sim/street/street.h"

namespace air_ground_sim {

enum class SurfaceKind { kGround, kWall, kRoof };

struct ModelSurface {
  SurfaceKind kind = SurfaceKind::kWall;
  std::vector<Eigen::Vector3d> polygon;  ///< in world, counter-clockwise seen from outside [m]
};

/// A building as a cadastre has it (LoD2): walls, roof, ground; no openings, balconies, eaves overhangs or chimneys.
/// `with_error`: moved by Building::model_error, as the model's files are.
std::vector<ModelSurface> modelSurfaces(const Building& building, bool with_error);

/// LoD2 buildings in `frame`'s coordinate system. Written through temporary files; throw std::runtime_error.
void writeCityGml(const std::string& path, const Street& street, const air_ground_common::LocalFrame& frame);
void writeObj(const std::string& path, const Street& street, const air_ground_common::LocalFrame& frame);

/// A line of geotags.csv.
struct Geotag {
  air_ground_common::Geodetic place;  ///< height in the vertical datum of the origin
  double heading = 0;                 ///< of the image's centre, clockwise from true north [deg]
  double pitch = 0;                   ///< of the image's centre, upwards [deg]
  double roll = 0;                    ///< right side down [deg]
};

/// `T_world_panorama`: x to the image's centre, y left, z up; R = Rz(90 deg - heading) Ry(-pitch) Rx(roll).
Geotag geotagOf(const air_ground_common::LocalFrame& frame, const air_ground_common::Pose& T_world_panorama);

/// Panoramas, geotags.csv, panorama_truth.csv, model.gml, model.obj, camera.yaml, city.yaml. `progress` (may be empty)
/// is called with panoramas done and in all.
void writeCity(const SimConfig& config, const Street& street, const std::string& folder,
               const std::function<void(int, int)>& progress);

/// `count` pictures of the flight, evenly spread over it, in folder/queries, and of streets without panoramas in
/// folder/queries_elsewhere; the truth beside them as <folder>_truth.csv.
void writeQueries(Recording* recording, int count, const std::string& folder);

}  // namespace air_ground_sim
