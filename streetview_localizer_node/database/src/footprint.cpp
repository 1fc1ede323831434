#include "footprint.h"

#include <cmath>
#include <vector>

#include "geopackage.h"

namespace streetview_localizer {
namespace {

// GEOS is happier on a grid of a millimetre (or its like in degrees).
double snapped(double v, double grid) { return std::round(v / grid) * grid; }

}  // namespace

std::unique_ptr<OGRGeometry> footprint(const CityModel& model, const std::vector<int>& triangles) {
  const double grid = std::abs(model.origin.x()) <= 360 && !model.crs.empty() ? 1e-8 : 1e-3;
  OGRMultiPolygon polygons;
  OGRMultiLineString lines;
  OGRMultiPoint points;
  for (const int i : triangles) {
    Eigen::Vector3d c[3];
    for (int k = 0; k < 3; ++k) {
      c[k] = model.crsFromWorld(model.mesh.vertices[model.mesh.triangles[i][k]].cast<double>());
      c[k].x() = snapped(c[k].x(), grid);
      c[k].y() = snapped(c[k].y(), grid);
      points.addGeometryDirectly(new OGRPoint(c[k].x(), c[k].y()));
    }
    const double area = 0.5 * ((c[1] - c[0]).head<2>().x() * (c[2] - c[0]).y() - (c[1] - c[0]).y() * (c[2] - c[0]).x());
    if (std::abs(area) > 100 * grid * grid) {
      auto* ring = new OGRLinearRing;
      for (const int k : {0, 1, 2, 0}) ring->addPoint(c[k].x(), c[k].y());
      auto* polygon = new OGRPolygon;
      polygon->addRingDirectly(ring);
      polygons.addGeometryDirectly(polygon);
    } else {
      auto* line = new OGRLineString;
      for (const int k : {0, 1, 2}) line->addPoint(c[k].x(), c[k].y());
      lines.addGeometryDirectly(line);
    }
  }
  const QuietGdal quiet;
  std::unique_ptr<OGRGeometry> result;
  if (!polygons.IsEmpty()) result.reset(polygons.UnionCascaded());
  // Walls alone: a strip as thick as a pencil line, so that the layer shows them.
  if (!result || result->IsEmpty()) result.reset(lines.Buffer(50 * grid, 2));
  if (!result || result->IsEmpty()) result.reset(points.ConvexHull());
  if (!result) result = std::make_unique<OGRMultiPolygon>();
  result.reset(OGRGeometryFactory::forceToMultiPolygon(result.release()));
  return result;
}

}  // namespace streetview_localizer
