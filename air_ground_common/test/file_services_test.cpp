#include "air_ground_common/ros/file_services.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>

namespace air_ground_common::ros_utils {
namespace {

std::vector<CloudPoint> threePoints() {
  CloudPoint p;
  p.position = {1, 2, 3};
  p.rgb = {10, 20, 60};
  p.source = 1;
  return {p, p, p};
}

// Header and data of a file, which is removed.
std::pair<std::string, std::string> readPcd(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const std::string all((std::istreambuf_iterator<char>(file)), {}), end = "DATA binary\n";
  std::remove(path.c_str());
  const std::size_t data = all.find(end);
  if (data == std::string::npos) return {};
  return {all.substr(0, data), all.substr(data + end.size())};
}

TEST(WriteCloud, PcdHoldsTheFieldsAskedFor) {
  const std::string path = testing::TempDir() + "file_services_test.pcd";
  const struct {
    CloudFields fields;
    const char *names, *types;
    std::size_t size;
  } cases[] = {{CloudFields::kXyz, "FIELDS x y z\n", "TYPE F F F\n", 12},
               {CloudFields::kXyzIntensity, "FIELDS x y z intensity\n", "TYPE F F F F\n", 16},
               {CloudFields::kXyzRgb, "FIELDS x y z rgb\n", "TYPE F F F U\n", 16},
               {CloudFields::kXyzRgbSource, "FIELDS x y z rgb source\n", "TYPE F F F U U\n", 17}};
  for (const auto& c : cases) {
    writeCloud(path, threePoints(), c.fields);
    const auto [header, data] = readPcd(path);
    EXPECT_NE(header.find(c.names), std::string::npos) << header;
    EXPECT_NE(header.find(c.types), std::string::npos) << header;
    EXPECT_NE(header.find("POINTS 3\n"), std::string::npos) << header;
    ASSERT_EQ(data.size(), 3 * c.size) << c.names;
    float xyz[3];
    std::memcpy(xyz, data.data() + c.size, sizeof(xyz));
    EXPECT_EQ(xyz[2], 3);
    if (c.fields == CloudFields::kXyzIntensity) {
      float intensity;
      std::memcpy(&intensity, data.data() + 12, 4);
      EXPECT_EQ(intensity, 30);
    }
    if (c.fields == CloudFields::kXyzRgb || c.fields == CloudFields::kXyzRgbSource) {
      EXPECT_EQ(data.substr(12, 4), std::string("\x3C\x14\x0A\xFF")) << "blue, green, red, opaque";
    }
    if (c.fields == CloudFields::kXyzRgbSource) {
      EXPECT_EQ(data[16], 1);
    }
  }
}

TEST(WriteCloud, PlyKeepsColourAndSource) {
  const std::string path = testing::TempDir() + "file_services_test.ply";
  writeCloud(path, threePoints());
  const auto points = readPlyPoints(path);
  std::remove(path.c_str());
  ASSERT_EQ(points.size(), 3u);
  EXPECT_EQ(points[0].rgb[2], 60);
  EXPECT_EQ(points[0].source, 1);
}

TEST(WriteCloud, RefusesWhatItCannotWrite) {
  const std::string folder = testing::TempDir();
  EXPECT_THROW(writeCloud(folder + "empty.ply", {}), std::runtime_error);
  EXPECT_THROW(writeCloud(folder + "cloud.xyz", threePoints()), std::runtime_error);
  EXPECT_THROW(writeCloud("/nonexistent/a.pcd", threePoints()), std::runtime_error);
}

TEST(AbsolutePath, KnowsTheHomeAndTheWorkingDirectory) {
  const std::string here = std::filesystem::current_path();
  const char* home = std::getenv("HOME");
  const std::string before = home ? home : "/";
  setenv("HOME", "/home/me", 1);
  EXPECT_EQ(absolutePath("~/maps/a b.ply"), "/home/me/maps/a b.ply");
  EXPECT_EQ(absolutePath("~"), "/home/me");
  EXPECT_EQ(absolutePath("~x/a.ply"), here + "/~x/a.ply");
  EXPECT_EQ(absolutePath("./maps/../a.ply"), here + "/a.ply");
  EXPECT_EQ(absolutePath("/tmp/~/a.ply"), "/tmp/~/a.ply");
  EXPECT_THROW(absolutePath(""), std::runtime_error);
  unsetenv("HOME");
  EXPECT_THROW(absolutePath("~/a.ply"), std::runtime_error);
  EXPECT_EQ(absolutePath("/a.ply"), "/a.ply");
  setenv("HOME", before.c_str(), 1);
}

TEST(Autosave, FindsTheHome) {
  const char* home = std::getenv("HOME");
  const std::string before = home ? home : "/", folder = testing::TempDir() + "autosave_home";
  setenv("HOME", folder.c_str(), 1);
  std::string written;
  Autosave("~/maps").save("map.ply", [&](const std::string& path) { written = path; });
  EXPECT_EQ(written.rfind(folder + "/maps/", 0), 0u) << written;
  setenv("HOME", before.c_str(), 1);
  std::filesystem::remove_all(folder);
}

TEST(Autosave, WritesUnderNewNamesAndRefusesAFolderThatIsNone) {
  namespace fs = std::filesystem;
  const std::string folder = testing::TempDir() + "autosave_test/of this user";
  fs::remove_all(folder);
  const auto put = [](const std::string& text) {
    return [text](const std::string& path) { std::ofstream(path) << text; };
  };
  const Autosave autosave(folder);
  autosave.save("map.ply", put("first"));
  autosave.save("map.ply", put("second"));  // its name is taken
  autosave.save("nothing.txt", [](const std::string&) { throw std::runtime_error("nothing to save"); });
  ASSERT_EQ(std::distance(fs::directory_iterator(folder), {}), 1);
  const std::string path = fs::directory_iterator(folder)->path().string();
  EXPECT_NE(path.find("_map.ply"), std::string::npos) << path;
  std::string text;
  std::ifstream(path) >> text;
  EXPECT_EQ(text, "first");
  EXPECT_THROW(Autosave(path + "/below a file"), std::runtime_error);
  // Started again at the same time, by a clock without battery.
  Autosave(folder).save("map.ply", put("third"));
  Autosave(folder).save("map.ply", put("fourth"));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder), {}), 3);
  Autosave("").save("map.ply", [](const std::string&) { FAIL() << "no folder is given"; });
  fs::remove_all(testing::TempDir() + "autosave_test");
}

}  // namespace
}  // namespace air_ground_common::ros_utils
