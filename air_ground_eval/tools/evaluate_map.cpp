// Distances from the points of an augmented map to the true surface of the world, as YAML on stdout.
#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "air_ground_common/mesh.h"
#include "air_ground_common/statistics.h"

namespace {

using air_ground_common::LabeledPoint;
using air_ground_common::quantile;

void printStatistics(const std::string& prefix, const std::vector<float>& distances) {
  std::printf("%s_points: %zu\n", prefix.c_str(), distances.size());
  if (distances.empty()) return;
  std::printf("%s_surface_error_median_m: %.5f\n", prefix.c_str(), quantile(distances, 0.5));
  std::printf("%s_surface_error_95_percent_m: %.5f\n", prefix.c_str(), quantile(distances, 0.95));
}

/// Horizontal cells that hold at least `min_points` of the points for which `keep` holds.
template <typename Keep>
std::set<std::pair<int, int>> cells(const std::vector<LabeledPoint>& points, double size, int min_points, Keep keep) {
  std::vector<std::pair<int, int>> all;
  for (const LabeledPoint& p : points) {
    if (keep(p)) {
      all.emplace_back(static_cast<int>(std::floor(p.position.x() / size)),
                       static_cast<int>(std::floor(p.position.y() / size)));
    }
  }
  std::sort(all.begin(), all.end());
  std::set<std::pair<int, int>> result;
  for (std::size_t begin = 0; begin < all.size();) {
    std::size_t end = begin;
    while (end < all.size() && all[end] == all[begin]) ++end;
    if (end - begin >= static_cast<std::size_t>(min_points)) result.insert(all[begin]);
    begin = end;
  }
  return result;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Size of an augmented map, the area that the aerial view added, and the points' distances to the true surface"};
  std::string map_path, mesh_path, distances_path;
  std::vector<double> transform{0, 0, 0, 0, 0, 0, 1};
  double max_distance = 1.0, cell = 0.05;
  int min_points = 2;
  app.add_option("map", map_path, "augmented map (PLY with x y z and source: 0 ground robot, 1 MAV)")->required();
  app.add_option("--mesh", mesh_path, "true surface (PLY mesh in the world frame); without it only sizes are printed");
  app.add_option("--transform", transform, "T_world_map: tx ty tz qx qy qz qw")->expected(7);
  app.add_option("--max-distance", max_distance, "distances are cut here [m]")->check(CLI::PositiveNumber);
  app.add_option("--cell", cell, "edge of the horizontal cells that areas are counted in [m]")
      ->check(CLI::PositiveNumber);
  app.add_option("--min-points", min_points, "points that make a cell seen")->check(CLI::PositiveNumber);
  app.add_option("--distances", distances_path,
                 "writes the distances, float32 little-endian in the order of the points");
  CLI11_PARSE(app, argc, argv);

  try {
    const std::vector<LabeledPoint> points = air_ground_common::readPlyPoints(map_path);
    const Eigen::Quaterniond q(transform[6], transform[3], transform[4], transform[5]);
    if (!(std::abs(q.norm() - 1) < 1e-3))
      throw std::invalid_argument("--transform: the quaternion is not of unit length");
    Eigen::Isometry3d T_world_map = Eigen::Isometry3d::Identity();
    T_world_map.linear() = q.normalized().toRotationMatrix();
    T_world_map.translation() << transform[0], transform[1], transform[2];

    std::printf("points: %zu\ncell_m: %g\n", points.size(), cell);
    const auto ground = cells(points, cell, min_points, [](const LabeledPoint& p) { return p.source == 0; });
    const auto aerial = cells(points, cell, min_points, [](const LabeledPoint& p) { return p.source == 1; });
    std::size_t added = 0;
    for (const auto& c : aerial) added += ground.count(c) == 0;
    std::printf("ground_area_m2: %.3f\naerial_area_m2: %.3f\nadded_area_m2: %.3f\n",
                static_cast<double>(ground.size()) * cell * cell, static_cast<double>(aerial.size()) * cell * cell,
                static_cast<double>(added) * cell * cell);

    if (!mesh_path.empty()) {
      const air_ground_common::MeshScene scene(air_ground_common::readPlyMesh(mesh_path));
      std::vector<float> distances(points.size());
#pragma omp parallel for schedule(dynamic, 1024)
      for (std::size_t i = 0; i < points.size(); ++i) {
        const Eigen::Vector3d p = T_world_map * points[i].position.cast<double>();
        distances[i] = scene.distance(p.cast<float>(), static_cast<float>(max_distance));
      }
      std::vector<float> by_source[2];
      for (std::size_t i = 0; i < points.size(); ++i) by_source[points[i].source == 1].push_back(distances[i]);
      printStatistics("map", distances);
      printStatistics("ground", by_source[0]);
      printStatistics("aerial", by_source[1]);
      if (!distances_path.empty()) {
        std::ofstream stream(distances_path, std::ios::binary);
        stream.write(reinterpret_cast<const char*>(distances.data()),
                     static_cast<std::streamsize>(distances.size() * sizeof(float)));
        if (!stream) throw std::runtime_error("cannot write " + distances_path);
      }
    } else {
      std::size_t by_source[2] = {0, 0};
      for (const LabeledPoint& p : points) ++by_source[p.source == 1];
      std::printf("ground_points: %zu\naerial_points: %zu\n", by_source[0], by_source[1]);
    }
  } catch (const std::exception& error) {
    std::cerr << "evaluate_map: " << error.what() << "\n";
    return 1;
  }
  return 0;
}
