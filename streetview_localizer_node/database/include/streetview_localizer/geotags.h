// Where photographs and panoramas were taken: geotag files, EXIF, and surveyed poses.
#pragma once

#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geodesy.h"
#include "streetview_localizer/city_model.h"
#include "streetview_localizer/types.h"

namespace streetview_localizer {

/// What headings are counted from. A heading on the map's grid plus the meridian convergence is one from true north.
enum class North { kTrue, kGrid };

/// One image and its geotag, in WGS 84. Angles at the image's centre: heading clockwise from north, pitch up positive,
/// roll clockwise positive (the image's right side low).
struct Geotag {
  std::string image;  ///< as the file names it
  air_ground_common::Geodetic position;
  double heading = 0, pitch = 0, roll = 0;  ///< [rad]
  bool height_known = true;                 ///< false: position.height is 0 and means nothing
  bool heading_known = true;                ///< false: heading is 0 and means nothing
  std::string problem;  ///< one line when the geotag cannot be used (at 0,0, not a number); else empty
};

/// One photograph of known pose.
struct SurveyedImage {
  std::string image;
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< [px]
  air_ground_common::Pose T_crs_camera =
      air_ground_common::Pose::Identity();  ///< optical frame to the coordinates of the model's file
};

/// CSV with a header line, commas or semicolons between; columns by name, in any order: image (filename, file, id,
/// pano_id), lat (latitude), lon (lng, longitude) and, optional, alt (altitude, elevation), heading_deg (heading,
/// computed_compass_angle, yaw, compass_angle), pitch_deg (pitch), roll_deg (roll). GeoJSON: points [lon, lat, alt]
/// with these properties, or the feature's id for the image; answers of Mapillary's interface, or lists of its images,
/// likewise (computed_geometry before geometry). Throws std::runtime_error with one line: file, line, what
/// is wrong.
std::vector<Geotag> readGeotags(const std::string& path);

/// EXIF GPS position and direction of the JPEGs of a folder, in order of their names; XMP GPano angles where present.
std::vector<Geotag> readExif(const std::string& folder);

/// Lines of: image fx fy cx cy tx ty tz qx qy qz qw (camera to model, pixels and metres, optical axes); '#' starts a
/// comment.
std::vector<SurveyedImage> readSurveyedImages(const std::string& path);

/// Focal length in pixels from EXIF's 35 mm equivalent, which is by the diagonal, if it has one.
std::optional<double> exifFocalLength(const std::string& image, int width);

/// From the file's header; empty for what is no image.
cv::Size imageSize(const std::string& image);

/// Of an image that by its XMP (GPano) shows a part of a sphere: the size in pixels that the sphere would have. Empty
/// for whole spheres, also those that have been padded since, and for what does not say.
std::optional<cv::Size> fullSphereSize(const std::string& image);

/// True when its XMP (GPano) says that an image is a sphere, or a part of one.
bool marksSphere(const std::string& image);

/// How the pixels of a file must be turned to be seen upright.
struct ExifOrientation {
  double roll = 0;        ///< of the stored image against the upright one, right side down [rad]
  bool mirrored = false;  ///< no camera's picture
};
ExifOrientation exifOrientation(const std::string& image);

/// Throws std::invalid_argument for a model without coordinate system: geotags have no place in it.
void requireCoordinateSystem(const CityModel& model);

/// Body pose in world (x towards the image's centre, y left, z up). Heights are taken in the model's vertical datum.
/// Throws std::invalid_argument for a model without coordinate system, or a place outside it.
air_ground_common::Pose worldPose(const Geotag& geotag, const CityModel& model, North north = North::kTrue);

}  // namespace streetview_localizer
