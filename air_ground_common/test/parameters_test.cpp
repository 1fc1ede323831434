// One declaration is read from YAML and the command line, checked and written.
#include "air_ground_common/parameters.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

namespace air_ground_common {
namespace {

enum class Mode { kFast, kThorough };

struct Settings {
  double voxel = 0.02, tilt = M_PI / 6;
  unsigned count = 5;
  bool refine = true;
  Mode mode = Mode::kFast;
  std::string frame;
  std::vector<double> stddev{8, 8, 12.5};
  std::optional<Pose> T_base_camera;
};

void describe(ParameterVisitor& v, Settings& s) {
  v.about("example: a program.");
  v.section("Grid", "All of it.");
  v("voxel", s.voxel, {0.001, 1}, "m", "edge");
  v("group/count", s.count, {1, 1 << 30}, "",
    "of clouds, a long text that does not fit into one line of the file and so goes on in the next line, below its "
    "beginning");
  v("group/refine", s.refine, "");
  v.section("Rest");
  v.degrees("tilt", s.tilt, {0, 90}, "largest");
  v.choice("mode", s.mode, {{"fast", Mode::kFast}, {"thorough", Mode::kThorough}}, "how");
  v("frame", s.frame, "empty: any");
  v("stddev", s.stddev, {1e-6, 100}, "m", "x y z");
  v("base_camera", s.T_base_camera, "all 0: from tf");
  v.others("chain");
}

std::string errorOf(const std::vector<std::string>& assignments, const std::string& path = "") {
  Settings s;
  try {
    readYaml(path, assignments, &s);
  } catch (const ParameterError& e) {
    return e.what();
  }
  return "";
}

std::string fileOf(const std::string& text) {
  const std::string path = testing::TempDir() + "parameters_test.yaml";
  std::ofstream(path) << text;
  return path;
}

TEST(Parameters, WrittenFileIsCommentedAndReadsBackTheSame) {
  const std::string text = yamlFile(Settings());
  EXPECT_EQ(text.find("# example: a program.\n"), 0u) << text;
  EXPECT_NE(text.find("\n# ---- Grid ----\n# All of it.\nvoxel: 0.02    # edge [m] (0.001..1)\ngroup:\n"
                      "  count: 5     # of clouds, a long text"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("tilt: 30.0 "), std::string::npos) << text;
  EXPECT_NE(text.find("# how (fast, thorough)\n"), std::string::npos) << text;
  Settings s;
  s.voxel = 0.5, s.tilt = 0, s.count = 7, s.mode = Mode::kThorough, s.stddev = {1, 2, 3}, s.frame = "map";
  readYaml(fileOf(text), {}, &s);
  EXPECT_EQ(yamlFile(s), text);
  EXPECT_NEAR(s.tilt, M_PI / 6, 1e-15);
}

TEST(Parameters, FileAndCommandLineAreRead) {
  Settings s;
  readYaml(fileOf("voxel: 1\ngroup: {count: 9, refine: false}\nchain: {filters: [VoxelGrid: {leaf: 1}]}\n"),
           {"mode=thorough", "group/count=12", "base_camera=[1, 2, 3, 0, 0, 1, 0]"}, &s);
  EXPECT_EQ(s.voxel, 1);
  EXPECT_EQ(s.count, 12u) << "the command line counts more";
  EXPECT_FALSE(s.refine);
  EXPECT_EQ(s.mode, Mode::kThorough);
  ASSERT_TRUE(s.T_base_camera);
  EXPECT_LT((*s.T_base_camera * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(0, 2, 3)).norm(), 1e-12);
}

TEST(Parameters, ErrorsNameParameterValueAndWhatIsAllowed) {
  EXPECT_EQ(errorOf({"voxel=7"}), "parameter voxel = 7.0 must lie in [0.001, 1] m");
  EXPECT_EQ(errorOf({"mode=slow"}), "parameter mode = slow must be one of: fast, thorough");
  EXPECT_NE(errorOf({"voxel=.nan"}), "");
  EXPECT_NE(errorOf({"voxel=fine"}).find("fine has the wrong type"), std::string::npos);
  EXPECT_NE(errorOf({"group/count=1.5"}).find("wrong type"), std::string::npos);
  EXPECT_NE(errorOf({"stddev=[1, 2]"}).find("must hold 3 numbers"), std::string::npos);
  EXPECT_NE(errorOf({"base_camera=[1, 2, 3, 0, 0, 0, 2]"}).find("length 1"), std::string::npos);
  EXPECT_NE(errorOf({"vxel=0.1"}).find("vxel"), std::string::npos) << "misspelt";
  EXPECT_NE(errorOf({"voxel"}).find("NAME=VALUE"), std::string::npos);
  EXPECT_NE(errorOf({}, "/nowhere.yaml").find("/nowhere.yaml"), std::string::npos);
}

TEST(Parameters, RangesOfAFilledStructAreChecked) {
  Settings s;
  EXPECT_NO_THROW(checkRanges(s));
  s.tilt = 2;
  EXPECT_THROW(checkRanges(s), ParameterError);
}

}  // namespace
}  // namespace air_ground_common
