// A street flight with known truth: odometry in an unknown unit, late fixes, outliers. Noise is drawn from the very
// covariances that the messages state, so that a right filter must be consistent.
#pragma once

#include <Eigen/Cholesky>
#include <optional>
#include <random>
#include <vector>

#include "air_ground_common/geometry.h"
#include "ekf_tracker/tracker.h"

namespace ekf_tracker {

struct SimulationSettings {
  unsigned seed = 0;
  double duration = 75;  ///< [s]; 150 m at 2 m/s, as in the paper
  double rate = 20;      ///< [Hz]
  double scale = 1;      ///< metres in one unit of the odometry
  bool metric = true;
  double fix_interval = 3.25;   ///< [s]: every 6.5 m
  double outlier_share = 0;     ///< of the fixes, thrown 25 to 100 m away with any yaw
  bool outliers_alike = false;  ///< all of them by the same
  double place_spacing = 0;     ///< way along which fixes rest on one panorama; 0: fixes do not name theirs [m]
  double common_share = 0;      ///< of a fix's variance, of an error that all fixes of its panorama have in common
  double speed = 2;             ///< [m/s]
  Vector4d fix_stddev{2.0, 2.2, 1.5, 7.5 * M_PI / 180};
  Vector4d odometry_stddev{0.010, 0.010, 0.008, 0.003};  ///< of a step, translation [m]
};

struct Simulation {
  std::vector<double> stamps;       ///< of the truth
  std::vector<Vector4d> truth;      ///< poses in world, yaw wrapped
  std::vector<Increment> odometry;  ///< from stamps[i] to stamps[i + 1]
  std::vector<Measurement> fixes;
  std::vector<bool> outlier;
  std::vector<Vector4d> truth_at_fix;
};

inline Vector4d gaussian(std::mt19937* random, const Matrix4d& covariance) {
  std::normal_distribution<double> normal;
  Vector4d n;
  for (int i = 0; i < 4; ++i) n[i] = normal(*random);
  return covariance.llt().matrixL() * n;
}

inline Simulation simulate(const SimulationSettings& s, const FilterSettings& filter) {
  std::mt19937 random(s.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(0, 1);
  Simulation out;
  Vector4d q(10, -5, 4, 2.9);  // the yaw crosses +-pi early on
  double scale = s.scale * (s.metric ? 1 + filter.metric_scale_stddev * normal(random) : 1);
  const double dt = 1 / s.rate;
  const int steps = static_cast<int>(s.duration * s.rate);
  const int fix_every = static_cast<int>(s.fix_interval * s.rate);
  Matrix4d odometry_covariance = s.odometry_stddev.cwiseAbs2().asDiagonal();
  odometry_covariance(0, 1) = odometry_covariance(1, 0) = 0.3 * s.odometry_stddev[0] * s.odometry_stddev[1];
  Vector4d unit;
  unit << Eigen::Vector3d::Constant(1 / s.scale), 1;
  odometry_covariance = (unit.asDiagonal() * odometry_covariance * unit.asDiagonal()).eval();
  Matrix4d fix_covariance = s.fix_stddev.cwiseAbs2().asDiagonal();
  fix_covariance(0, 1) = fix_covariance(1, 0) = 0.4 * s.fix_stddev[0] * s.fix_stddev[1];

  std::optional<Vector4d> thrown;
  double way = 0;
  Vector4d common = Vector4d::Zero();
  unsigned place = 0, wrong_place = 1000000;
  for (int i = 0; i <= steps; ++i) {
    const double t = 100 + i * dt;
    out.stamps.push_back(t);
    out.truth.push_back(q);
    if (i % fix_every == 0) {
      Measurement fix;
      fix.stamp = t;
      fix.covariance = fix_covariance;
      if (s.place_spacing > 0) fix.place = 1 + static_cast<unsigned>(way / s.place_spacing);
      if (fix.place != place && s.common_share > 0) common = gaussian(&random, s.common_share * fix_covariance);
      place = fix.place;
      fix.value = q + common + std::sqrt(1 - s.common_share) * gaussian(&random, fix_covariance);
      const bool wrong = uniform(random) < s.outlier_share;
      if (wrong) {
        const double away = 25 + 75 * uniform(random), direction = 2 * M_PI * uniform(random);
        const Vector4d by(away * std::cos(direction), away * std::sin(direction), 4 * normal(random),
                          2 * M_PI * uniform(random));
        if (!thrown || !s.outliers_alike) thrown = by;
        fix.value += *thrown;
        if (fix.place != 0) fix.place = s.outliers_alike ? wrong_place : ++wrong_place;
      }
      fix.value[3] = air_ground_common::wrapAngle(fix.value[3]);
      out.fixes.push_back(fix);
      out.outlier.push_back(wrong);
      out.truth_at_fix.push_back(q);
    }
    // Side-looking: it flies to its right, weaving, climbing and sinking.
    const Vector4d motion(0.3 * std::sin(0.2 * t) * dt, -s.speed * dt, 0.3 * std::cos(0.3 * t) * dt,
                          0.15 * std::sin(0.25 * t) * dt);
    Increment increment;
    increment.previous_stamp = t;
    increment.stamp = 100 + (i + 1) * dt;
    increment.metric = s.metric;
    increment.covariance = odometry_covariance;
    increment.motion << motion.head<3>() / scale, motion[3];
    increment.motion += gaussian(&random, odometry_covariance);
    out.odometry.push_back(increment);
    q = move<double>(q, motion, 1);
    way += motion.head<3>().norm();
    q[3] = air_ground_common::wrapAngle(q[3]);
    scale *= 1 + filter.scale_drift * std::sqrt(motion.head<3>().norm()) * normal(random);
  }
  out.odometry.pop_back();
  return out;
}

inline Vector4d poseError(const Vector4d& a, const Vector4d& b) {
  Vector4d e = a - b;
  e[3] = air_ground_common::wrapAngle(e[3]);
  return e;
}

}  // namespace ekf_tracker
