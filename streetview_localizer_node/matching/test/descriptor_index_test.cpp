#include "streetview_localizer/descriptor_index.h"

#include <gtest/gtest.h>

#include <omp.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "synthetic_descriptors.h"

namespace streetview_localizer {
namespace {

namespace fs = std::filesystem;

class IndexTest : public ::testing::TestWithParam<IndexMethod> {
 protected:
  void SetUp() override {
    if (!isAvailable(GetParam())) GTEST_SKIP() << "built without hnswlib";
    settings_.method = GetParam();
    folder_ = fs::temp_directory_path() / ("descriptor_index_test_" + std::to_string(getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string path() const { return (folder_ / "index").string(); }

  IndexSettings settings_;
  fs::path folder_;
};

void expectEqual(const std::vector<std::vector<Neighbor>>& a, const std::vector<std::vector<Neighbor>>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_EQ(a[i].size(), b[i].size());
    for (std::size_t j = 0; j < a[i].size(); ++j) {
      EXPECT_EQ(a[i][j].id, b[i][j].id);
      EXPECT_EQ(a[i][j].distance, b[i][j].distance);
    }
  }
}

TEST_P(IndexTest, FindsWhatAPlainLoopFinds) {
  const cv::Mat data = syntheticDescriptors(5000, 1), queries = disturbed(data, 300, 2);
  const auto found = buildIndex(data, settings_)->search(queries, 3);
  int right = 0, right_third = 0;
  for (int i = 0; i < queries.rows; ++i) {
    std::vector<std::pair<double, int>> all;
    for (int j = 0; j < data.rows; ++j) all.emplace_back(cv::norm(queries.row(i), data.row(j), cv::NORM_L2), j);
    std::partial_sort(all.begin(), all.begin() + 3, all.end());
    ASSERT_EQ(found[i].size(), 3u);
    right += found[i][0].id == all[0].second;
    right_third += found[i][2].id == all[2].second;
    for (const Neighbor& n : found[i])
      EXPECT_NEAR(n.distance, cv::norm(queries.row(i), data.row(n.id), cv::NORM_L2), 1e-3);
    EXPECT_LE(found[i][0].distance, found[i][1].distance);
    EXPECT_LE(found[i][1].distance, found[i][2].distance);
  }
  const double least = GetParam() == IndexMethod::kBruteForce ? 1 : 0.9;
  EXPECT_GE(right, least * queries.rows);
  EXPECT_GE(right_third, (least == 1 ? 1 : 0.8) * queries.rows);
}

TEST_P(IndexTest, DoesNotDependOnTheNumberOfThreads) {
  const cv::Mat data = syntheticDescriptors(3000, 3), queries = disturbed(data, 100, 4);
  const int threads = omp_get_max_threads();
  const auto index = buildIndex(data, settings_);
  omp_set_num_threads(1);
  const auto one = index->search(queries, 4);
  omp_set_num_threads(4);
  const auto four = index->search(queries, 4);
  expectEqual(one, four);
  if (GetParam() != IndexMethod::kFlann) expectEqual(one, buildIndex(data, settings_)->search(queries, 4));
  omp_set_num_threads(threads);
}

TEST_P(IndexTest, ComesBackFromItsFile) {
  const cv::Mat data = syntheticDescriptors(2000, 5), queries = disturbed(data, 100, 6);
  const auto index = buildIndex(data, settings_);
  index->save(path());
  EXPECT_FALSE(fs::exists(path() + ".tmp"));
  const auto loaded = loadIndex(path(), data, settings_);
  EXPECT_EQ(loaded->settings().method, GetParam());
  expectEqual(index->search(queries, 5), loaded->search(queries, 5));
}

TEST_P(IndexTest, RefusesFilesThatWereBuiltOtherwise) {
  const cv::Mat data = syntheticDescriptors(500, 7);
  buildIndex(data, settings_)->save(path());
  IndexSettings searched_otherwise = settings_, built_otherwise = settings_, of_another_method = settings_;
  searched_otherwise.flann_checks = 100;
  searched_otherwise.hnsw_search = 100;
  EXPECT_NO_THROW(loadIndex(path(), data, searched_otherwise));
  built_otherwise.flann_trees = 2;
  built_otherwise.hnsw_links = 8;
  if (GetParam() != IndexMethod::kBruteForce) {
    EXPECT_THROW(loadIndex(path(), data, built_otherwise), std::runtime_error);
  }
  of_another_method.method = GetParam() == IndexMethod::kFlann ? IndexMethod::kBruteForce : IndexMethod::kFlann;
  try {
    loadIndex(path(), data, of_another_method);
    FAIL() << "an index of another method was taken";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("not " + toString(of_another_method.method)), std::string::npos) << e.what();
  }
}

TEST_P(IndexTest, RefusesFilesThatAreNotItsOwn) {
  cv::Mat data = syntheticDescriptors(500, 7);
  buildIndex(data, settings_)->save(path());
  EXPECT_THROW(loadIndex(path() + "_absent", data, settings_), std::runtime_error);
  EXPECT_THROW(loadIndex(path(), data.rowRange(0, 499), settings_), std::runtime_error);
  cv::Mat changed = data.clone();
  changed.at<unsigned char>(250, 64) ^= 1;
  EXPECT_THROW(loadIndex(path(), changed, settings_), std::runtime_error);
  if (fs::exists(path() + ".data")) {
    fs::resize_file(path() + ".data", fs::file_size(path() + ".data") / 2);
    EXPECT_THROW(loadIndex(path(), data, settings_), std::runtime_error);
    fs::remove(path() + ".data");
    EXPECT_THROW(loadIndex(path(), data, settings_), std::runtime_error);
  }
  std::ofstream(path()) << "something else";
  EXPECT_THROW(loadIndex(path(), data, settings_), std::runtime_error);
  EXPECT_THROW(buildIndex(data, settings_)->save((folder_ / "absent" / "index").string()), std::runtime_error);
}

// Every byte counts: the libraries would follow a wrong link without asking.
TEST_P(IndexTest, RefusesAFlippedBit) {
  const cv::Mat data = syntheticDescriptors(500, 7);
  buildIndex(data, settings_)->save(path());
  if (!fs::exists(path() + ".data")) return;  // brute force keeps no data
  const auto bytes = static_cast<std::streamoff>(fs::file_size(path() + ".data"));
  for (const std::streamoff at : {std::streamoff{3}, bytes / 3, bytes / 2, bytes - 1}) {
    std::fstream file(path() + ".data", std::ios::in | std::ios::out | std::ios::binary);
    const auto flip = [&] {
      file.seekg(at);
      const char byte = static_cast<char>(file.peek() ^ 4);
      file.seekp(at);
      file.put(byte);
      file.flush();
    };
    flip();
    try {
      loadIndex(path(), data, settings_);
      ADD_FAILURE() << "taken with a flipped bit in byte " << at;
    } catch (const std::runtime_error& e) {
      EXPECT_NE(std::string(e.what()).find("have changed"), std::string::npos) << e.what();
    }
    flip();
    EXPECT_NO_THROW(loadIndex(path(), data, settings_));
  }
}

TEST_P(IndexTest, SmallAndEmpty) {
  const cv::Mat data = syntheticDescriptors(3, 8);
  const auto index = buildIndex(data, settings_);
  const auto found = index->search(data, 10);
  ASSERT_EQ(found.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    ASSERT_EQ(found[i].size(), 3u);
    EXPECT_EQ(found[i][0].id, i);
    EXPECT_EQ(found[i][0].distance, 0);
  }
  EXPECT_TRUE(index->search(cv::Mat(), 1).empty());
  EXPECT_THROW(index->search(data, 0), std::invalid_argument);
  EXPECT_THROW(index->search(cv::Mat(1, 128, CV_32F), 1), std::invalid_argument);
  const auto empty = buildIndex(cv::Mat(0, 128, CV_8U), settings_);
  EXPECT_TRUE(empty->search(data, 2)[0].empty());
}

INSTANTIATE_TEST_SUITE_P(Methods, IndexTest,
                         ::testing::Values(IndexMethod::kBruteForce, IndexMethod::kFlann, IndexMethod::kHnsw),
                         [](const auto& info) { return toString(info.param); });

TEST(IndexSettings, NamesAndRanges) {
  for (const char* name : {"brute_force", "flann", "hnsw"}) EXPECT_EQ(toString(indexMethodFromString(name)), name);
  EXPECT_THROW(indexMethodFromString("kdtree"), std::invalid_argument);
  IndexSettings settings;
  settings.hnsw_search = 0;
  EXPECT_THROW(buildIndex(syntheticDescriptors(10, 9), settings), std::invalid_argument);
}

}  // namespace
}  // namespace streetview_localizer
