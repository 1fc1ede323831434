#include "coordinate_system.h"

#include <ogr_spatialref.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>

#include "air_ground_common/geodesy.h"
#include "air_ground_common/text.h"

namespace streetview_localizer {

using air_ground_common::formatted;
using air_ground_common::LocalFrame;

namespace {

/// Up to six digits that follow `key` in the text; empty where there are none.
std::string digitsAfter(const std::string& text, const std::string& key) {
  const std::size_t at = text.find(key);
  if (at == std::string::npos) return "";
  const std::size_t begin = at + key.size();
  const std::size_t end = std::min(text.find_first_not_of("0123456789", begin), text.size());
  return text.substr(begin, std::min<std::size_t>(6, end - begin));
}

bool readArea(const OGRSpatialReference& srs, CrsName* name) {
  double west = 0, south = 0, east = 0, north = 0;
  if (!srs.GetAreaOfUse(&west, &south, &east, &north, nullptr) || south < -90) return false;  // -1000: not known
  name->west = west, name->south = south, name->east = east, name->north = north;
  return true;
}

}  // namespace

CrsName parseCrs(const std::string& text) {
  CrsName name;
  std::string definition = text;
  // The German surveys' own names: ETRS89_UTM32*DE_DHHN2016_NH, DE_DHDN_3GK4*...; coordinates come east first.
  bool east_first = true;
  const std::string utm = digitsAfter(text, "ETRS89_UTM"), gauss_krueger = digitsAfter(text, "DHDN_3GK");
  const std::string gml = digitsAfter(text, "epsg.xml#");
  if (utm == "31" || utm == "32" || utm == "33") {
    definition = "EPSG:258" + utm;
  } else if (gauss_krueger.size() == 1 && gauss_krueger >= "2" && gauss_krueger <= "5") {
    definition = "EPSG:3146" + std::to_string(gauss_krueger[0] - '0' + 4);
  } else if (!gml.empty()) {
    definition = "EPSG:" + gml;
  } else if (text.size() >= 4 && digitsAfter(text, "") == text) {
    definition = "EPSG:" + text;
  } else if (text.rfind("EPSG:", 0) != 0 && text.rfind("epsg:", 0) != 0) {
    east_first = false;  // what is not in a short form, which by long custom goes east first, follows the authority
  }
  OGRSpatialReference srs;
  CPLPushErrorHandler(CPLQuietErrorHandler);
  // A name out of a city model must reach neither files nor the network.
#if GDAL_VERSION_NUM >= GDAL_COMPUTE_VERSION(3, 3, 0)
  OGRErr error = srs.SetFromUserInput(definition.c_str(), OGRSpatialReference::SET_FROM_USER_INPUT_LIMITATIONS);
#else
  OGRErr error = srs.SetFromUserInput(definition.c_str());
#endif
  const bool area = error == OGRERR_NONE && readArea(srs, &name);
  if (error == OGRERR_NONE && srs.IsCompound()) {
    const double unit = srs.GetTargetLinearUnits("VERT_CS");
    if (unit > 1e-3 && unit < 1e3) name.height_unit = unit;  // else a slip of who wrote the definition
  }
  if (error == OGRERR_NONE && (srs.IsCompound() || srs.IsVertical())) error = srs.StripVertical();
  if (error == OGRERR_NONE && !area) readArea(srs, &name);  // a compound of two codes has none of its own
  CPLPopErrorHandler();
  if (error != OGRERR_NONE || (!srs.IsProjected() && !srs.IsGeographic()))
    throw std::runtime_error("unknown coordinate system '" + text +
                             "': give a projected or geographic one, like EPSG:2056");
  if (!east_first) name.north_first = srs.EPSGTreatsAsLatLong() || srs.EPSGTreatsAsNorthingEasting();
  if (srs.IsProjected()) name.plan_unit = srs.GetLinearUnits();
  const char* authority = srs.GetAuthorityName(nullptr);
  const char* code = srs.GetAuthorityCode(nullptr);
  if (authority && code) {
    name.horizontal = std::string(authority) + ":" + code;
  } else {
    char* wkt = nullptr;
    srs.exportToWkt(&wkt);
    name.horizontal = wkt;
    CPLFree(wkt);
  }
  return name;
}

Box bounds(const PolygonModel& model) {
  Box box;
  for (const Polygon& polygon : model.polygons)
    for (const Ring& ring : polygon.rings)
      for (const Eigen::Vector3d& p : ring) box.add(p);
  return box;
}

namespace {

constexpr double kKilometresPerDegree = 111.2;

/// To the area of use, 0 inside; infinite for what is no point of the system [deg of arc].
double distanceToArea(const CrsName& crs, const Eigen::Vector3d& east_north) {
  try {
    const auto g = LocalFrame(crs.horizontal, east_north).origin();
    const double width = crs.east - crs.west + (crs.east < crs.west ? 360 : 0);  // some cross the antimeridian
    const double aside = std::abs(std::remainder(g.longitude - (crs.west + 0.5 * width), 360)) - 0.5 * width;
    const double beyond = std::max(crs.south - g.latitude, g.latitude - crs.north);
    return std::hypot(std::max(0.0, aside) * std::cos(g.latitude * M_PI / 180), std::max(0.0, beyond));
  } catch (const std::invalid_argument&) {
    return std::numeric_limits<double>::infinity();
  }
}

}  // namespace

namespace {

void swapAxes(PolygonModel* model) {
  forEachPoint(model, [](Eigen::Vector3d& p) { std::swap(p.x(), p.y()); });
}

/// Of a model's closed buildings, how many there are and how many have their outsides inside.
struct ClosedBuildings {
  int all = 0, inside_out = 0;
};

ClosedBuildings countClosed(const PolygonModel& model) {
  struct Sum {
    Eigen::Vector3d area = Eigen::Vector3d::Zero(), reference = Eigen::Vector3d::Zero();
    double total = 0, volume = 0;
  };
  std::map<int, Sum> sums;
  for (const Polygon& polygon : model.polygons) {
    if (polygon.building < 0) continue;
    const Eigen::Vector3d& corner = polygon.rings[0][0];
    const auto [it, first] = sums.emplace(polygon.building, Sum());
    Sum& sum = it->second;
    if (first) sum.reference = corner;
    Eigen::Vector3d area = areaVector(polygon.rings[0]);
    for (std::size_t i = 1; i < polygon.rings.size(); ++i) {
      const Eigen::Vector3d hole = areaVector(polygon.rings[i]);
      area -= hole.dot(area) > 0 ? hole : Eigen::Vector3d(-hole);  // however it is wound
    }
    sum.area += area;
    sum.total += area.norm();
    sum.volume += area.dot(corner - sum.reference);
  }
  constexpr double kOpen = 0.02;  // of the area of all faces: holes for windows may be left
  ClosedBuildings count;
  for (const auto& [building, sum] : sums) {
    if (sum.area.norm() > kOpen * sum.total) continue;
    ++count.all;
    count.inside_out += sum.volume < 0;
  }
  return count;
}

const char* nameOf(bool north_first) { return north_first ? "north, east" : "east, north"; }

}  // namespace

double normaliseAxes(const std::string& path, const CrsName& crs, PolygonModel* model, std::string* axis_order) {
  constexpr double kMargin = 0.5, kFarthest = 10;  // [deg]
  const Box box = bounds(*model);
  const Eigen::Vector3d c = 0.5 * (box.low + box.high), swapped(c.y(), c.x(), c.z());
  bool swap = crs.north_first;
  const double declared = distanceToArea(crs, swap ? swapped : c), other = distanceToArea(crs, swap ? c : swapped);
  const bool against = declared > kMargin && (other <= kMargin || declared > kFarthest);
  double outside = against ? other : declared;
  if (outside > kFarthest) {
    constexpr double kLocal = 2e4;  // [m]: national grids count farther
    const bool local =
        std::max(box.low.head<2>().cwiseAbs().maxCoeff(), box.high.head<2>().cwiseAbs().maxCoeff()) < kLocal;
    throw std::runtime_error(path + ": coordinates around (" + std::to_string(c.x()) + ", " + std::to_string(c.y()) +
                             ") lie far outside the area of " + crs.horizontal + ": give the right system with --crs" +
                             (local ? ", or, if they are counted from a place of their own, its "
                                      "coordinates as --model-offset EASTING NORTHING HEIGHT"
                                    : ""));
  }
  if (against) {
    swap = !swap;
    model->remarks.push_back(path + ": axis order taken as " + nameOf(swap) +
                             ", against its declaration, since only that lies " + (outside > kMargin ? "near" : "in") +
                             " the area of " + crs.horizontal);
  }
  if (swap) swapAxes(model);
  if (!against && declared <= kMargin && other <= kMargin) {
    const ClosedBuildings closed = countClosed(*model);
    if (2 * closed.inside_out > closed.all) {
      swap = !swap;
      outside = other;
      swapAxes(model);
      model->remarks.push_back(path + ": axis order taken as " + nameOf(swap) + ", against its declaration: by that " +
                               std::to_string(closed.inside_out) + " of " + std::to_string(closed.all) +
                               " closed buildings are inside out, and both orders lie in the area of " +
                               crs.horizontal);
    }
  }
  *axis_order = nameOf(swap);
  return outside > kMargin ? outside * kKilometresPerDegree : 0;
}

std::string remarkOnArea(const std::string& crs, double outside) {
  return formatted(
      "the model lies %.0f km outside the area of %s: taken as it is; if that is wrong, give the right "
      "system with --crs, or with --model-offset the place that its coordinates are counted from",
      outside, crs.c_str());
}

double heightUnitOf(const CrsName& crs, double wanted, std::string* remark) {
  if (wanted > 0) return wanted;
  if (crs.height_unit > 0) return crs.height_unit;
  if (std::abs(crs.plan_unit - 1) > 1e-9)
    *remark = formatted(
        "heights taken as metres, though %s counts in units of %.7f m: if they do too, give "
        "--height-unit %.7f",
        crs.horizontal.c_str(), crs.plan_unit, crs.plan_unit);
  return 1;
}

}  // namespace streetview_localizer
