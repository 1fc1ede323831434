// Services that write files: the same formats and the same answers in every node.
#pragma once

#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "air_ground_common/mesh.h"
#include "air_ground_common/ros/conversions.h"

namespace air_ground_common::ros_utils {

/// Binary PCD with x y z rgb, as PCL writes PointXYZRGB. Throws std::runtime_error.
inline void writePcd(const std::string& path, const std::vector<CloudPoint>& points) {
  std::ofstream file(path, std::ios::binary);
  file << "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F "
          "U\nCOUNT 1 1 1 1\nWIDTH "
       << points.size() << "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " << points.size() << "\nDATA binary\n";
  for (const CloudPoint& p : points) {
    const std::uint8_t bgra[4] = {p.rgb[2], p.rgb[1], p.rgb[0], 255};
    file.write(reinterpret_cast<const char*>(p.position.data()), 3 * sizeof(float));
    file.write(reinterpret_cast<const char*>(bgra), sizeof(bgra));
  }
  file.close();
  if (!file) throw std::runtime_error("cannot write " + path);
}

/// By the path's ending: .ply (with `source`) or .pcd. Throws std::runtime_error.
inline void writeCloud(const std::string& path, const std::vector<CloudPoint>& points) {
  const auto ends = [&](const std::string& end) {
    return path.size() >= end.size() && path.compare(path.size() - end.size(), end.size(), end) == 0;
  };
  if (points.empty()) throw std::runtime_error("the map has no points yet");
  if (ends(".pcd")) return writePcd(path, points);
  if (!ends(".ply")) throw std::runtime_error("the path must end in .ply or .pcd");
  std::vector<LabeledPoint> labeled(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    labeled[i].position = points[i].position;
    labeled[i].rgb = points[i].rgb;
    labeled[i].source = points[i].source;
  }
  writePly(path, labeled);
}

/// Answers a service with `success` and `message`: `save` returns the message, its exception becomes the refusal.
template <typename Response, typename Save>
bool answer(Response& response, const Save& save) {
  try {
    response.message = save();
    response.success = true;
  } catch (const std::exception& e) {
    response.success = false;
    response.message = e.what();
  }
  return true;
}

}  // namespace air_ground_common::ros_utils
