// Seeds and former findings of the fuzzers, through the same entries: what once crashed, hung or lied does not again.
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "fuzzing.h"

namespace air_ground_fuzz {
namespace {

namespace fs = std::filesystem;

TEST(FuzzCorpus, EveryInputIsReadOrRefused) {
  const Targets targets = allTargets();
  for (const auto& folder : fs::directory_iterator(AIR_GROUND_FUZZ_CORPUS))
    EXPECT_TRUE(targets.count(folder.path().filename())) << folder.path() << " belongs to no target";
  for (const auto& [name, target] : targets) {
    const fs::path folder = fs::path(AIR_GROUND_FUZZ_CORPUS) / name;
    ASSERT_TRUE(fs::is_directory(folder)) << "target " << name << " has no corpus";
    int inputs = 0;
    for (const auto& file : fs::directory_iterator(folder)) {
      SCOPED_TRACE(file.path().string());
      std::ifstream stream(file.path(), std::ios::binary);
      const Bytes bytes{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
      const auto start = std::chrono::steady_clock::now();
      EXPECT_NO_THROW(target(bytes));
      EXPECT_LT(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), 10);
      ++inputs;
    }
    EXPECT_GT(inputs, 0) << name;
    EXPECT_NO_THROW(target({})) << name;
  }
}

}  // namespace
}  // namespace air_ground_fuzz
