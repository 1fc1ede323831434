#include "euroc_folder.h"

#include <yaml-cpp/yaml.h>

#include <fstream>
#include <sstream>
#include <stdexcept>

namespace mav_vo {

namespace {

/// Rows of a CSV file without its comments.
std::vector<std::vector<std::string>> readRows(const std::string& path, bool needed) {
  std::ifstream file(path);
  if (!file && needed) throw std::runtime_error("cannot read " + path);
  std::vector<std::vector<std::string>> rows;
  for (std::string line; std::getline(file, line);) {
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.pop_back();
    if (line.empty() || line.front() == '#') continue;
    std::vector<std::string> row;
    std::stringstream fields(line);
    for (std::string field; std::getline(fields, field, ',');) row.push_back(field);
    rows.push_back(row);
  }
  return rows;
}

double stampOf(const std::string& nanoseconds) {
  const long long ns = std::stoll(nanoseconds);
  return static_cast<double>(ns / 1000000000) + 1e-9 * static_cast<double>(ns % 1000000000);
}

Eigen::Vector3d vectorAt(const std::vector<std::string>& row, std::size_t first) {
  return {std::stod(row.at(first)), std::stod(row.at(first + 1)), std::stod(row.at(first + 2))};
}

YAML::Node readSensor(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path);
  std::string text;
  // OpenCV's "%YAML:1.0" is no YAML.
  for (std::string line; std::getline(file, line);)
    if (line.empty() || line.front() != '%') text += line + "\n";
  return YAML::Load(text);
}

air_ground_common::Pose poseOf(const YAML::Node& sensor, const std::string& path) {
  const auto data = sensor["T_BS"]["data"].as<std::vector<double>>();
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  for (int i = 0; i < 12; ++i) T(i / 4, i % 4) = data.at(static_cast<std::size_t>(i));
  const Eigen::Matrix3d R = T.linear();
  if (!T.matrix().allFinite() || (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-2 ||
      R.determinant() < 0)
    throw std::runtime_error(path + ": the upper left 3x3 of T_BS is no rotation");
  return air_ground_common::normalized(T);
}

air_ground_common::CameraModel cameraOf(const YAML::Node& camera, const std::string& path) {
  const auto size = camera["resolution"].as<std::vector<int>>();
  const auto f = camera["intrinsics"].as<std::vector<double>>();
  std::vector<double> k;
  if (camera["distortion_coefficients"]) k = camera["distortion_coefficients"].as<std::vector<double>>();
  const YAML::Node name = camera["distortion_model"];
  air_ground_common::CameraModel c;
  c.width = size.at(0);
  c.height = size.at(1);
  c.fx = f.at(0);
  c.fy = f.at(1);
  c.cx = f.at(2);
  c.cy = f.at(3);
  try {
    c.setDistortion(name ? name.as<std::string>() : "plumb_bob", k);
    c.validate();
  } catch (const std::invalid_argument& e) {
    throw std::runtime_error(path + ": " + e.what());
  }
  return c;
}

void readTruth(const std::string& root, EurocFolder* folder) {
  std::vector<std::vector<std::string>> rows = readRows(root + "state_groundtruth_estimate0/data.csv", false);
  if (rows.empty()) rows = readRows(root + "mocap0/data.csv", false);
  constexpr std::size_t kWithBiases = 17;
  for (const auto& row : rows) {
    air_ground_common::Pose T = air_ground_common::Pose::Identity();
    T.translation() = vectorAt(row, 1);
    const Eigen::Vector3d q = vectorAt(row, 5);
    T.linear() = Eigen::Quaterniond(std::stod(row.at(4)), q.x(), q.y(), q.z()).normalized().toRotationMatrix();
    folder->truth.push_back({stampOf(row.at(0)), T});
    if (row.size() >= kWithBiases) folder->truth_bias.push_back({vectorAt(row, 11), vectorAt(row, 14)});
  }
}

}  // namespace

EurocFolder readEurocFolder(const std::string& path) {
  const std::string root = path + "/mav0/", cam = root + "cam0/", imu = root + "imu0/";
  EurocFolder folder;
  const YAML::Node camera = readSensor(cam + "sensor.yaml");
  folder.camera = cameraOf(camera, cam + "sensor.yaml");
  folder.T_base_camera = poseOf(camera, cam + "sensor.yaml");
  folder.T_base_imu = poseOf(readSensor(imu + "sensor.yaml"), imu + "sensor.yaml");
  for (const auto& row : readRows(cam + "data.csv", true))
    folder.images.push_back({stampOf(row.at(0)), cam + "data/" + row.at(1)});
  for (const auto& row : readRows(imu + "data.csv", true))
    folder.imu.push_back({stampOf(row.at(0)), vectorAt(row, 1), vectorAt(row, 4)});
  readTruth(root, &folder);
  return folder;
}

}  // namespace mav_vo
