#include "streetview_localizer/pairwise.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <unordered_map>

#include "distance_kernel.h"

namespace streetview_localizer {
namespace {

constexpr float kSamePoint = 2;  // matches of the same two points up to this are one [px]

/// Nearest view feature of each query feature, with the ratio, and nearest query feature of each view feature.
struct Nearest {
  struct Row {
    int view = -1;  ///< -1: too far
    std::int32_t d2 = 0;
    std::int32_t elsewhere = INT32_MAX;
  };
  std::vector<Row> rows;
  std::vector<std::int32_t> column_owner;
};

void check(const Features& features, const char* name) {
  const cv::Mat& d = features.descriptors;
  if (features.size() == 0) return;
  if (d.type() != CV_8U || d.cols != kDescriptorSize || d.rows != static_cast<int>(features.size()))
    throw std::invalid_argument(std::string("matchPairwise: descriptors of the ") + name +
                                " must be one row of 128 bytes a keypoint");
}

float squaredPixels(const cv::KeyPoint& a, const cv::KeyPoint& b) {
  const float dx = a.pt.x - b.pt.x, dy = a.pt.y - b.pt.y;
  return dx * dx + dy * dy;
}

/// Keeps of equal matches the nearest: of one view feature, and of one pair of points.
std::vector<Match> withoutDuplicates(std::vector<Match> matches, const Features& query, const Features& view) {
  std::sort(matches.begin(), matches.end(), [](const Match& a, const Match& b) {
    return a.distance != b.distance ? a.distance < b.distance : a.query < b.query;
  });
  std::vector<bool> taken(view.size(), false);
  std::unordered_map<std::int64_t, std::vector<Match>> cells;
  const auto cell = [](float x) { return static_cast<std::int64_t>(std::floor(x / kSamePoint)); };
  std::vector<Match> kept;
  for (const Match& m : matches) {
    if (taken[m.view]) continue;
    const cv::KeyPoint& k = query.keypoints[m.query];
    bool known = false;
    for (int dy = -1; dy <= 1 && !known; ++dy)
      for (int dx = -1; dx <= 1 && !known; ++dx) {
        const auto found = cells.find(((cell(k.pt.y) + dy) << 32) + cell(k.pt.x) + dx);
        if (found == cells.end()) continue;
        for (const Match& other : found->second)
          known |= squaredPixels(k, query.keypoints[other.query]) < kSamePoint * kSamePoint &&
                   squaredPixels(view.keypoints[m.view], view.keypoints[other.view]) < kSamePoint * kSamePoint;
      }
    if (known) continue;
    taken[m.view] = true;
    cells[(cell(k.pt.y) << 32) + cell(k.pt.x)].push_back(m);
    kept.push_back(m);
  }
  std::sort(kept.begin(), kept.end(), [](const Match& a, const Match& b) { return a.query < b.query; });
  return kept;
}

std::vector<Match> select(const Nearest& nearest, const Features& query, const Features& view,
                          const PairwiseSettings& settings) {
  std::vector<Match> matches;
  const float r2 = static_cast<float>(settings.place_radius * settings.place_radius);
  for (int i = 0; i < static_cast<int>(query.size()); ++i) {
    const Nearest::Row& row = nearest.rows[i];
    if (row.view < 0) continue;
    Match m;
    m.query = i;
    m.view = row.view;
    m.distance = std::sqrt(static_cast<float>(row.d2));
    m.ratio = row.elsewhere == INT32_MAX ? 0.f
              : row.elsewhere == 0       ? 1.f
                                         : m.distance / std::sqrt(static_cast<float>(row.elsewhere));
    if (m.ratio > settings.max_ratio) continue;
    const int owner = nearest.column_owner[row.view];
    if (settings.mutual && owner != i && squaredPixels(query.keypoints[i], query.keypoints[owner]) > r2) continue;
    matches.push_back(m);
  }
  return withoutDuplicates(std::move(matches), query, view);
}

Nearest emptyNearest(const Features& query, const Features& view) {
  Nearest nearest;
  nearest.rows.resize(query.size());
  nearest.column_owner.assign(view.size(), -1);
  return nearest;
}

}  // namespace

std::vector<Match> matchPairwise(const Features& query, const Features& view, const PairwiseSettings& settings) {
  check(query, "query");
  check(view, "view");
  if (query.size() == 0 || view.size() == 0) return {};
  const int rows = static_cast<int>(query.size()), columns = static_cast<int>(view.size());
  const PackedDescriptors packed =
      packDescriptors(view.descriptors.ptr<std::uint8_t>(), columns, view.descriptors.step[0]);
  const int padded = packed.blocks * kLanes;
  std::vector<float> x(padded, 0.f), y(padded, 0.f);
  for (int j = 0; j < columns; ++j) {
    x[j] = view.keypoints[j].pt.x;
    y[j] = view.keypoints[j].pt.y;
  }
  Nearest nearest = emptyNearest(query, view);
  std::vector<std::int32_t> column_best(padded, INT32_MAX);
  const float r2 = static_cast<float>(settings.place_radius * settings.place_radius);
  const auto limit = static_cast<std::int32_t>(settings.max_distance * settings.max_distance);
  const double ratio2 = settings.max_ratio * settings.max_ratio * (1 + 1e-4);  // clear of rounding

#pragma omp parallel
  {
    std::vector<std::int32_t> distances(4 * static_cast<std::size_t>(padded)), best(padded, INT32_MAX),
        owner(padded, -1);
#pragma omp for schedule(static)
    for (int group = 0; group < (rows + 3) / 4; ++group) {
      const int first = std::max(0, std::min(4 * group, rows - 4));  // the last four overlap those before
      std::vector<std::uint8_t> few;
      const std::uint8_t* start = query.descriptors.ptr<std::uint8_t>(first);
      std::size_t stride = query.descriptors.step[0];
      if (rows < 4) {
        few.assign(4 * kDescriptorSize, 0);
        for (int q = 0; q < rows; ++q)
          std::copy_n(query.descriptors.ptr<std::uint8_t>(q), kDescriptorSize, few.data() + q * kDescriptorSize);
        start = few.data();
        stride = kDescriptorSize;
      }
      distancesOfFour(start, stride, packed, distances.data());
      for (int i = 4 * group; i < std::min(4 * group + 4, rows); ++i) {
        const std::int32_t* d = distances.data() + static_cast<std::size_t>(i - first) * padded;
        lowerColumns(d, padded, i, best.data(), owner.data());
        std::int32_t least;
        int j;
        minimumOf(d, columns, &least, &j);
        if (least > limit) continue;
        // Most features fail the ratio test: no need to know by how much.
        const auto enough = static_cast<std::int32_t>(std::min(2e9, least / ratio2));
        nearest.rows[i] = {j, least, minimumElsewhere(d, x.data(), y.data(), columns, x[j], y[j], r2, enough)};
      }
    }
    // Ties go to the lower index, whichever thread comes first.
#pragma omp critical
    for (int j = 0; j < columns; ++j)
      if (owner[j] >= 0 &&
          (best[j] < column_best[j] || (best[j] == column_best[j] && owner[j] < nearest.column_owner[j]))) {
        column_best[j] = best[j];
        nearest.column_owner[j] = owner[j];
      }
  }
  return select(nearest, query, view, settings);
}

std::vector<Match> matchPairwiseReference(const Features& query, const Features& view,
                                          const PairwiseSettings& settings) {
  check(query, "query");
  check(view, "view");
  if (query.size() == 0 || view.size() == 0) return {};
  Nearest nearest = emptyNearest(query, view);
  std::vector<std::int32_t> column_best(view.size(), INT32_MAX), d(view.size());
  for (int i = 0; i < static_cast<int>(query.size()); ++i) {
    Nearest::Row best;
    best.d2 = INT32_MAX;
    for (int j = 0; j < static_cast<int>(view.size()); ++j) {
      d[j] = 0;
      for (int e = 0; e < kDescriptorSize; ++e) {
        const int difference = query.descriptors.at<std::uint8_t>(i, e) - view.descriptors.at<std::uint8_t>(j, e);
        d[j] += difference * difference;
      }
      if (d[j] < best.d2) {
        best.d2 = d[j];
        best.view = j;
      }
      if (d[j] < column_best[j]) {
        column_best[j] = d[j];
        nearest.column_owner[j] = i;
      }
    }
    if (best.d2 > settings.max_distance * settings.max_distance) continue;
    for (int j = 0; j < static_cast<int>(view.size()); ++j)
      if (squaredPixels(view.keypoints[j], view.keypoints[best.view]) > settings.place_radius * settings.place_radius)
        best.elsewhere = std::min(best.elsewhere, d[j]);
    nearest.rows[i] = best;
  }
  return select(nearest, query, view, settings);
}

}  // namespace streetview_localizer
