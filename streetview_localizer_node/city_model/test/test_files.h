// Small input files for the tests, and the folder of the real ones.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

namespace streetview_localizer {

/// A folder of its own that goes with the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "streetview_XXXXXX").string();
    path_ = mkdtemp(name.data());
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  std::string operator/(const std::string& name) const { return path_ + "/" + name; }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(path_ + "/" + name) << text;
    return path_ + "/" + name;
  }

 private:
  std::string path_;
};

/// Recordings that are not part of the sources.
inline std::string sharedData(const std::string& name) {
  const char* folder = std::getenv("AIR_GROUND_SHARED");
  return std::string(folder ? folder : AIR_GROUND_SOURCE_DIR "/../shared") + "/data/" + name;
}

/// What an exception says; empty if none is thrown.
template <typename F>
std::string messageOf(const F& f) {
  try {
    f();
  } catch (const std::exception& e) {
    return e.what();
  }
  return "";
}

}  // namespace streetview_localizer
