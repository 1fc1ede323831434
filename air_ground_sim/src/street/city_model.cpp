// The street's buildings as CityGML 2.0 (LoD2) and Wavefront OBJ.
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/text.h"
#include "air_ground_sim/street/city.h"

namespace air_ground_sim {
namespace {

using Eigen::Vector3d;

void writeWhole(const std::string& path, const std::string& text) {
  const std::string part = path + ".part";
  std::ofstream out(part, std::ios::binary);
  out << text;
  out.close();
  if (!out || std::rename(part.c_str(), path.c_str()) != 0) throw std::runtime_error("cannot write '" + path + "'");
}

std::string number(double v) { return air_ground_common::formatted("%.3f", v); }

const char* nameOf(SurfaceKind kind) {
  return kind == SurfaceKind::kGround ? "GroundSurface" : kind == SurfaceKind::kWall ? "WallSurface" : "RoofSurface";
}

}  // namespace

std::vector<ModelSurface> modelSurfaces(const Building& b, bool with_error) {
  const double w = b.width, d = b.depth, e = b.eaves, ridge = e + b.roof_rise, middle = 0.5 * d;
  const Vector3d shift = with_error ? b.model_error : Vector3d(Vector3d::Zero());
  std::vector<ModelSurface> surfaces;
  const auto add = [&](SurfaceKind kind, const std::vector<Vector3d>& local) {
    ModelSurface s;
    s.kind = kind;
    for (const auto& p : local) s.polygon.push_back(b.T_world_front * p + shift);
    surfaces.push_back(s);
  };
  add(SurfaceKind::kGround, {{0, 0, 0}, {0, d, 0}, {w, d, 0}, {w, 0, 0}});
  add(SurfaceKind::kWall, {{0, 0, 0}, {w, 0, 0}, {w, 0, e}, {0, 0, e}});
  add(SurfaceKind::kWall, {{w, d, 0}, {0, d, 0}, {0, d, e}, {w, d, e}});
  if (b.roof == RoofKind::kGable) {
    add(SurfaceKind::kWall, {{0, d, 0}, {0, 0, 0}, {0, 0, e}, {0, middle, ridge}, {0, d, e}});
    add(SurfaceKind::kWall, {{w, 0, 0}, {w, d, 0}, {w, d, e}, {w, middle, ridge}, {w, 0, e}});
  } else {
    add(SurfaceKind::kWall, {{0, d, 0}, {0, 0, 0}, {0, 0, e}, {0, d, e}});
    add(SurfaceKind::kWall, {{w, 0, 0}, {w, d, 0}, {w, d, e}, {w, 0, e}});
  }
  if (b.roof == RoofKind::kFlat) {
    add(SurfaceKind::kRoof, {{0, 0, e}, {w, 0, e}, {w, d, e}, {0, d, e}});
    return surfaces;
  }
  const double inset = b.hipInset();
  add(SurfaceKind::kRoof, {{0, 0, e}, {w, 0, e}, {w - inset, middle, ridge}, {inset, middle, ridge}});
  add(SurfaceKind::kRoof, {{w, d, e}, {0, d, e}, {inset, middle, ridge}, {w - inset, middle, ridge}});
  if (b.roof == RoofKind::kHip) {
    add(SurfaceKind::kRoof, {{0, d, e}, {0, 0, e}, {inset, middle, ridge}});
    add(SurfaceKind::kRoof, {{w, 0, e}, {w, d, e}, {w - inset, middle, ridge}});
  }
  return surfaces;
}

void writeCityGml(const std::string& path, const Street& street, const air_ground_common::LocalFrame& frame) {
  std::ostringstream members;
  Vector3d low = Vector3d::Constant(1e30), high = -low;
  for (const auto& b : street.buildings) {
    members << "  <core:cityObjectMember>\n    <bldg:Building gml:id=\"" << b.id
            << "\">\n      <bldg:measuredHeight uom=\"m\">" << number(b.eaves + b.roof_rise)
            << "</bldg:measuredHeight>\n      <bldg:storeysAboveGround>" << b.floors << "</bldg:storeysAboveGround>\n";
    const auto surfaces = modelSurfaces(b, true);
    members << "      <bldg:lod2Solid>\n        <gml:Solid gml:id=\"" << b.id
            << "_solid\"><gml:exterior><gml:CompositeSurface>\n";
    for (std::size_t i = 0; i < surfaces.size(); ++i)
      members << "          <gml:surfaceMember xlink:href=\"#" << b.id << "_poly_" << i << "\"/>\n";
    members << "        </gml:CompositeSurface></gml:exterior></gml:Solid>\n      </bldg:lod2Solid>\n";
    for (std::size_t i = 0; i < surfaces.size(); ++i) {
      const char* name = nameOf(surfaces[i].kind);
      members << "      <bldg:boundedBy>\n        <bldg:" << name << " gml:id=\"" << b.id << "_surface_" << i
              << "\">\n          <bldg:lod2MultiSurface><gml:MultiSurface><gml:surfaceMember>\n"
              << "            <gml:Polygon gml:id=\"" << b.id << "_poly_" << i
              << "\"><gml:exterior><gml:LinearRing><gml:posList srsDimension=\"3\">";
      for (std::size_t k = 0; k <= surfaces[i].polygon.size(); ++k) {
        const Vector3d p = frame.toCrs(surfaces[i].polygon[k % surfaces[i].polygon.size()]);
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
        members << (k ? " " : "") << number(p.x()) << ' ' << number(p.y()) << ' ' << number(p.z());
      }
      members << "</gml:posList></gml:LinearRing></gml:exterior></gml:Polygon>\n          "
                 "</gml:surfaceMember></gml:MultiSurface></bldg:lod2MultiSurface>\n        </bldg:"
              << name << ">\n      </bldg:boundedBy>\n";
    }
    members << "    </bldg:Building>\n  </core:cityObjectMember>\n";
  }
  std::ostringstream out;
  out << "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<core:CityModel "
         "xmlns:core=\"http://www.opengis.net/citygml/2.0\" "
         "xmlns:bldg=\"http://www.opengis.net/citygml/building/2.0\" "
         "xmlns:gml=\"http://www.opengis.net/gml\" xmlns:xlink=\"http://www.w3.org/1999/xlink\">\n  <gml:boundedBy>\n  "
         "  <gml:Envelope "
         "srsName=\""
      << street.config.crs << "\" srsDimension=\"3\">\n      <gml:lowerCorner>" << number(low.x()) << ' '
      << number(low.y()) << ' ' << number(low.z()) << "</gml:lowerCorner>\n      <gml:upperCorner>" << number(high.x())
      << ' ' << number(high.y()) << ' ' << number(high.z())
      << "</gml:upperCorner>\n    </gml:Envelope>\n  </gml:boundedBy>\n"
      << members.str() << "</core:CityModel>\n";
  writeWhole(path, out.str());
}

void writeObj(const std::string& path, const Street& street, const air_ground_common::LocalFrame& frame) {
  std::ostringstream out;
  out << "# crs: " << street.config.crs << "\n# vertices: easting, northing, height [m]\n";
  std::size_t next = 1;
  for (const auto& b : street.buildings) {
    out << "o " << b.id << '\n';
    for (const auto& s : modelSurfaces(b, true)) {
      for (const auto& q : s.polygon) {
        const Vector3d p = frame.toCrs(q);
        out << "v " << number(p.x()) << ' ' << number(p.y()) << ' ' << number(p.z()) << '\n';
      }
      out << "g " << b.id << ' ' << nameOf(s.kind) << "\nf";
      for (std::size_t k = 0; k < s.polygon.size(); ++k) out << ' ' << next++;
      out << '\n';
    }
  }
  writeWhole(path, out.str());
}

}  // namespace air_ground_sim
