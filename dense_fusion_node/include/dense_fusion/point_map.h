// Everything reconstructed so far, thinned to one point a cell.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "dense_fusion/surface.h"

namespace dense_fusion {

class PointMap {
 public:
  /// `cell`: edge length [m] of the cells that keep one point each. Throws std::invalid_argument unless positive.
  explicit PointMap(double cell);

  /// Of two points in a cell the one with more support stays, the later one if equal.
  void add(const std::vector<SurfacePoint>& points);
  void clear() { cells_.clear(); }
  std::size_t size() const { return cells_.size(); }
  /// In the order of their cells: independent of the order of insertion.
  std::vector<SurfacePoint> points() const;

 private:
  double cell_;
  std::unordered_map<std::uint64_t, SurfacePoint> cells_;
};

}  // namespace dense_fusion
