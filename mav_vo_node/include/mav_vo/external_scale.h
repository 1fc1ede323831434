// Scale and level of a map without IMU, from its alignment with a metric, level map (the ground robot's).
#pragma once

#include <cstdint>
#include <optional>

#include "mav_vo/odometry.h"

namespace mav_vo {

struct ExternalScaleSettings {
  double min_change = 0.005;     ///< of the scale; smaller ones are not worth a step in the published poses [1]
  double min_tilt = 0.005;       ///< the same of the vertical [rad]
  double significance = 2.0;     ///< standard deviations that a change must exceed
  double largest_stddev = 0.10;  ///< relative; an alignment that knows its scale less well gives none [1]
};

/// Scale and vertical that an alignment with a metric, level map tells.
struct AlignedScale {
  std::uint32_t map_id = 0;                       ///< of the visual map that was aligned
  air_ground_common::Similarity T_ground_visual;  ///< p_ground [m] = scale R p_visual [visual unit] + t
  double scale_stddev = 0;                        ///< relative
  double tilt_stddev = 0;                         ///< of the vertical [rad]
  Pose T_visual_camera_first = Pose::Identity();  ///< first keyframe of the visual map [visual unit]
};

/// Holds p_map = scale R p_visual + t, whose map is metric and level with its origin at base_link of the first
/// keyframe. The visual map itself stays as it is: what was reconstructed in it, and the alignment, know nothing of the
/// scale that is taken from them. The first alignment is used; a later one when it differs significantly and the next
/// one says the same. Not thread-safe.
class ExternalScale {
 public:
  explicit ExternalScale(const Pose& T_base_camera, const ExternalScaleSettings& settings = {})
      : T_base_camera_(T_base_camera), settings_(settings) {}

  /// True when the similarity is another one after it. An alignment of another map than the one in use forgets the
  /// latter.
  bool update(const AlignedScale& aligned);
  void forget();

  /// Of that map, once known.
  std::optional<air_ground_common::Similarity> T_map_visual(std::uint32_t map_id) const;
  double relativeStddev() const { return adopted_ ? adopted_->scale_stddev : 0; }  ///< of the scale
  /// The result in the metric map, as an odometry with IMU gives it; unchanged while the scale of its map is not known.
  VoResult metric(const VoResult& visual) const;
  air_ground_common::Trajectory metric(const air_ground_common::Trajectory& visual, std::uint32_t map_id) const;

 private:
  bool differs(const AlignedScale& a, const AlignedScale& b) const;
  void adopt(const AlignedScale& aligned);

  Pose T_base_camera_;
  ExternalScaleSettings settings_;
  std::optional<AlignedScale> adopted_, candidate_;
  air_ground_common::Similarity T_map_visual_;
};

}  // namespace mav_vo
