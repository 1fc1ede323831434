#include "streetview_localizer/neighbour_check.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "relative_pose.h"
#include "streetview_localizer/plane_index.h"
#include "streetview_localizer/recent_cache.h"

namespace streetview_localizer {
namespace {

using air_ground_common::Pose;

using Shared = std::shared_ptr<const BearingFeatures>;
constexpr std::size_t kKeptBytes = std::size_t{256} << 20;  // of features in memory
std::size_t bytesOfShared(const Shared& features) { return bytesOf(*features); }

/// Pairs (a < b) of images that are among each other's nearest, by their first image.
std::vector<std::vector<int>> pairsOf(const std::vector<NeighbourImage>& images, const NeighbourSettings& s) {
  std::vector<std::pair<Eigen::Vector2d, int>> places;
  for (std::size_t i = 0; i < images.size(); ++i)
    places.emplace_back(images[i].T_world_image.translation().head<2>(), static_cast<int>(i));
  const PlaneIndex index(places);
  std::vector<std::vector<int>> pairs(images.size());
  for (int i = 0; i < static_cast<int>(images.size()); ++i) {
    std::vector<std::pair<double, int>> near;
    for (const int j : index.inSquare(places[i].first, s.max_distance)) {
      const double distance = (places[j].first - places[i].first).norm();
      const bool of_use = (images[i].registered || images[j].registered) && !(images[i].fixed && images[j].fixed);
      if (j != i && distance <= s.max_distance && of_use) near.emplace_back(distance, j);
    }
    std::sort(near.begin(), near.end());
    if (static_cast<int>(near.size()) > s.count) near.resize(s.count);
    for (const auto& [distance, j] : near) pairs[std::min(i, j)].push_back(std::max(i, j));
  }
  for (auto& list : pairs) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }
  return pairs;
}

/// Street by street, so that few images are looked at twice.
std::vector<int> orderOf(const std::vector<NeighbourImage>& images) {
  constexpr double kCell = 100;  // [m]
  std::vector<std::pair<std::pair<long, long>, int>> cells;
  for (std::size_t i = 0; i < images.size(); ++i) {
    const Eigen::Vector3d place = images[i].T_world_image.translation() / kCell;
    cells.push_back({{std::lround(place.x()), std::lround(place.y())}, static_cast<int>(i)});
  }
  std::sort(cells.begin(), cells.end());
  std::vector<int> order;
  for (const auto& [cell, i] : cells) order.push_back(i);
  return order;
}

Shared featuresOf(const NeighbourImage& image, const NeighbourSettings& s) {
  try {
    const cv::Mat bgr = image.load();
    if (bgr.empty()) return std::make_shared<BearingFeatures>();
    return std::make_shared<BearingFeatures>(image.camera ? bearingFeaturesOf(bgr, *image.camera, s.views, s.features)
                                                          : bearingFeaturesOf(bgr, s.views, s.features));
  } catch (const std::exception&) {  // the build says what is wrong with it
    return std::make_shared<BearingFeatures>();
  }
}

/// Of both ways to measure it that with which more matches agree: from a wrong place some rays meet the wrong house.
std::optional<NeighbourEdge> measure(const std::vector<NeighbourImage>& images, int a, int b,
                                     const BearingFeatures& of_a, const BearingFeatures& of_b,
                                     const BackProjector& projector) {
  std::vector<Match> matches = matchBearings(of_a, of_b);
  std::optional<RelativePose> best;
  if (images[a].registered) best = measureRelativePose(of_a, images[a].T_world_image, of_b, matches, projector);
  for (Match& m : matches) std::swap(m.query, m.view);
  if (images[b].registered)
    if (const auto back = measureRelativePose(of_b, images[b].T_world_image, of_a, matches, projector))
      if (!best || back->inliers > best->inliers) best = inverted(*back);
  if (!best) return std::nullopt;
  return NeighbourEdge{a, b, best->T_a_b, best->covariance};
}

}  // namespace

std::vector<NeighbourEdge> measureNeighbours(const std::vector<NeighbourImage>& images, const BackProjector& projector,
                                             const NeighbourSettings& settings, int threads,
                                             const std::function<void(int, int)>& progress) {
  const std::vector<std::vector<int>> pairs = pairsOf(images, settings);
  const std::vector<int> order = orderOf(images);
  RecentCache<Shared> cache(kKeptBytes, bytesOfShared);
  const auto features = [&](int i) { return cache.get(i, [&] { return featuresOf(images[i], settings); }); };
  std::vector<std::vector<NeighbourEdge>> edges_of(images.size());
  int done = 0;
  const int count = static_cast<int>(order.size());
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (int k = 0; k < count; ++k) {
    const int a = order[k];
    for (const int b : pairs[a])
      if (const auto edge = measure(images, a, b, *features(a), *features(b), projector)) edges_of[a].push_back(*edge);
#pragma omp critical(neighbour_progress)
    if (progress) progress(++done, count);
  }
  std::vector<NeighbourEdge> edges;
  for (const auto& list : edges_of) edges.insert(edges.end(), list.begin(), list.end());
  return edges;
}

}  // namespace streetview_localizer
