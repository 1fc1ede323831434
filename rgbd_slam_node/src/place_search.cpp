#include "place_search.h"

#include <algorithm>

namespace rgbd_slam {

namespace {

constexpr double kGap = 1.0;     // without a look, after which nothing is known of what the camera saw between [s]
constexpr double kSteady = 1.5;  // of the step before: so long a step is the rate of the looks, and no gap [1]

}  // namespace

void PlaceSearch::clear() {
  found();
  nearly_found_ = false;
}

void PlaceSearch::begin(double stamp) {
  const double step = last_ >= 0 ? stamp - last_ : 0;
  // What passed in a gap of the images is not known to be strange.
  since_last_ = step <= std::max(kGap, kSteady * std::max(step_, interval_)) ? step : 0;
  step_ = step;
  last_ = stamp;
}

void PlaceSearch::found() {
  strange_for_ = step_ = 0;
  last_ = -1;
}

void PlaceSearch::conclude(const visual_frontend::PlaceMatch& match, const std::string& reason) {
  reason_ = reason;
  nearly_found_ = match.success || match.inliers > near_miss_;
}

}  // namespace rgbd_slam
