#include "heightmap_mcl/compass.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/geometry.h"

namespace heightmap_mcl {
namespace {

constexpr double kReadings = 20;          // before north is believed
constexpr double kMemory = 2000;          // readings that count: iron passed long ago is forgotten
constexpr double kLeastHorizontal = 0.1;  // share of the field; a steeper one has no direction worth the name

}  // namespace

bool MagneticNorth::add(const Eigen::Vector3d& field) {
  const double horizontal = field.head<2>().norm();
  if (!field.allFinite() || !(horizontal > kLeastHorizontal * field.norm())) return false;
  const double keep = 1 - 1 / kMemory;
  weight_ = keep * weight_ + 1;
  x_ = keep * x_ + field.x() / horizontal;
  y_ = keep * y_ + field.y() / horizontal;
  return true;
}

std::optional<double> MagneticNorth::direction() const {
  if (weight_ < kReadings * 0.95) return std::nullopt;
  return std::atan2(y_, x_);
}

double MagneticNorth::deviation() const {
  if (weight_ <= 0) return M_PI;
  return std::sqrt(-2 * std::log(std::clamp(std::hypot(x_, y_) / weight_, 1e-6, 1.0)));
}

std::optional<Prior> headingPrior(const MagneticNorth& ground, const MagneticNorth& mav, double sigma) {
  const auto north_ground = ground.direction(), north_mav = mav.direction();
  if (!north_ground || !north_mav) return std::nullopt;
  Prior prior;
  prior.yaw = air_ground_common::wrapAngle(*north_ground - *north_mav);
  prior.yaw_sigma = std::min(
      std::sqrt(sigma * sigma + ground.deviation() * ground.deviation() + mav.deviation() * mav.deviation()), M_PI);
  return prior;
}

}  // namespace heightmap_mcl
