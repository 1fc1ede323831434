#include "streetview_localizer/geotags.h"

#include <cpl_conv.h>
#include <cpl_string.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/units.h"
#include "photograph_header.h"

namespace streetview_localizer {

using air_ground_common::Pose;

namespace {

using air_ground_common::kDegree;

/// Of a line; semicolons as spreadsheets write them where a comma is the decimal mark.
CPLStringList cellsOf(const std::string& line, const char* separator) {
  return CPLStringList(
      CSLTokenizeString2(line.c_str(), separator,
                         CSLT_HONOURSTRINGS | CSLT_ALLOWEMPTYTOKENS | CSLT_STRIPLEADSPACES | CSLT_STRIPENDSPACES));
}

double number(const char* text, const std::string& where) {
  if (!*text) return std::nan("");
  char* end = nullptr;
  const double v = CPLStrtod(text, &end);
  if (*end) throw std::runtime_error(where + ": '" + text + "' is not a number");
  return v;
}

// Columns and properties by what they are called here and there: Street View's metadata, Mapillary, KartaView, GIS.
// Where several are there, the first that says something counts.
using Names = std::initializer_list<const char*>;
constexpr Names kImage = {"image", "filename", "file", "id", "pano_id"};
constexpr Names kLatitude = {"lat", "latitude"};
constexpr Names kLongitude = {"lon", "lng", "longitude"};
constexpr Names kHeight = {"alt", "altitude", "elevation"};
constexpr Names kHeading = {"heading_deg", "heading", "computed_compass_angle", "yaw", "compass_angle"};
constexpr Names kPitch = {"pitch_deg", "pitch"};
constexpr Names kRoll = {"roll_deg", "roll"};

/// From values by name, NaN where nobody says; `value` gives nothing for a name that is not there.
Geotag geotagOf(const std::string& image, const std::function<std::optional<double>(const char*)>& value) {
  const auto first = [&](Names names, double fallback) {
    for (const char* name : names) {
      const std::optional<double> v = value(name);
      if (v && std::isfinite(*v)) return *v;
      if (v) fallback = *v;  // there, but no number
    }
    return fallback;
  };
  const double none = std::nan("");
  Geotag g;
  g.image = image;
  g.position = {first(kLatitude, none), first(kLongitude, none), first(kHeight, none)};
  g.heading = first(kHeading, none) * kDegree;
  g.pitch = first(kPitch, 0) * kDegree;
  g.roll = first(kRoll, 0) * kDegree;
  return g;
}

/// Of the columns with one of these names, the first; -1 without.
int columnOf(const CPLStringList& header, Names names) {
  for (const char* name : names)
    if (const int column = header.FindString(name); column >= 0) return column;
  return -1;
}

std::vector<Geotag> readCsv(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot open " + path);
  std::string line;
  int n = 0;
  const auto next = [&] {  // that says something
    do {
      if (!std::getline(file, line)) return false;
      if (++n == 1 && line.rfind("\xEF\xBB\xBF", 0) == 0) line.erase(0, 3);
    } while (line.empty() || line == "\r" || line[0] == '#');
    return true;
  };
  next();
  const char* separator = line.find(',') == std::string::npos ? ";" : ",";
  const CPLStringList header = cellsOf(line, separator);
  const int image = columnOf(header, kImage);
  for (const auto& [column, name] :
       {std::make_pair(image, "image"), {columnOf(header, kLatitude), "lat"}, {columnOf(header, kLongitude), "lon"}})
    if (column < 0)
      throw std::runtime_error(path + " has no column " + name +
                               ": needed are image, lat, lon; alt, heading_deg, pitch_deg and roll_deg may follow");
  std::vector<Geotag> tags;
  while (next()) {
    const CPLStringList cells = cellsOf(line, separator);
    const std::string where = path + " line " + std::to_string(n);
    if (cells.size() < header.size())
      throw std::runtime_error(where + " has " + std::to_string(cells.size()) + " columns instead of " +
                               std::to_string(header.size()));
    Geotag g = geotagOf(cells[image], [&](const char* name) -> std::optional<double> {
      const int column = header.FindString(name);
      return column < 0 ? std::nullopt : std::optional<double>(number(cells[column], where));
    });
    checkGeotag(&g);
    tags.push_back(g);
  }
  return tags;
}

/// Of a GeoJSON collection, of an answer of Mapillary's interface, or of a list of its images. Throws json::exception.
const nlohmann::json& itemsOf(const nlohmann::json& j) {
  if (j.is_array()) return j;
  const auto data = j.find("data");
  return data != j.end() ? *data : j.at("features");
}

/// Where Mapillary's reconstruction has an image goes before where its receiver had it. Throws json::exception.
const nlohmann::json& placeOf(const nlohmann::json& feature) {
  const auto computed = feature.find("computed_geometry");
  return computed != feature.end() && computed->is_object() ? *computed : feature.at("geometry");
}

/// What names the image of a GeoJSON feature: a property, or the feature's own id. Throws json::exception.
std::string imageOf(const nlohmann::json& feature, const nlohmann::json& properties) {
  const auto text = [](const nlohmann::json& v) { return v.is_string() ? v.get<std::string>() : v.dump(); };
  for (const char* name : kImage)
    if (const auto p = properties.find(name); p != properties.end() && (p->is_string() || p->is_number_integer()))
      return text(*p);
  const auto id = feature.find("id");
  if (id != feature.end() && (id->is_string() || id->is_number_integer())) return text(*id);
  return properties.at("image").get<std::string>();
}

Geotag geotagOf(const nlohmann::json& feature, const std::string& path) {
  const auto own = feature.find("properties");
  const nlohmann::json& properties = own != feature.end() ? *own : feature;  // Mapillary's are the image's own
  const std::string image = imageOf(feature, properties);
  Geotag g = geotagOf(image, [&](const char* name) -> std::optional<double> {
    const auto property = properties.find(name);
    if (property == properties.end()) return std::nullopt;
    if (property->is_number()) return property->get<double>();
    if (!property->is_string()) return std::nullopt;
    CPLString text(property->get<std::string>());  // as ogr2ogr makes them of a CSV file
    return number(text.Trim(), path + ", image " + image);
  });
  const nlohmann::json& geometry = placeOf(feature);
  if (geometry.is_null() || geometry.at("type") != "Point") {
    g.position = {std::nan(""), std::nan(""), std::nan("")};
  } else {
    const auto& c = geometry.at("coordinates");
    g.position = {c.at(1).get<double>(), c.at(0).get<double>(), c.size() > 2 ? c[2].get<double>() : g.position.height};
  }
  checkGeotag(&g);
  return g;
}

std::vector<Geotag> readGeoJson(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot open " + path);
  std::vector<Geotag> tags;
  try {
    const nlohmann::json j = nlohmann::json::parse(file);
    for (const auto& feature : itemsOf(j)) tags.push_back(geotagOf(feature, path));
  } catch (const nlohmann::json::exception& e) {
    throw std::runtime_error(path + " is no GeoJSON of points with a property image: " + e.what());
  }
  return tags;
}

}  // namespace

void checkGeotag(Geotag* geotag) {
  auto& p = geotag->position;
  if (!std::isfinite(p.latitude) || !std::isfinite(p.longitude)) {
    geotag->problem = "has no latitude and longitude";
  } else if (std::abs(p.latitude) < 1e-6 && std::abs(p.longitude) < 1e-6) {
    geotag->problem = "has the geotag 0,0: it was never located";
  } else if (std::abs(p.latitude) > 90 || std::abs(p.longitude) > 360) {
    geotag->problem = "has a latitude or longitude that is none";
  } else if (!std::isfinite(geotag->pitch) || !std::isfinite(geotag->roll)) {
    geotag->problem = "has a pitch or roll that is no number";
  }
  geotag->height_known = std::isfinite(p.height);
  geotag->heading_known = std::isfinite(geotag->heading);
  if (!geotag->height_known) p.height = 0;
  if (!geotag->heading_known) geotag->heading = 0;
}

std::vector<Geotag> readGeotags(const std::string& path) {
  std::vector<Geotag> tags =
      (EQUAL(CPLGetExtension(path.c_str()), "geojson") || EQUAL(CPLGetExtension(path.c_str()), "json"))
          ? readGeoJson(path)
          : readCsv(path);
  if (tags.empty()) throw std::runtime_error(path + " lists no images");
  return tags;
}

std::vector<SurveyedImage> readSurveyedImages(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot open " + path);
  std::vector<SurveyedImage> images;
  std::string line;
  for (int n = 1; std::getline(file, line); ++n) {
    const std::size_t start = line.find_first_not_of(" \t\r");
    if (start == std::string::npos || line[start] == '#') continue;
    std::istringstream words(line);
    SurveyedImage s;
    Eigen::Vector3d t;
    Eigen::Quaterniond q;
    const std::string where = path + " line " + std::to_string(n);
    if (!(words >> s.image >> s.fx >> s.fy >> s.cx >> s.cy >> t.x() >> t.y() >> t.z() >> q.x() >> q.y() >> q.z() >>
          q.w()))
      throw std::runtime_error(where + ": expected image fx fy cx cy tx ty tz qx qy qz qw");
    if (!(s.fx > 0) || !(s.fy > 0)) throw std::runtime_error(where + ": focal lengths must be positive");
    if (std::abs(q.norm() - 1) > 1e-2)
      throw std::runtime_error(where + ": the quaternion has norm " + std::to_string(q.norm()) + " instead of 1");
    s.T_crs_camera.translation() = t;
    s.T_crs_camera.linear() = q.normalized().toRotationMatrix();
    images.push_back(s);
  }
  if (images.empty()) throw std::runtime_error(path + " lists no images");
  return images;
}

void requireCoordinateSystem(const CityModel& model) {
  if (!model.frame)
    throw std::invalid_argument(
        "the city model has no coordinate system, so geotags have no place in it: give its system, like --crs "
        "EPSG:2056");
}

Pose worldPose(const Geotag& g, const CityModel& model, North north) {
  requireCoordinateSystem(model);
  Pose T = Pose::Identity();
  T.translation() = model.frame->fromGeodetic(g.position);
  double heading = g.heading;
  if (north == North::kGrid) heading += model.frame->meridianConvergence();
  T.linear() =
      (Eigen::AngleAxisd(M_PI / 2 - heading, Eigen::Vector3d::UnitZ()) *
       Eigen::AngleAxisd(-g.pitch, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(g.roll, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  return T;
}

}  // namespace streetview_localizer
