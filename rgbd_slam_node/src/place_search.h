// When a lost camera looks for a place it knows, and for how long it has seen none.
#pragma once

#include <string>

#include "rgbd_slam/slam.h"

namespace rgbd_slam {

class PlaceSearch {
 public:
  explicit PlaceSearch(const SlamSettings& settings)
      : interval_(settings.relocalization_interval),
        restart_after_(settings.restart_after),
        near_miss_(0.6 * settings.place.min_inliers) {}

  void clear();
  /// Descriptors of the whole image against the whole map take longer than an image may; after a near miss the next
  /// image is worth a look. `stamp`: of the image [s].
  bool due(double stamp) const { return nearly_found_ || stamp - last_ >= interval_ - 1e-3; }
  void begin(double stamp);                          ///< with this image [s]
  void sawAPlace() { strange_for_ += since_last_; }  ///< the image shows enough to be recognised, or to begin a map
  void conclude(const visual_frontend::PlaceMatch& match, const std::string& reason);
  void found();
  /// The camera has seen other places than those of the map for so long that a new one is better.
  bool givesUp() const { return restart_after_ > 0 && strange_for_ >= restart_after_ - 1e-6; }
  const std::string& reason() const { return reason_; }  ///< why the last search found nothing

 private:
  double interval_, restart_after_, near_miss_;
  double strange_for_ = 0;     // seen other places than those of the map [s]
  double since_last_ = 0;      // of that, from the last search to this one [s]
  double last_ = -1;           // search since the camera was lost [s]; negative: none
  double step_ = 0;            // from the one before to the last one [s]
  bool nearly_found_ = false;  // some of a place's points agreed, too few to be sure
  std::string reason_;
};

}  // namespace rgbd_slam
