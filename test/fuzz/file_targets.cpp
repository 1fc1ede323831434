// Clouds and meshes, trajectories, calibrations, ICP chains.
#include "air_ground_common/camera_file.h"
#include "air_ground_common/mesh.h"
#include "air_ground_common/parameters.h"
#include "air_ground_common/trajectory.h"
#include "ekf_tracker/tracker.h"
#include "fuzzing.h"
#include "icp_refine/icp.h"
#include "query_list.h"

namespace air_ground_fuzz {
namespace {

namespace common = air_ground_common;

void ply(const Bytes& bytes) {
  const std::string path = fileOf("input.ply", bytes);
  answers([&] { common::readPlyPoints(path); });
  answers([&] {
    const common::TriangleMesh mesh = common::readPlyMesh(path);
    const common::MeshScene scene(mesh);  // refuses corners that do not exist
    scene.cast({0, 0, 10}, {0, 0, -1});
  });
}

void trajectory(const Bytes& bytes) {
  const std::string path = fileOf("input.tum", bytes);
  answers([&] {
    const common::Trajectory read = common::readTum(path);
    for (const auto& pose : read) require(common::isValid(pose.T_map_body), "pose");
    common::poseAt(read, 1.0, 1.0);
  });
}

void cameraInfo(const Bytes& bytes) {
  const std::string path = fileOf("input.yaml", bytes);
  answers([&] {
    const common::CameraModel camera = common::readCameraFile(path);
    for (const double x : {0.0, 0.5, 1.0}) camera.unproject({x * camera.width, x * camera.height});
    camera.project({0.3, -0.2, 1});
  });
}

void cameraLists(const Bytes& bytes) {
  const std::string path = fileOf("input.csv", bytes);
  answers([&] { streetview_localizer::readCameraList(path); });
  answers([&] { streetview_localizer::readUpList(path); });
}

// Whatever the file holds, what is read is within the ranges.
void parameters(const Bytes& bytes) {
  const std::string path = fileOf("parameters.yaml", bytes);
  answers([&] {
    ekf_tracker::TrackerSettings settings;
    common::readYaml(path, {}, &settings);
    common::checkRanges(settings);
  });
}

// A chain that is accepted must bear a small cloud.
void chain(const Bytes& bytes) {
  answers([&] {
    const auto chain = icp_refine::IcpChain::fromString(std::string(bytes.begin(), bytes.end()));
    icp_refine::Cloud cloud;
    for (int i = 0; i < 60; ++i) {
      const auto u = 0.05f * static_cast<float>(i % 8), v = 0.05f * static_cast<float>(i / 8);
      cloud.points.emplace_back(u, v, i % 2 ? 0.f : 0.5f * u);
    }
    const auto reference = chain.prepareReference(cloud);
    chain.align(chain.prepareReading(cloud), reference, icp_refine::Similarity());
  });
}

}  // namespace

void addFileTargets(Targets* targets) {
  targets->insert({{"ply", ply},
                   {"trajectory", trajectory},
                   {"camera_info_file", cameraInfo},
                   {"parameters", parameters},
                   {"camera_lists", cameraLists},
                   {"icp_chain", chain}});
}

}  // namespace air_ground_fuzz
