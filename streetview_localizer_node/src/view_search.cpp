#include "view_search.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "air_ground_common/text.h"
#include "step_times.h"

namespace streetview_localizer {
namespace {

// Indices of the `count` features of strongest response (0: all), ascending.
std::vector<int> strongest(const Features& query, int count) {
  std::vector<int> indices(query.size());
  std::iota(indices.begin(), indices.end(), 0);
  if (count == 0 || static_cast<int>(indices.size()) <= count) return indices;
  std::stable_sort(indices.begin(), indices.end(), [&](int a, int b) {
    return query.keypoints[static_cast<std::size_t>(a)].response >
           query.keypoints[static_cast<std::size_t>(b)].response;
  });
  indices.resize(static_cast<std::size_t>(count));
  std::sort(indices.begin(), indices.end());
  return indices;
}

cv::Mat rowsOf(const cv::Mat& all, const std::vector<int>& indices) {
  cv::Mat rows(static_cast<int>(indices.size()), all.cols, all.type());
  for (std::size_t i = 0; i < indices.size(); ++i) all.row(indices[i]).copyTo(rows.row(static_cast<int>(i)));
  return rows;
}

}  // namespace

Features strongestFeatures(const Features& features, int count) {
  const std::vector<int> indices = strongest(features, count);
  Features out;
  out.descriptors = rowsOf(features.descriptors, indices);
  for (const int i : indices) out.keypoints.push_back(features.keypoints[static_cast<std::size_t>(i)]);
  return out;
}

// In a keypoint's own frame, x along its direction, mirroring turns y about: rows of the descriptor's 4 x 4 grid are
// reversed, directions change sign.
Features mirroredFeatures(Features features) {
  const cv::Mat from = features.descriptors;
  features.descriptors = cv::Mat(from.size(), from.type());
  for (int i = 0; i < from.rows; ++i) {
    const auto* in = from.ptr<uchar>(i);
    auto* out = features.descriptors.ptr<uchar>(i);
    for (int row = 0; row < 4; ++row)
      for (int col = 0; col < 4; ++col)
        for (int bin = 0; bin < 8; ++bin)
          out[(row * 4 + col) * 8 + bin] = in[((3 - row) * 4 + col) * 8 + (8 - bin) % 8];
  }
  return features;
}

ViewSearch::ViewSearch(const StreetviewDatabase& database, const StreetviewLocalizerSettings& settings)
    : database_(database), settings_(settings) {
  std::vector<cv::Mat> parts;
  for (std::size_t i = 0; i < database_.views.size(); ++i) {
    const Features& features = database_.views[i].features;
    if (features.size() == 0) continue;
    parts.push_back(features.descriptors);
    view_of_row_.insert(view_of_row_.end(), features.size(), static_cast<int>(i));
  }
  cv::vconcat(parts, descriptors_);
  prepareIndex();
}

void ViewSearch::prepareIndex() {
  const std::string name =
      toString(settings_.index.method) + " index over " + std::to_string(descriptors_.rows) + " descriptors";
  std::string why;
  if (std::filesystem::exists(settings_.index_file)) {
    try {
      index_ = loadIndex(settings_.index_file, descriptors_, settings_.index);
      index_remark_ = name + " read from " + settings_.index_file;
      return;
    } catch (const std::runtime_error& e) {
      why = std::string(" (") + e.what() + ")";
    }
  }
  const auto start = StepTimes::Clock::now();
  index_ = buildIndex(descriptors_, settings_.index);
  index_remark_ = name + air_ground_common::formatted(" built in %.1f s", StepTimes::secondsSince(start)) + why;
  if (settings_.index_file.empty()) return;
  try {
    index_->save(settings_.index_file);
    index_remark_ += ", kept in " + settings_.index_file;
  } catch (const std::runtime_error& e) {
    index_remark_ += std::string(", not kept: ") + e.what();
  }
}

std::vector<int> ViewSearch::byPrior(const CameraModel& camera, const PosePrior& prior, int max_views) const {
  const Pose& T = *prior.T_world_camera;
  const Pose T_camera_world = T.inverse();
  // Two standard deviations of the attitude, and of the position seen at 10 m.
  const double position_stddev = std::sqrt(prior.covariance.topLeftCorner<3, 3>().diagonal().maxCoeff());
  const double angle =
      2 * std::sqrt(prior.covariance.bottomRightCorner<3, 3>().diagonal().maxCoeff()) + 0.2 * position_stddev;
  const double half = std::min(std::atan(0.5 * std::hypot(camera.width, camera.height) / camera.fx) + angle, M_PI);
  const double min_cosine = std::cos(half);
  std::vector<std::pair<int, int>> ranked;
  // Photographs look one way each, and some have no views at all: only what shows something takes a place. No pose is
  // accepted from farther away.
  int shown = 0;
  for (const int p : database_.near(T.translation(), settings_.acceptance.max_range + 3 * position_stddev)) {
    if (shown == settings_.near_panoramas) break;
    const std::size_t before = ranked.size();
    for (const int v : database_.viewsOf(p)) {
      const View& candidate = database_.views[static_cast<std::size_t>(v)];
      int seen = 0;
      for (std::size_t i = 0; i < candidate.points.size(); ++i) {
        const Eigen::Vector3d point = candidate.points[i].cast<double>();
        const Eigen::Vector3d in_camera = T_camera_world * point;
        seen += in_camera.z() > min_cosine * in_camera.norm() &&
                candidate.normals[i].cast<double>().dot(T.translation() - point) > 0;
      }
      if (seen >= settings_.min_view_matches) ranked.emplace_back(-seen, v);
    }
    shown += ranked.size() > before;
  }
  std::sort(ranked.begin(), ranked.end());
  std::vector<int> views;
  for (std::size_t i = 0; i < ranked.size() && i < static_cast<std::size_t>(max_views); ++i)
    views.push_back(ranked[i].second);
  return views;
}

FoundDescriptors ViewSearch::nearest(const Features& query) const {
  FoundDescriptors found;
  found.queried = strongest(query, settings_.search_features);
  found.neighbors =
      index_->search(rowsOf(query.descriptors, found.queried), std::min(settings_.neighbors, descriptors_.rows));
  return found;
}

std::vector<int> ViewSearch::votedBy(const FoundDescriptors& found, const Features& query, int max_views) const {
  VotingSettings voting = settings_.voting;
  voting.best = max_views;
  std::vector<int> views;
  for (const Vote& vote : voteForPlaces(found.neighbors, found.queried, query.keypoints, view_of_row_,
                                        static_cast<int>(database_.views.size()), voting))
    views.push_back(vote.place);
  return views;
}

std::vector<int> ViewSearch::byMirrorImage(const Features& mirrored, int max_views) const {
  FoundDescriptors found;
  found.queried.resize(mirrored.size());
  std::iota(found.queried.begin(), found.queried.end(), 0);
  found.neighbors = index_->search(mirrored.descriptors, std::min(settings_.neighbors, descriptors_.rows));
  return votedBy(found, mirrored, max_views);
}

}  // namespace streetview_localizer
