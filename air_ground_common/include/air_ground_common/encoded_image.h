// Compressed images are as large as they say, which is known before they are decoded.
#pragma once

#include <cstddef>
#include <cstdint>
#include <opencv2/core/types.hpp>

namespace air_ground_common {

/// Pixels that an image from elsewhere may have: 67 million, 512 MiB at the deepest.
constexpr std::int64_t kMaxImagePixels = std::int64_t{1} << 26;

/// Width and height that the header of a JPEG or PNG states; empty for anything else, and where it states none.
cv::Size encodedSize(const std::uint8_t* data, std::size_t size);

}  // namespace air_ground_common
