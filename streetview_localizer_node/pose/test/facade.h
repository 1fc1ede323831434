// Simulated facade, seen by a panorama and by a query, with exact truth: for tests and benchmarks of the pose.
#pragma once

#include <cmath>

#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/testing/camera.h"
#include "air_ground_common/testing/random.h"
#include "streetview_localizer/acceptance.h"

namespace streetview_localizer::simulation {

using air_ground_common::testing::Random;

/// Small front camera of a MAV.
inline CameraModel camera(bool distorted = true) {
  const Eigen::Vector4d distortion(-0.18, 0.05, 0.0008, -0.0006);
  return air_ground_common::testing::vgaCamera({500, 498, 321, 238}, (distorted ? 1 : 0) * distortion);
}

/// Facade coordinates: x along the wall, y into the building, z up; the street is at y < 0.
struct FacadeSettings {
  double distance = 12;          ///< of the query from the wall [m]
  double max_side = 6;           ///< and along it, from the centre of what it sees [m]
  double panorama_distance = 9;  ///< [m]
  double panorama_side = 3;
  int inliers = 60;
  int outliers = 30;
  double pixel_noise = 1;  ///< of a match, one axis [px]
  double relief = 0;       ///< share of the points 0.5 m in front of the wall, on balconies that the model has
  double hidden_relief =
      0;  ///< of the real wall, unknown to the model: standard deviation [m], constant over 1.5 m patches
  bool database_errors = false;  ///< as PointSource says
  bool distorted = true;
  double span = 18;   ///< width of the part of the wall that is matched [m]; its height is two thirds
  int shifted = 0;    ///< matches with the next window, `period` farther along the wall, in place of the right one
  double period = 3;  ///< [m]
};

struct Scene {
  std::vector<Correspondence> matches;
  CameraModel camera;
  Pose T_world_camera = Pose::Identity();
  PointSource source;
  Pose T_world_facade = Pose::Identity();
};

/// Camera at `centre` that looks at `target`, its x axis level but for `roll` [rad].
inline Pose lookAt(const Eigen::Vector3d& centre, const Eigen::Vector3d& target, double roll) {
  const Eigen::Vector3d z = (target - centre).normalized(), x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
  Pose T = Pose::Identity();
  T.linear().col(0) = x;
  T.linear().col(1) = z.cross(x);
  T.linear().col(2) = z;
  T.linear() = T.linear() * air_ground_common::expSO3({0, 0, roll});
  T.translation() = centre;
  return T;
}

inline Scene facadeScene(Random& random, const FacadeSettings& s) {
  Scene scene;
  scene.camera = camera(s.distorted);
  scene.T_world_facade = air_ground_common::yawPose(
      random.uniform(-M_PI, M_PI), {random.uniform(-200, 200), random.uniform(-200, 200), random.uniform(-5, 20)});
  const Eigen::Vector3d target(0, 0, random.uniform(3, 7));
  const Pose T_facade_camera =
      lookAt({random.uniform(-s.max_side, s.max_side), -s.distance, random.uniform(2, 10)},
             target + Eigen::Vector3d(random.gauss(0.5), 0, random.gauss(0.5)), random.gauss(0.03));
  const Eigen::Vector3d panorama(random.uniform(-s.panorama_side, s.panorama_side), -s.panorama_distance, 2.5);

  // The database believes another panorama pose and other walls.
  Eigen::Vector3d position_error = Eigen::Vector3d::Zero(), rotation_error = Eigen::Vector3d::Zero();
  double offset[2] = {0, 0}, height = 0;
  if (s.database_errors) {
    position_error = random.gaussVector(scene.source.position_stddev);
    rotation_error = random.gaussVector(scene.source.orientation_stddev);
    for (double& o : offset) o = random.gauss(scene.source.model_lateral_stddev);
    height = random.gauss(scene.source.model_height_stddev);
  }
  const Eigen::Vector3d believed = panorama + position_error;
  double patches[16][16];
  for (auto& row : patches) {
    for (double& p : row) p = random.gauss(s.hidden_relief);
  }
  const Pose inverse = T_facade_camera.inverse();
  const auto add = [&](bool good, double shift) {
    for (int attempt = 0; attempt < 1000; ++attempt) {
      Eigen::Vector3d p(0.5 * s.span * random.uniform(-1, 1), 0,
                        std::max(0.2, target.z() + s.span / 3 * random.uniform(-1, 1)));
      const bool balcony = random.uniform(0, 1) < s.relief;
      if (balcony) p.y() = -0.5;
      const double wall = p.y();
      p.y() += patches[static_cast<int>((p.x() + 12) / 1.5)][static_cast<int>(p.z() / 1.5)];
      auto pixel = scene.camera.project(inverse * p);
      if (!pixel || !scene.camera.contains(*pixel, 5)) continue;
      p.x() += shift;
      const Eigen::Vector3d ray = air_ground_common::expSO3(rotation_error) * (p - panorama);
      const double y = wall + offset[balcony];
      const Eigen::Vector3d cast = believed + ray * ((y - believed.y()) / ray.y());
      Correspondence c;
      if (!good) *pixel = {random.uniform(5, 635), random.uniform(5, 475)};
      c.pixel = *pixel + Eigen::Vector2d(random.gauss(s.pixel_noise), random.gauss(s.pixel_noise));
      c.p_world = scene.T_world_facade * (cast + Eigen::Vector3d(0, 0, height));
      c.normal = scene.T_world_facade.linear() * Eigen::Vector3d(0, -1, 0);
      c.quality = random.uniform(good ? 0.3 : 0, good ? 1 : 0.7);
      scene.matches.push_back(c);
      return;
    }
  };
  for (int i = 0; i < s.inliers; ++i) add(true, 0);
  for (int i = 0; i < s.outliers; ++i) add(false, 0);
  for (int i = 0; i < s.shifted; ++i) add(true, s.period);
  scene.T_world_camera = scene.T_world_facade * T_facade_camera;
  scene.source.position = scene.T_world_facade * (believed + Eigen::Vector3d(0, 0, height));
  return scene;
}

inline double positionError(const Pose& a, const Pose& b) { return (a.translation() - b.translation()).norm(); }

/// Normalised squared error; 6 on average for an honest covariance.
inline double nees(const Pose& truth, const Pose& estimate, const Matrix6d& covariance) {
  air_ground_common::Vector6d e;
  e.head<3>() = truth.translation() - estimate.translation();
  e.tail<3>() = air_ground_common::logSO3(truth.linear() * estimate.linear().transpose());
  return air_ground_common::squaredMahalanobis(e, covariance);
}

}  // namespace streetview_localizer::simulation
