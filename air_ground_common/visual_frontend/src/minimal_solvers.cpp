#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "visual_frontend/pose_solver.h"

namespace visual_frontend {

std::optional<Eigen::Vector3d> solveP2P(const Eigen::Matrix3d& R, const Eigen::Vector3d& p0,
                                        const Eigen::Vector3d& ray0, const Eigen::Vector3d& p1,
                                        const Eigen::Vector3d& ray1) {
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

/// Largest real root of x^3 + a x^2 + b x + c.
double largestCubicRoot(double a, double b, double c) {
  const double q = (a * a - 3 * b) / 9, r = (2 * a * a * a - 9 * a * b + 27 * c) / 54;
  double x;
  if (r * r < q * q * q) {
    const double root = std::sqrt(q), angle = std::acos(std::clamp(r / (q * root), -1.0, 1.0));
    x = -2 * root * std::cos((angle + 2 * M_PI) / 3) - a / 3;
  } else {
    const double s = -std::copysign(std::cbrt(std::abs(r) + std::sqrt(r * r - q * q * q)), r);
    x = s + (s != 0 ? q / s : 0) - a / 3;
  }
  for (int i = 0; i < 2; ++i) {  // polish
    const double f = ((x + a) * x + b) * x + c, d = (3 * x + 2 * a) * x + b;
    if (d == 0) break;
    x -= f / d;
  }
  return x;
}

/// Real roots of k4 x^4 + ... + k0 (Ferrari), complex pairs that are nearly a double root included; returns their
/// number.
int realQuarticRoots(const double k[5], double roots[4]) {
  const double A = k[3] / k[4], B = k[2] / k[4], C = k[1] / k[4], D = k[0] / k[4];
  const double A2 = A * A;
  const double p = B - 3 * A2 / 8, q = C - A * B / 2 + A2 * A / 8, r = D - A * C / 4 + A2 * B / 16 - 3 * A2 * A2 / 256;
  if (!std::isfinite(p + q + r)) return 0;
  // y^4 + p y^2 + q y + r = (y^2 + p/2 + m)^2 - 2m (y - q / 4m)^2, x = y - A/4.
  const double m = largestCubicRoot(p, p * p / 4 - r, -q * q / 8);
  int count = 0;
  const auto quadratic = [&](double b, double c) {  // y^2 + b y + c
    double discriminant = b * b / 4 - c;
    if (discriminant < -1e-7 * (b * b / 4 + std::abs(c))) return;
    discriminant = std::sqrt(std::max(0.0, discriminant));
    roots[count++] = -b / 2 + discriminant - A / 4;
    roots[count++] = -b / 2 - discriminant - A / 4;
  };
  if (m > 1e-12 * (std::abs(p) + std::sqrt(std::abs(r)))) {
    const double w = std::sqrt(2 * m);
    quadratic(w, p / 2 + m - q / (2 * w));
    quadratic(-w, p / 2 + m + q / (2 * w));
  } else {  // biquadratic
    const double s = p * p / 4 - r;
    if (s < 0) return 0;
    for (const double y2 : {-p / 2 + std::sqrt(s), -p / 2 - std::sqrt(s)}) {
      if (y2 >= 0) quadratic(0, -y2);
    }
  }
  for (int i = 0; i < count; ++i) {  // polish
    double& x = roots[i];
    for (int iteration = 0; iteration < 2; ++iteration) {
      const double f = (((x + A) * x + B) * x + C) * x + D, d = ((4 * x + 3 * A) * x + 2 * B) * x + C;
      if (std::abs(d) < 1e-8 * (1 + std::abs(C))) break;
      x -= f / d;
    }
  }
  return count;
}

/// Newton steps on the depths l of the three rays y so that the sides of the triangle are right. False when it fails.
bool polishDepths(const Eigen::Matrix3d& y, const double (&side2)[3], Eigen::Vector3d* l) {
  const double cosine[3] = {y.col(0).dot(y.col(1)), y.col(0).dot(y.col(2)), y.col(1).dot(y.col(2))};
  const double scale2 = side2[0] + side2[1] + side2[2];
  constexpr int kFirst[3] = {0, 0, 1}, kSecond[3] = {1, 2, 2};
  for (int iteration = 0;; ++iteration) {
    Eigen::Matrix3d J = Eigen::Matrix3d::Zero();
    Eigen::Vector3d r;
    for (int e = 0; e < 3; ++e) {
      const double a = (*l)[kFirst[e]], b = (*l)[kSecond[e]];
      r[e] = a * a + b * b - 2 * cosine[e] * a * b - side2[e];
      J(e, kFirst[e]) = 2 * (a - cosine[e] * b);
      J(e, kSecond[e]) = 2 * (b - cosine[e] * a);
    }
    const double error = r.cwiseAbs().maxCoeff();
    if (error < 1e-12 * scale2) return true;
    if (iteration == 4) return error < 1e-9 * scale2;
    const double determinant = J.determinant();
    if (!(std::abs(determinant) > 0)) return error < 1e-9 * scale2;
    *l -= J.inverse() * r;
    if (!(l->minCoeff() > 0)) return false;
  }
}

}  // namespace

P3PSolutions solveP3PFixed(const Eigen::Matrix3d& p_map, const Eigen::Matrix3d& rays) {
  P3PSolutions solutions;
  Eigen::Matrix3d y = rays, P = p_map;
  for (int i = 0; i < 3; ++i) y.col(i).normalize();
  const Eigen::Vector3d side12 = P.col(1) - P.col(0), side13 = P.col(2) - P.col(0);
  const double scale2 = side12.squaredNorm() + side13.squaredNorm();
  if (!(side12.cross(side13).squaredNorm() > 1e-12 * scale2 * scale2) || !(std::abs(y.determinant()) > 1e-9))
    return solutions;

  // Intermediate camera frame with ray 1 along x and ray 2 in the xy plane; the third ray must have z < 0 (their eq.
  // 1).
  Eigen::Matrix3d T;
  const auto cameraFrame = [&] {
    T.row(0) = y.col(0);
    T.row(2) = y.col(0).cross(y.col(1)).normalized();
    T.row(1) = T.row(2).transpose().cross(y.col(0));
  };
  cameraFrame();
  if (T.row(2).dot(y.col(2)) > 0) {
    y.col(0).swap(y.col(1));
    P.col(0).swap(P.col(1));
    cameraFrame();
  }
  const Eigen::Vector3d f3 = T * y.col(2);
  // Intermediate map frame with P2 on the x axis and P3 in the xy plane (eq. 2).
  Eigen::Matrix3d N;
  const double d = (P.col(1) - P.col(0)).norm();
  N.row(0) = (P.col(1) - P.col(0)) / d;
  N.row(2) = N.row(0).transpose().cross(P.col(2) - P.col(0)).normalized();
  N.row(1) = N.row(2).transpose().cross(N.row(0).transpose());
  const double p1 = N.row(0).dot(P.col(2) - P.col(0)), p2 = N.row(1).dot(P.col(2) - P.col(0));
  const double f1 = f3.x() / f3.z(), f2 = f3.y() / f3.z();
  const double cosine = y.col(0).dot(y.col(1));
  const double b =
      cosine / std::sqrt(std::max(1e-300, 1 - cosine * cosine));  // cotangent of the angle between rays 1, 2

  // Quartic in the cosine of the angle between the planes of the two frames (eq. 11).
  const double f11 = f1 * f1, f22 = f2 * f2, p11 = p1 * p1, p22 = p2 * p2, p222 = p22 * p2, p2222 = p22 * p22,
               d2 = d * d, b2 = b * b;
  const double k[5] = {
      -2 * f1 * f2 * p1 * p22 * d * b + f22 * p22 * d2 + 2 * p11 * p1 * d - p11 * d2 + f22 * p22 * p11 - p11 * p11 -
          2 * f22 * p22 * p1 * d + p22 * f11 * p11 + f22 * p22 * d2 * b2,
      2 * p11 * p2 * d * b + 2 * f1 * f2 * p222 * d - 2 * f22 * p222 * d * b - 2 * p1 * p2 * d2 * b,
      -f22 * p22 * p11 - f22 * p22 * d2 * b2 - f22 * p22 * d2 + f22 * p2222 + p2222 * f11 + 2 * p1 * p22 * d +
          2 * f1 * f2 * p1 * p22 * d * b - p22 * p11 * f11 + 2 * p1 * p22 * f22 * d - p22 * d2 * b2 - 2 * p11 * p22,
      2 * p222 * d * b + 2 * f22 * p222 * d * b - 2 * f1 * f2 * p222 * d, -f22 * p2222 - p2222 * f11 - p2222};
  double roots[4];
  const int count = realQuarticRoots(k, roots);
  const double side2[3] = {d2, (P.col(2) - P.col(0)).squaredNorm(), (P.col(2) - P.col(1)).squaredNorm()};
  for (int i = 0; i < count; ++i) {
    const double cos_theta = std::clamp(roots[i], -1.0, 1.0), sin_theta = std::sqrt(1 - cos_theta * cos_theta);
    // Angle alpha at P1 between the baseline and the camera centre (eq. 9), multiplied by f2 so that f2 may vanish.
    const double numerator = -f1 * p1 + f2 * (d * b - cos_theta * p2),
                 denominator = -f1 * cos_theta * p2 + f2 * (p1 - d);
    const double length = std::copysign(std::hypot(numerator, denominator), denominator);
    if (!(std::abs(length) > 0)) continue;
    const double sin_alpha = denominator / length, cos_alpha = numerator / length;
    const double along = d * (sin_alpha * b + cos_alpha);
    const Eigen::Vector3d centre(along * cos_alpha, along * sin_alpha * cos_theta, along * sin_alpha * sin_theta);
    // Depths of the three points, then their Newton polish: the quartic loses digits near double roots.
    Eigen::Vector3d l(centre.norm(), (centre - Eigen::Vector3d(d, 0, 0)).norm(),
                      (centre - Eigen::Vector3d(p1, p2, 0)).norm());
    if (!l.allFinite() || !(l.minCoeff() > 0) || !polishDepths(y, side2, &l)) continue;
    bool known = false;
    // The frame N of the triangle, seen by the camera.
    Eigen::Matrix3d C;
    C.col(0) = (l[1] * y.col(1) - l[0] * y.col(0)) / d;
    C.col(2) = C.col(0).cross(l[2] * y.col(2) - l[0] * y.col(0)) / p2;
    C.col(1) = C.col(2).cross(C.col(0));
    const Eigen::Matrix3d R = (C * N).transpose();
    const Eigen::Vector3d t = P.col(0) - R * (l[0] * y.col(0));
    for (int j = 0; j < solutions.size && !known; ++j)
      known = (t - solutions.t_map_camera[j]).squaredNorm() < 1e-18 * scale2;
    if (known) continue;
    solutions.R_map_camera[solutions.size] = R;
    solutions.t_map_camera[solutions.size++] = t;
  }
  return solutions;
}

std::vector<Pose> solveP3P(const Eigen::Matrix3d& p_map, const Eigen::Matrix3d& rays) {
  const P3PSolutions solutions = solveP3PFixed(p_map, rays);
  std::vector<Pose> poses(solutions.size, Pose::Identity());
  for (int i = 0; i < solutions.size; ++i) {
    poses[i].linear() = solutions.R_map_camera[i];
    poses[i].translation() = solutions.t_map_camera[i];
  }
  return poses;
}

}  // namespace visual_frontend
