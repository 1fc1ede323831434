#include "air_ground_common/ros/file_services.h"

#include <ros/console.h>
#include <ros/this_node.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <ostream>
#include <system_error>

#include "air_ground_common/atomic_file.h"

namespace air_ground_common::ros_utils {
namespace {

template <typename T>
void put(std::ostream& out, const T& value) {
  out.write(reinterpret_cast<const char*>(&value), sizeof(T));
}

void writePcd(const std::string& path, const std::vector<CloudPoint>& points, CloudFields fields) {
  const bool intensity = fields == CloudFields::kXyzIntensity, source = fields == CloudFields::kXyzRgbSource;
  const bool rgb = fields == CloudFields::kXyzRgb || source;
  std::string names = "x y z", sizes = "4 4 4", types = "F F F", counts = "1 1 1";
  const auto add = [&](const char* name, const char* size, const char* type) {
    names += std::string(" ") + name;
    sizes += std::string(" ") + size;
    types += std::string(" ") + type;
    counts += " 1";
  };
  if (intensity) add("intensity", "4", "F");
  if (rgb) add("rgb", "4", "U");
  if (source) add("source", "1", "U");
  const auto body = [&](std::ostream& out) {
    out << "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS " << names << "\nSIZE " << sizes
        << "\nTYPE " << types << "\nCOUNT " << counts << "\nWIDTH " << points.size()
        << "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " << points.size() << "\nDATA binary\n";
    for (const CloudPoint& p : points) {
      for (int i = 0; i < 3; ++i) put(out, p.position[i]);
      if (intensity) put(out, (p.rgb[0] + p.rgb[1] + p.rgb[2]) / 3.0f);
      // As PCL packs them: blue lowest, opaque.
      if (rgb) put(out, 0xFF000000u | std::uint32_t{p.rgb[0]} << 16 | std::uint32_t{p.rgb[1]} << 8 | p.rgb[2]);
      if (source) put(out, p.source);
    }
  };
  writeAtomically(path, body, "# .PCD");
}

}  // namespace

void writeCloud(const std::string& path, const std::vector<CloudPoint>& points, CloudFields fields) {
  const auto ends = [&](const std::string& end) {
    return path.size() >= end.size() && path.compare(path.size() - end.size(), end.size(), end) == 0;
  };
  if (points.empty()) throw std::runtime_error("the map has no points yet");
  if (ends(".pcd")) return writePcd(path, points, fields);
  if (!ends(".ply")) throw std::runtime_error("the path must end in .ply or .pcd");
  writePly(path, points);
}

Autosave::Autosave(const std::string& folder) {
  if (folder.empty()) return;
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
  begin_ = (std::filesystem::path(folder) / (node + "_" + time + "_")).string();
}

void Autosave::save(const std::string& what, const std::function<void(const std::string&)>& save) const {
  if (begin_.empty()) return;
  const std::string path = begin_ + what;
  try {
    if (std::filesystem::exists(path)) throw std::runtime_error("it is there already");
    save(path);
    ROS_INFO_STREAM("saved " << path);
  } catch (const std::exception& e) {
    ROS_WARN_STREAM("not saved, " << path << ": " << e.what());
  }
}

}  // namespace air_ground_common::ros_utils
