#include "icp_refine/pcd.h"

#include <cstdio>
#include <cstring>
#include <fstream>
#include <stdexcept>

namespace icp_refine {

void writePcd(const std::string& path, const std::vector<air_ground_common::LabeledPoint>& points) {
  const std::string temporary = path + ".tmp";
  {
    std::ofstream file(temporary, std::ios::binary);
    file << "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb source\nSIZE 4 4 4 4 1\nTYPE F F F U U\n"
         << "COUNT 1 1 1 1 1\nWIDTH " << points.size() << "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " << points.size()
         << "\nDATA binary\n";
    for (const auto& p : points) {
      char row[17];
      const std::uint32_t rgb = static_cast<std::uint32_t>(p.rgb[0]) << 16 | static_cast<std::uint32_t>(p.rgb[1]) << 8 | p.rgb[2];
      std::memcpy(row, p.position.data(), 12);
      std::memcpy(row + 12, &rgb, 4);
      row[16] = static_cast<char>(p.source);
      file.write(row, sizeof(row));
    }
    file.flush();
    if (!file) {
      std::remove(temporary.c_str());
      throw std::runtime_error("cannot write " + temporary + ": does its folder exist, and is there space?");
    }
  }
  if (std::rename(temporary.c_str(), path.c_str()) != 0) throw std::runtime_error("cannot rename " + temporary + " to " + path);
}

}  // namespace icp_refine
