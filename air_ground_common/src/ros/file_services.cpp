#include "air_ground_common/ros/file_services.h"

#include <ros/this_node.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <iostream>
#include <system_error>

#include "air_ground_common/atomic_file.h"

namespace air_ground_common::ros_utils {
namespace {

void writePcd(const std::string& path, const std::vector<CloudPoint>& points, CloudFields fields) {
  sensor_msgs::PointCloud2 cloud = toMsg(points, fields, {});
  std::string names, sizes, types, counts;
  for (const auto& field : cloud.fields) {
    const bool byte = field.datatype == sensor_msgs::PointField::UINT8, rgb = field.name == "rgb";
    names += " " + field.name;
    sizes += byte ? " 1" : " 4";
    types += byte || rgb ? " U" : " F";
    counts += " 1";
    // As PCL packs them: blue lowest, opaque.
    for (std::size_t at = field.offset + 3; rgb && at < cloud.data.size(); at += cloud.point_step)
      cloud.data[at] = 0xFF;
  }
  const auto body = [&](std::ostream& out) {
    out << "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS" << names << "\nSIZE" << sizes << "\nTYPE"
        << types << "\nCOUNT" << counts << "\nWIDTH " << points.size() << "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS "
        << points.size() << "\nDATA binary\n";
    out.write(reinterpret_cast<const char*>(cloud.data.data()), static_cast<std::streamsize>(cloud.data.size()));
  };
  writeAtomically(path, body, "# .PCD");
}

bool holdsFilesOf(const std::string& begin, const std::string& folder) {
  for (const auto& file : std::filesystem::directory_iterator(folder))
    if (file.path().filename().string().compare(0, begin.size(), begin) == 0) return true;
  return false;
}

}  // namespace

std::string absolutePath(const std::string& path) {
  if (path.empty()) throw std::runtime_error("the path is empty");
  const bool in_home = path == "~" || path.rfind("~/", 0) == 0;
  const char* home = std::getenv("HOME");
  if (in_home && (home == nullptr || *home == '\0'))
    throw std::runtime_error("the node has no HOME: give a path that begins with / instead of " + path);
  return std::filesystem::absolute(in_home ? home + path.substr(1) : path).lexically_normal();
}

void writeCloud(const std::string& path, const std::vector<CloudPoint>& points, CloudFields fields) {
  const auto ends = [&](const std::string& end) {
    return path.size() >= end.size() && path.compare(path.size() - end.size(), end.size(), end) == 0;
  };
  if (points.empty()) throw std::runtime_error("the map has no points yet");
  if (ends(".pcd")) return writePcd(path, points, fields);
  if (!ends(".ply")) throw std::runtime_error("the path must end in .ply or .pcd");
  writePly(path, points);
}

Autosave::Autosave(const std::string& given) {
  if (given.empty()) return;
  const std::string folder = absolutePath(given);
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error || ::access(folder.c_str(), W_OK | X_OK) != 0)
    throw std::runtime_error("parameter autosave: the folder " + folder +
                             " cannot be written to: " + (error ? error.message() : std::strerror(errno)));
  std::string node = ros::this_node::getName().substr(1);
  std::replace(node.begin(), node.end(), '/', '_');
  const std::time_t now = std::time(nullptr);
  char time[32];
  std::strftime(time, sizeof time, "%Y%m%d-%H%M%S", std::gmtime(&now));
  // Without a battery for its clock, a robot may start twice at one time.
  std::string start = node + "_" + time;
  for (int again = 2; holdsFilesOf(start + "_", folder); ++again)
    start = node + "_" + time + "-" + std::to_string(again);
  begin_ = (std::filesystem::path(folder) / (start + "_")).string();
}

void Autosave::save(const std::string& what, const std::function<void(const std::string&)>& save) const {
  if (begin_.empty()) return;
  const std::string path = begin_ + what;
  try {
    if (std::filesystem::exists(path)) throw std::runtime_error("it is there already");
    save(path);
    std::cerr << "saved " << path << std::endl;
  } catch (const std::exception& e) {
    std::cerr << "not saved, " << path << ": " << e.what() << std::endl;
  }
}

}  // namespace air_ground_common::ros_utils
