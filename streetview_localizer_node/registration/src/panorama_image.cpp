#include "panorama_image.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace streetview_localizer::registration {

cv::Mat turnPanorama(const cv::Mat& image, const Eigen::Matrix3d& R_body_level, int interpolation) {
  const int width = image.cols, height = image.rows;
  cv::Mat map_x(height, width, CV_32F), map_y(height, width, CV_32F);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      const Eigen::Vector2d p = pixelOf(R_body_level * rayOf(u, v, width, height), width, height);
      map_x.at<float>(v, u) = static_cast<float>(p.x());
      map_y.at<float>(v, u) = static_cast<float>(p.y());
    }
  }
  // One column of each side beyond the other, so that interpolation crosses the seam.
  cv::Mat wide, turned;
  cv::copyMakeBorder(image, wide, 0, 0, 2, 2, cv::BORDER_WRAP);
  map_x += 2;
  cv::remap(wide, turned, map_x, map_y, interpolation, cv::BORDER_REPLICATE);
  return turned;
}

namespace {

struct Edgel {  // a maximum of the gradient across the edge
  Eigen::Vector3d ray;
  float dx = 0, dy = 0;
  int u = 0, v = 0;
};

/// Plane of the best great circle: the direction in which the rays spread least.
Segment fitSegment(const std::vector<Edgel>& edgels, const std::vector<int>& chain, int first, int last, double pixel) {
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (int i = first; i <= last; ++i) scatter += edgels[chain[i]].ray * edgels[chain[i]].ray.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(scatter);
  const Eigen::Vector3d a = edgels[chain[first]].ray, b = edgels[chain[last]].ray;
  Segment segment;
  segment.normal = solver.eigenvectors().col(0);
  segment.middle = (a + b).normalized();
  segment.length = std::acos(std::clamp(a.dot(b), -1.0, 1.0));
  const int count = last - first + 1;
  const double spread = std::max(0.25 * pixel, std::sqrt(std::max(0.0, solver.eigenvalues()(0)) / count));
  segment.stddev = spread * std::sqrt(12.0 / count) / segment.length;
  return segment;
}

void splitChain(const std::vector<Edgel>& edgels, const std::vector<int>& chain, int first, int last, double pixel,
                std::vector<Segment>* segments) {
  constexpr int kShortest = 12;
  if (last - first + 1 < kShortest) return;
  const Eigen::Vector3d normal = edgels[chain[first]].ray.cross(edgels[chain[last]].ray).normalized();
  int farthest = first;
  double distance = 0;
  for (int i = first + 1; i < last; ++i) {
    const double d = std::abs(normal.dot(edgels[chain[i]].ray));
    if (d > distance) distance = d, farthest = i;
  }
  if (distance > 1.2 * pixel) {
    splitChain(edgels, chain, first, farthest, pixel, segments);
    splitChain(edgels, chain, farthest, last, pixel, segments);
    return;
  }
  segments->push_back(fitSegment(edgels, chain, first, last, pixel));
}

}  // namespace

namespace {

struct Edgels {
  std::vector<Edgel> list;
  cv::Mat index;            ///< CV_32S: of the edgel at a pixel, -1 where none is
  int top = 0, bottom = 0;  ///< rows between which they lie
};

/// Pixels at which the gradient is strongest across the edge, placed between pixels by a parabola.
Edgels findEdgels(const cv::Mat& bgr, const cv::Mat& mask, double max_elevation) {
  const int width = bgr.cols, height = bgr.rows;
  cv::Mat gray, smooth, gx, gy, magnitude;
  cv::cvtColor(bgr, gray, cv::COLOR_BGR2GRAY);
  cv::copyMakeBorder(gray, gray, 0, 0, 8, 8, cv::BORDER_WRAP);
  gray.convertTo(gray, CV_32F);
  cv::GaussianBlur(gray, smooth, {0, 0}, 1.0);
  cv::Scharr(smooth, gx, CV_32F, 1, 0, 1.0 / 32);
  cv::Scharr(smooth, gy, CV_32F, 0, 1, 1.0 / 32);
  cv::magnitude(gx, gy, magnitude);
  Edgels edgels;
  edgels.top = std::max(2, static_cast<int>((0.5 - max_elevation / M_PI) * height));
  edgels.bottom = std::min(height - 3, static_cast<int>((0.5 + max_elevation / M_PI) * height));
  edgels.index.create(height, width, CV_32S);
  edgels.index.setTo(-1);
  for (int v = edgels.top; v < edgels.bottom; ++v) {
    const float* m = magnitude.ptr<float>(v);
    for (int u = 0; u < width; ++u) {
      const int x = u + 8;
      if (m[x] < 2.5f || (!mask.empty() && mask.at<std::uint8_t>(v, u) < 255)) continue;
      Edgel edgel;
      edgel.dx = gx.at<float>(v, x), edgel.dy = gy.at<float>(v, x);
      const bool steep = std::abs(edgel.dx) > std::abs(edgel.dy);  // the edge, not the gradient
      const float before = steep ? m[x - 1] : magnitude.at<float>(v - 1, x);
      const float after = steep ? m[x + 1] : magnitude.at<float>(v + 1, x);
      if (m[x] < before || m[x] <= after) continue;
      const float curvature = before + after - 2 * m[x];
      const float shift = curvature < 0 ? 0.5f * (before - after) / curvature : 0;
      edgel.ray = rayOf(u + (steep ? shift : 0), v + (steep ? 0 : shift), width, height);
      edgel.u = u, edgel.v = v;
      edgels.index.at<int>(v, u) = static_cast<int>(edgels.list.size());
      edgels.list.push_back(edgel);
    }
  }
  return edgels;
}

/// The unused neighbour further along the edge whose gradient is most alike; -1 when none is. Steep edges go on
/// downwards, flat ones to the right.
int nextAlong(const Edgels& edgels, int from, bool steep, const std::vector<char>& used) {
  const int width = edgels.index.cols;
  const Edgel& end = edgels.list[from];
  int best = -1;
  double best_cosine = 0.9;
  for (int side = -1; side <= 1; ++side) {
    const int v = end.v + (steep ? 1 : side), u = (end.u + (steep ? side : 1) + width) % width;
    if (v < edgels.top || v >= edgels.bottom) continue;
    const int next = edgels.index.at<int>(v, u);
    if (next < 0 || used[next]) continue;
    const Edgel& e = edgels.list[next];
    const double cosine = (e.dx * end.dx + e.dy * end.dy) / (std::hypot(e.dx, e.dy) * std::hypot(end.dx, end.dy));
    if (cosine > best_cosine) best_cosine = cosine, best = next;
  }
  return best;
}

}  // namespace

std::vector<Segment> findSegments(const cv::Mat& bgr, const cv::Mat& mask, double max_elevation) {
  const Edgels edgels = findEdgels(bgr, mask, max_elevation);
  std::vector<char> used(edgels.list.size(), 0);
  std::vector<Segment> segments;
  std::vector<int> chain;
  for (std::size_t start = 0; start < edgels.list.size(); ++start) {
    if (used[start]) continue;
    chain.assign(1, static_cast<int>(start));
    used[start] = 1;
    const bool steep = std::abs(edgels.list[start].dx) > std::abs(edgels.list[start].dy);
    while (static_cast<int>(chain.size()) <= bgr.cols / 4) {
      const int next = nextAlong(edgels, chain.back(), steep, used);
      if (next < 0) break;
      chain.push_back(next);
      used[next] = 1;
    }
    splitChain(edgels.list, chain, 0, static_cast<int>(chain.size()) - 1, M_PI / bgr.rows, &segments);
  }
  return segments;
}

Eigen::Vector3d verticalDirection(const std::vector<Segment>& segments, double start_stddev, double* stddev) {
  Eigen::Vector2d tilt = Eigen::Vector2d::Zero();  // up ~ (tilt.x, tilt.y, 1)
  *stddev = start_stddev;
  Eigen::Matrix2d hessian = Eigen::Matrix2d::Zero();
  double cost = 0;
  int count = 0;
  for (const double kernel : {0.05, 0.04, 0.03, 0.02, 0.015, 0.015, 0.015}) {
    hessian = Eigen::Matrix2d::Zero();
    Eigen::Vector2d gradient = Eigen::Vector2d::Zero();
    cost = 0;
    count = 0;
    for (const Segment& segment : segments) {
      const Eigen::Vector3d& n = segment.normal;
      const double r = n.x() * tilt.x() + n.y() * tilt.y() + n.z();
      if (std::abs(r) > 3 * kernel) continue;
      const double sigma = std::hypot(segment.stddev, 0.003), q = r / (3 * kernel);
      const double w = (1 - q * q) * (1 - q * q) / (sigma * sigma);
      const Eigen::Vector2d j(n.x(), n.y());
      hessian += w * j * j.transpose();
      gradient += w * r * j;
      cost += w * r * r;
      ++count;
    }
    if (count < 20) return {0, 0, 1};
    tilt -= hessian.ldlt().solve(gradient);
    if (tilt.norm() > 0.2) return {0, 0, 1};
  }
  // Scaled by what the segments leave over; walls are not plumb to better than 1.5 milliradians, all in all.
  const double variance = hessian.inverse().diagonal().maxCoeff() * std::max(1.0, cost / count);
  *stddev = std::min(start_stddev, std::sqrt(variance + 2.3e-6));
  return Eigen::Vector3d(tilt.x(), tilt.y(), 1).normalized();
}

VerticalEvidence::VerticalEvidence(const cv::Mat& bgr, const cv::Mat& mask) : width_(bgr.cols), height_(bgr.rows) {
  cv::Mat lab, wide;
  cv::cvtColor(bgr, lab, cv::COLOR_BGR2Lab);
  const int reach = std::max(2, width_ / 700);
  cv::copyMakeBorder(lab, wide, 0, 0, 2 * reach, 2 * reach, cv::BORDER_WRAP);
  cv::Mat smooth;
  cv::blur(wide, smooth, {reach, 1});
  constexpr float kSaturation[3] = {10, 5, 5};
  for (int c = 0; c < 3; ++c) {
    sums_[c].assign(static_cast<std::size_t>(height_ + 1) * width_, 0.0f);
    for (int v = 0; v < height_; ++v) {
      const auto* row = smooth.ptr<cv::Vec3b>(v);
      const float* above = &sums_[c][static_cast<std::size_t>(v) * width_];
      float* below = &sums_[c][static_cast<std::size_t>(v + 1) * width_];
      for (int u = 0; u < width_; ++u) {
        const int x = u + 2 * reach;
        // blur's anchor is its middle, rounded down: the two boxes meet half a column before u.
        const float change =
            static_cast<float>(row[x + reach / 2][c]) - static_cast<float>(row[x + reach / 2 - reach][c]);
        const bool valid = mask.empty() || mask.at<std::uint8_t>(v, u) == 255;
        below[u] = above[u] + (valid ? std::clamp(change / kSaturation[c], -1.0f, 1.0f) : 0.0f);
      }
    }
  }
}

float VerticalEvidence::strength(int column, int top, int bottom) const {
  column = ((column % width_) + width_) % width_;
  top = std::clamp(top, 0, height_);
  bottom = std::clamp(bottom, 0, height_);
  if (bottom - top < 3) return 0;
  float best = 0;
  for (const auto& sums : sums_) {
    best = std::max(best, std::abs(sums[static_cast<std::size_t>(bottom) * width_ + column] -
                                   sums[static_cast<std::size_t>(top) * width_ + column]));
  }
  return best / static_cast<float>(bottom - top);
}

}  // namespace streetview_localizer::registration
