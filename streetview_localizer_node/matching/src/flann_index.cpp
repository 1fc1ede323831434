// Randomised kd-trees of the FLANN library (Muja and Lowe, PAMI 2014) on the bytes themselves.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include <flann/algorithms/kdtree_index.h>

#include "distance_kernel.h"
#include "index_backends.h"

namespace streetview_localizer {
namespace {

/// FLANN's L2, with the vectorised distance.
struct ByteDistance {
  using is_kdtree_distance = bool;
  using ElementType = unsigned char;
  using ResultType = float;

  template <typename Iterator>
  ResultType operator()(Iterator a, const unsigned char* b, std::size_t size, ResultType = -1) const {
    if (size == static_cast<std::size_t>(kDescriptorSize)) return static_cast<float>(distance(&a[0], b));
    ResultType sum = 0;
    for (std::size_t i = 0; i < size; ++i) sum += accum_dist(a[i], b[i], 0);
    return sum;
  }
  template <typename U, typename V>
  ResultType accum_dist(const U& a, const V& b, int) const {
    const float d = static_cast<float>(a) - static_cast<float>(b);
    return d * d;
  }

 private:
  static std::int32_t distance(const unsigned char* a, const unsigned char* b) { return squaredDistance(a, b); }
  static std::int32_t distance(const float* a, const unsigned char* b) {
    float sum = 0;
    for (int i = 0; i < kDescriptorSize; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
    return static_cast<std::int32_t>(sum);
  }
};

class FlannIndex : public DescriptorIndex {
 public:
  FlannIndex(const cv::Mat& descriptors, const IndexSettings& settings, const std::string& data_path)
      : DescriptorIndex(descriptors, settings),
        index_(flann::Matrix<unsigned char>(descriptors_.data, descriptors_.rows, kDescriptorSize),
               flann::KDTreeIndexParams(settings.flann_trees)) {
    if (descriptors_.rows == 0) return;
    if (data_path.empty()) {
      index_.buildIndex();
      return;
    }
    std::FILE* file = std::fopen(data_path.c_str(), "rb");
    if (!file) throw std::runtime_error("cannot be opened");
    try {
      index_.loadIndex(file);
    } catch (...) {
      std::fclose(file);
      throw;
    }
    std::fclose(file);
    if (index_.size() != static_cast<std::size_t>(descriptors_.rows)) throw std::runtime_error("wrong size");
  }

 private:
  void searchRows(const cv::Mat& queries, int k, std::vector<std::vector<Neighbor>>* out) const override {
    const flann::SearchParams parameters(settings_.flann_checks);
#pragma omp parallel
    {
      std::vector<std::size_t> ids(k);
      std::vector<float> distances(k);
      std::vector<std::pair<float, std::int32_t>> found;
#pragma omp for schedule(dynamic, 16)
      for (int i = 0; i < queries.rows; ++i) {
        const flann::Matrix<unsigned char> row(const_cast<unsigned char*>(queries.ptr<unsigned char>(i)), 1,
                                               kDescriptorSize);
        flann::Matrix<std::size_t> id_matrix(ids.data(), 1, k);
        flann::Matrix<float> distance_matrix(distances.data(), 1, k);
        const int count = index_.knnSearch(row, id_matrix, distance_matrix, k, parameters);
        found.clear();
        for (int j = 0; j < count; ++j) found.emplace_back(distances[j], static_cast<std::int32_t>(ids[j]));
        std::sort(found.begin(), found.end());
        for (const auto& [d2, id] : found) (*out)[i].push_back({id, std::sqrt(d2)});
      }
    }
  }

  bool saveData(const std::string& path) const override {
    std::FILE* file = std::fopen(path.c_str(), "wb");
    if (!file) throw std::runtime_error("cannot be opened for writing");
    const_cast<flann::KDTreeIndex<ByteDistance>&>(index_).saveIndex(file);  // writes only, yet not const in FLANN
    const bool failed = std::ferror(file) != 0;
    if (std::fclose(file) != 0 || failed) throw std::runtime_error("the disk may be full");
    return true;
  }

  flann::KDTreeIndex<ByteDistance> index_;
};

}  // namespace

std::unique_ptr<DescriptorIndex> makeFlannIndex(const cv::Mat& descriptors, const IndexSettings& settings,
                                                const std::string& data_path) {
  return std::make_unique<FlannIndex>(descriptors, settings, data_path);
}

}  // namespace streetview_localizer
