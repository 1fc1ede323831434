// How well the keyframes of a map are known in it.
#pragma once

#include <map>

#include "visual_frontend/map.h"

namespace visual_frontend {

class KeyframeCovariances {
 public:
  /// Along the shortest chain of views: that of the best known keyframe which shares 20 landmarks with this one, plus
  /// what its own pose adds. Throws std::out_of_range for a keyframe that is not in the map.
  void add(KeyframeId id, const Matrix6d& pose_covariance, const Map& map);
  /// Of a point at `position` in the map, fixed to the keyframe; zero where nothing is known of that.
  Matrix6d at(KeyframeId id, const Eigen::Vector3d& position, const Map& map) const;
  void forget(KeyframeId id) { covariance_.erase(id); }
  void clear() { covariance_.clear(); }
  void transform(const air_ground_common::Similarity& S_new_old);  ///< with Map::transform

 private:
  std::map<KeyframeId, Matrix6d> covariance_;
};

}  // namespace visual_frontend
