#include "icp_refine/localizability.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <unordered_set>

#include "air_ground_common/linear_algebra.h"

namespace icp_refine {
namespace {

Vector6d jacobian(const MatchedClouds& c, std::size_t i, const Eigen::Vector3d& centre) {
  const Eigen::Vector3d n = c.reference.normals[c.matches.reference_index[i]].cast<double>();
  Vector6d J;
  J << n, (c.reading.points[i].cast<double>() - centre).cross(n);
  return J;
}

std::string axisName(const Eigen::Vector3d& v) {
  static const char* kNames[3] = {"x", "y", "z"};
  const Eigen::Vector3d u = v.normalized();
  for (int k = 0; k < 3; ++k) {
    if (std::abs(u[k]) > 0.98) return kNames[k];
  }
  char text[64];
  std::snprintf(text, sizeof(text), "(%.2f %.2f %.2f)", u.x(), u.y(), u.z());
  return text;
}

}  // namespace

bool Localizability::complete() const {
  for (const auto& d : directions) {
    if (!d.localizable) return false;
  }
  return true;
}

std::string Localizability::describeMissing() const {
  std::string out;
  for (const auto& d : directions) {
    if (d.localizable) continue;
    const Eigen::Vector3d t = d.v.head<3>(), r = d.v.tail<3>();
    std::string name;
    if (t.norm() > 0.4) name = "translation along " + axisName(t);
    if (r.norm() > 0.4) name += (name.empty() ? "rotation about " : " with rotation about ") + axisName(r);
    out += (out.empty() ? "" : ", ") + name;
  }
  return out;
}

Localizability analyzeLocalizability(const MatchedClouds& c, const std::vector<float>& weights,
                                     const Eigen::Vector3d& centre, const LocalizabilitySettings& settings) {
  Localizability out;
  double total = 0, range = 0;
  int matches = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] <= 0) continue;
    range += weights[i] * (c.reading.points[i].cast<double>() - centre).norm();
    total += weights[i];
    ++matches;
  }
  if (!(total > 0) || !(range > 0)) return out;
  out.mean_range = range / total;
  Vector6d scale = Vector6d::Ones();
  scale.tail<3>() /= out.mean_range;

  Matrix6d H = Matrix6d::Zero();
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] <= 0) continue;
    const Vector6d J = scale.cwiseProduct(jacobian(c, i, centre));
    H += weights[i] * J * J.transpose();
  }
  const auto eigen = air_ground_common::symmetricEigen(Matrix6d(H / total));
  std::array<std::unordered_set<std::uint64_t>, 6> patches;
  for (int k = 0; k < 6; ++k) {
    out.directions[k].v = eigen.vectors.col(k);
    out.directions[k].eigenvalue = eigen.values[k];
  }
  for (std::size_t i = 0; i < weights.size(); ++i) {
    // A match that the robust kernel has all but dropped is no evidence.
    if (weights[i] < 0.3f) continue;
    Vector6d J = scale.cwiseProduct(jacobian(c, i, centre));
    // A long lever would turn a slightly tilted floor normal into strong evidence for yaw.
    J.tail<3>() /= std::max(1.0, (c.reading.points[i].cast<double>() - centre).norm() / out.mean_range);
    for (int k = 0; k < 6; ++k) {
      if (std::abs(J.dot(out.directions[k].v)) < settings.strong) continue;
      ++out.directions[k].strong_points;
      patches[k].insert(cellKey(c.reading.points[i], static_cast<float>(settings.patch_size)));
    }
  }
  for (int k = 0; k < 6; ++k) {
    auto& d = out.directions[k];
    d.strong_patches = static_cast<int>(patches[k].size());
    d.localizable = d.strong_points >= settings.min_points && d.strong_points >= settings.min_share * matches &&
                    d.strong_patches >= settings.min_patches;
  }
  return out;
}

Matrix6d estimateCovariance(const MatchedClouds& c, const std::vector<float>& weights, const Step& step,
                            const Localizability& localizability, const CovarianceSettings& settings) {
  struct Block {
    Vector6d gradient = Vector6d::Zero();
    Vector6d information = Vector6d::Zero();  // sum of w J: gradient of a residual common to the block
  };
  const double range = std::max(localizability.mean_range, 1e-3);
  Vector6d unit = Vector6d::Ones();  // metres for all six
  unit.tail<3>() /= range;

  std::map<std::pair<std::uint64_t, int>, Block> blocks;  // ordered: sums do not depend on the hash
  Vector6d scale_gradient = Vector6d::Zero();
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] <= 0) continue;
    const Vector6d J = unit.cwiseProduct(jacobian(c, i, step.centre));
    const Eigen::Vector3f n = c.reference.normals[c.matches.reference_index[i]];
    int axis;
    n.cwiseAbs().maxCoeff(&axis);
    const int facing = 2 * axis + (n[axis] < 0);
    // Blocks in a cell with the same facing share the error of one surface.
    Block& block = blocks[{cellKey(c.reading.points[i], static_cast<float>(settings.block_size)), facing}];
    block.gradient += weights[i] * c.residual(i) * J;
    block.information += weights[i] * J;
    scale_gradient += weights[i] * n.cast<double>().dot(c.reading.points[i].cast<double>() - step.centre) * J;
  }

  Matrix6d H = unit.asDiagonal() * step.hessian * unit.asDiagonal();
  Matrix6d meat = Matrix6d::Zero();
  const double floor2 = settings.noise_floor * settings.noise_floor;
  for (const auto& [key, block] : blocks) {
    meat += block.gradient * block.gradient.transpose() + floor2 * block.information * block.information.transpose();
  }
  const double count = static_cast<double>(blocks.size());
  meat *= count > 12 ? count / (count - 6) : 2.0;

  // Missing directions: their own Hessian is noise, so they are taken out and given a wide variance below.
  Matrix6d inverse = Matrix6d::Zero();
  Matrix6d missing = Matrix6d::Zero();
  const auto eigen = air_ground_common::symmetricEigen(H);
  const double smallest = 1e-9 * std::max(eigen.values[5], 1e-9);
  for (int k = 0; k < 6; ++k) {
    const Vector6d v = eigen.vectors.col(k);
    // Eigenvectors of H and of the localizability analysis are the same up to weights' normalisation, weakest first.
    if (localizability.directions[k].localizable && eigen.values[k] > smallest) {
      inverse += v * v.transpose() / eigen.values[k];
    } else {
      missing += v * v.transpose();
    }
  }
  const Vector6d from_scale = settings.scale_sigma * (inverse * scale_gradient);
  Matrix6d covariance = settings.inflation * settings.inflation * inverse * meat * inverse +
                        from_scale * from_scale.transpose() + missing;
  covariance += 1e-8 * Matrix6d::Identity();  // 0.1 mm: positive definite whatever the geometry
  covariance = (unit.asDiagonal() * covariance * unit.asDiagonal()).eval();
  covariance.diagonal().head<3>().array() += settings.map_translation_sigma * settings.map_translation_sigma;
  covariance.diagonal().tail<3>().array() += settings.map_rotation_sigma * settings.map_rotation_sigma;
  return 0.5 * (covariance + covariance.transpose());
}

}  // namespace icp_refine
