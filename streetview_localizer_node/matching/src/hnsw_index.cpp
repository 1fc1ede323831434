// Hierarchical navigable small worlds of hnswlib, with the distance of bytes in vector instructions (hnswlib's own is
// scalar).
#include <stdexcept>

#include "index_backends.h"

#ifdef AIR_GROUND_HNSWLIB
#include <hnswlib/hnswlib.h>
#include <omp.h>

#include <algorithm>
#include <cmath>

#include "distance_kernel.h"
#endif

namespace streetview_localizer {

#ifdef AIR_GROUND_HNSWLIB

namespace {

class ByteSpace : public hnswlib::SpaceInterface<int> {
 public:
  std::size_t get_data_size() override { return kDescriptorSize; }
  hnswlib::DISTFUNC<int> get_dist_func() override { return distance; }
  void* get_dist_func_param() override { return nullptr; }

 private:
  static int distance(const void* a, const void* b, const void*) {
    return squaredDistance(static_cast<const std::uint8_t*>(a), static_cast<const std::uint8_t*>(b));
  }
};

class HnswIndex : public DescriptorIndex {
 public:
  HnswIndex(const cv::Mat& descriptors, const IndexSettings& settings, const std::string& data_path)
      : DescriptorIndex(descriptors, settings) {
    const std::size_t count = std::max(1, descriptors.rows);
    if (!data_path.empty()) {
      graph_ = std::make_unique<Graph>(&space_, data_path, false, count);
      if (graph_->cur_element_count != size()) throw std::runtime_error("wrong size");
    } else {
      graph_ = std::make_unique<Graph>(&space_, count, settings.hnsw_links, settings.hnsw_construction, kSeed);
      build();
    }
    graph_->setEf(settings.hnsw_search);
  }

 private:
  using Graph = hnswlib::HierarchicalNSW<int>;
  static constexpr std::size_t kSeed = 1;

  void build() {
    if (descriptors_.rows == 0) return;
    graph_->addPoint(descriptors_.ptr(0), 0);
    const int threads = settings_.build_threads > 0 ? settings_.build_threads : omp_get_max_threads();
#pragma omp parallel for schedule(dynamic, 64) num_threads(threads)
    for (int i = 1; i < descriptors_.rows; ++i) graph_->addPoint(descriptors_.ptr(i), i);
  }

  void searchRows(const cv::Mat& queries, int k, std::vector<std::vector<Neighbor>>* out) const override {
#pragma omp parallel for schedule(dynamic, 16)
    for (int i = 0; i < queries.rows; ++i) {
      auto found = graph_->searchKnn(queries.ptr(i), k);
      std::vector<Neighbor>& list = (*out)[i];
      list.resize(found.size());
      for (std::size_t j = found.size(); j-- > 0; found.pop())  // farthest first
        list[j] = {static_cast<std::int32_t>(found.top().second), std::sqrt(static_cast<float>(found.top().first))};
    }
  }

  bool saveData(const std::string& path) const override {
    graph_->saveIndex(path);
    return true;
  }

  mutable ByteSpace space_;
  std::unique_ptr<Graph> graph_;
};

}  // namespace

std::unique_ptr<DescriptorIndex> makeHnswIndex(const cv::Mat& descriptors, const IndexSettings& settings,
                                               const std::string& data_path) {
  return std::make_unique<HnswIndex>(descriptors, settings, data_path);
}

#else

std::unique_ptr<DescriptorIndex> makeHnswIndex(const cv::Mat&, const IndexSettings&, const std::string&) {
  throw std::invalid_argument("built without hnswlib; use flann");
}

#endif

}  // namespace streetview_localizer
