// Step 2 of the matching: nearest neighbours of byte descriptors in the whole database.
#pragma once

#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "streetview_localizer/voting.h"

namespace streetview_localizer {

enum class IndexMethod {
  kBruteForce,  ///< exact, linear in the database
  kFlann,       ///< forest of randomised kd-trees, as in the paper
  kHnsw,        ///< navigable small-world graph (Malkov and Yashunin, PAMI 2020): the fastest at equal recall
};

std::string toString(IndexMethod method);
/// "brute_force", "flann" or "hnsw". Throws std::invalid_argument for another name.
IndexMethod indexMethodFromString(const std::string& name);
/// False for kHnsw in a build without hnswlib.
bool isAvailable(IndexMethod method);
/// kHnsw where available, else kFlann.
IndexMethod defaultIndexMethod();

struct IndexSettings {
  IndexMethod method = defaultIndexMethod();
  int flann_trees = 4;
  int flann_checks = 512;       ///< leaves visited a query: more is slower and finds more
  int hnsw_links = 16;          ///< of a node (M)
  int hnsw_construction = 100;  ///< candidates kept while building
  int hnsw_search = 48;         ///< candidates kept while searching, at least k: more is slower and finds more
  int build_threads = 1;        ///< of HNSW; with more than 1 (0: all) the graph depends on their timing
};

/// An index over descriptors (n x 128, CV_8U); row i has the id i. Searching is deterministic, in OpenMP threads, and
/// may be done by several callers at once. Building is deterministic but for FLANN's, whose trees draw on
/// std::random_device.
class DescriptorIndex {
 public:
  virtual ~DescriptorIndex() = default;

  /// The k nearest found of each row of `queries` (n x 128, CV_8U), ascending in distance, equal ones by id; fewer when
  /// the index holds fewer. Throws std::invalid_argument for another type or k < 1.
  std::vector<std::vector<Neighbor>> search(const cv::Mat& queries, int k) const;

  /// Writes `path` and, where the method has data of its own, `path`.data; each to a temporary file first. The
  /// descriptors are not written. Throws std::runtime_error when it cannot.
  void save(const std::string& path) const;

  std::size_t size() const { return static_cast<std::size_t>(descriptors_.rows); }
  const IndexSettings& settings() const { return settings_; }

 protected:
  DescriptorIndex(const cv::Mat& descriptors, const IndexSettings& settings);
  virtual void searchRows(const cv::Mat& queries, int k, std::vector<std::vector<Neighbor>>* out) const = 0;
  /// False when there is nothing to write.
  virtual bool saveData(const std::string& path) const = 0;

  cv::Mat descriptors_;  // continuous
  IndexSettings settings_;
};

/// Throws std::invalid_argument when the descriptors are not n x 128, CV_8U, a setting is out of range, or the method
/// is not available. `descriptors` must not change while the index lives.
std::unique_ptr<DescriptorIndex> buildIndex(const cv::Mat& descriptors, const IndexSettings& settings = {});

/// An index that was saved for the same descriptors, by the same method with the same build parameters (flann_trees;
/// hnsw_links and hnsw_construction). Throws std::runtime_error, saying why, when a file is missing, damaged, belongs
/// to other descriptors or was built otherwise; std::invalid_argument as buildIndex.
std::unique_ptr<DescriptorIndex> loadIndex(const std::string& path, const cv::Mat& descriptors,
                                           const IndexSettings& settings = {});

}  // namespace streetview_localizer
