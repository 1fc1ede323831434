// Depth images as compressed_depth_image_transport writes them with format "rvl": Wilson, Fast Lossless Depth Image
// Compression, ISS 2017.
#pragma once

#include <cstddef>
#include <cstdint>
#include <opencv2/core/mat.hpp>

namespace air_ground_common {

/// CV_16UC1 of `size` bytes: width and height (32 bits each), then in turn the length of a run of zeros, that of a run
/// of others, and the differences of these, in groups of three bits, eight of them in a word of 32 bits.
/// Throws std::invalid_argument where they do not make up an image.
cv::Mat decodeRvl(const std::uint8_t* data, std::size_t size);

}  // namespace air_ground_common
