// Gradients of the views' images, which k-VLD needs: costly to make, too large to keep them all.
#pragma once

#include <list>
#include <memory>
#include <mutex>
#include <utility>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

/// Thread-safe. Keeps those asked for last.
class PyramidCache {
 public:
  /// The database must outlive it.
  explicit PyramidCache(const StreetviewDatabase& database) : database_(database) {}

  std::shared_ptr<const GradientPyramid> of(int view) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      for (auto it = pyramids_.begin(); it != pyramids_.end(); ++it) {
        if (it->first != view) continue;
        pyramids_.splice(pyramids_.begin(), pyramids_, it);
        return it->second;
      }
    }
    auto made = std::make_shared<const GradientPyramid>(database_.views[static_cast<std::size_t>(view)].image);
    const std::lock_guard<std::mutex> lock(mutex_);
    pyramids_.emplace_front(view, made);
    bytes_ += made->bytes();
    while (bytes_ > kMostBytes && pyramids_.size() > 1) {
      bytes_ -= pyramids_.back().second->bytes();
      pyramids_.pop_back();
    }
    return made;
  }

 private:
  static constexpr std::size_t kMostBytes = std::size_t{256} << 20;

  const StreetviewDatabase& database_;
  std::mutex mutex_;
  std::list<std::pair<int, std::shared_ptr<const GradientPyramid>>> pyramids_;  // the most recent first
  std::size_t bytes_ = 0;
};

}  // namespace streetview_localizer
