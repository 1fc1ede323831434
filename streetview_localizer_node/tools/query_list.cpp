#include "query_list.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace streetview_localizer {
namespace {

using air_ground_common::CameraModel;

// name -> numbers of each line.
std::map<std::string, std::vector<double>> readTable(const std::string& path, const std::vector<std::size_t>& columns,
                                                     const std::string& expected) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path);
  std::map<std::string, std::vector<double>> table;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream words(line);
    std::string name;
    if (!(words >> name) || name[0] == '#' || name == "image") continue;
    std::vector<double> values;
    std::string word;
    bool good = true;
    while (words >> word) {
      std::size_t used = 0;
      try {
        values.push_back(std::stod(word, &used));
      } catch (const std::exception&) {
        used = 0;
      }
      good = good && used == word.size() && std::isfinite(values.back());
    }
    if (!good || std::find(columns.begin(), columns.end(), values.size()) == columns.end())
      throw std::runtime_error(path + ", line " + std::to_string(number) + ": expected `" + expected + "`");
    table[name] = values;
  }
  if (table.empty()) throw std::runtime_error(path + " lists no image");
  return table;
}

}  // namespace

std::map<std::string, CameraModel> readCameraList(const std::string& path) {
  std::map<std::string, CameraModel> cameras;
  for (const auto& [name, v] : readTable(path, {4, 9}, "image fx fy cx cy [k1 k2 p1 p2 k3]")) {
    CameraModel c;
    c.fx = v[0];
    c.fy = v[1];
    c.cx = v[2];
    c.cy = v[3];
    if (v.size() == 9) c.setDistortion("plumb_bob", {v[4], v[5], v[6], v[7], v[8]});
    if (!(c.fx > 0) || !(c.fy > 0)) throw std::runtime_error(path + ": focal lengths of " + name + " must be positive");
    cameras[name] = c;
  }
  return cameras;
}

std::map<std::string, Eigen::Vector3d> readUpList(const std::string& path) {
  std::map<std::string, Eigen::Vector3d> ups;
  for (const auto& [name, v] : readTable(path, {3}, "image x y z")) {
    ups[name] = {v[0], v[1], v[2]};
    if (ups[name].norm() < 1e-6) throw std::runtime_error(path + ": the direction of " + name + " is zero");
  }
  return ups;
}

std::vector<std::string> listImages(const std::string& folder) {
  if (!std::filesystem::is_directory(folder)) throw std::runtime_error(folder + " is no folder");
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    std::string extension = entry.path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char ch) { return std::tolower(ch); });
    if (extension == ".jpg" || extension == ".jpeg" || extension == ".png")
      names.push_back(entry.path().filename().string());
  }
  if (names.empty()) throw std::runtime_error(folder + " holds no images (jpg, jpeg, png)");
  std::sort(names.begin(), names.end());
  return names;
}

std::vector<std::string> listCalibratedImages(const std::string& folder,
                                              const std::map<std::string, CameraModel>& cameras,
                                              const std::string& list) {
  std::vector<std::string> names = listImages(folder);
  names.erase(std::remove_if(names.begin(), names.end(), [&](const auto& name) { return cameras.count(name) == 0; }),
              names.end());
  if (names.empty()) throw std::runtime_error("no image of " + folder + " is listed in " + list);
  return names;
}

}  // namespace streetview_localizer
