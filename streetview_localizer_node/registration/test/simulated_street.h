// What `simulate --world street` leaves beside its panoramas, for the studies.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>
#include <string>

#include "air_ground_common/geometry.h"
#include "streetview_localizer/city_model.h"

namespace streetview_localizer::testing {

/// True poses of the panoramas of FOLDER.city by their names without extension.
inline std::map<std::string, air_ground_common::Pose> truePoses(const std::string& folder) {
  std::map<std::string, air_ground_common::Pose> truth;
  std::ifstream file(folder + "/panorama_truth.csv");
  for (std::string line; std::getline(file, line);) {
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream stream(line);
    std::string id;
    double x, y, z, qx, qy, qz, qw;
    if (!(stream >> id >> x >> y >> z >> qx >> qy >> qz >> qw)) continue;
    truth[id] =
        air_ground_common::Pose(Eigen::Translation3d(x, y, z) * Eigen::Quaterniond(qw, qx, qy, qz).normalized());
  }
  return truth;
}

/// The city model of FOLDER.city in the frame of those.
inline CityModel modelOfTruth(const std::string& folder) {
  CityModelOptions options;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::ifstream description(folder + "/city.yaml");
  for (std::string line; std::getline(description, line);)
    std::sscanf(line.c_str(), "origin: [%lf, %lf, %lf]", &origin.x(), &origin.y(), &origin.z());
  options.origin = origin;
  return readCityModel(folder + "/model.gml", options);
}

}  // namespace streetview_localizer::testing
