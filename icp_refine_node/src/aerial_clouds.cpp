#include "icp_refine/aerial_clouds.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <vector>

#include "icp_refine/data_filters.h"

namespace icp_refine {

void AerialClouds::add(std::int64_t stamp, Cloud cloud) {
  removeInvalid(cloud);
  YAML::Node leaf;
  leaf["leaf"] = leaf_;
  makeDataFilter("VoxelGrid", leaf)->apply(cloud);
  if (cloud.empty()) return;
  clouds_.emplace_back(stamp, std::move(cloud));
  if (clouds_.size() > std::max(air_ground_common::kFollowedClouds, in_row_)) clouds_.pop_front();
}

Similarity AerialClouds::correct(const air_ground_common::CloudCorrections& corrections) {
  Similarity newest;
  air_ground_common::correctClouds(corrections, &clouds_, [&](const Similarity& S, Cloud* cloud) {
    *cloud = transformed(*cloud, S);
    removeInvalid(*cloud);
    newest = S;
  });
  return newest;
}

AerialClouds::Reading AerialClouds::readingFrom(std::size_t first) const {
  Reading out;
  for (std::size_t i = first; i < std::min(first + in_row_, clouds_.size()); ++i) {
    const auto& [stamp, cloud] = clouds_[i];
    out.stamp = stamp;
    out.cloud.points.insert(out.cloud.points.end(), cloud.points.begin(), cloud.points.end());
  }
  return out;
}

AerialClouds::Reading AerialClouds::newest() const {
  return readingFrom(clouds_.size() - std::min(in_row_, clouds_.size()));
}

AerialClouds::Reading AerialClouds::on(const GroundHeights& ground, const Similarity& T) const {
  constexpr std::size_t kSamples = 200;  // of a cloud
  constexpr double kBeside = 0.1;        // least share of the newest clouds that lies on the ground map
  if (clouds_.size() <= in_row_) return newest();
  Cloud samples;
  std::vector<std::size_t> ends;
  for (const auto& [stamp, cloud] : clouds_) {
    const std::size_t step = std::max<std::size_t>(1, cloud.size() / kSamples);
    for (std::size_t i = 0; i < cloud.size(); i += step) samples.points.push_back(cloud.points[i]);
    ends.push_back(samples.size());
  }
  const std::vector<char> near = ground.near(transformed(samples, T));
  std::vector<double> share;
  for (std::size_t k = 0, begin = 0; k < ends.size(); begin = ends[k++]) {
    const auto count = std::count(near.begin() + static_cast<std::ptrdiff_t>(begin),
                                  near.begin() + static_cast<std::ptrdiff_t>(ends[k]), 1);
    share.push_back(static_cast<double>(count) / static_cast<double>(std::max<std::size_t>(1, ends[k] - begin)));
  }
  const auto inRow = [&](std::size_t first) {
    double sum = 0;
    for (std::size_t k = first; k < first + in_row_; ++k) sum += share[k];
    return sum / static_cast<double>(in_row_);
  };
  const std::size_t last = clouds_.size() - in_row_;
  if (inRow(last) >= kBeside) return readingFrom(last);
  std::size_t best = last;
  for (std::size_t first = last; first-- > 0;)
    if (inRow(first) > inRow(best)) best = first;
  return readingFrom(best);
}

}  // namespace icp_refine
