#include "air_ground_common/encoded_image.h"

#include <cstring>

namespace air_ground_common {
namespace {

// ISO/IEC 15948, 5.2 and 11.2.2: signature, length and name of the first chunk, width, height.
cv::Size pngSize(const std::uint8_t* data, std::size_t size) {
  if (size < 24 || std::memcmp(data + 12, "IHDR", 4) != 0) return {};
  const auto number = [&](std::size_t at) {
    return std::uint32_t{data[at]} << 24 | std::uint32_t{data[at + 1]} << 16 | std::uint32_t{data[at + 2]} << 8 |
           data[at + 3];
  };
  const std::uint32_t width = number(16), height = number(20);
  if (width > 0x7fffffffu || height > 0x7fffffffu) return {};
  return {static_cast<int>(width), static_cast<int>(height)};
}

// ITU T.81, B.1 and B.2.2: segments of a marker and a length, up to the frame's header.
cv::Size jpegSize(const std::uint8_t* data, std::size_t size) {
  const auto number = [&](std::size_t at) { return data[at] << 8 | data[at + 1]; };
  for (std::size_t at = 2; at + 9 < size;) {
    if (data[at] != 0xff) return {};
    const std::uint8_t marker = data[at + 1];
    if (marker == 0xff) {  // filling
      ++at;
      continue;
    }
    const bool frame = marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (frame) return {number(at + 7), number(at + 5)};
    at += 2 + static_cast<std::size_t>(number(at + 2));
  }
  return {};
}

}  // namespace

cv::Size encodedSize(const std::uint8_t* data, std::size_t size) {
  if (size >= 8 && std::memcmp(data, "\x89PNG\r\n\x1a\n", 8) == 0) return pngSize(data, size);
  if (size >= 2 && data[0] == 0xff && data[1] == 0xd8) return jpegSize(data, size);
  return {};
}

}  // namespace air_ground_common
