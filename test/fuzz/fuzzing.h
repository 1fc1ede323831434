// What the fuzz targets share. A target reads hostile bytes as a file or a message; the readers may refuse them as
// their headers promise, and nothing else: any other exception, a crash or a broken result ends the process.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace air_ground_fuzz {

using Bytes = std::vector<std::uint8_t>;
using Target = std::function<void(const Bytes&)>;
using Targets = std::map<std::string, Target>;

void addFileTargets(Targets* targets);
void addCityTargets(Targets* targets);
void addMessageTargets(Targets* targets);
void addFusionTargets(Targets* targets);

inline Targets allTargets() {
  Targets targets;
  addFileTargets(&targets);
  addCityTargets(&targets);
  addMessageTargets(&targets);
  addFusionTargets(&targets);
  return targets;
}

/// Values from the front of an input; zeros when it is used up.
class Source {
 public:
  explicit Source(const Bytes& bytes) : bytes_(bytes) {}
  bool empty() const { return at_ >= bytes_.size(); }

  template <typename T>
  T take() {
    T value{};
    const std::size_t count = std::min(sizeof(T), bytes_.size() - at_);
    if (count > 0) std::memcpy(&value, bytes_.data() + at_, count);
    at_ += count;
    return value;
  }
  /// Of a few hundred kinds: small integers, tenths, and what comparisons forget.
  double number();
  std::string text(std::size_t longest);
  Bytes rest() {
    return Bytes(bytes_.begin() + static_cast<std::ptrdiff_t>(std::exchange(at_, bytes_.size())), bytes_.end());
  }

 private:
  const Bytes& bytes_;
  std::size_t at_ = 0;
};

/// A file of this content, in a folder that goes with the process.
std::string fileOf(const std::string& name, const Bytes& content);
/// That folder, emptied.
std::string emptyFolder();

/// True if `read` gave a result, false if it refused with a reason.
bool answers(const std::function<void()>& read);

/// A result that its type forbids.
inline void require(bool good, const char* what) {
  if (!good) throw std::logic_error(std::string("a broken result was handed out: ") + what);
}

}  // namespace air_ground_fuzz
