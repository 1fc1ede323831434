#include "streetview_localizer/geotags.h"

#include <cpl_minixml.h>
#include <cpl_string.h>
#include <gdal_priv.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/units.h"
#include "exif_gps.h"
#include "geopackage.h"

namespace streetview_localizer {

namespace fs = std::filesystem;
using air_ground_common::Pose;

namespace {

using air_ground_common::kDegree;

// Empty, or why the geotag cannot be used.
std::string problemOf(const Geotag& g) {
  const auto& p = g.position;
  if (!std::isfinite(p.latitude) || !std::isfinite(p.longitude)) return "has no latitude and longitude";
  if (std::abs(p.latitude) < 1e-6 && std::abs(p.longitude) < 1e-6) return "has the geotag 0,0: it was never located";
  if (std::abs(p.latitude) > 90 || std::abs(p.longitude) > 360) return "has a latitude or longitude that is none";
  if (!std::isfinite(p.height)) return "has no height";
  if (!std::isfinite(g.heading)) return "has no heading";
  if (!std::isfinite(g.pitch) || !std::isfinite(g.roll)) return "has a pitch or roll that is no number";
  return "";
}

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
  for (const char* name : {"image", "lat", "lon", "alt", "heading_deg"})
    if (header.FindString(name) < 0)
      throw std::runtime_error(path + " has no column " + name +
                               ": needed are image, lat, lon, alt, heading_deg; pitch_deg and roll_deg may follow");
  std::vector<Geotag> tags;
  while (next()) {
    const CPLStringList cells = cellsOf(line, separator);
    const std::string where = path + " line " + std::to_string(n);
    if (cells.size() < header.size())
      throw std::runtime_error(where + " has " + std::to_string(cells.size()) + " columns instead of " +
                               std::to_string(header.size()));
    const auto value = [&](const char* name, double fallback) {
      const int column = header.FindString(name);
      return column < 0 ? fallback : number(cells[column], where);
    };
    Geotag g;
    g.image = cells[header.FindString("image")];
    g.position = {value("lat", 0), value("lon", 0), value("alt", 0)};
    g.heading = value("heading_deg", 0) * kDegree;
    g.pitch = value("pitch_deg", 0) * kDegree;
    g.roll = value("roll_deg", 0) * kDegree;
    g.problem = problemOf(g);
    tags.push_back(g);
  }
  return tags;
}

std::vector<Geotag> readGeoJson(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot open " + path);
  std::vector<Geotag> tags;
  try {
    const nlohmann::json j = nlohmann::json::parse(file);
    for (const auto& feature : j.at("features")) {
      const auto& properties = feature.at("properties");
      Geotag g;
      g.image = properties.at("image").get<std::string>();
      const auto value = [&](const char* name, double fallback) {
        const auto property = properties.find(name);
        if (property == properties.end()) return fallback;
        if (property->is_number()) return property->get<double>();
        if (!property->is_string()) return fallback;
        CPLString text(property->get<std::string>());  // as ogr2ogr makes them of a CSV file
        return number(text.Trim(), path + ", image " + g.image);
      };
      const auto& geometry = feature.at("geometry");
      if (geometry.is_null() || geometry.at("type") != "Point") {
        g.position = {std::nan(""), std::nan(""), std::nan("")};
      } else {
        const auto& c = geometry.at("coordinates");
        g.position = {c.at(1).get<double>(), c.at(0).get<double>(),
                      c.size() > 2 ? c[2].get<double>() : value("alt", std::nan(""))};
      }
      g.heading = value("heading_deg", std::nan("")) * kDegree;
      g.pitch = value("pitch_deg", 0) * kDegree;
      g.roll = value("roll_deg", 0) * kDegree;
      g.problem = problemOf(g);
      tags.push_back(g);
    }
  } catch (const nlohmann::json::exception& e) {
    throw std::runtime_error(path + " is no GeoJSON of points with a property image: " + e.what());
  }
  return tags;
}

// EXIF rationals come from GDAL as "(47) (22) (30.5)".
double angle(const char* text) {
  const CPLStringList parts(CSLTokenizeString2(text ? text : "", " ()", 0));
  double sum = parts.empty() ? std::nan("") : 0;
  for (int i = 0; i < parts.size(); ++i) sum += CPLAtof(parts[i]) / std::pow(60, i);
  return sum;
}

// Of the attribute or element of this name, wherever it stands.
double xmpNumber(CPLXMLNode* xmp, const std::string& name) {
  const CPLXMLNode* node = CPLSearchXMLNode(xmp, ("=" + name).c_str());
  const char* text = node ? CPLGetXMLValue(node, nullptr, "") : "";
  char* end = nullptr;
  const double number = std::strtod(text, &end);
  return end == text ? std::nan("") : number;
}

Dataset openImage(const std::string& path) {
  GDALAllRegister();
  // Photographs alone: a virtual raster or a web description named .jpg would reach other files.
  const char* drivers[] = {"JPEG", "PNG", "GTiff", "WEBP", "BMP", nullptr};
  return Dataset(GDALDataset::Open(path.c_str(), GDAL_OF_RASTER, drivers), &GDALClose);
}

Geotag exifOf(const std::string& path) {
  Geotag g;
  g.image = fs::path(path).filename();
  g.position = {std::nan(""), std::nan(""), std::nan("")};
  g.heading = std::nan("");
  const QuietGdal quiet;
  const Dataset image = openImage(path);
  if (!image) {
    g.problem = "cannot be read as an image";
    return g;
  }
  const auto tag = [&](const char* name) { return image->GetMetadataItem(name); };
  const std::set<std::uint16_t> over_zero = gpsTagsOverZero(path);
  const auto gpsAngle = [&](GpsTag number, const char* name) {
    return over_zero.count(number) > 0 ? std::nan("") : angle(tag(name));
  };
  const auto letter = [&](const char* name, char fallback) {
    return tag(name) && *tag(name) ? tag(name)[0] : fallback;
  };
  g.position.latitude =
      gpsAngle(kGpsLatitude, "EXIF_GPSLatitude") * (letter("EXIF_GPSLatitudeRef", 'N') == 'S' ? -1 : 1);
  g.position.longitude =
      gpsAngle(kGpsLongitude, "EXIF_GPSLongitude") * (letter("EXIF_GPSLongitudeRef", 'E') == 'W' ? -1 : 1);
  const char* below = tag("EXIF_GPSAltitudeRef");
  g.position.height = gpsAngle(kGpsAltitude, "EXIF_GPSAltitude") *
                      (below && std::string(below).find('1') != std::string::npos ? -1 : 1);
  g.heading = gpsAngle(kGpsImageDirection, "EXIF_GPSImgDirection") * kDegree;
  bool magnetic = letter("EXIF_GPSImgDirectionRef", 'T') == 'M';
  if (char** packet = image->GetMetadata("xml:XMP"); packet && *packet) {
    const CPLXMLTreeCloser tree(CPLParseXMLString(*packet));
    CPLXMLNode* xmp = tree.get();
    if (const double heading = xmpNumber(xmp, "GPano:PoseHeadingDegrees"); std::isfinite(heading))
      g.heading = heading * kDegree, magnetic = false;
    if (const double pitch = xmpNumber(xmp, "GPano:PosePitchDegrees"); std::isfinite(pitch)) g.pitch = pitch * kDegree;
    if (const double roll = xmpNumber(xmp, "GPano:PoseRollDegrees"); std::isfinite(roll)) g.roll = roll * kDegree;
  }
  g.problem = problemOf(g);
  if (over_zero.count(kGpsLatitude) > 0 || over_zero.count(kGpsLongitude) > 0)
    g.problem = "has a latitude or longitude over zero in its EXIF: it was never located";
  if (g.problem.empty() && magnetic)
    g.problem = "has a heading from magnetic north: add the declination and give a geotag file";
  return g;
}

bool hasExtension(const std::string& path, std::initializer_list<const char*> extensions) {
  return std::any_of(extensions.begin(), extensions.end(),
                     [&](const char* extension) { return EQUAL(CPLGetExtension(path.c_str()), extension); });
}

}  // namespace

std::vector<Geotag> readGeotags(const std::string& path) {
  std::vector<Geotag> tags = hasExtension(path, {"geojson", "json"}) ? readGeoJson(path) : readCsv(path);
  if (tags.empty()) throw std::runtime_error(path + " lists no images");
  return tags;
}

std::vector<Geotag> readExif(const std::string& folder) {
  if (!fs::is_directory(folder)) throw std::runtime_error("there is no folder " + folder);
  std::vector<std::string> files;
  for (const auto& entry : fs::directory_iterator(folder))
    if (hasExtension(entry.path(), {"jpg", "jpeg"})) files.push_back(entry.path());
  if (files.empty()) throw std::runtime_error("no JPEG files in " + folder);
  std::sort(files.begin(), files.end());
  std::vector<Geotag> tags;
  for (const std::string& file : files) tags.push_back(exifOf(file));
  return tags;
}

std::optional<double> exifFocalLength(const std::string& path, int width) {
  const QuietGdal quiet;
  const Dataset image = openImage(path);
  if (!image) return std::nullopt;
  const double equivalent = angle(image->GetMetadataItem("EXIF_FocalLengthIn35mmFilm"));
  // The 35 mm frame is 36 mm wide.
  if (equivalent > 5) return equivalent / 36 * std::max(width, image->GetRasterYSize());
  return std::nullopt;
}

cv::Size imageSize(const std::string& path) {
  const QuietGdal quiet;
  const Dataset image = openImage(path);
  return image ? cv::Size(image->GetRasterXSize(), image->GetRasterYSize()) : cv::Size();
}

std::optional<cv::Size> fullSphereSize(const std::string& path) {
  const QuietGdal quiet;
  const Dataset image = openImage(path);
  char** packet = image ? image->GetMetadata("xml:XMP") : nullptr;
  if (!packet || !*packet) return std::nullopt;
  const CPLXMLTreeCloser tree(CPLParseXMLString(*packet));
  const auto sizeOf = [&](const std::string& what) {
    return cv::Size2d(xmpNumber(tree.get(), "GPano:" + what + "WidthPixels"),
                      xmpNumber(tree.get(), "GPano:" + what + "HeightPixels"));
  };
  const cv::Size2d full = sizeOf("FullPano"), part = sizeOf("CroppedAreaImage");
  constexpr double kWhole = 0.99, kLargest = 1e6;  // [px]
  const auto covers = [&](double some, double all) { return !(some > 0) || some >= kWhole * all; };
  if (!(full.width >= 1 && full.height >= 1 && full.width < kLargest && full.height < kLargest) ||
      (covers(part.width, full.width) && covers(part.height, full.height)))
    return std::nullopt;
  const cv::Size sphere(full);
  if (sphere == cv::Size(image->GetRasterXSize(), image->GetRasterYSize())) return std::nullopt;
  return sphere;
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
