#include "rgbd_slam/ground_cloud.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

namespace rgbd_slam {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

void CloudSettings::validate() const {
  const auto require = [](bool ok, const char* what) {
    if (!ok) throw std::invalid_argument(std::string("CloudSettings::") + what);
  };
  require(voxel > 0.001 && voxel < 1, "voxel must be in (0.001, 1) m");
  require(stride >= 1 && stride <= 16, "stride must be in [1, 16]");
  require(max_range > 0.1, "max_range must be above 0.1 m");
  require(max_incidence > 0.1 && max_incidence < 1.57, "max_incidence must be in (0.1, 1.57) rad");
  require(edge_margin >= 0 && edge_margin <= 10, "edge_margin must be in [0, 10] px");
  require(gate > 0, "gate must be positive");
  require(min_confirmations >= 1, "min_confirmations must be at least 1");
  require(min_weight_share >= 0 && min_weight_share < 1, "min_weight_share must be in [0, 1)");
}

namespace {

/// Pixels from one cell to the next: images larger than 640x480 give no more cells than all pixels of one such.
int strideFor(const cv::Size& size, int wanted) {
  constexpr int kMostCells = 640 * 480;
  while (size.area() / (wanted * wanted) > kMostCells) ++wanted;
  return wanted;
}

/// Marks pixels whose neighbourhood holds a depth edge: a jump that no surface within the incidence limit explains.
cv::Mat edges(const cv::Mat& depth, const DepthModel& model, double fx, double max_incidence) {
  cv::Mat mask(depth.size(), CV_8UC1, cv::Scalar(0));
  const double slope =
      std::tan(max_incidence) / fx;  // relative change of depth a pixel at the steepest accepted surface
  for (int v = 0; v + 1 < depth.rows; ++v) {
    const float* row = depth.ptr<float>(v);
    const float* below = depth.ptr<float>(v + 1);
    for (int u = 0; u + 1 < depth.cols; ++u) {
      if (!isKnown(row[u])) continue;
      const double limit = 3 * model.sigma(row[u]) + slope * row[u];
      if (isKnown(row[u + 1]) && std::abs(row[u + 1] - row[u]) > limit)
        mask.at<std::uint8_t>(v, u) = mask.at<std::uint8_t>(v, u + 1) = 255;
      if (isKnown(below[u]) && std::abs(below[u] - row[u]) > limit)
        mask.at<std::uint8_t>(v, u) = mask.at<std::uint8_t>(v + 1, u) = 255;
    }
  }
  return mask;
}

/// Neither the pixel nor what lies around it has a depth.
bool missingAbout(const cv::Mat& depth, int u, int v) {
  const int step = std::max(1, depth.cols / 128);
  for (int y = v - step; y <= v + step; y += step)
    for (int x = u - step; x <= u + step; x += step)
      if (x >= 0 && y >= 0 && x < depth.cols && y < depth.rows && isKnown(depth.at<float>(y, x))) return false;
  return true;
}

}  // namespace

KeyframeDepth::KeyframeDepth(const CameraModel& camera, const cv::Mat& depth, const cv::Mat& bgr,
                             const DepthModel& model, const CloudSettings& settings,
                             const visual_frontend::RollingShutter* rows) {
  if (depth.type() != CV_32F || depth.size() != bgr.size() || (bgr.type() != CV_8UC3 && bgr.type() != CV_8UC1)) {
    throw std::invalid_argument("KeyframeDepth: needs CV_32F depth and a CV_8UC3 or CV_8UC1 image of the same size");
  }
  cv::Mat edge = edges(depth, model, camera.fx, settings.max_incidence);
  if (settings.edge_margin > 0) {
    const int k = 2 * settings.edge_margin + 1;
    cv::dilate(edge, edge, cv::Mat::ones(k, k, CV_8UC1));
  }
  const double max_range = std::min(settings.max_range, model.max_range);
  const double min_cosine = std::cos(settings.max_incidence);
  // Pixels to the neighbours that give the normal, and half the length over which each is averaged: nearer and fewer
  // ones drown in the noise.
  constexpr int kReach = 4, kMean = 2;
  const auto meanDepth = [&depth](int u, int v, bool vertical) {
    float sum = 0;
    int count = 0;
    for (int i = -kMean; i <= kMean; ++i) {
      const float z = vertical ? depth.at<float>(v + i, u) : depth.at<float>(v, u + i);
      if (!isKnown(z)) continue;
      sum += z;
      ++count;
    }
    return count > 0 ? sum / count : 0.f;
  };
  const int stride = strideFor(depth.size(), settings.stride);
  for (int v = kReach; v < depth.rows - kReach; v += stride) {
    for (int u = kReach; u < depth.cols - kReach; u += stride) {
      const float z = depth.at<float>(v, u);
      if (!isKnown(z) || z < model.min_range || z > max_range || edge.at<std::uint8_t>(v, u)) continue;
      const float zl = meanDepth(u - kReach, v, true), zr = meanDepth(u + kReach, v, true),
                  zu = meanDepth(u, v - kReach, false), zd = meanDepth(u, v + kReach, false);
      if (!isKnown(zl) || !isKnown(zr) || !isKnown(zu) || !isKnown(zd)) continue;
      const Eigen::Vector2d ray = camera.unproject(Eigen::Vector2d(u, v));
      const double dx = kReach / camera.fx, dy = kReach / camera.fy;
      const Eigen::Vector3d right((ray.x() + dx) * zr - (ray.x() - dx) * zl, ray.y() * (zr - zl), zr - zl);
      const Eigen::Vector3d down(ray.x() * (zd - zu), (ray.y() + dy) * zd - (ray.y() - dy) * zu, zd - zu);
      const Eigen::Vector3d normal = down.cross(right).normalized();  // towards the camera
      const double cosine = -normal.dot(ray.homogeneous().normalized());
      if (!(cosine > min_cosine)) continue;
      Cell cell;
      const Eigen::Vector3d seen = z * ray.homogeneous(), p = rows ? rows->pointToMiddleRow(v, seen) : seen;
      cell.x = static_cast<float>(p.x() / p.z());
      cell.y = static_cast<float>(p.y() / p.z());
      cell.z = static_cast<float>(p.z());
      const double sigma = model.sigma(z);
      cell.weight = static_cast<float>(1 / (sigma * sigma));
      if (bgr.type() == CV_8UC3) {
        const cv::Vec3b c = bgr.at<cv::Vec3b>(v, u);
        std::copy(c.val, c.val + 3, cell.bgr);
      } else {
        std::fill(cell.bgr, cell.bgr + 3, bgr.at<std::uint8_t>(v, u));
      }
      cells_.push_back(cell);
    }
  }
}

void KeyframeDepth::fuse(const CameraModel& camera, const cv::Mat& depth, const Pose& T_frame_keyframe,
                         const DepthModel& model, const CloudSettings& settings,
                         const visual_frontend::RollingShutter* rows) {
  const bool rolling = rows && rows->active();
  const Eigen::Matrix3f R = T_frame_keyframe.linear().cast<float>();
  const Eigen::Vector3f t = T_frame_keyframe.translation().cast<float>();
  ++frames_;
  for (Cell& cell : cells_) {
    const Eigen::Vector3f p = R * (cell.z * Eigen::Vector3f(cell.x, cell.y, 1)) + t;
    auto pixel = camera.project(p.cast<double>());
    if (!pixel) continue;
    float expected = p.z();
    if (rolling) {
      // The row that sees it is next to that of the middle row's image: within a pixel nothing changes.
      const Eigen::Vector3d in_row = rows->pointFromMiddleRow(pixel->y(), p.cast<double>());
      pixel = camera.project(in_row);
      if (!pixel) continue;
      expected = static_cast<float>(in_row.z());
    }
    const int u = static_cast<int>(std::lround(pixel->x())), v = static_cast<int>(std::lround(pixel->y()));
    if (u < 0 || v < 0 || u >= depth.cols || v >= depth.rows) continue;
    const float z = depth.at<float>(v, u);
    const auto contradict = [&cell] {
      if (cell.disagree < 255) ++cell.disagree;
    };
    if (!isKnown(z)) {
      // What gave a depth from here would give it again.
      if (missingAbout(depth, u, v)) contradict();
      continue;
    }
    if (z < model.min_range) continue;
    const float sigma = static_cast<float>(model.sigma(z)), difference = z - expected;
    // The surface may rise within the pixel: that much is no disagreement.
    const float slack = static_cast<float>(settings.gate) * sigma + 0.5f * z / static_cast<float>(camera.fx) * 3.f;
    if (std::abs(difference) > slack) {
      // Seen through the point: it is not there. Something nearer only hides it.
      if (difference > 0) contradict();
      continue;
    }
    if (z > model.max_range) continue;
    if (cell.agree < 255) ++cell.agree;
    // Depth along the keyframe's ray whose image is at the measured depth.
    const float along = R.row(2).dot(Eigen::Vector3f(cell.x, cell.y, 1));
    if (along < 0.3f) continue;
    const float measured = (z + (p.z() - expected) - t.z()) / along, weight = along * along / (sigma * sigma);
    cell.z += weight / (cell.weight + weight) * (measured - cell.z);
    cell.weight += weight;
  }
}

std::vector<KeyframeDepth::Point> KeyframeDepth::points(const DepthModel& model, const CloudSettings& settings) const {
  std::vector<Point> result;
  result.reserve(cells_.size());
  const int needed = std::min(settings.min_confirmations, frames_);
  for (const Cell& cell : cells_) {
    if (cell.agree < needed || cell.disagree >= cell.agree) continue;
    Point point;
    point.position = cell.z * Eigen::Vector3f(cell.x, cell.y, 1);
    std::copy(cell.bgr, cell.bgr + 3, point.bgr);
    // Averaging does not remove what the sensor repeats (calibration, quantisation): a floor of a third of one frame's.
    const double common = model.sigma(cell.z) / 3;
    point.weight = static_cast<float>(1 / (1 / cell.weight + common * common));
    result.push_back(point);
  }
  return result;
}

}  // namespace rgbd_slam
