// A refiner with a scene's ground map and one aerial cloud, of stamp 1.
#pragma once

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include "icp_refine/alignment_refiner.h"
#include "synthetic_scene.h"

namespace icp_refine {

class Refiner : public testing::Test {
 protected:
  Refiner()
      : scene(synthetic::makeScene(1)),
        refiner(IcpChain(YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"]), {}) {
    refiner.setGround(scene.ground);
    refiner.addAerial(1, scene.aerial);
    centre = synthetic::centroid(scene.aerial);
  }

  Pose moved(double x, double y, double z, double yaw) const {
    const Eigen::Vector3d m = scene.T_ground_map_mav_map * centre;
    const Eigen::Matrix3d R = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    Pose D = Pose::Identity();
    D.linear() = R;
    D.translation() = m + Eigen::Vector3d(x, y, z) - R * m;
    return D * scene.T_ground_map_mav_map;
  }

  /// What images tell that are 2 cm and 0.02 rad sure, about the middle of what the MAV saw.
  KnownAlignment viewsAt(const Pose& T) const {
    KnownAlignment views;
    views.T_ground_map_mav_map = similarity(T);
    views.covariance = 4e-4 * Matrix6d::Identity();
    views.centre = scene.T_ground_map_mav_map * centre;
    return views;
  }

  double error(const Similarity& T) const { return (T * centre - scene.T_ground_map_mav_map * centre).norm(); }

  synthetic::Scene scene;
  AlignmentRefiner refiner;
  Eigen::Vector3d centre;
};

}  // namespace icp_refine
