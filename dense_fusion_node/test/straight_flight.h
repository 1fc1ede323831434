// A straight flight over boxes for tests of the whole mapper.
#pragma once

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <utility>
#include <vector>

#include "dense_fusion/dense_mapper.h"
#include "synthetic_scene.h"

namespace dense_fusion::testing {

inline air_ground_common::CameraModel smallCamera() {
  air_ground_common::CameraModel c;
  c.width = 240;
  c.height = 160;
  c.fx = c.fy = 150;
  c.cx = 119.5;
  c.cy = 79.5;
  return c;
}

inline MapperSettings smallSettings() {
  MapperSettings s;
  s.rectifier.scale = 1;
  s.fusion.voxel_size = 0.03;
  s.sweep.hypotheses = 100;
  s.frame_spacing = 0.02;
  return s;
}

/// Rendered once for all tests: 1.7 m at 2 m above the boxes.
inline const std::vector<cv::Mat>& flight() {
  static const std::vector<cv::Mat> images = [] {
    std::vector<cv::Mat> result;
    for (int i = 0; i < 57; ++i)
      result.push_back(boxScene().render(smallCamera(), lookDown({-0.8 + 0.03 * i, 0, 2}, 0.02, 0.01, 0.1),
                                         1 + 0.004 * i, -i * 0.2));
    return result;
  }();
  return images;
}

inline Eigen::Isometry3d flightPose(int i) { return lookDown({-0.8 + 0.03 * i, 0, 2}, 0.02, 0.01, 0.1); }

inline std::vector<FusedMap> fly(DenseMapper* mapper) {
  std::vector<FusedMap> maps;
  for (std::size_t i = 0; i < flight().size(); ++i)
    if (auto fused = mapper->add(flight()[i], smallCamera(), static_cast<std::int64_t>(i) * 50000000,
                                 flightPose(static_cast<int>(i)), 1.3, 2.05))
      maps.push_back(std::move(*fused));
  if (auto fused = mapper->flush()) maps.push_back(std::move(*fused));
  return maps;
}

}  // namespace dense_fusion::testing
