#include "air_ground_common/camera_file.h"

#include <yaml-cpp/yaml.h>

#include <stdexcept>
#include <vector>

namespace air_ground_common {

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
    if (node["distortion_coefficients"]) {
      const auto d = node["distortion_coefficients"]["data"].as<std::vector<double>>();
      const std::string model = node["distortion_model"] ? node["distortion_model"].as<std::string>() : "plumb_bob";
      if (model != "plumb_bob" || d.size() > 5)
        throw std::runtime_error("distortion model " + model + " with " + std::to_string(d.size()) +
                                 " coefficients; calibrate with plumb_bob (up to five), or rectify the images");
      double* const fields[] = {&c.k1, &c.k2, &c.p1, &c.p2, &c.k3};
      for (std::size_t i = 0; i < d.size(); ++i) *fields[i] = d[i];
    }
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

}  // namespace air_ground_common
