#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>

#include "visual_frontend/pose_solver.h"

namespace visual_frontend {

std::optional<Eigen::Vector3d> solveP2P(const Eigen::Matrix3d& R, const Eigen::Vector3d& p0, const Eigen::Vector3d& ray0,
                                        const Eigen::Vector3d& p1, const Eigen::Vector3d& ray1) {
  // With R known, each ray leaves the camera centre one line through its point; c is nearest to both lines.
  const Eigen::Vector3d d0 = R * ray0.normalized(), d1 = R * ray1.normalized();
  const Eigen::Vector3d n = d0.cross(d1);
  const double sin2 = n.squaredNorm();
  if (!(sin2 > 1e-8)) return std::nullopt;
  // Lines c = p_i - s_i d_i: the nearest points of the two are at s_i below.
  const Eigen::Vector3d w = p0 - p1;
  const double s0 = w.cross(d1).dot(d0.cross(d1)) / sin2;
  const double s1 = w.cross(d0).dot(d0.cross(d1)) / sin2;
  if (!(s0 > 0 && s1 > 0)) return std::nullopt;
  return 0.5 * (p0 - s0 * d0 + p1 - s1 * d1);
}

namespace {

/// A real root of g3 x^3 + g2 x^2 + g1 x + g0, g3 != 0.
double realCubicRoot(double g3, double g2, double g1, double g0) {
  const double a = g2 / g3, b = g1 / g3, c = g0 / g3;
  const double q = (a * a - 3 * b) / 9, r = (2 * a * a * a - 9 * a * b + 27 * c) / 54;
  double x;
  if (r * r < q * q * q) {
    const double angle = std::acos(std::max(-1.0, std::min(1.0, r / std::sqrt(q * q * q))));
    x = -2 * std::sqrt(q) * std::cos(angle / 3) - a / 3;
  } else {
    const double s = -std::copysign(std::cbrt(std::abs(r) + std::sqrt(r * r - q * q * q)), r);
    x = s + (s != 0 ? q / s : 0) - a / 3;
  }
  for (int i = 0; i < 3; ++i) {  // polish
    const double f = ((x + a) * x + b) * x + c, d = (3 * x + 2 * a) * x + b;
    if (d == 0) break;
    x -= f / d;
  }
  return x;
}

/// Rotation and translation from three exact point pairs.
Pose poseFromTriangles(const Eigen::Matrix3d& p_map, const Eigen::Matrix3d& p_camera) {
  const auto frame = [](const Eigen::Matrix3d& p) {
    Eigen::Matrix3d F;
    F.col(0) = (p.col(1) - p.col(0)).normalized();
    F.col(2) = F.col(0).cross(p.col(2) - p.col(0)).normalized();
    F.col(1) = F.col(2).cross(F.col(0));
    return F;
  };
  Pose T = Pose::Identity();
  T.linear() = frame(p_map) * frame(p_camera).transpose();
  T.translation() = p_map.rowwise().mean() - T.linear() * p_camera.rowwise().mean();
  return T;
}

}  // namespace

std::vector<Pose> solveP3P(const Eigen::Matrix3d& p_map, const Eigen::Matrix3d& rays) {
  // Depths l along unit rays y: |l_i y_i - l_j y_j|^2 = a_ij, three quadrics l' M_ij l = a_ij. Two homogeneous
  // combinations D1, D2 vanish at the solution; the member D1 + g D2 of rank two splits into two planes (Persson and
  // Nordberg, ECCV 2018).
  Eigen::Matrix3d y = rays;
  for (int i = 0; i < 3; ++i) y.col(i).normalize();
  const auto gram = [&](int i, int j) {
    Eigen::Matrix3d M = Eigen::Matrix3d::Zero();
    M(i, i) = M(j, j) = 1;
    M(i, j) = M(j, i) = -y.col(i).dot(y.col(j));
    return M;
  };
  const Eigen::Matrix3d M[3] = {gram(0, 1), gram(0, 2), gram(1, 2)};
  const double a[3] = {(p_map.col(0) - p_map.col(1)).squaredNorm(), (p_map.col(0) - p_map.col(2)).squaredNorm(),
                       (p_map.col(1) - p_map.col(2)).squaredNorm()};
  std::vector<Pose> poses;
  const double scale2 = a[0] + a[1] + a[2];
  const double area2 = (p_map.col(1) - p_map.col(0)).cross(p_map.col(2) - p_map.col(0)).squaredNorm();
  if (!(area2 > 1e-12 * scale2 * scale2) || !(std::abs(y.determinant()) > 1e-9)) return poses;

  const Eigen::Matrix3d D1 = M[0] * a[2] - M[2] * a[0];
  const Eigen::Matrix3d D2 = M[1] * a[2] - M[2] * a[1];
  // det(D1 + g D2) as a cubic in g, from the mixed determinants.
  const auto mixed = [](const Eigen::Matrix3d& A, const Eigen::Matrix3d& B) {
    return B.col(0).dot(A.col(1).cross(A.col(2))) + A.col(0).dot(B.col(1).cross(A.col(2))) + A.col(0).dot(A.col(1).cross(B.col(2)));
  };
  const double g3 = D2.determinant(), g0 = D1.determinant(), g1 = mixed(D1, D2), g2 = mixed(D2, D1);
  const double size = std::abs(g0) + std::abs(g1) + std::abs(g2) + std::abs(g3);
  const Eigen::Matrix3d D = std::abs(g3) > 1e-14 * size ? Eigen::Matrix3d(D1 + realCubicRoot(g3, g2, g1, g0) * D2) : D2;
  const Eigen::Matrix3d& other = std::abs(g3) > 1e-14 * size ? D2 : D1;

  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(D);
  // Of the three eigenvalues the one of smallest magnitude stands for zero; the others must differ in sign.
  const Eigen::Vector3d values = eigen.eigenvalues();
  if (!(values[0] < 0 && values[2] > 0)) return poses;
  const Eigen::Vector3d e1 = eigen.eigenvectors().col(2) * std::sqrt(values[2]);
  const Eigen::Vector3d e2 = eigen.eigenvectors().col(0) * std::sqrt(-values[0]);

  for (const double sign : {1.0, -1.0}) {
    const Eigen::Vector3d n = e1 + sign * e2;  // plane n.l = 0
    int k;
    if (!(n.cwiseAbs().maxCoeff(&k) > 0)) continue;
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    // l = u l_i + v l_j spans the plane.
    Eigen::Vector3d u = Eigen::Vector3d::Zero(), v = Eigen::Vector3d::Zero();
    u[i] = 1;
    u[k] = -n[i] / n[k];
    v[j] = 1;
    v[k] = -n[j] / n[k];
    const double A = v.dot(other * v), B = 2 * u.dot(other * v), C = u.dot(other * u);  // in t = l_j / l_i
    double discriminant = B * B - 4 * A * C;
    if (discriminant < 0) {
      if (discriminant < -1e-9 * (B * B + std::abs(4 * A * C))) continue;
      discriminant = 0;
    }
    const double q = -0.5 * (B + std::copysign(std::sqrt(discriminant), B));
    const double roots[2] = {A != 0 ? q / A : -1, q != 0 ? C / q : -1};
    for (const double t : roots) {
      if (!(t > 0) || !std::isfinite(t)) continue;
      Eigen::Vector3d l = u + t * v;
      // Scale from the sum of the three equations: every term is positive.
      const double norm = l.dot((M[0] + M[1] + M[2]) * l);
      if (!(norm > 0)) continue;
      l *= std::sqrt(scale2 / norm);
      if (!(l.minCoeff() > 0)) continue;
      for (int iteration = 0; iteration < 4; ++iteration) {  // Newton on the three quadrics
        Eigen::Matrix3d J;
        Eigen::Vector3d r;
        for (int e = 0; e < 3; ++e) {
          J.row(e) = 2 * (M[e] * l).transpose();
          r[e] = l.dot(M[e] * l) - a[e];
        }
        if (r.cwiseAbs().maxCoeff() < 1e-14 * scale2) break;
        l -= J.partialPivLu().solve(r);
      }
      if (!l.allFinite() || !(l.minCoeff() > 0)) continue;
      bool exact = true;
      for (int e = 0; e < 3; ++e) exact = exact && std::abs(l.dot(M[e] * l) - a[e]) < 1e-6 * scale2;
      if (exact) poses.push_back(poseFromTriangles(p_map, y * l.asDiagonal()));
    }
  }
  return poses;
}

}  // namespace visual_frontend
