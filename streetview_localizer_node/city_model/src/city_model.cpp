#include "streetview_localizer/city_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <unordered_map>

#include "air_ground_common/text.h"
#include "ground_themes.h"
#include "model_files.h"
#include "polygons.h"

namespace streetview_localizer {

using air_ground_common::formatted;
using air_ground_common::LocalFrame;

namespace {

// Where the file is silent: steep is wall; what faces down is a floor; the rest is roof, unless it belongs to no
// building.
Surface classify(const Polygon& polygon) {
  if (polygon.surface) return *polygon.surface;
  if (polygon.building < 0) return Surface::kGround;
  const Eigen::Vector3d n = areaVector(polygon.rings[0]).normalized();
  if (std::abs(n.z()) < 0.5) return Surface::kWall;
  return n.z() > 0 ? Surface::kRoof : Surface::kGround;
}

// Corners of one building that agree to 0.1 mm become one vertex.
class VertexMerger {
 public:
  int index(const Eigen::Vector3d& p, CityModel* model) {
    const Eigen::Vector3d q = p * 1e4;
    const std::array<long long, 3> key = {std::llround(q.x()), std::llround(q.y()), std::llround(q.z())};
    const auto inserted = vertices_.emplace(key, static_cast<int>(model->mesh.vertices.size()));
    if (inserted.second) model->mesh.vertices.push_back(p.cast<float>());
    return inserted.first->second;
  }

 private:
  struct Hash {
    std::size_t operator()(const std::array<long long, 3>& k) const {
      return static_cast<std::size_t>(k[0]) * 73856093u ^ static_cast<std::size_t>(k[1]) * 19349663u ^
             static_cast<std::size_t>(k[2]) * 83492791u;
    }
  };
  std::unordered_map<std::array<long long, 3>, int, Hash> vertices_;
};

// A closed building whose volume comes out negative is inside out.
void orientOutwards(CityModel* model) {
  const std::size_t buildings = model->building_ids.size();
  std::vector<std::map<std::pair<int, int>, int>> edges(buildings);
  std::vector<double> volume(buildings, 0);
  std::vector<Eigen::Vector3d> reference(buildings, Eigen::Vector3d::Zero());
  std::vector<char> started(buildings, 0);
  for (std::size_t i = 0; i < model->mesh.triangles.size(); ++i) {
    const int b = model->building[i];
    if (b < 0) continue;
    const Eigen::Vector3i& t = model->mesh.triangles[i];
    const auto& v = model->mesh.vertices;
    if (!started[b]) reference[b] = v[t[0]].cast<double>();
    started[b] = 1;
    for (int k = 0; k < 3; ++k) ++edges[b][{t[k], t[(k + 1) % 3]}];
    volume[b] += (v[t[0]].cast<double>() - reference[b])
                     .dot((v[t[1]].cast<double>() - reference[b]).cross(v[t[2]].cast<double>() - reference[b]));
  }
  std::vector<char> flip(buildings, 0);
  int flipped = 0;
  for (std::size_t b = 0; b < buildings; ++b) {
    if (volume[b] >= 0) continue;
    const bool closed = std::all_of(edges[b].begin(), edges[b].end(), [&](const auto& e) {
      const auto back = edges[b].find({e.first.second, e.first.first});
      return back != edges[b].end() && back->second == e.second;
    });
    flip[b] = closed;
    flipped += closed;
  }
  if (flipped == 0) return;
  for (std::size_t i = 0; i < model->mesh.triangles.size(); ++i)
    if (model->building[i] >= 0 && flip[model->building[i]])
      std::swap(model->mesh.triangles[i][1], model->mesh.triangles[i][2]);
  model->remarks.push_back(std::to_string(flipped) + " buildings were inside out and were turned");
}

}  // namespace

Eigen::Vector3d CityModel::worldFromCrs(const Eigen::Vector3d& point) const {
  return frame ? frame->fromCrs(point) : Eigen::Vector3d(point - origin);
}
Eigen::Vector3d CityModel::crsFromWorld(const Eigen::Vector3d& point) const {
  return frame ? frame->toCrs(point) : Eigen::Vector3d(point + origin);
}

namespace {

/// Far from its origin the frame's z is no height, and float coordinates lose centimetres: a slip of the command line.
void checkOrigin(const Box& box, const CityModelOptions& options, const CityModel& model) {
  if (!options.origin) return;
  constexpr double kFarthest = 50e3, kHighest = 10e3;  // [m]
  const Eigen::Vector3d near = model.origin.cwiseMax(box.low).cwiseMin(box.high);
  const auto level = [&](const Eigen::Vector3d& p) {
    const Eigen::Vector3d foot(p.x(), p.y(), 0);
    return model.frame ? model.frame->fromCrs(foot) : foot;
  };
  const double plan = (level(model.origin) - level(near)).norm(), height = std::abs(model.origin.z() - near.z());
  if (plan <= kFarthest && height <= kHighest) return;
  const Eigen::Vector3d& o = *options.origin;
  throw std::runtime_error(formatted("--origin (%.10g, %.10g, %.10g) lies %.0f km from the model", o.x(), o.y(), o.z(),
                                     std::max(plan, height) / 1000) +
                           ": give easting, northing and height as its file counts them");
}

/// Origin and frame of the model, from its reference system and extent.
void chooseFrame(const std::string& path, const Box& box, const CityModelOptions& options, CityModel* result) {
  CityModel& model = *result;
  std::optional<Eigen::Vector3d> origin = options.origin;
  if (origin) origin->z() *= model.height_unit;
  if (model.crs.empty()) {
    if (box.low.cwiseAbs().maxCoeff() > 1e5 || box.high.cwiseAbs().maxCoeff() > 1e5)
      throw std::runtime_error(
          path + " has coordinates of a national grid but does not name it: give its system, like --crs EPSG:2056");
    model.origin = origin.value_or(Eigen::Vector3d::Zero());
  } else {
    const Eigen::Vector3d c = 0.5 * (box.low + box.high);
    const bool degrees = box.high.head<2>().cwiseAbs().maxCoeff() <= 360;
    const double step = degrees ? 1e-5 : 1;
    model.origin = origin.value_or(
        Eigen::Vector3d(std::round(c.x() / step) * step, std::round(c.y() / step) * step, std::floor(box.low.z())));
    model.frame = std::make_shared<LocalFrame>(model.crs, model.origin);
  }
  checkOrigin(box, options, model);
}

/// Triangles of all polygons, welded within each building; `polygons` in the world frame.
void triangulateAll(const PolygonModel& polygons, CityModel* result) {
  CityModel& model = *result;
  std::map<int, VertexMerger> mergers;
  std::vector<Eigen::Vector3d> points;
  int empty = 0;
  for (const Polygon& polygon : polygons.polygons) {
    const auto triangles = triangulate(polygon.rings, &points);
    if (triangles.empty()) ++empty;
    const Surface surface = classify(polygon);
    VertexMerger& merger = mergers[polygon.building];
    for (const auto& t : triangles) {
      Eigen::Vector3i corners;
      for (int k = 0; k < 3; ++k) corners[k] = merger.index(points[t[k]], &model);
      if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0]) continue;
      model.mesh.triangles.push_back(corners);
      model.surface.push_back(surface);
      model.building.push_back(polygon.building);
    }
  }
  if (empty > 0) model.remarks.push_back(std::to_string(empty) + " polygons without area were left out");
}

/// Ids of buildings that came out empty go, so that every id has triangles.
void numberBuildings(const std::vector<std::string>& ids, CityModel* model) {
  std::vector<int> number(ids.size(), -1);
  for (const int b : model->building)
    if (b >= 0) number[b] = 0;
  for (std::size_t b = 0; b < ids.size(); ++b) {
    if (number[b] < 0) continue;
    number[b] = static_cast<int>(model->building_ids.size());
    model->building_ids.push_back(ids[b]);
  }
  for (int& b : model->building)
    if (b >= 0) b = number[b];
}

}  // namespace

CityModel readCityModel(const std::string& path, const CityModelOptions& options) {
  CityModel model;
  PolygonModel polygons = readModelFiles(path, options, &model);
  const auto move = [&](const auto& moved) { forEachPoint(&polygons, [&](Eigen::Vector3d& p) { p = moved(p); }); };
  model.remarks = std::move(polygons.remarks);
  try {
    chooseFrame(path, bounds(polygons), options, &model);
    move([&](const Eigen::Vector3d& p) { return model.worldFromCrs(p); });
  } catch (const std::invalid_argument& e) {
    throw std::runtime_error(path + ": " + e.what());
  }
  leaveOutStrayGround(&polygons, &model.remarks);
  triangulateAll(polygons, &model);
  numberBuildings(polygons.building_ids, &model);
  if (model.building_ids.empty())
    throw std::runtime_error(path + " has no buildings with walls (LoD1 to LoD3): a model of the facades is needed");
  orientOutwards(&model);
  return model;
}

}  // namespace streetview_localizer
