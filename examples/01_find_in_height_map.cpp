// Where does an aerial point cloud belong in a ground robot's map? No guess, no ROS: the search of heightmap_mcl.
//
//   01_find_in_height_map AERIAL.ply GROUND.ply      both in metres, z up
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"
#include "air_ground_common/mesh.h"
#include "heightmap_mcl/localizer.h"

namespace {

std::vector<Eigen::Vector3f> positions(const std::string& path) {
  std::vector<Eigen::Vector3f> result;
  for (const auto& point : air_ground_common::readPlyPoints(path)) result.push_back(point.position);
  return result;
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 3) {
    std::fprintf(stderr, "usage: %s AERIAL.ply GROUND.ply\n", argv[0]);
    return 2;
  }
  heightmap_mcl::HeightMapLocalizerSettings settings;
  settings.verdict.min_maps = 1;  // one cloud that holds all the MAV has seen, not one of many
  heightmap_mcl::HeightMapLocalizer localizer(settings);
  if (!localizer.setGround(positions(argv[2]))) {
    std::fprintf(stderr, "%s holds no surface\n", argv[2]);
    return 1;
  }
  heightmap_mcl::AerialCloud aerial;
  aerial.points = positions(argv[1]);
  for (const auto& p : aerial.points) aerial.reference += p.cast<double>() / static_cast<double>(aerial.points.size());
  // For the particles to gather around what the search found. Each time the cloud's evidence counts once more, which
  // suits a demonstration: a robot adds each of its clouds once.
  for (int update = 0; update < 4; ++update)
    if (!localizer.addAerial(aerial)) {
      std::fprintf(stderr, "%s holds no surface\n", argv[1]);
      return 1;
    }
  const heightmap_mcl::CoarseEstimate& e = localizer.estimate();
  const Eigen::Vector3d p = e.T_ground_mav.translation();
  std::printf("%s %s\n", toString(e.status), e.reason.c_str());
  std::printf("%.4f %.4f %.4f %.4f\n", p.x(), p.y(), p.z(), air_ground_common::yawOf(e.T_ground_mav.linear()));
  return e.status == heightmap_mcl::Status::kConverged ? 0 : 1;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
