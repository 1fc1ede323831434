#include "depth_carrier.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "rgbd_slam/depth_model.h"

namespace rgbd_slam {

using air_ground_common::Pose;

namespace {

constexpr int kCell = 16;              // between nodes of the grid [px]
constexpr float kLeastShift = 0.5f;    // smaller ones matter less than where a feature is [px]
constexpr float kSameSurface = 0.05f;  // of neighbouring depths, relative: between others there is an edge
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

/// 0, kCell ... and the last pixel.
std::vector<int> nodesAlong(int pixels) {
  std::vector<int> nodes;
  for (int i = 0; i < pixels - 1; i += kCell) nodes.push_back(i);
  nodes.push_back(pixels - 1);
  return nodes;
}

/// Depth at a place of the image: between four pixels of one surface linear, so that a slanted one does not become
/// stairs, else that of the nearest pixel. Not positive or not finite: unknown.
float depthAt(const cv::Mat& depth, float x, float y) {
  if (!(x >= 0 && y >= 0 && x <= static_cast<float>(depth.cols - 1) && y <= static_cast<float>(depth.rows - 1)))
    return kNaN;
  const int u = std::min(static_cast<int>(x), depth.cols - 2), v = std::min(static_cast<int>(y), depth.rows - 2);
  const float *upper = depth.ptr<float>(v) + u, *lower = depth.ptr<float>(v + 1) + u;
  const float a = upper[0], b = upper[1], c = lower[0], d = lower[1];
  const float right = x - static_cast<float>(u), down = y - static_cast<float>(v);
  const float least = std::min(std::min(a, b), std::min(c, d)), most = std::max(std::max(a, b), std::max(c, d));
  // Sums and products with NaN are NaN, comparisons false.
  if (least > 0 && most - least < kSameSurface * least && std::isfinite(a + b + c + d))
    return (1 - down) * (a + right * (b - a)) + down * (c + right * (d - c));
  return (down < 0.5f ? upper : lower)[right < 0.5f ? 0 : 1];
}

}  // namespace

void DepthCarrier::makeGrid() {
  columns_ = nodesAlong(camera_.width);
  rows_ = nodesAlong(camera_.height);
  for (const int v : rows_)
    for (const int u : columns_) rays_.push_back(camera_.unproject(Eigen::Vector2d(u, v)));
}

std::vector<DepthCarrier::Node> DepthCarrier::displacements(const Pose& T_image_depth) const {
  const Pose T_depth_image = T_image_depth.inverse();
  std::vector<Node> nodes;
  for (std::size_t i = 0; i < rays_.size(); ++i) {
    const Eigen::Vector2d pixel(columns_[i % columns_.size()], rows_[i / columns_.size()]);
    const Eigen::Vector3d far = T_depth_image.linear() * rays_[i].homogeneous(),
                          near = far + T_depth_image.translation();
    const auto at_far = camera_.project(far), at_near = camera_.project(near);
    if (at_far && at_near) {
      const Eigen::Vector2f by_turn = (*at_far - pixel).cast<float>(), by_way = (*at_near - *at_far).cast<float>();
      nodes.push_back({by_turn.x(), by_turn.y(), by_way.x(), by_way.y(), static_cast<float>(1 / far.z())});
    } else {
      nodes.push_back({kNaN, kNaN, kNaN, kNaN, kNaN});
    }
  }
  return nodes;
}

cv::Mat DepthCarrier::carry(const cv::Mat& depth, const Pose& T_image_depth) {
  const float middle = static_cast<float>(medianDepth(depth));
  if (!(middle > 0) || depth.cols < 2 || depth.rows < 2) return depth;
  if (rays_.empty()) makeGrid();
  const std::vector<Node> nodes = displacements(T_image_depth);
  float shift = 0;             // at the middle distance [px]
  for (const Node& n : nodes)  // NaN is never more
    shift = std::max(shift, std::hypot(n.far_x + n.near_x / middle, n.far_y + n.near_y / middle));
  if (!(shift >= kLeastShift)) return depth;
  const float offset = static_cast<float>(-T_image_depth.inverse().translation().z());
  cv::Mat carried(depth.size(), CV_32F);
  std::vector<Node> row(columns_.size());
  for (std::size_t r = 0; r + 1 < rows_.size(); ++r) {
    const int last = r + 2 < rows_.size() ? rows_[r + 1] - 1 : rows_[r + 1];
    for (int v = rows_[r]; v <= last; ++v) {
      const float share = static_cast<float>(v - rows_[r]) / static_cast<float>(rows_[r + 1] - rows_[r]);
      for (std::size_t c = 0; c < row.size(); ++c) {
        const Node &a = nodes[r * row.size() + c], &b = nodes[(r + 1) * row.size() + c];
        const auto between = [share](float p, float q) { return p + share * (q - p); };
        row[c] = {between(a.far_x, b.far_x), between(a.far_y, b.far_y), between(a.near_x, b.near_x),
                  between(a.near_y, b.near_y), between(a.scale, b.scale)};
      }
      carryRow(depth, v, row, offset, carried.ptr<float>(v));
    }
  }
  return carried;
}

void DepthCarrier::carryRow(const cv::Mat& depth, int v, const std::vector<Node>& row, float offset, float* out) const {
  constexpr int kRounds = 3;
  const float* here = depth.ptr<float>(v);
  float inverse = 0;  // depth, as far as known; where nothing is known here, that of the pixel before [1/m]
  for (std::size_t c = 0; c + 1 < row.size(); ++c) {
    const Node &a = row[c], &b = row[c + 1];
    const float step = 1 / static_cast<float>(columns_[c + 1] - columns_[c]);
    const int last = c + 2 < row.size() ? columns_[c + 1] - 1 : columns_[c + 1];
    for (int u = columns_[c]; u <= last; ++u) {
      const float share = step * static_cast<float>(u - columns_[c]);
      const auto between = [share](float p, float q) { return p + share * (q - p); };
      const float x = static_cast<float>(u) + between(a.far_x, b.far_x),
                  y = static_cast<float>(v) + between(a.far_y, b.far_y), along_x = between(a.near_x, b.near_x),
                  along_y = between(a.near_y, b.near_y), scale = between(a.scale, b.scale);
      if (isKnown(here[u])) inverse = 1 / here[u];
      out[u] = kNaN;
      for (int round = 0; round < kRounds; ++round) {
        const float z = scale * (depthAt(depth, x + along_x * inverse, y + along_y * inverse) + offset);
        if (!(z > 0) || !std::isfinite(z)) break;
        const float change = 1 / z - inverse;
        inverse += change;
        // Else what was found lies elsewhere in the image than where it was looked for.
        if ((along_x * along_x + along_y * along_y) * change * change < kLeastShift * kLeastShift) {
          out[u] = z;
          break;
        }
      }
    }
  }
}

}  // namespace rgbd_slam
