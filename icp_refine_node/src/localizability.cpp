#include "icp_refine/localizability.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/text.h"
#include "key_table.h"

namespace icp_refine {
namespace {

std::string axisName(const Eigen::Vector3d& v) {
  static const char* kNames[3] = {"x", "y", "z"};
  const Eigen::Vector3d u = v.normalized();
  for (int k = 0; k < 3; ++k) {
    if (std::abs(u[k]) > 0.98) return kNames[k];
  }
  return air_ground_common::formatted("(%.2f %.2f %.2f)", u.x(), u.y(), u.z());
}

using Matrix = Eigen::MatrixXd;

// Inverse of a symmetric matrix on the directions that have information.
Matrix pseudoInverse(const Matrix& A) {
  if (A.rows() == 0 || !A.allFinite()) return Matrix::Zero(A.rows(), A.cols());
  const Eigen::SelfAdjointEigenSolver<Matrix> eigen(A);
  const double limit = 1e-5 * eigen.eigenvalues()[A.rows() - 1];
  Eigen::VectorXd inverse = Eigen::VectorXd::Zero(A.rows());
  for (int k = 0; k < A.rows(); ++k) {
    if (limit > 0 && eigen.eigenvalues()[k] > limit) inverse[k] = 1 / eigen.eigenvalues()[k];
  }
  return eigen.eigenvectors() * inverse.asDiagonal() * eigen.eigenvectors().transpose();
}

// Inverse of A on the subspace that the columns of B span.
Matrix7d inverseOn(const Matrix& B, const Matrix7d& A) {
  return B * pseudoInverse(B.transpose() * A * B) * B.transpose();
}

// Metres for all seven: rotations and scale by the mean range.
Vector7d metres(double mean_range) {
  Vector7d unit = Vector7d::Ones();
  unit.tail<4>() /= std::max(mean_range, 1e-3);
  return unit;
}

// Directions of the pose that the geometry fixes, in metres; with_scale: and the scale.
Matrix fixedDirections(const Localizability& localizability, bool with_scale) {
  Matrix B = Matrix::Zero(7, 7);
  int columns = 0;
  for (const auto& d : localizability.directions) {
    if (d.localizable) B.col(columns++).head<6>() = d.v;
  }
  if (with_scale) B(6, columns++) = 1;
  return B.leftCols(columns);
}

// A prior of one unknown, all in metres: its weight against residuals, and its standard deviation.
struct Weighed {
  int index;
  double weight, deviation;
};

// (k^2 + information * distortion^2) / stddev^2: k^2 = u^T S u / u^T A u along the unknown's direction u.
Weighed weigh(int index, const Matrix7d& A, const Matrix7d& scatter, const Vector7d& u, double distortion,
              double deviation) {
  const double information = u.dot(A * u);
  if (!(information > 0) || !(deviation > 0) || !std::isfinite(deviation)) return {index, 0, deviation};
  const double variance = u.dot(scatter * u) / information + information * distortion * distortion;
  return {index, variance / (deviation * deviation), deviation};
}

// Those of the tilt; of the scale, where it follows the clouds, along what the pose cannot follow.
std::vector<Weighed> weighPriors(const Matrix7d& A, const Matrix7d& scatter, const Localizability& localizability,
                                 const Priors& priors, bool scale_free, const CovarianceSettings& settings) {
  const double range = localizability.mean_range;
  std::vector<Weighed> out;
  for (int axis : {3, 4}) {
    out.push_back(
        weigh(axis, A, scatter, Vector7d::Unit(axis), range * settings.map_rotation_sigma, range * priors.tilt_stddev));
  }
  if (scale_free && priors.scale.mode == ScalePrior::Mode::kPrior) {
    const Vector7d e = Vector7d::Unit(6);
    const Vector7d u = e - inverseOn(fixedDirections(localizability, false), A) * A * e;
    out.push_back(weigh(6, A, scatter, u, range * settings.map_scale_sigma, range * priors.scale.stddev));
  }
  return out;
}

}  // namespace

bool estimatesScale(const Localizability& localizability, int dof, const ScalePrior& prior) {
  return dof == 7 && prior.mode != ScalePrior::Mode::kFixed && localizability.scale.localizable;
}

bool Localizability::complete() const {
  for (const auto& d : directions) {
    if (!d.localizable) return false;
  }
  return scale.localizable || !needs_scale;
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
  if (needs_scale && !scale.localizable) out += out.empty() ? "scale" : ", scale";
  return out;
}

Localizability analyzeLocalizability(const MatchedClouds& c, const std::vector<float>& weights,
                                     const NormalEquations& equations, const LocalizabilitySettings& settings,
                                     ScalePrior::Mode mode) {
  Localizability out;
  out.needs_scale = mode == ScalePrior::Mode::kFree;
  if (!(equations.mean_range > 0)) return out;
  out.mean_range = equations.mean_range;
  const Vector7d unit = metres(out.mean_range);
  const Matrix7d H = unit.asDiagonal() * (equations.hessian / equations.weight) * unit.asDiagonal();
  const auto eigen = air_ground_common::symmetricEigen(Matrix6d(H.topLeftCorner<6, 6>()));
  // Rows: the six directions, and the scale without its regression on the pose.
  Matrix7d probes = Matrix7d::Identity();
  probes.topLeftCorner<6, 6>() = eigen.vectors.transpose();
  probes.bottomLeftCorner<1, 6>() = -(pseudoInverse(H.topLeftCorner<6, 6>()) * H.topRightCorner<6, 1>()).transpose();
  for (int k = 0; k < 6; ++k) {
    out.directions[k].v = eigen.vectors.col(k);
  }

  std::array<Evidence*, 7> evidence;
  for (int k = 0; k < 6; ++k) evidence[k] = &out.directions[k];
  evidence[6] = &out.scale;
  KeyTable cells;
  std::vector<char> seen;  // of each cell and direction
  for (std::size_t i = 0; i < weights.size(); ++i) {
    // A match that the robust kernel has all but dropped is no evidence.
    if (weights[i] < 0.3f) continue;
    Vector7d J = unit.cwiseProduct(jacobian(c, i, equations.centre));
    // A long lever would turn a slightly tilted floor normal into strong evidence for yaw.
    J.tail<4>() /= std::max(1.0, (c.reading.points[i].cast<double>() - equations.centre).norm() / out.mean_range);
    const Vector7d contribution = probes * J;
    const auto cell =
        static_cast<std::size_t>(cells.insert(cellKey(c.reading.points[i], static_cast<float>(settings.patch_size))));
    if (seen.size() <= 7 * cell) seen.resize(7 * cell + 7, 0);
    for (int k = 0; k < 7; ++k) {
      if (std::abs(contribution[k]) < settings.strong) continue;
      ++evidence[k]->strong_points;
      evidence[k]->strong_patches += !seen[7 * cell + k];
      seen[7 * cell + k] = 1;
    }
  }
  for (Evidence* e : evidence) {
    e->localizable = e->strong_points >= settings.min_points &&
                     e->strong_points >= settings.min_share * static_cast<double>(equations.used) &&
                     e->strong_patches >= settings.min_patches;
  }
  return out;
}

Matrix7d gradientScatter(const MatchedClouds& c, const std::vector<float>& weights, const Eigen::Vector3d& centre,
                         const CovarianceSettings& settings) {
  struct Block {
    Vector7d gradient = Vector7d::Zero();
    Vector7d information = Vector7d::Zero();  // sum of w J: gradient of a residual common to the block
  };
  KeyTable keys;
  std::vector<Block> blocks;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] <= 0) continue;
    const Vector7d J = jacobian(c, i, centre);
    const Eigen::Vector3f n = c.reference.normals[c.matches.reference_index[i]];
    int axis;
    n.cwiseAbs().maxCoeff(&axis);
    const auto facing = static_cast<std::uint64_t>(2 * axis + (n[axis] < 0));
    // Points of a cell with the same facing share the error of one surface. Keys made alike by the facing belong to
    // cells half a grid apart.
    const std::uint64_t cell = cellKey(c.reading.points[i], static_cast<float>(settings.block_size));
    const auto block = static_cast<std::size_t>(keys.insert(cell ^ facing << 61));
    if (block >= blocks.size()) blocks.emplace_back();
    blocks[block].gradient += weights[i] * c.residual(i) * J;
    blocks[block].information += weights[i] * J;
  }
  Matrix7d scatter = Matrix7d::Zero();
  const double floor2 = settings.noise_floor * settings.noise_floor;
  for (const auto& block : blocks) {
    scatter += block.gradient * block.gradient.transpose() + floor2 * block.information * block.information.transpose();
  }
  const double count = static_cast<double>(blocks.size());
  return scatter * (count > 14 ? count / (count - 7) : 2.0);
}

Vector7d constrainedStep(const NormalEquations& equations, const Localizability& localizability,
                         const Matrix7d& scatter, int dof, const Priors& priors, const Similarity& T,
                         const CovarianceSettings& settings) {
  const Vector7d unit = metres(localizability.mean_range);
  Matrix7d H = unit.asDiagonal() * equations.hessian * unit.asDiagonal();
  Vector7d g = unit.cwiseProduct(equations.gradient);
  Vector7d to_mean = Vector7d::Zero();  // of the priors, in metres
  to_mean.segment<2>(3) = -priors.up_reference.cross(T.R * priors.up_reading).head<2>() / unit[3];
  to_mean[6] = std::log(priors.scale.mean / T.scale) / unit[6];
  Vector7d held = Vector7d::Zero();
  Matrix B;
  if (dof == 4) {
    B = Matrix::Zero(7, 4);
    B(0, 0) = B(1, 1) = B(2, 2) = B(5, 3) = 1;
  } else {
    const bool free = estimatesScale(localizability, dof, priors.scale);
    B = fixedDirections(localizability, free);
    const Matrix7d A = equations.slope * H, S = unit.asDiagonal() * scatter * unit.asDiagonal();
    for (const Weighed& prior : weighPriors(A, S, localizability, priors, free, settings)) {
      H(prior.index, prior.index) += prior.weight;
      g[prior.index] -= prior.weight * to_mean[prior.index];
    }
    if (dof == 7 && !free) held[6] = to_mean[6];
  }
  Vector7d step = held - inverseOn(B, H) * (g + H * held);
  if (dof == 4) {
    for (const auto& d : localizability.directions) {
      if (!d.localizable) step.head<6>() -= d.v * d.v.dot(step.head<6>());
    }
    step.segment<2>(3).setZero();
  }
  return unit.cwiseProduct(step);
}

Matrix7d estimateCovariance(const NormalEquations& equations, const Localizability& localizability,
                            const Matrix7d& scatter, int dof, const Priors& priors,
                            const CovarianceSettings& settings) {
  const Vector7d unit = metres(localizability.mean_range), e = Vector7d::Unit(6);
  const Matrix7d residuals = equations.slope * (unit.asDiagonal() * equations.hessian * unit.asDiagonal());
  const Matrix7d S = settings.inflation * settings.inflation * (unit.asDiagonal() * scatter * unit.asDiagonal());
  // Missing directions: their own Hessian is noise, so they are left out and given a wide variance.
  Matrix7d covariance = 1e-8 * Matrix7d::Identity();  // 0.1 mm: positive definite whatever the geometry
  for (const auto& d : localizability.directions) {
    if (!d.localizable) covariance.topLeftCorner<6, 6>() += d.v * d.v.transpose();
  }
  const bool free = estimatesScale(localizability, dof, priors.scale);
  std::vector<Weighed> weighed;
  if (dof > 4) weighed = weighPriors(residuals, S, localizability, priors, free, settings);
  Matrix7d A = residuals;
  for (const Weighed& prior : weighed) A(prior.index, prior.index) += prior.weight;
  const Matrix7d inverse = inverseOn(fixedDirections(localizability, free), A);
  covariance += inverse * S * inverse;
  // What the maps' distortion does to the alignment, as far as the priors leave it to the residuals.
  const double range = localizability.mean_range;
  Vector7d distortion;
  distortion << Eigen::Vector3d::Constant(settings.map_translation_sigma),
      Eigen::Vector3d::Constant(range * settings.map_rotation_sigma), free ? range * settings.map_scale_sigma : 0.0;
  const Matrix7d shift = inverse * residuals * distortion.asDiagonal();
  covariance += shift * shift.transpose();
  for (const Weighed& prior : weighed) {
    if (prior.weight == 0) continue;
    const Vector7d by_prior = prior.weight * prior.deviation * inverse.col(prior.index);
    covariance += by_prior * by_prior.transpose();
  }
  if (!free) {
    const Vector7d by_scale = e - inverse * (A * e);
    const double unknown = priors.scale.mode == ScalePrior::Mode::kFree ? 1.0 : priors.scale.stddev / unit[6];
    covariance += unknown * unknown * by_scale * by_scale.transpose();
  }
  covariance = (unit.asDiagonal() * covariance * unit.asDiagonal()).eval();
  if (!free) covariance(6, 6) += settings.map_scale_sigma * settings.map_scale_sigma;
  return 0.5 * (covariance + covariance.transpose());
}

}  // namespace icp_refine
