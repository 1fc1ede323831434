#include "air_ground_common/camera_model.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cctype>
#include <cmath>
#include <initializer_list>
#include <sstream>
#include <stdexcept>
#include <utility>

namespace air_ground_common {
namespace {

// The theta-polynomial of Kannala and Brandt, and its derivative if asked.
double equidistantRadius(const CameraModel& c, double theta, double* derivative) {
  const double t2 = theta * theta;
  if (derivative) *derivative = 1 + t2 * (3 * c.k1 + t2 * (5 * c.k2 + t2 * (7 * c.k3 + t2 * 9 * c.k4)));
  return theta * (1 + t2 * (c.k1 + t2 * (c.k2 + t2 * (c.k3 + t2 * c.k4))));
}

Eigen::Vector2d distortEquidistant(const CameraModel& c, const Eigen::Vector2d& n, Eigen::Matrix2d* J) {
  const double r = n.norm();
  if (r < 1e-8) {
    if (J) J->setIdentity();
    return n;
  }
  double derivative = 0;
  const double scale = equidistantRadius(c, std::atan(r), J ? &derivative : nullptr) / r;
  if (J) {
    const Eigen::Vector2d u = n / r;
    *J = scale * Eigen::Matrix2d::Identity() + (derivative / (1 + r * r) - scale) * u * u.transpose();
  }
  return scale * n;
}

// Radial factor of plumb_bob and rational_polynomial at r^2, and twice its derivative with respect to r^2 if asked.
double radialFactor(const CameraModel& c, double r2, double* twice_derivative) {
  const double numerator = 1 + r2 * (c.k1 + r2 * (c.k2 + r2 * c.k3));
  const double slope = c.k1 + r2 * (2 * c.k2 + r2 * 3 * c.k3);
  if (c.model == DistortionModel::kPlumbBob) {
    if (twice_derivative) *twice_derivative = 2 * slope;
    return numerator;
  }
  const double denominator = 1 + r2 * (c.k4 + r2 * (c.k5 + r2 * c.k6));
  const double factor = numerator / denominator;
  if (twice_derivative)
    *twice_derivative = 2 * (slope - factor * (c.k4 + r2 * (2 * c.k5 + r2 * 3 * c.k6))) / denominator;
  return factor;
}

// Distorts (x, y); fills the 2x2 Jacobian of the distorted with respect to the undistorted coordinates if asked.
Eigen::Vector2d distortWithJacobian(const CameraModel& c, const Eigen::Vector2d& n, Eigen::Matrix2d* J) {
  if (c.model == DistortionModel::kEquidistant) return distortEquidistant(c, n, J);
  const double x = n.x(), y = n.y();
  const double r2 = x * x + y * y;
  double d_radial = 0;
  const double radial = radialFactor(c, r2, J ? &d_radial : nullptr);
  Eigen::Vector2d distorted(x * radial + 2 * c.p1 * x * y + c.p2 * (r2 + 2 * x * x),
                            y * radial + c.p1 * (r2 + 2 * y * y) + 2 * c.p2 * x * y);
  if (J) {
    (*J)(0, 0) = radial + x * x * d_radial + 2 * c.p1 * y + 6 * c.p2 * x;
    (*J)(0, 1) = x * y * d_radial + 2 * c.p1 * x + 2 * c.p2 * y;
    (*J)(1, 0) = (*J)(0, 1);
    (*J)(1, 1) = radial + y * y * d_radial + 6 * c.p1 * y + 2 * c.p2 * x;
  }
  if (c.model == DistortionModel::kRationalPolynomial) {
    distorted += r2 * Eigen::Vector2d(c.s1 + r2 * c.s2, c.s3 + r2 * c.s4);
    if (J) *J += Eigen::Vector2d(2 * c.s1 + 4 * r2 * c.s2, 2 * c.s3 + 4 * r2 * c.s4) * n.transpose();
  }
  return distorted;
}

// Distorted radius of an undistorted one, tangential terms and prism left out, with its derivative.
double distortedRadius(const CameraModel& c, double r, double* derivative) {
  if (c.model == DistortionModel::kEquidistant) {
    const double distorted = equidistantRadius(c, std::atan(r), derivative);
    *derivative /= 1 + r * r;
    return distorted;
  }
  double d_radial = 0;
  const double radial = radialFactor(c, r * r, &d_radial);
  *derivative = radial + r * r * d_radial;
  return r * radial;
}

// Where the distorted radius stops growing, or the largest angle that the wide-angle models are used to.
double largestRadius(const CameraModel& c) {
  constexpr int kSteps = 800;
  double last = 0, derivative = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double r = std::tan(CameraModel::kMaxHalfAngle * i / kSteps);
    const double distorted = distortedRadius(c, r, &derivative);
    if (!(derivative > 0) || !(distorted > 0)) return last;
    last = r;
  }
  return c.model == DistortionModel::kPlumbBob ? std::numeric_limits<double>::infinity() : last;
}

// Argument in [0, upper] at which the growing function f(argument, &derivative) takes the value `target`: Newton steps,
// bisection where they leave the bracket, until a step is below `tolerance`. Not a number when f(upper) < target.
template <class Function>
double invertGrowing(const Function& f, double target, double upper, double tolerance) {
  double derivative = 0;
  if (!(f(upper, &derivative) >= target)) return std::numeric_limits<double>::quiet_NaN();
  double low = 0, high = upper, x = std::min(target, upper);
  for (int i = 0; i < 60; ++i) {
    const double error = f(x, &derivative) - target;
    (error > 0 ? high : low) = x;
    double next = x - error / derivative;
    if (!(next >= low && next <= high)) next = 0.5 * (low + high);
    if (std::abs(next - x) < tolerance * (1 + x)) return next;
    x = next;
  }
  return x;
}

Eigen::Vector2d undistortEquidistant(const CameraModel& c, const Eigen::Vector2d& distorted) {
  const double radius = distorted.norm();
  if (radius < 1e-8) return distorted;
  const double limit = std::min(CameraModel::kMaxHalfAngle, std::atan(c.max_radius));
  const double theta = invertGrowing([&](double t, double* derivative) { return equidistantRadius(c, t, derivative); },
                                     radius, limit, 1e-14);
  return std::tan(theta) / radius * distorted;
}

// Newton iterations on both coordinates from `n`; converged tells whether they have ended at the target.
Eigen::Vector2d undistortNewton(const CameraModel& c, const Eigen::Vector2d& target, Eigen::Vector2d n,
                                bool* converged) {
  *converged = false;
  for (int i = 0; i < 20; ++i) {
    Eigen::Matrix2d J;
    const Eigen::Vector2d error = target - distortWithJacobian(c, n, &J);
    const Eigen::Vector2d step = J.inverse() * error;
    if (!step.allFinite()) break;
    n += step;
    *converged = step.squaredNorm() < 1e-20;
    if (*converged) break;
  }
  return n;
}

// The radial part alone gives a start inside the range of the model, from which the other terms are a small correction.
// Not a number where the model sees nothing.
Eigen::Vector2d undistortFromRadius(const CameraModel& c, const Eigen::Vector2d& target) {
  const double radius = target.norm();
  if (radius < 1e-8) return target;
  const double limit = std::min(std::tan(CameraModel::kMaxHalfAngle), c.max_radius);
  const double start = invertGrowing([&](double r, double* derivative) { return distortedRadius(c, r, derivative); },
                                     radius, limit, 1e-3);
  bool converged = false;
  const Eigen::Vector2d n = undistortNewton(c, target, start / radius * target, &converged);
  if (converged && n.norm() <= limit) return n;
  return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
}

bool isAnyOf(const std::string& name, std::initializer_list<const char*> names) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

void CameraModel::setDistortion(const std::string& name, const std::vector<double>& coefficients) {
  std::string lower = name;
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](unsigned char c) { return c == ' ' || c == '-' ? '_' : std::tolower(c); });
  std::size_t count = coefficients.size();
  while (count > 0 && coefficients[count - 1] == 0) --count;  // drivers fill up with zeros

  const auto refuse = [&](const std::string& why) {
    throw std::invalid_argument("camera calibration: distortion model '" + name + "' " + why +
                                "; known are plumb_bob (up to 5 coefficients), rational_polynomial (8, or 12 with "
                                "thin prism) and equidistant, also called fisheye (4)");
  };
  std::vector<double*> fields = {&k1, &k2, &p1, &p2, &k3, &k4, &k5, &k6, &s1, &s2, &s3, &s4};
  for (double* field : fields) *field = 0;
  if (isAnyOf(lower, {"equidistant", "fisheye", "equi", "kannala_brandt"})) {
    model = DistortionModel::kEquidistant;
    fields = {&k1, &k2, &k3, &k4};
  } else if (isAnyOf(lower, {"plumb_bob", "radtan", "radial_tangential", "brown_conrady", "rational_polynomial"}) ||
             (isAnyOf(lower, {"", "none", "pinhole", "perspective", "inverse_brown_conrady"}) && count == 0)) {
    // More than five under the name plumb_bob are the rational model's, as OpenCV and image_geometry take them.
    model =
        lower == "rational_polynomial" || count > 5 ? DistortionModel::kRationalPolynomial : DistortionModel::kPlumbBob;
  } else {
    refuse("is not supported");
  }
  if (count > fields.size()) refuse("with " + std::to_string(count) + " coefficients is not supported");
  for (std::size_t i = 0; i < count; ++i) *fields[i] = coefficients[i];
  max_radius = largestRadius(*this);
}

std::string CameraModel::distortionName() const {
  switch (model) {
    case DistortionModel::kRationalPolynomial:
      return "rational_polynomial";
    case DistortionModel::kEquidistant:
      return "equidistant";
    case DistortionModel::kPlumbBob:
      break;
  }
  return "plumb_bob";
}

std::vector<double> CameraModel::distortionCoefficients() const {
  switch (model) {
    case DistortionModel::kRationalPolynomial:
      if (s1 != 0 || s2 != 0 || s3 != 0 || s4 != 0) return {k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4};
      return {k1, k2, p1, p2, k3, k4, k5, k6};
    case DistortionModel::kEquidistant:
      return {k1, k2, k3, k4};
    case DistortionModel::kPlumbBob:
      break;
  }
  return {k1, k2, p1, p2, k3};
}

void CameraModel::validate() const {
  const auto fail = [](const char* name, double value, const char* rule) {
    std::ostringstream s;
    s << "camera calibration: " << name << " = " << value << " " << rule;
    throw std::invalid_argument(s.str());
  };
  if (width <= 0) fail("width", width, "must be positive (does the driver fill in camera_info?)");
  if (height <= 0) fail("height", height, "must be positive (does the driver fill in camera_info?)");
  // Of any camera, with room on both sides; products and quotients of what lies within are finite.
  constexpr double kLeast = 1e-3, kMost = 1e9;  // [px]
  const std::pair<const char*, double> focal_lengths[] = {{"fx", fx}, {"fy", fy}}, centre[] = {{"cx", cx}, {"cy", cy}};
  for (const auto& [name, value] : focal_lengths)
    if (!(value >= kLeast && value <= kMost))
      fail(name, value, "must be positive, a focal length in pixels (is the camera calibrated?)");
  for (const auto& [name, value] : centre)
    if (!(std::abs(value) <= kMost)) fail(name, value, "must be finite, and near the image [px]");
  const std::pair<const char*, double> others[] = {{"k1", k1}, {"k2", k2}, {"p1", p1}, {"p2", p2},
                                                   {"k3", k3}, {"k4", k4}, {"k5", k5}, {"k6", k6},
                                                   {"s1", s1}, {"s2", s2}, {"s3", s3}, {"s4", s4}};
  for (const auto& [name, value] : others)
    if (!std::isfinite(value)) fail(name, value, "must be finite");
}

bool CameraModel::hasDistortion() const {
  if (model == DistortionModel::kEquidistant) return true;
  for (const double c : {k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4})
    if (c != 0) return true;
  return false;
}

Eigen::Matrix3d CameraModel::K() const {
  Eigen::Matrix3d K;
  K << fx, 0, cx, 0, fy, cy, 0, 0, 1;
  return K;
}

cv::Mat CameraModel::cvK() const { return (cv::Mat_<double>(3, 3) << fx, 0, cx, 0, fy, cy, 0, 0, 1); }

cv::Mat CameraModel::cvDistortion() const { return cv::Mat(distortionCoefficients(), true).reshape(1, 1); }

Eigen::Vector2d CameraModel::distort(const Eigen::Vector2d& normalized) const {
  return hasDistortion() ? distortWithJacobian(*this, normalized, nullptr) : normalized;
}

std::optional<Eigen::Vector2d> CameraModel::project(const Eigen::Vector3d& p) const { return project(p, nullptr); }

std::optional<Eigen::Vector2d> CameraModel::project(const Eigen::Vector3d& p,
                                                    Eigen::Matrix<double, 2, 3>* jacobian) const {
  if (!(p.z() >= 1e-6)) return std::nullopt;
  const double iz = 1 / p.z();
  const Eigen::Vector2d n(p.x() * iz, p.y() * iz);
  if (!(n.squaredNorm() <= max_radius * max_radius)) return std::nullopt;
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
  if (model == DistortionModel::kEquidistant) return undistortEquidistant(*this, target);
  if (model == DistortionModel::kPlumbBob) {
    bool converged = false;
    const Eigen::Vector2d n = undistortNewton(*this, target, target, &converged);
    if (converged && n.norm() <= max_radius) return n;  // else lost, or beyond the fold
  }
  return undistortFromRadius(*this, target);
}

Eigen::Vector3d CameraModel::ray(const Eigen::Vector2d& pixel) const {
  return unproject(pixel).homogeneous().normalized();
}

NormalizedNoise CameraModel::normalizedNoise(const Eigen::Vector2d& normalized, double pixel_sigma) const {
  const double focal = 0.5 * (fx + fy);
  if (model == DistortionModel::kPlumbBob) return {pixel_sigma / focal, 1};
  Eigen::Matrix2d J;
  distortWithJacobian(*this, normalized, &J);
  const double r = normalized.norm();
  const Eigen::Vector2d away = r > 1e-8 ? Eigen::Vector2d(normalized / r) : Eigen::Vector2d::UnitX();
  const Eigen::Vector2d across(-away.y(), away.x());
  const double radial = away.dot(J * away), tangential = across.dot(J * across);
  constexpr double kLeast = 1e-6;  // at the fold, where all noise is infinite
  return {pixel_sigma / (focal * std::sqrt(std::max(kLeast, radial) * std::max(kLeast, tangential))),
          std::max(kLeast, tangential) / std::max(kLeast, radial)};
}

bool CameraModel::contains(const Eigen::Vector2d& p, double border) const {
  const bool inside = p.x() >= border && p.y() >= border && p.x() <= width - 1 - border && p.y() <= height - 1 - border;
  if (!inside || (model == DistortionModel::kPlumbBob && !std::isfinite(max_radius))) return inside;
  double derivative = 0;
  const double limit = distortedRadius(*this, std::min(max_radius, std::tan(kMaxHalfAngle)), &derivative);
  const double radius = std::hypot((p.x() - cx) / fx, (p.y() - cy) / fy);
  if (!(radius + border / std::min(fx, fy) <= limit)) return false;
  constexpr double kRound = 0.9;  // up to here the terms that are not radial, which bend the rim, do not matter
  return radius <= kRound * limit || unproject(p).allFinite();
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

CameraModel CameraModel::window(int x, int y, int window_width, int window_height, int binning_x, int binning_y) const {
  if (x < 0 || y < 0 || window_width <= 0 || window_height <= 0 || window_width > width - x ||
      window_height > height - y || binning_x < 1 || binning_y < 1 || binning_x > window_width ||
      binning_y > window_height)
    throw std::invalid_argument("camera calibration: the region of interest (" + std::to_string(window_width) + "x" +
                                std::to_string(window_height) + " at " + std::to_string(x) + ", " + std::to_string(y) +
                                ", binned " + std::to_string(binning_x) + "x" + std::to_string(binning_y) +
                                ") does not lie in the image of " + std::to_string(width) + "x" +
                                std::to_string(height));
  CameraModel c = *this;
  c.width = window_width / binning_x;
  c.height = window_height / binning_y;
  c.fx = fx / binning_x;
  c.fy = fy / binning_y;
  c.cx = (cx - x + 0.5) / binning_x - 0.5;
  c.cy = (cy - y + 0.5) / binning_y - 0.5;
  return c;
}

CameraModel CameraModel::undistorted() const {
  CameraModel c = *this;
  c.setDistortion("plumb_bob", {});
  return c;
}

}  // namespace air_ground_common
