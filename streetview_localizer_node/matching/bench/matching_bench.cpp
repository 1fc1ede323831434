// Times of the five steps of the matching as in figure 4 of Majdik 2014, on photographs where ../shared has them, else
// on drawn facades; each beside a plain reference. AIR_GROUND_BENCH_DESCRIPTORS: rows of the index (default 200000; the
// bar is for 1000000).
#include <benchmark/benchmark.h>

#include <ctime>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <opencv2/core/utility.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "../test/synthetic_descriptors.h"
#include "streetview_localizer/descriptor_index.h"
#include "streetview_localizer/kvld.h"
#include "streetview_localizer/pairwise.h"
#include "streetview_localizer/virtual_views.h"
#include "streetview_localizer/voting.h"

namespace streetview_localizer {
namespace {

namespace fs = std::filesystem;
constexpr int kViews = 8;      // compared with the query, as with a prior from the tracker
constexpr int kNeighbors = 4;  // of each of the query's features in the whole database

struct Seconds {
  double wall = 0, cpu = 0;
};

double cpuNow() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

/// Least of `runs`: the machine may be shared.
Seconds measure(int runs, const std::function<void()>& work) {
  Seconds best{1e9, 1e9};
  for (int r = 0; r < runs; ++r) {
    const double cpu = cpuNow();
    const auto start = std::chrono::steady_clock::now();
    work();
    best.wall = std::min(best.wall, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    best.cpu = std::min(best.cpu, cpuNow() - cpu);
  }
  return best;
}

cv::Mat drawFacade(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> x(-20, 640), y(-20, 480), side(6, 60), grey(0, 255);
  cv::Mat image(480, 640, CV_8U, cv::Scalar(128));
  for (int i = 0; i < 700; ++i) {
    const cv::Rect box(x(random), y(random), side(random), side(random));
    cv::rectangle(image, box, cv::Scalar(grey(random)), i % 3 ? -1 : 2);
  }
  cv::GaussianBlur(image, image, cv::Size(0, 0), 0.8);
  return image;
}

/// A query and views of the same facade, 640x480; neighbouring photographs of castle-P30 where they are.
struct Scene {
  Scene() {
    const char* shared = std::getenv("AIR_GROUND_SHARED");
    const fs::path folder = fs::path(shared ? shared : AIR_GROUND_SOURCE_SHARED) / "data/strecha_960/castle-P30/images";
    std::vector<fs::path> files;
    if (fs::exists(folder))
      for (const auto& entry : fs::directory_iterator(folder)) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    photographs = files.size() >= 30;
    if (photographs) {
      for (const fs::path& file : files) {
        const cv::Mat image = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
        cv::Mat small;
        cv::resize(image, small, cv::Size(720, 480), 0, 0, cv::INTER_AREA);
        images.push_back(small(cv::Rect(40, 0, 640, 480)).clone());
      }
      query = 12;
    } else {
      for (unsigned i = 0; i < 30; ++i) {
        cv::Mat image;
        const double s = 1 - 0.01 * i;
        const cv::Matx23d H(s, 0.02 * i, 5. * i, 0, s, 4. * i);
        cv::warpAffine(drawFacade(1), image, H, cv::Size(640, 480), cv::INTER_LINEAR, cv::BORDER_REFLECT);
        images.push_back(image);
      }
      query = 4;
    }
    camera.width = 640;
    camera.height = 480;
    camera.fx = camera.fy = 647;
    camera.cx = 319.5;
    camera.cy = 239.5;
    for (int d = 1; static_cast<int>(views.size()) < kViews; ++d)
      for (const int i : {query - d, query + d})
        if (i >= 0 && i < static_cast<int>(images.size()) && static_cast<int>(views.size()) < kViews)
          views.push_back(i);
    for (const int i : views) {
      view_features.push_back(extractFeatures(images[i]));
      view_gradients.emplace_back(images[i]);
    }
    query_features = extractWithVirtualViews(images[query], camera);
  }

  bool photographs = false;
  int query = 0;
  std::vector<cv::Mat> images;
  air_ground_common::CameraModel camera;
  std::vector<int> views;
  std::vector<Features> view_features;
  std::vector<GradientPyramid> view_gradients;
  Features query_features;
};

const Scene& scene() {
  static const Scene instance;
  return instance;
}

int indexSize() {
  const char* rows = std::getenv("AIR_GROUND_BENCH_DESCRIPTORS");
  return rows ? std::max(20000, std::atoi(rows)) : 200000;
}

/// As many descriptors as asked for: those of the photographs, repeated with noise, or synthetic ones; and queries:
/// photographs that the database does not hold, or disturbed rows.
struct Database {
  Database() {
    const Scene& s = scene();
    if (s.photographs) {
      cv::Mat base;
      for (std::size_t i = 0; i < s.images.size(); ++i)
        if (static_cast<int>(i) % 3 != s.query % 3) base.push_back(extractFeatures(s.images[i]).descriptors);
      descriptors.create(indexSize(), 128, CV_8U);
      // Further copies are disturbed by shuffled parts: as different from one another as those of different buildings.
      std::mt19937 random(3);
      std::uniform_int_distribution<int> row(0, base.rows - 1);
      for (int i = 0; i < descriptors.rows; ++i) {
        if (i < base.rows) {
          base.row(i).copyTo(descriptors.row(i));
          continue;
        }
        const cv::Mat a = base.row(row(random)), b = base.row(row(random));
        for (int cell = 0; cell < 16; ++cell)
          (random() % 2 ? a : b)
              .colRange(8 * cell, 8 * cell + 8)
              .copyTo(descriptors.row(i).colRange(8 * cell, 8 * cell + 8));
      }
      queries = s.query_features.descriptors;
    } else {
      descriptors = syntheticDescriptors(indexSize(), 1);
      queries = disturbed(descriptors, 8000, 2);
    }
  }
  cv::Mat descriptors, queries;
};

const Database& database() {
  static const Database instance;
  return instance;
}

double recall(const std::vector<std::vector<Neighbor>>& found, const std::vector<std::vector<Neighbor>>& exact) {
  int right = 0;
  for (std::size_t i = 0; i < exact.size(); ++i)
    right += !found[i].empty() && found[i][0].distance <= exact[i][0].distance + 1e-3f;
  return static_cast<double>(right) / static_cast<double>(exact.size());
}

void line(const char* name, const Seconds& s) { std::printf("  %-62s %8.1f %8.1f\n", name, 1e3 * s.wall, 1e3 * s.cpu); }

/// OpenCV's SIFT, doubled, in the query and every virtual view.
std::size_t referenceExtraction(const Scene& s) {
  VirtualViewSettings settings;
  settings.warped.double_image = true;
  return extractWithVirtualViews(s.images[s.query], s.camera, settings).size();
}

void printTable() {
  const Scene& s = scene();
  std::printf("\nAir-ground matching, query %s, 640x480, %zu features with virtual views, %d views, %d threads\n",
              s.photographs ? "a photograph of castle-P30" : "a drawn facade", s.query_features.size(), kViews,
              cv::getNumThreads());
  std::printf("  %-62s %8s %8s\n", "step (least of several runs)", "wall ms", "CPU ms");
  const Seconds extract =
      measure(5, [&] { benchmark::DoNotOptimize(extractWithVirtualViews(s.images[s.query], s.camera)); });
  line("1 virtual views and feature extraction", extract);

  IndexSettings settings;
  settings.build_threads = 0;
  const auto index = buildIndex(database().descriptors, settings);
  std::vector<std::vector<Neighbor>> neighbors;
  const Seconds search = measure(3, [&] { neighbors = index->search(database().queries, kNeighbors); });
  line(("2 search of " + std::to_string(index->size()) + " descriptors, " + toString(settings.method)).c_str(), search);

  std::vector<int> queried(database().queries.rows), place(index->size());
  for (std::size_t i = 0; i < queried.size(); ++i) queried[i] = static_cast<int>(i);
  for (std::size_t i = 0; i < place.size(); ++i) place[i] = static_cast<int>(i / 2000);
  std::vector<cv::KeyPoint> keypoints = s.query_features.keypoints;
  keypoints.resize(queried.size());
  const Seconds vote = measure(5, [&] {
    benchmark::DoNotOptimize(
        voteForPlaces(neighbors, queried, keypoints, place, static_cast<int>(index->size()) / 2000 + 1));
  });
  line("3 histogram voting", vote);

  std::vector<std::vector<Match>> matches(kViews);
  const Seconds match = measure(5, [&] {
    for (int v = 0; v < kViews; ++v) matches[v] = matchPairwise(s.query_features, s.view_features[v]);
  });
  line("4 pairwise matching with the views", match);
  std::size_t putative = 0, kept = 0;
  const Seconds kvld = measure(5, [&] {
    putative = kept = 0;
    const GradientPyramid gradients(s.images[s.query]);
    for (int v = 0; v < kViews; ++v) {
      putative += matches[v].size();
      kept += filterKvld(gradients, s.view_gradients[v], s.query_features.keypoints, s.view_features[v].keypoints,
                         matches[v])
                  .kept.size();
    }
  });
  line("5 k-VLD", kvld);
  std::printf("    (%zu of %zu putative matches kept)\n", kept, putative);
  line("1 + 4 + 5 (the bar: 400; the paper: 3200 on 8 cores)",
       {extract.wall + match.wall + kvld.wall, extract.cpu + match.cpu + kvld.cpu});
  const std::pair<const char*, double> steps[] = {{"1 virtual views and feature extraction", extract.wall},
                                                  {"2 search of the whole database", search.wall},
                                                  {"3 histogram voting", vote.wall},
                                                  {"4 pairwise matching", match.wall},
                                                  {"5 k-VLD", kvld.wall}};
  std::printf("  slowest: %s\n", std::max_element(std::begin(steps), std::end(steps), [](const auto& a, const auto& b) {
                                   return a.second < b.second;
                                 })->first);

  std::printf("\nAgainst plain references (CPU time)\n");
  const Seconds doubled = measure(3, [&] { benchmark::DoNotOptimize(referenceExtraction(s)); });
  std::printf("  1 OpenCV's SIFT with every view doubled: %.0f ms, %.1fx\n", 1e3 * doubled.cpu,
              doubled.cpu / extract.cpu);
  const Seconds plain =
      measure(1, [&] { benchmark::DoNotOptimize(matchPairwiseReference(s.query_features, s.view_features[0])); });
  const Seconds one =
      measure(3, [&] { benchmark::DoNotOptimize(matchPairwise(s.query_features, s.view_features[0])); });
  std::printf("  4 one view, pair by pair: %.0f ms, %.1fx\n", 1e3 * plain.cpu, plain.cpu / one.cpu);
  cv::Mat query_float, view_float;
  s.query_features.descriptors.convertTo(query_float, CV_32F);
  s.view_features[0].descriptors.convertTo(view_float, CV_32F);
  std::vector<std::vector<cv::DMatch>> opencv;
  const Seconds brute = measure(1, [&] { cv::BFMatcher(cv::NORM_L2).knnMatch(query_float, view_float, opencv, 2); });
  std::printf("  4 one view, OpenCV's BFMatcher: %.0f ms, %.1fx\n", 1e3 * brute.cpu, brute.cpu / one.cpu);
}

void printRecall() {
  const Database& d = database();
  const cv::Mat queries = d.queries.rowRange(0, std::min(1000, d.queries.rows));
  IndexSettings settings;
  settings.method = IndexMethod::kBruteForce;
  std::vector<std::vector<Neighbor>> exact;
  const auto brute = buildIndex(d.descriptors, settings);
  const Seconds plain = measure(1, [&] { exact = brute->search(queries, kNeighbors); });
  const double scale = 1e6 / queries.rows;  // CPU time counts both threads: the time of one
  std::printf("\nIndices over %d descriptors, %d queries\n  %-24s %10s %10s %10s %10s\n", d.descriptors.rows,
              queries.rows, "method", "build s", "CPU us", "recall@1", "speed-up");
  std::printf("  %-24s %10s %10.0f %10.3f %10.1f\n", "brute_force", "", plain.cpu * scale, 1., 1.);
  for (const IndexMethod method : {IndexMethod::kFlann, IndexMethod::kHnsw}) {
    if (!isAvailable(method)) continue;
    settings.method = method;
    settings.build_threads = 0;
    std::unique_ptr<DescriptorIndex> index;
    const Seconds build = measure(1, [&] { index = buildIndex(d.descriptors, settings); });
    const fs::path file = fs::temp_directory_path() / ("matching_bench_" + toString(method));
    index->save(file.string());
    for (const int effort :
         method == IndexMethod::kFlann ? std::vector<int>{64, 256, 1024, 4096} : std::vector<int>{16, 32, 48, 96}) {
      settings.flann_checks = settings.hnsw_search = effort;
      index = loadIndex(file.string(), d.descriptors, settings);
      std::vector<std::vector<Neighbor>> found;
      const Seconds search = measure(2, [&] { found = index->search(queries, kNeighbors); });
      std::printf("  %-24s %10.1f %10.0f %10.3f %10.1f\n", (toString(method) + " " + std::to_string(effort)).c_str(),
                  build.wall, search.cpu * scale, recall(found, exact), plain.cpu / search.cpu);
    }
    fs::remove(file);
    fs::remove(file.string() + ".data");
  }
}

void BM_ExtractWithVirtualViews(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(extractWithVirtualViews(scene().images[scene().query], scene().camera));
}
void BM_MatchOneView(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(matchPairwise(scene().query_features, scene().view_features[0]));
}
void BM_KvldOneView(benchmark::State& state) {
  const Scene& s = scene();
  const GradientPyramid gradients(s.images[s.query]);
  const auto matches = matchPairwise(s.query_features, s.view_features[0]);
  for (auto _ : state)
    benchmark::DoNotOptimize(
        filterKvld(gradients, s.view_gradients[0], s.query_features.keypoints, s.view_features[0].keypoints, matches));
  state.counters["matches"] = static_cast<double>(matches.size());
}
void BM_GradientPyramid(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(GradientPyramid(scene().images[scene().query]));
}
BENCHMARK(BM_ExtractWithVirtualViews)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();
BENCHMARK(BM_MatchOneView)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();
BENCHMARK(BM_KvldOneView)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();
BENCHMARK(BM_GradientPyramid)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();

}  // namespace
}  // namespace streetview_localizer

int main(int argc, char** argv) {
  const bool listing =
      std::any_of(argv, argv + argc, [](const char* a) { return std::string(a) == "--benchmark_list_tests=true"; });
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  benchmark::RunSpecifiedBenchmarks();
  if (listing) return 0;
  streetview_localizer::printTable();
  streetview_localizer::printRecall();
}
