// How feature tracks move in the image: where a row that is read later sees them.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <unordered_map>
#include <vector>

#include "visual_frontend/types.h"

namespace visual_frontend {
struct Feature;
}

namespace mav_vo {

class TrackFlows {
 public:
  /// `sigma`: of a normalised image coordinate.
  explicit TrackFlows(double sigma) : sigma_(sigma) {}

  /// Next image's tracks.
  void add(double stamp, const std::vector<visual_frontend::Feature>& features);
  /// Of a track at the last image, in normalised image coordinates [1/s]; null where it is not known: the track is new,
  /// or its flow does not change as the others' do.
  const Eigen::Vector2d* steadyFlow(visual_frontend::TrackId id) const;
  void clear();

 private:
  struct Track {
    Eigen::Vector2d ray = Eigen::Vector2d::Zero();
    std::optional<Eigen::Vector2d> mean;  ///< flow since the image before [1/s]
    std::optional<Eigen::Vector2d> flow;  ///< at the image, where it is steady [1/s]
  };
  double sigma_;
  double last_stamp_ = -1;  ///< [s]
  std::unordered_map<visual_frontend::TrackId, Track> tracks_;
};

}  // namespace mav_vo
