// A house as CityGML, and measures of models.
#pragma once

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "../src/polygons.h"
#include "air_ground_common/text.h"
#include "streetview_localizer/city_model.h"

namespace streetview_localizer {

inline double areaOf(const CityModel& m, Surface surface) {
  double area = 0;
  for (std::size_t i = 0; i < m.mesh.triangles.size(); ++i) {
    if (m.surface[i] != surface) continue;
    const auto& t = m.mesh.triangles[i];
    const Eigen::Vector3d a = m.mesh.vertices[t[0]].cast<double>();
    area += 0.5 * (m.mesh.vertices[t[1]].cast<double>() - a).cross(m.mesh.vertices[t[2]].cast<double>() - a).norm();
  }
  return area;
}

// Six faces, wound outwards, of a box 10 (east) x 20 (north) x 5 (up) at `o`; the face y = 0 has a window 2 x 1.
using Faces = std::vector<std::vector<Ring>>;
inline Faces boxFaces(const Eigen::Vector3d& o) {
  const auto p = [&](double x, double y, double z) { return Eigen::Vector3d(o + Eigen::Vector3d(x, y, z)); };
  return {{{p(0, 0, 0), p(0, 20, 0), p(10, 20, 0), p(10, 0, 0)}},
          {{p(0, 0, 5), p(10, 0, 5), p(10, 20, 5), p(0, 20, 5)}},
          {{p(0, 0, 0), p(10, 0, 0), p(10, 0, 5), p(0, 0, 5)}, {p(4, 0, 2), p(4, 0, 3), p(6, 0, 3), p(6, 0, 2)}},
          {{p(10, 20, 0), p(0, 20, 0), p(0, 20, 5), p(10, 20, 5)}},
          {{p(0, 20, 0), p(0, 0, 0), p(0, 0, 5), p(0, 20, 5)}},
          {{p(10, 0, 0), p(10, 20, 0), p(10, 20, 5), p(10, 0, 5)}}};
}
inline const char* const kNames[] = {"GroundSurface", "RoofSurface", "WallSurface",
                                     "WallSurface",   "WallSurface", "WallSurface"};

inline std::string posList(const Ring& ring, bool north_first) {
  std::string out;
  for (std::size_t i = 0; i <= ring.size(); ++i) {
    const Eigen::Vector3d& p = ring[i % ring.size()];
    out += air_ground_common::formatted("%.6f %.6f %.6f ", north_first ? p.y() : p.x(), north_first ? p.x() : p.y(),
                                        p.z());
  }
  return out;
}

inline std::string gmlPolygon(const std::vector<Ring>& rings, bool north_first) {
  std::string out = "<gml:Polygon>";
  for (std::size_t i = 0; i < rings.size(); ++i) {
    const std::string side = i == 0 ? "exterior" : "interior";
    out += "<gml:" + side + "><gml:LinearRing><gml:posList>" + posList(rings[i], north_first) +
           "</gml:posList></gml:LinearRing></gml:" + side + ">";
  }
  return out + "</gml:Polygon>";
}

// LoD2 with thematic surfaces; `version` 1, 2 or 3.
inline std::string cityGml(const std::string& srs, const Eigen::Vector3d& origin, int version = 2,
                           bool north_first = false) {
  std::string out =
      "<?xml version=\"1.0\"?>\n<CityModel xmlns:gml=\"http://www.opengis.net/gml\" "
      "xmlns:bldg=\"http://www.opengis.net/citygml/building/" +
      std::to_string(version) + ".0\"><gml:boundedBy><gml:Envelope srsName=\"" + srs +
      "\" srsDimension=\"3\"/></gml:boundedBy><cityObjectMember><bldg:Building gml:id=\"house\">";
  const Faces faces = boxFaces(origin);
  const std::string boundary = version == 3 ? "boundary" : "bldg:boundedBy", prefix = version == 3 ? "con:" : "bldg:";
  for (std::size_t i = 0; i < faces.size(); ++i)
    out += "<" + boundary + "><" + prefix + kNames[i] + "><" + prefix +
           "lod2MultiSurface><gml:MultiSurface><gml:surfaceMember>" + gmlPolygon(faces[i], north_first) +
           "</gml:surfaceMember></gml:MultiSurface></" + prefix + "lod2MultiSurface></" + prefix + kNames[i] + "></" +
           boundary + ">";
  return out + "</bldg:Building></cityObjectMember></CityModel>";
}

}  // namespace streetview_localizer
