// Files that are either whole or not there.
#pragma once

#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <string>

namespace air_ground_common {

/// `body` writes to the stream it gets. Goes through `path`.partial, so that an interrupted write leaves the old file
/// whole. Throws std::runtime_error.
template <typename Body>
void writeAtomically(const std::string& path, const Body& body) {
  const std::string partial = path + ".partial";
  {
    std::ofstream file(partial, std::ios::binary);
    body(file);
    file.close();
    if (!file) {
      std::remove(partial.c_str());
      throw std::runtime_error("cannot write " + path);
    }
  }
  if (std::rename(partial.c_str(), path.c_str()) != 0) throw std::runtime_error("cannot write " + path);
}

}  // namespace air_ground_common
