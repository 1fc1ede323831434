// Geotags, sizes and lenses of photographs, from their EXIF and XMP.
#include "photograph_header.h"

#include <cpl_minixml.h>
#include <cpl_string.h>
#include <gdal_priv.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <stdexcept>

#include "air_ground_common/units.h"
#include "exif_gps.h"
#include "geopackage.h"
#include "streetview_localizer/geotags.h"

namespace streetview_localizer {

namespace fs = std::filesystem;

namespace {

using air_ground_common::kDegree;

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
  checkGeotag(&g);
  if (over_zero.count(kGpsLatitude) > 0 || over_zero.count(kGpsLongitude) > 0)
    g.problem = "has a latitude or longitude over zero in its EXIF: it was never located";
  if (g.problem.empty() && magnetic)
    g.problem = "has a heading from magnetic north: add the declination and give a geotag file";
  return g;
}

}  // namespace

std::vector<Geotag> readExif(const std::string& folder) {
  if (!fs::is_directory(folder)) throw std::runtime_error("there is no folder " + folder);
  std::vector<std::string> files;
  for (const auto& entry : fs::directory_iterator(folder))
    if ((EQUAL(CPLGetExtension(entry.path().c_str()), "jpg") || EQUAL(CPLGetExtension(entry.path().c_str()), "jpeg")))
      files.push_back(entry.path());
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
  // The same angle across the diagonal (CIPA DCG-001), which is that of 36 mm x 24 mm: sensors have other proportions.
  if (equivalent > 5) return equivalent / std::hypot(36, 24) * std::hypot(width, image->GetRasterYSize());
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

bool marksSphere(const std::string& path) {
  const QuietGdal quiet;
  const Dataset image = openImage(path);
  char** packet = image ? image->GetMetadata("xml:XMP") : nullptr;
  if (!packet || !*packet) return false;
  const CPLXMLTreeCloser tree(CPLParseXMLString(*packet));
  const CPLXMLNode* projection = CPLSearchXMLNode(tree.get(), "=GPano:ProjectionType");
  return (projection && EQUAL(CPLGetXMLValue(projection, nullptr, ""), "equirectangular")) ||
         xmpNumber(tree.get(), "GPano:FullPanoWidthPixels") > 0;
}

ExifOrientation exifOrientation(const std::string& path) {
  const QuietGdal quiet;
  const Dataset image = openImage(path);
  const char* text = image ? image->GetMetadataItem("EXIF_Orientation") : nullptr;
  ExifOrientation orientation;
  switch (text ? std::atoi(text) : 1) {
    case 2:
    case 4:
    case 5:
    case 7:
      orientation.mirrored = true;
      break;
    case 3:
      orientation.roll = M_PI;
      break;
    case 6:
      orientation.roll = M_PI / 2;
      break;
    case 8:
      orientation.roll = -M_PI / 2;
      break;
    default:
      break;
  }
  return orientation;
}

}  // namespace streetview_localizer
