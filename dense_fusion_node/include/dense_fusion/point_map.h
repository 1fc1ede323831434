// Everything reconstructed so far, thinned to one point a cell.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "dense_fusion/surface.h"

namespace dense_fusion {

class PointMap {
 public:
  /// `cell`: edge length [m] of the cells that keep one point each. It doubles whenever more than `max_points` would be
  /// kept. Throws std::invalid_argument unless cell > 0 and max_points >= 8 (eight cells meet at the origin, however
  /// large).
  explicit PointMap(double cell, std::size_t max_points = 5000000);

  /// Of two points in a cell the one with more support stays, the later one if equal. Returns how many were left out:
  /// not finite, or more than 2^20 cells from the origin.
  std::size_t add(const std::vector<SurfacePoint>& points);
  /// Also shrinks the cells to their first size.
  void clear();
  std::size_t size() const { return cells_.size(); }
  double cell() const { return cell_; }  ///< present edge length [m]
  /// In the order of their cells: independent of the order of insertion.
  std::vector<SurfacePoint> points() const;

 private:
  bool insert(const SurfacePoint& point);

  double first_cell_, cell_;
  std::size_t max_points_;
  std::unordered_map<std::uint64_t, SurfacePoint> cells_;
};

}  // namespace dense_fusion
