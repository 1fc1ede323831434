// Rays through a distorted camera into a Scene: light per pixel, averaged over the exposure, and depth.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "air_ground_sim/scene.h"

namespace air_ground_sim {

struct DepthImage {
  int width = 0, height = 0;
  std::vector<float> depth;       ///< along the optical axis [m]; 0 where nothing is hit
  std::vector<float> cosine;      ///< of the angle between ray and surface normal, in [0, 1]
  std::vector<std::uint8_t> lit;  ///< 1 where the projector, beside the camera, sees the point too
};

class Renderer {
 public:
  /// Rays of every pixel are computed once: `samples` jittered places in each pixel, distortion inverted exactly.
  Renderer(const Scene& scene, const air_ground_common::CameraModel& camera, int samples, std::uint64_t seed);

  int samples() const { return samples_; }

  /// Light of each pixel, linear, 1 = a white surface in full light. Sample s of every pixel is seen from
  /// T_world_camera[s] (size: samples()), or, with a rolling shutter, in row r from T_world_camera[r * samples() + s]
  /// (size: height * samples()). `channels` 1 (luminance) or 3 (R G B interleaved); the result has width * height *
  /// channels.
  void light(const std::vector<air_ground_common::Pose>& T_world_camera, int channels,
             std::vector<float>* result) const;

  /// Depth through pixel centres. `projector_offset` is the projector's place along the camera's x axis [m]; 0: no
  /// shadow. One pose for all rows, or one a row.
  void depth(const std::vector<air_ground_common::Pose>& T_world_camera, float projector_offset,
             DepthImage* result) const;
  void depth(const air_ground_common::Pose& T_world_camera, float projector_offset, DepthImage* result) const {
    depth(std::vector<air_ground_common::Pose>{T_world_camera}, projector_offset, result);
  }

 private:
  const Scene& scene_;
  air_ground_common::CameraModel camera_;
  int samples_;
  std::vector<float> rays_;     // per sample and pixel: x/z, y/z as planes of one sample after the other
  std::vector<float> centers_;  // through pixel centres
};

/// Equirectangular picture, width x width / 2, of the light, linear, R G B interleaved. Body frame: x towards the
/// image's centre, y left, z up. Pixel (u, v), (0, 0) being the centre of the top-left one, looks ((u + 1/2) / W - 1/2)
/// 2 pi to the right of x and (1/2 - (v + 1/2) / H) pi above the horizon.
void renderPanorama(const Scene& scene, const air_ground_common::Pose& T_world_panorama, int width, int samples,
                    std::uint64_t seed, std::vector<float>* rgb);

}  // namespace air_ground_sim
