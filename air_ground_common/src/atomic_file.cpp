#include "air_ground_common/atomic_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace air_ground_common {
namespace {

[[noreturn]] void fail(const std::string& path, int error) {
  throw std::runtime_error("cannot write " + path + ": " + (error != 0 ? std::strerror(error) : "unknown error"));
}

/// Returns 0 or the error's number.
int syncToDisk(const std::string& path) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return errno;
  const int error = ::fsync(file) == 0 ? 0 : errno;
  ::close(file);
  return error;
}

}  // namespace

void refuseOtherKind(const std::string& path, const std::string& begins_with) {
  if (begins_with.empty() || !std::filesystem::exists(path)) return;
  std::string begin(begins_with.size(), '\0');
  std::ifstream file(path, std::ios::binary);
  file.read(begin.data(), static_cast<std::streamsize>(begin.size()));
  if (file.gcount() == 0 && std::filesystem::is_regular_file(path)) return;  // an empty file holds nothing
  if (begin != begins_with)
    throw std::runtime_error(path + " is there already and is another kind of file: give another path, or delete it");
}

void writeAtomically(const std::string& path, const std::function<void(std::ostream&)>& body,
                     const std::string& begins_with) {
  refuseOtherKind(path, begins_with);
  static std::atomic<unsigned> counter{0};
  const std::string partial = path + ".partial-" + std::to_string(::getpid()) + "-" + std::to_string(++counter);
  try {
    errno = 0;
    std::ofstream file(partial, std::ios::binary);
    if (file) body(file);
    file.close();
    if (!file) fail(path, errno);
    if (const int error = syncToDisk(partial)) fail(path, error);
    if (std::rename(partial.c_str(), path.c_str()) != 0) fail(path, errno);
  } catch (...) {
    std::remove(partial.c_str());
    throw;
  }
  // The new name itself; some file systems cannot sync a folder, and the file is whole all the same.
  const std::string folder = std::filesystem::path(path).parent_path().string();
  syncToDisk(folder.empty() ? "." : folder);
}

}  // namespace air_ground_common
