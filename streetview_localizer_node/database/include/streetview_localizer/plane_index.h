// Places in plan, found without a look at all of them.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <utility>
#include <vector>

namespace streetview_localizer {

/// An R-tree. Results come in no order.
class PlaneIndex {
 public:
  /// Places in plan, finite, each with what is to be found there.
  explicit PlaneIndex(const std::vector<std::pair<Eigen::Vector2d, int>>& entries);

  std::vector<int> nearest(const Eigen::Vector2d& place, unsigned count) const;
  /// No farther away than `radius` along either axis.
  std::vector<int> inSquare(const Eigen::Vector2d& place, double radius) const;

 private:
  struct Tree;
  std::shared_ptr<const Tree> tree_;
};

}  // namespace streetview_localizer
