// From a rough pose to an exact one: a chain of ICP stages as the parameter file of icp_refine has it, scale included.
//
//   02_refine_by_icp AERIAL.ply GROUND.ply X Y Z YAW CHAIN.yaml      CHAIN.yaml: e.g. config/icp_refine.yaml
#include <yaml-cpp/yaml.h>

#include <cstdio>
#include <exception>
#include <string>

#include "air_ground_common/geometry.h"
#include "air_ground_common/mesh.h"
#include "icp_refine/icp.h"

namespace {

icp_refine::Cloud read(const std::string& path) {
  icp_refine::Cloud cloud;
  for (const auto& point : air_ground_common::readPlyPoints(path)) cloud.points.push_back(point.position);
  return cloud;
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 8) {
    std::fprintf(stderr, "usage: %s AERIAL.ply GROUND.ply X Y Z YAW CHAIN.yaml\n", argv[0]);
    return 2;
  }
  const icp_refine::IcpChain chain(YAML::LoadFile(argv[7])["chain"]);
  const icp_refine::IcpReference ground = chain.prepareReference(read(argv[2]));
  const icp_refine::Cloud aerial = chain.prepareReading(read(argv[1]));
  const air_ground_common::Pose guess =
      air_ground_common::yawPose(std::stod(argv[6]), {std::stod(argv[3]), std::stod(argv[4]), std::stod(argv[5])});
  icp_refine::ScalePrior scale;
  scale.stddev = 0.05;  // the aerial map's unit is a metre to 5 %
  const icp_refine::IcpResult result = chain.align(aerial, ground, guess, scale);
  if (result.outcome != icp_refine::IcpResult::Outcome::kConverged) {
    std::fprintf(stderr, "not aligned: %s\n", result.reason.c_str());
    return 1;
  }
  const auto& T = result.T_reference_reading;
  std::printf("%.4f %.4f %.4f %.4f scale %.5f\n", T.t.x(), T.t.y(), T.t.z(), air_ground_common::yawOf(T.R), T.scale);
  return 0;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
