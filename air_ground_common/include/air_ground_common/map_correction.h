// How what was made of a map's poses follows when the map is corrected: by what the camera's poses nearby went through.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "air_ground_common/similarity.h"

namespace air_ground_common {

/// T_map_camera by the stamp of the image [ns].
using PosesByStamp = std::map<std::int64_t, Pose>;

/// What clouds of the map have gone through, by their stamps [ns]: similarities T_now_then. Empty: the map has bent
/// there, and the cloud is off in itself.
using CloudCorrections = std::map<std::int64_t, std::optional<Similarity>>;

/// As many clouds follow, the newest: older ones stay as they are.
constexpr std::size_t kFollowedClouds = 100;

/// What `now` adds to `before`, where both say what clouds have gone through since they were published.
CloudCorrections correctionsSince(const CloudCorrections& before, const CloudCorrections& now);

/// The pose at `stamp`, to a microsecond: stamps that were held as seconds are off by less. Empty where there is none.
std::optional<Pose> poseOfImage(const PosesByStamp& poses, std::int64_t stamp);

/// What the map around a place has gone through.
struct LocalCorrection {
  Similarity T_now_then;
  /// By which the cameras do not follow it: root mean square [unit of the map as it was]; infinite where they would
  /// have grown or shrunk by a factor of two.
  double residual = 0;
};

/// A correction of a map, by the poses of the images that are in it before and after.
class MapCorrection {
 public:
  MapCorrection(const PosesByStamp& then, const PosesByStamp& now);

  /// Of the surroundings of `centre` (in the map as it was), by the cameras there: the similarity that takes poses as
  /// they were to what they are now, in the least-squares sense (Umeyama 1991, its rotation that of the attitudes,
  /// which positions along a straight flight leave open). A pose weighs exp(-(d^2 - n^2) / (2 radius^2)), d: its
  /// distance, n: that of the nearest; below a millionth it is left out. Identity where no image is in both. Where the
  /// cameras lie within a small part of the radius they do not tell the scale, and it stays.
  LocalCorrection around(const Eigen::Vector3d& centre, double radius) const;

 private:
  struct Camera {
    Pose then, now;
  };
  std::vector<Camera> cameras_;
};

}  // namespace air_ground_common
