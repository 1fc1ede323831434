// What a file's coordinates are counted in: its coordinate system, the order of its axes, the unit of its heights.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>

#include "polygons.h"

namespace streetview_localizer {

/// A coordinate system as files name it (EPSG:7415, urn:ogc:def:crs:EPSG::2056,
/// https://www.opengis.net/def/crs/EPSG/0/25832, urn:adv:crs:ETRS89_UTM32*DE_DHHN2016_NH, compound systems).
struct CrsName {
  std::string horizontal;    ///< for LocalFrame: "EPSG:28992", or WKT where there is no code
  bool north_first = false;  ///< the file's coordinates come as (northing, easting) or (latitude, longitude)
  double west = -180, south = -90, east = 180, north = 90;  ///< area of use [deg]; across 180 degrees east < west
  double plan_unit = 1;                                     ///< of eastings and northings [m]; 1 where they are degrees
  double height_unit = 0;                                   ///< of the vertical part [m]; 0 where there is none
};
/// Throws std::runtime_error: "unknown coordinate system '...'".
CrsName parseCrs(const std::string& text);

struct Box {
  Eigen::Vector3d low = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector3d high = -low;
  void add(const Eigen::Vector3d& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
};
Box bounds(const PolygonModel& model);

/// Puts easting first. The declared order is believed where it lands in the system's area of use; many files break it.
/// Where both orders land there, the one counts by which closed buildings are not inside out. `axis_order`: what was
/// taken, as CityModel has it. Surveys also use a grid beyond its area: returns how far outside the model lies [km], 0
/// inside. Throws std::runtime_error where neither order lies near the area.
double normaliseAxes(const std::string& path, const CrsName& crs, PolygonModel* model, std::string* axis_order);
std::string remarkOnArea(const std::string& crs, double outside);

/// Of a file's heights [m]: `wanted`, unless it is 0, or as the system says. Where only the plan has a system, and that
/// is not in metres, `remark` tells what was assumed.
double heightUnitOf(const CrsName& crs, double wanted, std::string* remark);

}  // namespace streetview_localizer
