// The local east-north-up frame of a city map: an origin given in any EPSG coordinate system, tied to latitude and
// longitude through PROJ. Double precision throughout: float32 cannot hold UTM or LV95 coordinates.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>

namespace air_ground_common {

/// WGS 84. `height` [m] is counted in the vertical datum of the coordinate system that the frame was made from.
struct Geodetic {
  double latitude = 0;   ///< [deg], north positive
  double longitude = 0;  ///< [deg], east positive
  double height = 0;     ///< [m]
};

/// Cartesian frame tangent to the ellipsoid at its origin: x true east, y true north, z up [m]. True north differs from
/// grid north by meridianConvergence(), lengths from grid lengths by gridScale(), and a point at distance d on the
/// ellipsoid has z = -d^2 / 12742 km (8 cm at 1 km). Heights pass through unchanged, in the datum that `origin` uses.
/// Methods may be called from several threads.
class LocalFrame {
 public:
  /// `crs`: what PROJ understands of a projected or geographic system, e.g. "EPSG:2056" (Swiss LV95), "EPSG:32632"
  /// (UTM 32N); `origin`: (easting, northing, height) [m] in it, or (longitude [deg], latitude [deg], height [m]).
  /// Grid files (CHENYX06 for the Swiss LV03, EPSG:21781) are used where PROJ finds them; see usesGrid().
  /// Throws std::invalid_argument for an unknown system or an origin outside its domain.
  LocalFrame(const std::string& crs, const Eigen::Vector3d& origin);
  ~LocalFrame();
  LocalFrame(LocalFrame&&) noexcept;
  LocalFrame& operator=(LocalFrame&&) noexcept;

  /// Between the system named at construction and this frame. Throw std::invalid_argument for a point outside it.
  Eigen::Vector3d fromCrs(const Eigen::Vector3d& point) const;
  Eigen::Vector3d toCrs(const Eigen::Vector3d& point) const;

  Eigen::Vector3d fromGeodetic(const Geodetic& point) const;
  Geodetic toGeodetic(const Eigen::Vector3d& point) const;

  const Geodetic& origin() const;

  /// Angle [rad] from true north to grid north at the origin, clockwise positive: a grid azimuth plus the convergence
  /// is a true azimuth. 0 for a geographic system.
  double meridianConvergence() const;
  /// Grid length over length on the ellipsoid at the origin (0.9996 on the central meridian of UTM). 1 if geographic.
  double gridScale() const;
  /// True when the conversion at the origin reads a grid file rather than formulas alone. Before PROJ 9.1 it cannot be
  /// told for grids that PROJ chose itself: then false.
  bool usesGrid() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace air_ground_common
