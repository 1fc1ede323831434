#include "air_ground_common/rvl.h"

#include <cstring>
#include <opencv2/core.hpp>
#include <stdexcept>

#include "air_ground_common/encoded_image.h"

namespace air_ground_common {
namespace {

/// Whole numbers of any length, the lowest three bits first; a fourth bit says that more follow.
class Numbers {
 public:
  Numbers(const std::uint8_t* data, std::size_t size) : data_(data), words_(size / 4) {}

  std::uint32_t next() {
    std::uint32_t value = 0;
    for (int shift = 0; shift < 32; shift += 3) {
      const std::uint32_t nibble = nextNibble();
      value |= (nibble & 7u) << shift;
      if (!(nibble & 8u)) return value;
    }
    throw std::invalid_argument("RVL depth: a number is too long");
  }

 private:
  std::uint32_t nextNibble() {
    if (left_ == 0) {
      if (words_ == 0) throw std::invalid_argument("RVL depth: the data end within the image");
      std::memcpy(&word_, data_, 4);
      data_ += 4;
      --words_;
      left_ = 8;
    }
    --left_;
    const std::uint32_t nibble = word_ >> 28;
    word_ <<= 4;
    return nibble;
  }

  const std::uint8_t* data_;
  std::size_t words_;
  std::uint32_t word_ = 0;
  int left_ = 0;  // nibbles of the word
};

}  // namespace

cv::Mat decodeRvl(const std::uint8_t* data, std::size_t size) {
  std::uint32_t edges[2];
  if (size < sizeof edges) throw std::invalid_argument("RVL depth: it has no data");
  std::memcpy(edges, data, sizeof edges);
  const std::uint64_t pixels = std::uint64_t{edges[0]} * edges[1];
  if (pixels == 0 || pixels > static_cast<std::uint64_t>(kMaxImagePixels))
    throw std::invalid_argument("RVL depth: it states " + std::to_string(edges[0]) + " x " + std::to_string(edges[1]) +
                                " pixels");
  cv::Mat image = cv::Mat::zeros(static_cast<int>(edges[1]), static_cast<int>(edges[0]), CV_16UC1);
  Numbers numbers(data + sizeof edges, size - sizeof edges);
  auto* out = image.ptr<std::uint16_t>();
  std::uint32_t value = 0;
  for (std::uint64_t i = 0; i < pixels;) {
    i += numbers.next();  // zeros
    const std::uint64_t end = i + numbers.next();
    if (end > pixels) throw std::invalid_argument("RVL depth: more pixels than it states");
    for (; i < end; ++i) {
      const std::uint32_t folded = numbers.next();  // 0, -1, 1, -2, 2 ... as 0, 1, 2, 3, 4
      value += (folded >> 1) ^ (~(folded & 1u) + 1u);
      out[i] = static_cast<std::uint16_t>(value);
    }
  }
  return image;
}

}  // namespace air_ground_common
