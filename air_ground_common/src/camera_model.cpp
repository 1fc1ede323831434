#include "air_ground_common/camera_model.h"

#include <Eigen/Geometry>
#include <cmath>
#include <sstream>
#include <stdexcept>

namespace air_ground_common {
namespace {

// Distorts (x, y); fills the 2x2 Jacobian of the distorted with respect to the undistorted coordinates if asked.
Eigen::Vector2d distortWithJacobian(const CameraModel& c, const Eigen::Vector2d& n, Eigen::Matrix2d* J) {
  const double x = n.x(), y = n.y();
  const double r2 = x * x + y * y;
  const double radial = 1 + r2 * (c.k1 + r2 * (c.k2 + r2 * c.k3));
  if (J) {
    const double d_radial = 2 * (c.k1 + r2 * (2 * c.k2 + r2 * 3 * c.k3));  // d radial / d r2, times 2
    (*J)(0, 0) = radial + x * x * d_radial + 2 * c.p1 * y + 6 * c.p2 * x;
    (*J)(0, 1) = x * y * d_radial + 2 * c.p1 * x + 2 * c.p2 * y;
    (*J)(1, 0) = (*J)(0, 1);
    (*J)(1, 1) = radial + y * y * d_radial + 6 * c.p1 * y + 2 * c.p2 * x;
  }
  return {x * radial + 2 * c.p1 * x * y + c.p2 * (r2 + 2 * x * x),
          y * radial + c.p1 * (r2 + 2 * y * y) + 2 * c.p2 * x * y};
}

}  // namespace

void CameraModel::validate() const {
  const auto fail = [](const char* name, double value, const char* rule) {
    std::ostringstream s;
    s << "camera calibration: " << name << " = " << value << " " << rule;
    throw std::invalid_argument(s.str());
  };
  if (width <= 0) fail("width", width, "must be positive");
  if (height <= 0) fail("height", height, "must be positive");
  if (!(fx > 0) || !std::isfinite(fx)) fail("fx", fx, "must be positive (is the camera calibrated?)");
  if (!(fy > 0) || !std::isfinite(fy)) fail("fy", fy, "must be positive (is the camera calibrated?)");
  const std::pair<const char*, double> others[] = {{"cx", cx}, {"cy", cy}, {"k1", k1}, {"k2", k2},
                                                   {"p1", p1}, {"p2", p2}, {"k3", k3}};
  for (const auto& [name, value] : others)
    if (!std::isfinite(value)) fail(name, value, "must be finite");
}

Eigen::Matrix3d CameraModel::K() const {
  Eigen::Matrix3d K;
  K << fx, 0, cx, 0, fy, cy, 0, 0, 1;
  return K;
}

cv::Mat CameraModel::cvK() const { return (cv::Mat_<double>(3, 3) << fx, 0, cx, 0, fy, cy, 0, 0, 1); }

cv::Mat CameraModel::cvDistortion() const { return (cv::Mat_<double>(1, 5) << k1, k2, p1, p2, k3); }

Eigen::Vector2d CameraModel::distort(const Eigen::Vector2d& normalized) const {
  return hasDistortion() ? distortWithJacobian(*this, normalized, nullptr) : normalized;
}

std::optional<Eigen::Vector2d> CameraModel::project(const Eigen::Vector3d& p) const { return project(p, nullptr); }

std::optional<Eigen::Vector2d> CameraModel::project(const Eigen::Vector3d& p,
                                                    Eigen::Matrix<double, 2, 3>* jacobian) const {
  if (!(p.z() >= 1e-6)) return std::nullopt;
  const double iz = 1 / p.z();
  const Eigen::Vector2d n(p.x() * iz, p.y() * iz);
  Eigen::Matrix2d J_distort;
  const Eigen::Vector2d d = distortWithJacobian(*this, n, jacobian ? &J_distort : nullptr);
  if (jacobian) {
    Eigen::Matrix<double, 2, 3> J_normalize;
    J_normalize << iz, 0, -n.x() * iz, 0, iz, -n.y() * iz;
    *jacobian = Eigen::Vector2d(fx, fy).asDiagonal() * J_distort * J_normalize;
  }
  return Eigen::Vector2d(fx * d.x() + cx, fy * d.y() + cy);
}

Eigen::Vector2d CameraModel::unproject(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d target((pixel.x() - cx) / fx, (pixel.y() - cy) / fy);
  if (!hasDistortion()) return target;
  Eigen::Vector2d n = target;
  for (int i = 0; i < 20; ++i) {
    Eigen::Matrix2d J;
    const Eigen::Vector2d error = target - distortWithJacobian(*this, n, &J);
    const Eigen::Vector2d step = J.inverse() * error;
    if (!step.allFinite()) break;
    n += step;
    if (step.squaredNorm() < 1e-20) break;
  }
  return n;
}

Eigen::Vector3d CameraModel::ray(const Eigen::Vector2d& pixel) const {
  return unproject(pixel).homogeneous().normalized();
}

bool CameraModel::contains(const Eigen::Vector2d& p, double border) const {
  return p.x() >= border && p.y() >= border && p.x() <= width - 1 - border && p.y() <= height - 1 - border;
}

CameraModel CameraModel::scaled(double factor) const {
  CameraModel c = *this;
  c.width = static_cast<int>(std::lround(width * factor));
  c.height = static_cast<int>(std::lround(height * factor));
  c.fx = fx * factor;
  c.fy = fy * factor;
  c.cx = (cx + 0.5) * factor - 0.5;
  c.cy = (cy + 0.5) * factor - 0.5;
  return c;
}

CameraModel CameraModel::undistorted() const {
  CameraModel c = *this;
  c.k1 = c.k2 = c.p1 = c.p2 = c.k3 = 0;
  return c;
}

}  // namespace air_ground_common
