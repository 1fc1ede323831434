// How many images a map may keep: bounded in bytes, too, where they are large.
#pragma once

#include <algorithm>
#include <cstddef>
#include <opencv2/core/mat.hpp>
#include <vector>

namespace visual_frontend {

inline constexpr double kImageMemory = 600e6;  ///< of the images of a map's keyframes, at the most [bytes]

inline std::size_t bytesOf(const std::vector<cv::Mat>& pyramid) {
  std::size_t bytes = 0;
  for (const cv::Mat& level : pyramid) bytes += level.total() * level.elemSize();
  return bytes;
}

/// Keyframes that keep an image like `pyramid`: `most`, or what kImageMemory has room for, but not less than the place
/// where the camera is needs.
inline int imagesKept(const std::vector<cv::Mat>& pyramid, int most, double memory = kImageMemory) {
  constexpr double kFewest = 10;
  const double room = memory / static_cast<double>(std::max<std::size_t>(1, bytesOf(pyramid)));
  return static_cast<int>(std::min<double>(most, std::max(kFewest, room)));
}

}  // namespace visual_frontend
