#include "air_ground_common/atomic_file.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <thread>
#include <vector>

namespace air_ground_common {
namespace {

namespace fs = std::filesystem;

class AtomicFile : public testing::Test {
 protected:
  AtomicFile() : folder_(fs::path(testing::TempDir()) / "atomic_file_test") {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~AtomicFile() override { fs::remove_all(folder_); }

  std::string path() const { return (folder_ / "file").string(); }
  std::string content() const {
    std::ostringstream all;
    all << std::ifstream(path()).rdbuf();
    return all.str();
  }
  std::size_t files() const { return std::distance(fs::directory_iterator(folder_), fs::directory_iterator()); }
  static void writeText(const std::string& to, const std::string& text, const std::string& begins_with = "") {
    writeAtomically(
        to, [&](std::ostream& out) { out << text; }, begins_with);
  }

  fs::path folder_;
};

TEST_F(AtomicFile, LeavesTheOldFileWholeWhenTheBodyFails) {
  writeText(path(), "old");
  EXPECT_THROW(writeAtomically(path(),
                               [](std::ostream& out) {
                                 out << "new";
                                 throw std::runtime_error("midway");
                               }),
               std::runtime_error);
  EXPECT_EQ(content(), "old");
  EXPECT_EQ(files(), 1u) << "nothing is left behind";
  writeText(path(), "new");
  EXPECT_EQ(content(), "new");
}

TEST_F(AtomicFile, WritersOfOnePathDoNotMix) {
  const std::string texts[2] = {std::string(200000, 'a'), std::string(300000, 'b')};
  std::vector<std::thread> writers;
  for (const std::string& text : texts)
    writers.emplace_back([&, this] {
      for (int i = 0; i < 20; ++i) writeText(path(), text);
    });
  for (auto& writer : writers) writer.join();
  EXPECT_TRUE(content() == texts[0] || content() == texts[1]);
  EXPECT_EQ(files(), 1u);
}

TEST_F(AtomicFile, DoesNotOverwriteAnotherKindOfFile) {
  std::ofstream(path()) << "#!/bin/sh";
  EXPECT_THROW(writeText(path(), "ply\n", "ply"), std::runtime_error);
  EXPECT_EQ(content(), "#!/bin/sh");
  EXPECT_THROW(refuseOtherKind(path(), "ply"), std::runtime_error) << "asked before";
  EXPECT_NO_THROW(refuseOtherKind((folder_ / "absent").string(), "ply"));
  std::ofstream(path()) << "";
  EXPECT_NO_THROW(writeText(path(), "ply\n1", "ply")) << "an empty file holds nothing";
  EXPECT_NO_THROW(writeText(path(), "ply\n2", "ply"));
  EXPECT_EQ(content(), "ply\n2");
}

TEST_F(AtomicFile, SaysWhy) {
  try {
    writeText((folder_ / "absent" / "file").string(), "x");
    FAIL() << "written into a folder that is not there";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("No such file or directory"), std::string::npos) << e.what();
  }
}

}  // namespace
}  // namespace air_ground_common
