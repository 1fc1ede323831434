#include "depth_carrier.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "rgbd_slam/depth_model.h"

namespace rgbd_slam {

using air_ground_common::Pose;

namespace {

constexpr int kCell = 16;            // between nodes of the grid [px]
constexpr float kLeastShift = 0.5f;  // smaller ones matter less than where a feature is [px]
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

/// 0, kCell ... and the last pixel.
std::vector<int> nodesAlong(int pixels) {
  std::vector<int> nodes;
  for (int i = 0; i < pixels - 1; i += kCell) nodes.push_back(i);
  nodes.push_back(pixels - 1);
  return nodes;
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

void DepthCarrier::carryRow(const cv::Mat& depth, int v, const std::vector<Node>& row, float offset, float* out) {
  const int width = depth.cols;
  const float* here = depth.ptr<float>(v);
  sought_.resize(width);
  Sought& s = sought_;
  for (std::size_t c = 0; c + 1 < row.size(); ++c) {
    const Node &a = row[c], &b = row[c + 1];
    const float step = 1 / static_cast<float>(columns_[c + 1] - columns_[c]);
    const int first = columns_[c], last = c + 2 < row.size() ? columns_[c + 1] - 1 : columns_[c + 1];
    for (int u = first; u <= last; ++u) {
      const float share = step * static_cast<float>(u - first);
      const auto between = [share](float p, float q) { return p + share * (q - p); };
      s.far_x[u] = static_cast<float>(u) + between(a.far_x, b.far_x);
      s.far_y[u] = static_cast<float>(v) + between(a.far_y, b.far_y);
      s.near_x[u] = between(a.near_x, b.near_x);
      s.near_y[u] = between(a.near_y, b.near_y);
      s.scale[u] = between(a.scale, b.scale);
    }
  }
  float inverse = 0;  // depth; where nothing is known here, that of the pixel before [1/m]
  for (int u = 0; u < width; ++u) {
    if (isKnown(here[u])) inverse = 1 / here[u];
    s.inverse[u] = inverse;
  }
  for (int u = 0; u < width; ++u) {
    s.x[u] = s.far_x[u] + s.near_x[u] * s.inverse[u];
    s.y[u] = s.far_y[u] + s.near_y[u] * s.inverse[u];
  }
  const DepthImage image{depth.ptr<float>(), width, depth.rows, static_cast<std::ptrdiff_t>(depth.step1())};
  depthsAt(image, s.x.data(), s.y.data(), width, out);
  for (int u = 0; u < width; ++u) out[u] = settled(image, u, offset, out[u]);
}

float DepthCarrier::settled(const DepthImage& image, int u, float offset, float found) const {
  constexpr int kRounds = 3;
  const Sought& s = sought_;
  const float squared = s.near_x[u] * s.near_x[u] + s.near_y[u] * s.near_y[u];
  float inverse = s.inverse[u];
  for (int round = 0; round < kRounds; ++round) {
    if (round > 0) found = depthAt(image, s.far_x[u] + s.near_x[u] * inverse, s.far_y[u] + s.near_y[u] * inverse);
    const float z = s.scale[u] * (found + offset);
    if (!(z > 0) || !std::isfinite(z)) return kNaN;
    const float change = 1 / z - inverse;
    // Else what was found lies elsewhere in the image than where it was looked for.
    if (squared * change * change < kLeastShift * kLeastShift) return z;
    inverse += change;
  }
  return kNaN;
}

}  // namespace rgbd_slam
