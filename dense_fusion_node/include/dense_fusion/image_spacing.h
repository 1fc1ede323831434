// How far apart images lie, and how far from its reference view a depth map therefore takes them.
#pragma once

#include <deque>

namespace dense_fusion {

/// Distances between images that follow each other.
class ImageSpacing {
 public:
  /// [m]
  void add(double distance);
  void clear() { recent_.clear(); }
  /// Median of the newest ones [m]; 0 before there is any. A gap or two does not change it.
  double typical() const;

 private:
  std::deque<double> recent_;
};

struct SweepReach {
  double radius = 0;  ///< images this near to the reference view join its depth map [m]
  /// So far apart are the images that too few of them lie within it: pixels must do with two, and some have none.
  bool few = false;
};

/// `radius` as set [m], unless fewer than 2.5 images `spacing` [m] apart fit in it: then 3.5 of them, but no more than
/// `longest` [m], beyond which one surface no longer looks the same from both ends.
SweepReach sweepReach(double radius, double spacing, double longest);

}  // namespace dense_fusion
