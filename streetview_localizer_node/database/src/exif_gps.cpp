#include "exif_gps.h"

#include <cstddef>
#include <fstream>
#include <utility>

namespace streetview_localizer {
namespace {

/// Bytes of a file; what lies outside of them reads as 0.
class Bytes {
 public:
  Bytes(std::string bytes, bool big_endian) : bytes_(std::move(bytes)), big_endian_(big_endian) {}

  std::uint32_t number(std::size_t at, std::size_t size) const {
    if (at > bytes_.size() || size > bytes_.size() - at) return 0;
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < size; ++i)
      value = value << 8 | static_cast<unsigned char>(bytes_[at + (big_endian_ ? i : size - 1 - i)]);
    return value;
  }
  std::size_t size() const { return bytes_.size(); }

 private:
  std::string bytes_;
  bool big_endian_;
};

/// The TIFF structure in a JPEG's EXIF segment; empty without.
std::string exifOf(const std::string& path) {
  constexpr std::size_t kMost = 1 << 20;  // of a file's begin, where the segment must lie
  const std::string header("Exif\0\0", 6);
  std::string file(kMost, '\0');
  std::ifstream stream(path, std::ios::binary);
  stream.read(file.data(), kMost);
  file.resize(static_cast<std::size_t>(stream.gcount()));
  const Bytes bytes(file, true);
  if (bytes.number(0, 2) != 0xFFD8) return "";
  for (std::size_t at = 2; at + 4 <= file.size();) {
    const std::uint32_t marker = bytes.number(at, 2), length = bytes.number(at + 2, 2);
    if (marker < 0xFFC0 || marker == 0xFFDA || length < 2) return "";  // the picture itself
    const std::size_t begin = at + 4 + header.size();
    at += 2 + length;
    if (marker == 0xFFE1 && at >= begin && file.compare(begin - header.size(), header.size(), header) == 0)
      return file.substr(begin, at - begin);
  }
  return "";
}

constexpr std::size_t kEntry = 12;  // bytes of a directory's entry: tag, type, count, value or its offset

}  // namespace

std::set<std::uint16_t> gpsTagsOverZero(const std::string& path) {
  const std::string exif = exifOf(path);
  const Bytes tiff(exif, exif.compare(0, 2, "MM") == 0);
  // Calls f(tag, type, count, offset) for each entry of the directory at `begin`.
  const auto forEach = [&](std::size_t begin, const auto& f) {
    for (std::size_t i = 0; i < tiff.number(begin, 2) && begin + 2 + kEntry * i < tiff.size(); ++i) {
      const std::size_t at = begin + 2 + kEntry * i;
      f(tiff.number(at, 2), tiff.number(at + 2, 2), tiff.number(at + 4, 4), tiff.number(at + 8, 4));
    }
  };
  constexpr std::uint32_t kGpsDirectory = 0x8825, kRational = 5, kSignedRational = 10;
  std::size_t gps = 0;
  forEach(tiff.number(4, 4), [&](std::uint32_t tag, std::uint32_t, std::uint32_t, std::uint32_t value) {
    if (tag == kGpsDirectory) gps = value;
  });
  std::set<std::uint16_t> over_zero;
  if (gps == 0) return over_zero;
  forEach(gps, [&](std::uint32_t tag, std::uint32_t type, std::uint32_t count, std::size_t at) {
    if (type != kRational && type != kSignedRational) return;
    for (std::size_t i = 0; i < count && at + 8 * (i + 1) <= tiff.size(); ++i)
      if (tiff.number(at + 8 * i + 4, 4) == 0) over_zero.insert(static_cast<std::uint16_t>(tag));
  });
  return over_zero;
}

}  // namespace streetview_localizer
