// What the readers produce before it becomes a mesh: polygons with holes in the file's own coordinates.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "streetview_localizer/city_model.h"

namespace streetview_localizer {

using Ring = std::vector<Eigen::Vector3d>;

struct Polygon {
  std::vector<Ring> rings;         ///< the outer one first; not closed (last point differs from the first)
  std::optional<Surface> surface;  ///< empty: the file does not say
  int building = -1;
  std::string theme;  ///< of what is no building: the file's word, "Road"; empty where it has none
};

struct PolygonModel {
  std::vector<Polygon> polygons;
  std::vector<std::string> building_ids;
  std::string srs;  ///< as in the file, empty if it does not say
  std::vector<std::string> remarks;
  bool turned = false;  ///< from y up to z up
};

/// Calls `f` with each point, which it may move.
template <typename F>
void forEachPoint(PolygonModel* model, const F& f) {
  for (Polygon& polygon : model->polygons)
    for (Ring& ring : polygon.rings)
      for (Eigen::Vector3d& p : ring) f(p);
}

/// Newell's normal, of length twice the area of the ring.
Eigen::Vector3d areaVector(const Ring& ring);

/// Triangles of a polygon, wound as its outer ring. Points are the corners of all rings in order. Self-touching and
/// slightly non-planar rings are accepted; corners where edges cross are appended to `points`. Nothing for a polygon
/// without area.
std::vector<std::array<int, 3>> triangulate(const std::vector<Ring>& rings, std::vector<Eigen::Vector3d>* points);

/// A file that is no city model, where a folder may hold some: metadata, styles, packed files.
struct NoModel : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// All may come back without polygons, or with terrain alone, as tiles have it. Throw NoModel, or std::runtime_error
/// for a model that is broken.
PolygonModel readCityGml(const std::string& path, int lod);
PolygonModel readCityJson(const std::string& path, int lod);
/// `y_up`: CityModelOptions::y_up.
PolygonModel readObj(const std::string& path, bool y_up);

/// Of an object's polygons by level of detail, the level to use: the wanted one, or the finest that holds at least half
/// the area of the fullest (a building may carry one detailed door beside a complete coarser shell). -1 if there is
/// none.
int chooseLod(const std::array<double, 4>& area_of_lod, int wanted);

}  // namespace streetview_localizer
