#include "streetview_localizer/descriptor_index.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <stdexcept>
#include <utility>

#include "distance_kernel.h"
#include "index_backends.h"

namespace streetview_localizer {
namespace {

constexpr const char* kMagic = "air_ground_descriptor_index 2";

void checkDescriptors(const cv::Mat& descriptors, const char* what) {
  if (descriptors.rows > 0 && (descriptors.type() != CV_8U || descriptors.cols != kDescriptorSize))
    throw std::invalid_argument(std::string(what) + " must be n x 128, CV_8U");
}

void checkSettings(const IndexSettings& s) {
  const auto require = [](bool ok, const char* what) {
    if (!ok) throw std::invalid_argument(std::string("IndexSettings: ") + what);
  };
  require(s.flann_trees >= 1 && s.flann_trees <= 64, "flann_trees must be in [1, 64]");
  require(s.flann_checks >= 1, "flann_checks must be at least 1");
  require(s.hnsw_links >= 2 && s.hnsw_links <= 128, "hnsw_links must be in [2, 128]");
  require(s.hnsw_construction >= 1, "hnsw_construction must be at least 1");
  require(s.hnsw_search >= 1, "hnsw_search must be at least 1");
  require(s.build_threads >= 0, "build_threads must be at least 0");
  require(isAvailable(s.method), "built without hnswlib; use flann");
}

/// FNV-1a over words of eight bytes, the last one filled up with zeros.
class Checksum {
 public:
  void add(const std::uint8_t* bytes, std::size_t count) {
    for (std::size_t e = 0; e < count; e += 8) {
      std::uint64_t word = 0;
      for (std::size_t b = std::min<std::size_t>(8, count - e); b-- > 0;) word = word << 8 | bytes[e + b];
      hash_ = (hash_ ^ word) * 1099511628211u;
      hash_ ^= hash_ >> 29;
    }
  }
  std::uint64_t value() const { return hash_; }

 private:
  std::uint64_t hash_ = 1469598103934665603u;
};

/// Says whether an index belongs to the descriptors.
std::uint64_t checksum(const cv::Mat& descriptors) {
  Checksum sum;
  for (int i = 0; i < descriptors.rows; ++i) sum.add(descriptors.ptr<std::uint8_t>(i), kDescriptorSize);
  return sum.value();
}

/// Of a data file. The search libraries trust every field of theirs: a flipped bit would be a wrong answer or a crash.
std::uint64_t checksum(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::vector<std::uint8_t> block(1 << 20);
  Checksum sum;
  while (file) {
    file.read(reinterpret_cast<char*>(block.data()), static_cast<std::streamsize>(block.size()));
    sum.add(block.data(), static_cast<std::size_t>(file.gcount()));
  }
  if (!file.eof()) throw std::runtime_error("cannot read " + path);
  return sum.value();
}

std::unique_ptr<DescriptorIndex> make(const cv::Mat& descriptors, const IndexSettings& settings,
                                      const std::string& data) {
  const cv::Mat rows = descriptors.isContinuous() ? descriptors : descriptors.clone();
  switch (settings.method) {
    case IndexMethod::kFlann:
      return makeFlannIndex(rows, settings, data);
    case IndexMethod::kHnsw:
      return makeHnswIndex(rows, settings, data);
    case IndexMethod::kBruteForce:
      break;
  }
  return makeBruteForceIndex(rows, settings);
}

/// How an index was built, as far as that shapes it; names it in messages, too.
std::string buildOf(const IndexSettings& s) {
  const std::string name = toString(s.method);
  switch (s.method) {
    case IndexMethod::kFlann:
      return name + " with " + std::to_string(s.flann_trees) + " trees";
    case IndexMethod::kHnsw:
      return name + " with " + std::to_string(s.hnsw_links) + " links and " + std::to_string(s.hnsw_construction) +
             " candidates";
    case IndexMethod::kBruteForce:
      break;
  }
  return name;
}

class BruteForceIndex : public DescriptorIndex {
 public:
  BruteForceIndex(const cv::Mat& descriptors, const IndexSettings& settings) : DescriptorIndex(descriptors, settings) {
    for (int first = 0; first < descriptors.rows; first += kTile)
      tiles_.push_back(packDescriptors(descriptors.ptr<std::uint8_t>(first), std::min(kTile, descriptors.rows - first),
                                       descriptors.step[0]));
  }

 private:
  static constexpr int kTile = 1024;  // descriptors that stay in the second-level cache with their distances

  bool saveData(const std::string&) const override { return false; }

  void searchRows(const cv::Mat& queries, int k, std::vector<std::vector<Neighbor>>* out) const override {
    using Candidate = std::pair<std::int32_t, std::int32_t>;  // squared distance, id
#pragma omp parallel
    {
      std::vector<std::int32_t> distances(4 * kTile);
      std::vector<Candidate> best[4];
      cv::Mat four(4, kDescriptorSize, CV_8U, cv::Scalar(0));
#pragma omp for schedule(dynamic, 4)
      for (int group = 0; group < (queries.rows + 3) / 4; ++group) {
        const int rows = std::min(4, queries.rows - 4 * group);
        for (int q = 0; q < rows; ++q) {
          queries.row(4 * group + q).copyTo(four.row(q));
          best[q].clear();
        }
        for (std::size_t t = 0; t < tiles_.size(); ++t) {
          distancesOfFour(four.data, four.step[0], tiles_[t], distances.data());
          const std::size_t stride = static_cast<std::size_t>(tiles_[t].blocks) * kLanes;
          for (int q = 0; q < rows; ++q)
            insertNearest(distances.data() + q * stride, tiles_[t].count, static_cast<std::int32_t>(t) * kTile, k,
                          &best[q]);
        }
        for (int q = 0; q < rows; ++q) {
          std::sort(best[q].begin(), best[q].end());
          for (const Candidate& c : best[q])
            (*out)[4 * group + q].push_back({c.second, std::sqrt(static_cast<float>(c.first))});
        }
      }
    }
  }

  /// `best` is a heap of at most k, the farthest first.
  static void insertNearest(const std::int32_t* distances, int count, std::int32_t first_id, int k,
                            std::vector<std::pair<std::int32_t, std::int32_t>>* best) {
    std::int32_t least;
    int at;
    minimumOf(distances, count, &least, &at);
    if (static_cast<int>(best->size()) == k && least >= best->front().first) return;
    for (int j = 0; j < count; ++j) {
      if (static_cast<int>(best->size()) == k) {
        if (distances[j] >= best->front().first) continue;
        std::pop_heap(best->begin(), best->end());
        best->pop_back();
      }
      best->emplace_back(distances[j], first_id + j);
      std::push_heap(best->begin(), best->end());
    }
  }

  std::vector<PackedDescriptors> tiles_;
};

}  // namespace

std::string toString(IndexMethod method) {
  return method == IndexMethod::kBruteForce ? "brute_force" : method == IndexMethod::kFlann ? "flann" : "hnsw";
}

IndexMethod indexMethodFromString(const std::string& name) {
  for (const IndexMethod method : {IndexMethod::kBruteForce, IndexMethod::kFlann, IndexMethod::kHnsw})
    if (name == toString(method)) return method;
  throw std::invalid_argument("index method '" + name + "' is not one of brute_force, flann, hnsw");
}

bool isAvailable(IndexMethod method) {
#ifdef AIR_GROUND_HNSWLIB
  (void)method;
  return true;
#else
  return method != IndexMethod::kHnsw;
#endif
}

IndexMethod defaultIndexMethod() { return isAvailable(IndexMethod::kHnsw) ? IndexMethod::kHnsw : IndexMethod::kFlann; }

DescriptorIndex::DescriptorIndex(const cv::Mat& descriptors, const IndexSettings& settings)
    : descriptors_(descriptors), settings_(settings) {}

std::vector<std::vector<Neighbor>> DescriptorIndex::search(const cv::Mat& queries, int k) const {
  checkDescriptors(queries, "DescriptorIndex: queries");
  if (k < 1) throw std::invalid_argument("DescriptorIndex: k must be at least 1");
  std::vector<std::vector<Neighbor>> out(queries.rows);
  if (size() > 0 && queries.rows > 0) searchRows(queries, static_cast<int>(std::min<std::size_t>(k, size())), &out);
  return out;
}

void DescriptorIndex::save(const std::string& path) const {
  const std::string data = path + ".data", temporary = path + ".tmp";
  const auto discard = [&] { std::remove(temporary.c_str()); };
  try {
    std::uintmax_t bytes = 0;
    std::uint64_t data_checksum = 0;
    if (size() > 0 && saveData(temporary)) {
      bytes = std::filesystem::file_size(temporary);
      data_checksum = checksum(temporary);
      std::filesystem::rename(temporary, data);
    }
    // The header comes last: without it the data is no index.
    std::ofstream header(temporary);
    header << kMagic << "\nmethod " << toString(settings_.method) << "\ncount " << size() << "\nchecksum "
           << checksum(descriptors_) << "\nbytes " << bytes << "\ndata_checksum " << data_checksum << "\nflann_trees "
           << settings_.flann_trees << "\nhnsw_links " << settings_.hnsw_links << "\nhnsw_construction "
           << settings_.hnsw_construction << "\n";
    header.close();
    if (!header) throw std::runtime_error("the disk may be full, or the folder missing");
    std::filesystem::rename(temporary, path);
  } catch (const std::exception& e) {
    discard();
    throw std::runtime_error("cannot write the descriptor index " + path + ": " + e.what());
  }
}

std::unique_ptr<DescriptorIndex> buildIndex(const cv::Mat& descriptors, const IndexSettings& settings) {
  checkDescriptors(descriptors, "buildIndex: descriptors");
  checkSettings(settings);
  return make(descriptors, settings, "");
}

std::unique_ptr<DescriptorIndex> loadIndex(const std::string& path, const cv::Mat& descriptors,
                                           const IndexSettings& settings) {
  checkDescriptors(descriptors, "loadIndex: descriptors");
  checkSettings(settings);
  const auto fail = [&](const std::string& why) { throw std::runtime_error("descriptor index " + path + ": " + why); };
  std::ifstream header(path);
  if (!header) fail("cannot be opened; build it again");
  std::string line;
  std::getline(header, line);
  if (line != kMagic) fail("is not a descriptor index of this version; build it again");
  std::map<std::string, std::string> fields;
  for (std::string name, value; header >> name >> value;) fields[name] = value;
  IndexSettings stored = settings;
  std::uintmax_t bytes = 0;
  std::uint64_t data_checksum = 0;
  try {
    stored.method = indexMethodFromString(fields.at("method"));
    stored.flann_trees = std::stoi(fields.at("flann_trees"));
    stored.hnsw_links = std::stoi(fields.at("hnsw_links"));
    stored.hnsw_construction = std::stoi(fields.at("hnsw_construction"));
    bytes = std::stoull(fields.at("bytes"));
    data_checksum = std::stoull(fields.at("data_checksum"));
    if (std::stoull(fields.at("count")) != static_cast<unsigned long long>(descriptors.rows) ||
        std::stoull(fields.at("checksum")) != checksum(descriptors))
      fail("belongs to other descriptors; build it again");
  } catch (const std::logic_error&) {  // a missing field, or one that is no number
    fail("its header is damaged; build it again");
  }
  if (buildOf(stored) != buildOf(settings))
    fail("is " + buildOf(stored) + ", not " + buildOf(settings) + "; build it again");
  if (bytes == 0) return make(descriptors, stored, "");
  std::error_code error;
  if (std::filesystem::file_size(path + ".data", error) != bytes || error)
    fail("its data file " + path + ".data is missing or truncated; build it again");
  try {
    if (checksum(path + ".data") != data_checksum) throw std::runtime_error("its bytes have changed");
    return make(descriptors, stored, path + ".data");
  } catch (const std::exception& e) {
    fail(std::string("its data cannot be read (") + e.what() + "); build it again");
  }
  return nullptr;
}

std::unique_ptr<DescriptorIndex> makeBruteForceIndex(const cv::Mat& descriptors, const IndexSettings& settings) {
  return std::make_unique<BruteForceIndex>(descriptors, settings);
}

}  // namespace streetview_localizer
