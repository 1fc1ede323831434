#include "fuzzing.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>

namespace air_ground_fuzz {
namespace {

namespace fs = std::filesystem;

// In memory where there is such a file system: thousands of files a second.
class Folder {
 public:
  Folder() {
    const fs::path memory = "/dev/shm";
    std::string name =
        ((fs::is_directory(memory) ? memory : fs::temp_directory_path()) / "air_ground_fuzz_XXXXXX").string();
    if (!mkdtemp(name.data())) throw std::logic_error("no folder for the inputs");
    path = name;
  }
  ~Folder() { fs::remove_all(path); }
  std::string path;
};

const std::string& folder() {
  static const Folder folder;
  return folder.path;
}

}  // namespace

double Source::number() {
  const double inf = std::numeric_limits<double>::infinity();
  const double odd[] = {0, -0.0, 1, inf, -inf, std::nan(""), 1e300, -1e300, 1e-300, 1e9, -1e9, 4294967296.0};
  const std::uint8_t kind = take<std::uint8_t>();
  if (kind < std::size(odd)) return odd[kind];
  if (kind < 100) return kind - 50;
  if (kind < 200) return 0.1 * (kind - 150);
  return take<double>();
}

std::string Source::text(std::size_t longest) {
  const std::size_t length = std::min({std::size_t{take<std::uint8_t>()}, longest, bytes_.size() - at_});
  std::string out(bytes_.begin() + static_cast<std::ptrdiff_t>(at_),
                  bytes_.begin() + static_cast<std::ptrdiff_t>(at_ + length));
  at_ += length;
  return out;
}

std::string fileOf(const std::string& name, const Bytes& content) {
  const std::string path = folder() + "/" + name;
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(content.data()), static_cast<std::streamsize>(content.size()));
  return path;
}

std::string emptyFolder() {
  for (const auto& entry : fs::directory_iterator(folder())) fs::remove_all(entry.path());
  return folder();
}

bool answers(const std::function<void()>& read) {
  std::string reason;
  try {
    read();
    return true;
  } catch (const std::runtime_error& e) {
    reason = e.what();
  } catch (const std::invalid_argument& e) {
    reason = e.what();
  }
  if (reason.empty()) throw std::logic_error("refused without a reason");
  return false;
}

}  // namespace air_ground_fuzz
