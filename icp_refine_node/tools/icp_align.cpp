// icp_align: aligns two PLY clouds from the command line with the node's chain and checks.
#include <yaml-cpp/yaml.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <stdexcept>
#include <string>

#include "../src/ros/node_parameters.h"
#include "air_ground_common/mesh.h"
#include "air_ground_common/parameters.h"

namespace {

icp_refine::Cloud readCloud(const std::string& path) {
  icp_refine::Cloud out;
  for (const auto& p : air_ground_common::readPlyPoints(path)) out.points.push_back(p.position);
  return out;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Aligns an aerial cloud with a ground cloud (PLY, gravity-aligned, metres) by the chain of icp_refine_node");
  std::string aerial_path, ground_path, config_path, out_path;
  std::vector<double> initial{0, 0, 0, 0};
  bool stages = false;
  app.add_option("aerial", aerial_path, "PLY of the aerial cloud");
  app.add_option("ground", ground_path, "PLY of the ground cloud");
  app.add_option("--config", config_path,
                 "YAML of the node's parameters, such as config/icp_refine.yaml, or of a chain alone");
  app.add_option("--initial", initial, "guess of the aerial cloud's pose in the ground cloud: x y z [m] yaw [rad]")
      ->expected(4);
  app.add_option("--out", out_path, "writes both clouds, merged, as PLY with a source label");
  app.add_flag("--stages", stages, "prints all stages of a chain with their parameters, and ends");
  CLI11_PARSE(app, argc, argv);
  if (stages) {
    std::fputs(icp_refine::describeStages().c_str(), stdout);
    return 0;
  }
  try {
    if (aerial_path.empty() || ground_path.empty() || config_path.empty()) {
      throw std::invalid_argument("needed: AERIAL.ply GROUND.ply --config FILE; see --help");
    }
    const YAML::Node config = YAML::LoadFile(config_path);
    const bool whole = config["chain"].IsDefined();
    icp_refine::NodeSettings settings;
    if (whole) air_ground_common::readYaml(config_path, {}, &settings);
    icp_refine::AlignmentRefiner refiner(icp_refine::IcpChain(whole ? config["chain"] : config), settings.refiner);
    const auto aerial = readCloud(aerial_path), ground = readCloud(ground_path);
    refiner.setGround(ground);
    refiner.addAerial(0, aerial);
    refiner.setCoarse(air_ground_common::yawPose(initial[3], {initial[0], initial[1], initial[2]}));
    const auto out = refiner.refine();
    static const char* kNames[] = {"SEARCHING", "DEGENERATE", "CONVERGED", "REJECTED"};
    std::printf("%s: %s\n", kNames[static_cast<int>(out.status)], out.reason.c_str());
    const Eigen::Quaterniond q(out.T_ground_map_mav_map.R);
    const Eigen::Vector3d t = out.T_ground_map_mav_map.t;
    std::printf(
        "T_ground_aerial: %.6f %.6f %.6f  %.7f %.7f %.7f %.7f (x y z, quaternion x y z w), scale %.5f +- %.5f\n", t.x(),
        t.y(), t.z(), q.x(), q.y(), q.z(), q.w(), out.T_ground_map_mav_map.scale, out.scale_stddev);
    const icp_refine::Vector6d sigma = out.covariance.diagonal().cwiseSqrt();
    std::printf("standard deviations: %.4f %.4f %.4f m  %.5f %.5f %.5f rad; %d iterations, %.0f ms\n", sigma[0],
                sigma[1], sigma[2], sigma[3], sigma[4], sigma[5], out.iterations, 1e3 * out.icp.seconds);
    if (!out_path.empty()) {
      std::vector<air_ground_common::LabeledPoint> points;
      for (const auto& p : ground.points) points.push_back({p, {220, 30, 30}, 0});
      for (const auto& p : icp_refine::transformed(aerial, out.T_ground_map_mav_map).points)
        points.push_back({p, {150, 150, 150}, 1});
      air_ground_common::writePly(out_path, points);
    }
    return out.status == icp_refine::RefineStatus::kConverged ? 0 : 2;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "icp_align: %s\n", e.what());
    return 1;
  }
}
