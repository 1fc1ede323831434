#include "place_search.h"

namespace rgbd_slam {

namespace {

constexpr double kGap = 1.0;  // without an image, after which nothing is known of what the camera saw between [s]

}  // namespace

void PlaceSearch::clear() {
  strange_for_ = 0;
  last_ = -1;
  nearly_found_ = false;
}

void PlaceSearch::begin(double stamp) {
  // What passed in a gap of the images is not known to be strange.
  since_last_ = last_ >= 0 && stamp - last_ <= kGap ? stamp - last_ : 0;
  last_ = stamp;
}

void PlaceSearch::conclude(const visual_frontend::PlaceMatch& match, const std::string& reason) {
  reason_ = reason;
  nearly_found_ = match.success || match.inliers > near_miss_;
}

}  // namespace rgbd_slam
