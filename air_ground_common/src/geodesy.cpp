#include "air_ground_common/geodesy.h"

#include <proj.h>

#include <Eigen/Geometry>
#include <cmath>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "air_ground_common/units.h"

namespace air_ground_common {
namespace {

// WGS 84.
constexpr double kA = 6378137.0, kF = 1 / 298.257223563, kE2 = kF * (2 - kF);

Eigen::Vector3d earthCentred(const Geodetic& g) {
  const double sin_lat = std::sin(g.latitude * kDegree), cos_lat = std::cos(g.latitude * kDegree);
  const double n = kA / std::sqrt(1 - kE2 * sin_lat * sin_lat);
  return {(n + g.height) * cos_lat * std::cos(g.longitude * kDegree),
          (n + g.height) * cos_lat * std::sin(g.longitude * kDegree), (n * (1 - kE2) + g.height) * sin_lat};
}

// Fixed-point iteration on the latitude: converges by a factor of e^2 = 1/150 a round, below 1e-12 rad after six.
Geodetic geodetic(const Eigen::Vector3d& p) {
  const double r = std::hypot(p.x(), p.y());
  double lat = std::atan2(p.z(), r * (1 - kE2)), height = 0;
  for (int i = 0; i < 8; ++i) {
    const double s = std::sin(lat), n = kA / std::sqrt(1 - kE2 * s * s);
    height = r * std::cos(lat) + p.z() * s - kA * kA / n;
    lat = std::atan2(p.z(), r * (1 - kE2 * n / (n + height)));
  }
  return {lat / kDegree, std::atan2(p.y(), p.x()) / kDegree, height};
}

bool finite(const PJ_COORD& c) { return std::isfinite(c.xy.x) && std::isfinite(c.xy.y) && c.xy.x != HUGE_VAL; }

// PROJ's database knows the Swiss grid by its new GeoTIFF name alone; Debian's and Ubuntu's proj-data carry the NTv2
// file.
constexpr char kLv03ThroughLegacyGrid[] =
    "+proj=pipeline +step +inv +proj=somerc +lat_0=46.9524055555556 +lon_0=7.43958333333333 +k_0=1 +x_0=600000 "
    "+y_0=200000 "
    "+ellps=bessel +step +proj=hgridshift +grids=CHENYX06_etrs.gsb +step +proj=unitconvert +xy_in=rad +xy_out=deg";

// x east (or longitude), y north (or latitude), whatever axis order the systems' definitions have. Null when
// impossible.
PJ* conversion(PJ_CONTEXT* context, const std::string& source, const char* target) {
  PJ* raw = proj_create_crs_to_crs(context, source.c_str(), target, nullptr);
  if (!raw) return nullptr;
  PJ* normalised = proj_normalize_for_visualization(context, raw);
  proj_destroy(raw);
  return normalised;
}

bool lastUsedGrid([[maybe_unused]] PJ_CONTEXT* context, [[maybe_unused]] PJ* conversion) {
#if PROJ_VERSION_MAJOR > 9 || (PROJ_VERSION_MAJOR == 9 && PROJ_VERSION_MINOR >= 1)
  if (PJ* used = proj_trans_get_last_used_operation(conversion)) {
    const bool grid = proj_coordoperation_get_grid_used_count(context, used) > 0;
    proj_destroy(used);
    return grid;
  }
#endif
  return false;
}

std::string text(const Eigen::Vector3d& p) {
  return "(" + std::to_string(p.x()) + ", " + std::to_string(p.y()) + ", " + std::to_string(p.z()) + ")";
}

}  // namespace

struct LocalFrame::Impl {
  std::string crs;
  PJ_CONTEXT* context = proj_context_create();
  PJ* to_wgs84 = nullptr;
  Geodetic origin;
  Eigen::Vector3d origin_ecef;
  Eigen::Matrix3d R_enu_ecef;
  double convergence = 0, scale = 1;
  bool grid = false;
  mutable std::mutex mutex;  // a PROJ context serves one thread at a time

  ~Impl() {
    proj_destroy(to_wgs84);
    proj_context_destroy(context);
  }

  // Takes `candidate` over when it reads a grid at the origin; destroys the loser.
  void tryInstead(PJ* candidate, const Eigen::Vector3d& point, bool has_grid) {
    if (!candidate) return;
    std::swap(to_wgs84, candidate);
    try {
      const Geodetic precise = forward(point);
      grid = has_grid || lastUsedGrid(context, to_wgs84);
      if (grid) origin = precise;
    } catch (const std::invalid_argument&) {  // outside the candidate's domain
    }
    if (!grid) std::swap(to_wgs84, candidate);
    proj_destroy(candidate);
  }

  Geodetic forward(const Eigen::Vector3d& p) const {
    const std::lock_guard<std::mutex> lock(mutex);
    const PJ_COORD out = proj_trans(to_wgs84, PJ_FWD, proj_coord(p.x(), p.y(), 0, 0));
    if (!p.allFinite() || !finite(out))
      throw std::invalid_argument("geodesy: " + text(p) + " is not a point of " + crs);
    return {out.lp.phi, out.lp.lam, p.z()};
  }

  Eigen::Vector3d inverse(const Geodetic& g) const {
    const std::lock_guard<std::mutex> lock(mutex);
    const PJ_COORD out = proj_trans(to_wgs84, PJ_INV, proj_coord(g.longitude, g.latitude, 0, 0));
    if (!finite(out))
      throw std::invalid_argument("geodesy: latitude " + std::to_string(g.latitude) + ", longitude " +
                                  std::to_string(g.longitude) + " is outside " + crs);
    return {out.xy.x, out.xy.y, g.height};
  }
};

LocalFrame::LocalFrame(const std::string& crs, const Eigen::Vector3d& origin) : impl_(std::make_unique<Impl>()) {
  Impl& d = *impl_;
  d.crs = crs;
  proj_log_level(d.context, PJ_LOG_NONE);
  d.to_wgs84 = conversion(d.context, crs, "EPSG:4326");
  if (!d.to_wgs84)
    throw std::invalid_argument("geodesy: PROJ knows no coordinate system '" + crs +
                                "'; give something like EPSG:2056");
  d.origin = d.forward(origin);
  d.grid = lastUsedGrid(d.context, d.to_wgs84);
  // Grids of national networks lead to ETRS89 (EPSG:4258), which PROJ equates with WGS 84 but does not search on its
  // own.
  if (!d.grid) d.tryInstead(conversion(d.context, crs, "EPSG:4258"), origin, false);
  if (!d.grid && crs == "EPSG:21781") d.tryInstead(proj_create(d.context, kLv03ThroughLegacyGrid), origin, true);
  d.origin_ecef = earthCentred(d.origin);
  const double lat = d.origin.latitude * kDegree, lon = d.origin.longitude * kDegree;
  d.R_enu_ecef.row(0) << -std::sin(lon), std::cos(lon), 0;
  d.R_enu_ecef.row(1) << -std::sin(lat) * std::cos(lon), -std::sin(lat) * std::sin(lon), std::cos(lat);
  d.R_enu_ecef.row(2) << std::cos(lat) * std::cos(lon), std::cos(lat) * std::sin(lon), std::sin(lat);

  // Central difference along the meridian: exact to 1e-9 at 100 m, and independent of how PROJ describes the system.
  const Eigen::Vector3d south = d.inverse({d.origin.latitude - 9e-4, d.origin.longitude, 0});
  const Eigen::Vector3d north = d.inverse({d.origin.latitude + 9e-4, d.origin.longitude, 0});
  const bool geographic = std::abs((north - south).y()) < 1;
  if (!geographic) {
    const Eigen::Vector3d grid = north - south;
    const Eigen::Vector3d metric = earthCentred({d.origin.latitude + 9e-4, d.origin.longitude, 0}) -
                                   earthCentred({d.origin.latitude - 9e-4, d.origin.longitude, 0});
    // The meridian, seen in the grid, leans left of grid north where grid north lies clockwise of true north.
    d.convergence = -std::atan2(grid.x(), grid.y());
    d.scale = grid.head<2>().norm() / metric.norm();
  }
}

LocalFrame::~LocalFrame() = default;
LocalFrame::LocalFrame(LocalFrame&&) noexcept = default;
LocalFrame& LocalFrame::operator=(LocalFrame&&) noexcept = default;

Eigen::Vector3d LocalFrame::fromCrs(const Eigen::Vector3d& point) const { return fromGeodetic(impl_->forward(point)); }
Eigen::Vector3d LocalFrame::toCrs(const Eigen::Vector3d& point) const { return impl_->inverse(toGeodetic(point)); }

Eigen::Vector3d LocalFrame::fromGeodetic(const Geodetic& point) const {
  if (!std::isfinite(point.latitude) || !std::isfinite(point.longitude) || !std::isfinite(point.height) ||
      std::abs(point.latitude) > 90)
    throw std::invalid_argument("geodesy: latitude, longitude and height must be finite, latitude within 90 degrees");
  return impl_->R_enu_ecef * (earthCentred(point) - impl_->origin_ecef);
}

Geodetic LocalFrame::toGeodetic(const Eigen::Vector3d& point) const {
  return geodetic(impl_->origin_ecef + impl_->R_enu_ecef.transpose() * point);
}

const Geodetic& LocalFrame::origin() const { return impl_->origin; }
double LocalFrame::meridianConvergence() const { return impl_->convergence; }
double LocalFrame::gridScale() const { return impl_->scale; }
bool LocalFrame::usesGrid() const { return impl_->grid; }

}  // namespace air_ground_common
