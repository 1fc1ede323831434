// The logs of the Zurich Urban MAV flight (Majdik, Till, Scaramuzza 2017): what was recorded, in a local frame, and the
// odometry and fixes made from its photogrammetric truth.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstdlib>
#include <fstream>
#include <optional>
#include <random>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "air_ground_common/geodesy.h"
#include "air_ground_common/geometry.h"
#include "ekf_tracker/tracker.h"

namespace ekf_tracker {

using Rows = std::vector<std::vector<double>>;

/// Comma-separated numbers; the header line and rows with fewer than `columns` are skipped.
inline Rows readCsv(const std::string& path, std::size_t columns) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path);
  Rows rows;
  std::string line, cell;
  while (std::getline(file, line)) {
    std::istringstream stream(line);
    std::vector<double> row;
    while (std::getline(stream, cell, ',')) {
      char* end = nullptr;
      const double value = std::strtod(cell.c_str(), &end);
      if (end == cell.c_str()) break;
      row.push_back(value);
    }
    if (row.size() >= columns) rows.push_back(row);
  }
  return rows;
}

struct AgzLog {
  air_ground_common::LocalFrame frame;
  std::vector<double> truth_stamps;              ///< [s], one a second
  std::vector<Vector4d> truth;                   ///< position, heading of the camera (unwrapped), in `frame`
  std::vector<Eigen::Matrix3d> R_grid_camera;    ///< as read: omega, phi, kappa
  std::vector<Eigen::Vector3d> gps;              ///< recorded, at truth_stamps
  std::vector<double> image_stamps;              ///< recorded, 30 Hz
  std::vector<std::array<double, 2>> barometer;  ///< stamp [s], altitude [m]
  std::vector<std::array<double, 2>> gyro_z;     ///< stamp [s], rate about the body's z axis (down) [rad/s]
  std::vector<Eigen::Vector3d> panoramas;        ///< recorded geotags; height 0

  /// Truth between its samples: cubic in position (Catmull-Rom), linear in heading. Empty outside.
  std::optional<Vector4d> at(double stamp) const;
};

inline AgzLog readAgz(const std::string& directory) {
  const Rows poses = readCsv(directory + "/GroundTruthAGL.csv", 10),
             images = readCsv(directory + "/GroundTruthAGM.csv", 2);
  if (poses.empty() || images.empty()) throw std::runtime_error("the logs in " + directory + " are empty");
  AgzLog log{air_ground_common::LocalFrame("EPSG:32632", {poses[0][1], poses[0][2], poses[0][3]}),
             {},
             {},
             {},
             {},
             {},
             {},
             {},
             {}};
  const double convergence = log.frame.meridianConvergence();
  for (const auto& row : images) log.image_stamps.push_back(row[0] * 1e-6);
  for (const auto& row : poses) {
    const auto image = static_cast<std::size_t>(row[0]) - 1;  // ids count from 1 and skip none
    if (image >= images.size() || static_cast<std::size_t>(images[image][1]) != image + 1)
      throw std::runtime_error("image ids are not consecutive");
    // Photogrammetry's omega, phi, kappa (the readme calls them yaw, pitch, roll): R_grid_camera = Rx Ry Rz, with the
    // camera's axes x right, y up, z backwards.
    const double d = M_PI / 180;
    const Eigen::Matrix3d R = (Eigen::AngleAxisd(row[4] * d, Eigen::Vector3d::UnitX()) *
                               Eigen::AngleAxisd(row[5] * d, Eigen::Vector3d::UnitY()) *
                               Eigen::AngleAxisd(row[6] * d, Eigen::Vector3d::UnitZ()))
                                  .toRotationMatrix();
    const Eigen::Vector3d ahead = -R.col(2);
    double yaw = std::atan2(ahead.y(), ahead.x()) - convergence;
    if (!log.truth.empty()) yaw = log.truth.back()[3] + air_ground_common::wrapAngle(yaw - log.truth.back()[3]);
    Vector4d pose;
    pose << log.frame.fromCrs({row[1], row[2], row[3]}), yaw;
    log.truth_stamps.push_back(log.image_stamps[image]);
    log.truth.push_back(pose);
    log.R_grid_camera.push_back(R);
    log.gps.push_back(log.frame.fromCrs({row[7], row[8], row[9]}));
  }
  for (const auto& row : readCsv(directory + "/BarometricPressure.csv", 3))
    log.barometer.push_back({row[0] * 1e-6, row[2]});
  for (const auto& row : readCsv(directory + "/RawGyro.csv", 5)) log.gyro_z.push_back({row[0] * 1e-6, row[4]});
  for (const auto& row : readCsv(directory + "/StreetViewGPS.csv", 2))
    log.panoramas.push_back(log.frame.fromGeodetic({row[0], row[1], poses[0][3]}));
  return log;
}

inline std::optional<Vector4d> AgzLog::at(double stamp) const {
  if (stamp < truth_stamps.front() || stamp > truth_stamps.back()) return std::nullopt;
  std::size_t i = static_cast<std::size_t>(std::upper_bound(truth_stamps.begin(), truth_stamps.end(), stamp) -
                                           truth_stamps.begin());
  i = std::min(i, truth_stamps.size() - 1);
  const std::size_t a = i - 1, before = a > 0 ? a - 1 : a, after = std::min(i + 1, truth.size() - 1);
  const double u = (stamp - truth_stamps[a]) / (truth_stamps[i] - truth_stamps[a]);
  const Vector4d in = 0.5 * (truth[i] - truth[before]), out = 0.5 * (truth[after] - truth[a]);
  const double u2 = u * u, u3 = u2 * u;
  Vector4d pose =
      (2 * u3 - 3 * u2 + 1) * truth[a] + (u3 - 2 * u2 + u) * in + (3 * u2 - 2 * u3) * truth[i] + (u3 - u2) * out;
  pose[3] = truth[a][3] + u * (truth[i][3] - truth[a][3]);
  return pose;
}

struct AgzMadeSettings {
  unsigned seed = 0;
  bool metric = false;
  double scale = 1.7;  ///< metres in one unit of an odometry that is not metric
  // Odometry, a step at 30 Hz: of the order of a good monocular odometry's drift (degrees and per cents in minutes).
  double translation_stddev = 0.003;  ///< [m], plus
  double translation_share = 0.03;    ///< of the step
  double yaw_stddev = 0.001;          ///< [rad]: 13 degrees in half an hour
  double scale_drift = 0.01;          ///< per square root of metre: 33 % in a kilometre
  // Fixes: tried when the last one is done, likelier near a panorama, with the paper's uncertainty.
  double fix_period = 3.2;                               ///< [s]: the paper's processing time; a fix arrives that late
  double match_range = 5;                                ///< [m]: sigma of the paper's figure 3
  Vector4d fix_stddev{4.2, 4.3, 3.6, 7.5 * M_PI / 180};  ///< the paper's average uncertainty
  double outlier_share = 0.05;
};

struct AgzMade {
  std::vector<Increment> odometry;
  std::vector<Measurement> fixes;
  std::vector<bool> outlier;
};

inline AgzMade make(const AgzLog& log, const AgzMadeSettings& s) {
  std::mt19937 random(s.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(0, 1);
  AgzMade out;
  double scale = s.metric ? 1 + 0.05 * normal(random) : s.scale;
  double next_fix = 0;
  for (std::size_t i = 1; i < log.image_stamps.size(); ++i) {
    const auto a = log.at(log.image_stamps[i - 1]), b = log.at(log.image_stamps[i]);
    if (!a || !b) continue;
    Increment increment;
    increment.previous_stamp = log.image_stamps[i - 1];
    increment.stamp = log.image_stamps[i];
    increment.metric = s.metric;
    const double c = std::cos((*a)[3]), sn = std::sin((*a)[3]);
    const Eigen::Vector3d d = b->head<3>() - a->head<3>();
    const Eigen::Vector3d body(c * d.x() + sn * d.y(), -sn * d.x() + c * d.y(), d.z());
    const double sigma = s.translation_stddev + s.translation_share * body.norm();
    for (int k = 0; k < 3; ++k) increment.motion[k] = (body[k] + sigma * normal(random)) / scale;
    increment.motion[3] = (*b)[3] - (*a)[3] + s.yaw_stddev * normal(random);
    const double unit = sigma / scale;
    increment.covariance = Vector4d(unit, unit, unit, s.yaw_stddev).cwiseAbs2().asDiagonal();
    out.odometry.push_back(increment);
    scale *= 1 + s.scale_drift * std::sqrt(body.norm()) * normal(random);

    if (increment.stamp < next_fix) continue;
    double nearest = 1e9;
    for (const auto& p : log.panoramas) nearest = std::min(nearest, (p - b->head<3>()).head<2>().norm());
    next_fix = increment.stamp + s.fix_period;
    if (uniform(random) > std::exp(-0.5 * std::pow(nearest / s.match_range, 2))) continue;
    Measurement fix;
    fix.stamp = increment.stamp;
    fix.covariance = s.fix_stddev.cwiseAbs2().asDiagonal();
    for (int k = 0; k < 4; ++k) fix.value[k] = (*b)[k] + s.fix_stddev[k] * normal(random);
    const bool wrong = uniform(random) < s.outlier_share;
    if (wrong) {
      const double away = 30 + 70 * uniform(random), direction = 2 * M_PI * uniform(random);
      fix.value += Vector4d(away * std::cos(direction), away * std::sin(direction), 0, 2 * M_PI * uniform(random));
    }
    fix.value[3] = air_ground_common::wrapAngle(fix.value[3]);
    out.fixes.push_back(fix);
    out.outlier.push_back(wrong);
  }
  return out;
}

}  // namespace ekf_tracker
