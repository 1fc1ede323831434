#include "streetview_localizer/plane_index.h"

#include <boost/geometry.hpp>
#include <boost/geometry/geometries/point.hpp>
#include <boost/geometry/index/rtree.hpp>

namespace streetview_localizer {

namespace {

namespace bgi = boost::geometry::index;
using PlanePoint = boost::geometry::model::point<double, 2, boost::geometry::cs::cartesian>;

PlanePoint pointOf(const Eigen::Vector2d& place) { return {place.x(), place.y()}; }

}  // namespace

struct PlaneIndex::Tree {
  bgi::rtree<std::pair<PlanePoint, int>, bgi::quadratic<16>> entries;

  template <typename Predicate>
  std::vector<int> found(const Predicate& predicate) const {
    std::vector<int> found;
    for (auto it = entries.qbegin(predicate); it != entries.qend(); ++it) found.push_back(it->second);
    return found;
  }
};

PlaneIndex::PlaneIndex(const std::vector<std::pair<Eigen::Vector2d, int>>& entries) {
  std::vector<std::pair<PlanePoint, int>> points;
  for (const auto& [place, value] : entries) points.emplace_back(pointOf(place), value);
  tree_.reset(new Tree{decltype(Tree::entries)(points)});
}

std::vector<int> PlaneIndex::nearest(const Eigen::Vector2d& place, unsigned count) const {
  return tree_->found(bgi::nearest(pointOf(place), count));
}

std::vector<int> PlaneIndex::inSquare(const Eigen::Vector2d& place, double radius) const {
  const Eigen::Vector2d half = Eigen::Vector2d::Constant(radius);
  return tree_->found(
      bgi::intersects(boost::geometry::model::box<PlanePoint>(pointOf(place - half), pointOf(place + half))));
}

}  // namespace streetview_localizer
