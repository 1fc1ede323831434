#include "air_ground_common/camera_file.h"

#include <yaml-cpp/yaml.h>

#include <sstream>
#include <stdexcept>
#include <vector>

namespace air_ground_common {
namespace {

std::string modelName(const YAML::Node& node) {
  if (node["distortion_model"]) return node["distortion_model"].as<std::string>();
  return node["fisheye_model"] && node["fisheye_model"].as<std::string>() == "1" ? "fisheye" : "plumb_bob";
}

}  // namespace

CameraModel readCameraFile(const std::string& path) {
  CameraModel c;
  try {
    const YAML::Node node = YAML::LoadFile(path);
    c.width = node["image_width"].as<int>();
    c.height = node["image_height"].as<int>();
    const auto k = node["camera_matrix"]["data"].as<std::vector<double>>();
    c.fx = k.at(0);
    c.cx = k.at(2);
    c.fy = k.at(4);
    c.cy = k.at(5);
    std::vector<double> coefficients;
    if (node["distortion_coefficients"])
      coefficients = node["distortion_coefficients"]["data"].as<std::vector<double>>();
    c.setDistortion(modelName(node), coefficients);
    c.validate();
  } catch (const YAML::BadFile&) {
    throw std::runtime_error("cannot read the camera calibration " + path + ": no such file, or not readable");
  } catch (const std::exception& e) {
    throw std::runtime_error(
        path +
        " is no camera calibration (image_width, image_height, camera_matrix, distortion_coefficients): " + e.what());
  }
  return c;
}

std::string cameraFileText(const CameraModel& c, const std::string& name) {
  std::ostringstream s;
  s.precision(12);
  s << "image_width: " << c.width << "\nimage_height: " << c.height << "\ncamera_name: " << name
    << "\ndistortion_model: " << c.distortionName() << "\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [" << c.fx
    << ", 0, " << c.cx << ", 0, " << c.fy << ", " << c.cy << ", 0, 0, 1]\n";
  const std::vector<double> d = c.distortionCoefficients();
  s << "distortion_coefficients:\n  rows: 1\n  cols: " << d.size() << "\n  data: [";
  for (std::size_t i = 0; i < d.size(); ++i) s << (i > 0 ? ", " : "") << d[i];
  s << "]\n";
  return s.str();
}

}  // namespace air_ground_common
