#include "streetview_localizer/virtual_views.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <unordered_map>

#include "air_ground_common/units.h"
#include "halved_features.h"

namespace streetview_localizer {
namespace {

using air_ground_common::CameraModel;

using air_ground_common::kDegree;
constexpr double kMaximumTurn = 80 * kDegree;
constexpr double kImageBlur = 0.5;  // of any image, as SIFT assumes [px]
constexpr int kGrid = 8;            // the warp is evaluated exactly every so many pixels and interpolated between

/// Camera coordinates of a virtual camera at `centre` that looks at (0, 0, 1) without roll.
Eigen::Matrix3d lookAtFacade(const Eigen::Vector3d& centre) {
  const Eigen::Vector3d z = (Eigen::Vector3d(0, 0, 1) - centre).normalized();
  const Eigen::Vector3d x = Eigen::Vector3d(0, 1, 0).cross(z).normalized();
  Eigen::Matrix3d R;
  R << x.transpose(), z.cross(x).transpose(), z.transpose();
  return R;
}

Eigen::Vector2d transform(const Eigen::Matrix3d& H, const Eigen::Vector2d& p) {
  return (H * p.homogeneous()).hnormalized();
}

/// Keypoints of the warped view as keypoints of the original; those near a border are dropped.
Features mapBack(const Features& warped, const VirtualViewWarp& warp, const CameraModel& camera, double border,
                 int id) {
  Features out;
  std::vector<int> kept;
  for (std::size_t i = 0; i < warped.size(); ++i) {
    cv::KeyPoint k = warped.keypoints[i];
    const double margin = border * k.size;
    const Eigen::Vector2d p(k.pt.x, k.pt.y);
    // The original's border, seen in the view, is a border as well: four points around the keypoint must lie inside.
    bool inside = p.x() >= margin && p.y() >= margin && p.x() <= warp.size().width - 1 - margin &&
                  p.y() <= warp.size().height - 1 - margin;
    for (int side = 0; inside && side < 4; ++side) {
      const Eigen::Vector2d step(side == 0   ? margin
                                 : side == 1 ? -margin
                                             : 0,
                                 side == 2   ? margin
                                 : side == 3 ? -margin
                                             : 0);
      inside = camera.contains(warp.toOriginal(p + step));
    }
    if (!inside) continue;
    const Eigen::Vector2d q = warp.toOriginal(p);
    const Eigen::Matrix2d J = warp.jacobian(p);
    const Eigen::Vector2d direction = J * Eigen::Vector2d(std::cos(k.angle * kDegree), std::sin(k.angle * kDegree));
    k.pt = cv::Point2f(static_cast<float>(q.x()), static_cast<float>(q.y()));
    k.size *= static_cast<float>(std::sqrt(std::abs(J.determinant())));
    k.angle = static_cast<float>(std::atan2(direction.y(), direction.x()) / kDegree);
    if (k.angle < 0) k.angle += 360;
    k.class_id = id;
    out.keypoints.push_back(k);
    kept.push_back(static_cast<int>(i));
  }
  out.descriptors.create(static_cast<int>(kept.size()), 128, CV_8U);
  for (std::size_t i = 0; i < kept.size(); ++i)
    warped.descriptors.row(kept[i]).copyTo(out.descriptors.row(static_cast<int>(i)));
  return out;
}

/// Concatenates the lists, leaving out features that an earlier one of another view already holds.
class Merger {
 public:
  explicit Merger(const VirtualViewSettings& settings)
      : settings_(settings), cell_(std::max(1.0, settings.merge_pixels)) {}

  void add(const Features& features) {
    for (int i = 0; i < static_cast<int>(features.size()); ++i) {
      const cv::KeyPoint& k = features.keypoints[i];
      const unsigned char* descriptor = features.descriptors.ptr<unsigned char>(i);
      if (isKnown(k, descriptor)) continue;
      cells_[key(cellOf(k.pt.x), cellOf(k.pt.y))].push_back(static_cast<int>(keypoints_.size()));
      keypoints_.push_back(k);
      descriptors_.insert(descriptors_.end(), descriptor, descriptor + 128);
    }
  }

  Features result() {
    Features out;
    out.descriptors = cv::Mat(static_cast<int>(keypoints_.size()), 128, CV_8U);
    std::copy(descriptors_.begin(), descriptors_.end(), out.descriptors.data);
    out.keypoints = std::move(keypoints_);
    return out;
  }

 private:
  int cellOf(float x) const { return static_cast<int>(std::floor(x / cell_)); }
  static std::int64_t key(int x, int y) { return (static_cast<std::int64_t>(y) << 32) + x; }

  bool isKnown(const cv::KeyPoint& k, const unsigned char* descriptor) const {
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) {
        const auto cell = cells_.find(key(cellOf(k.pt.x) + dx, cellOf(k.pt.y) + dy));
        if (cell == cells_.end()) continue;
        for (int other : cell->second)
          if (isSame(k, keypoints_[other], descriptor, &descriptors_[128 * static_cast<std::size_t>(other)]))
            return true;
      }
    return false;
  }

  bool isSame(const cv::KeyPoint& a, const cv::KeyPoint& b, const unsigned char* da, const unsigned char* db) const {
    constexpr double kSizeRatio = 1.4, kAngle = 20;  // [deg]
    if (a.class_id == b.class_id) return false;
    if (cv::norm(a.pt - b.pt) > settings_.merge_pixels) return false;
    if (a.size > kSizeRatio * b.size || b.size > kSizeRatio * a.size) return false;
    if (std::abs(std::remainder(a.angle - b.angle, 360.f)) > kAngle) return false;
    int d2 = 0;
    for (int j = 0; j < 128; ++j) d2 += (da[j] - db[j]) * (da[j] - db[j]);
    return d2 <= settings_.merge_distance * settings_.merge_distance;
  }

  const VirtualViewSettings& settings_;
  const double cell_;
  std::vector<cv::KeyPoint> keypoints_;
  std::vector<unsigned char> descriptors_;
  std::unordered_map<std::int64_t, std::vector<int>> cells_;
};

}  // namespace

std::vector<VirtualView> airToGroundViews() {
  std::vector<VirtualView> views;
  for (double elevation : {-45., 45., -62.}) views.push_back({0, elevation * kDegree});
  for (double azimuth : {-45., 45., -62., 62.}) views.push_back({azimuth * kDegree, 0});
  for (double azimuth : {-40., 40.}) views.push_back({azimuth * kDegree, -40 * kDegree});
  return views;
}

VirtualViewWarp::VirtualViewWarp(const CameraModel& camera, const VirtualView& view, double distance)
    : camera_(camera) {
  camera.validate();
  if (!(std::abs(view.azimuth) < kMaximumTurn && std::abs(view.elevation) < kMaximumTurn))
    throw std::invalid_argument("VirtualView: azimuth and elevation must be below 80 degrees");
  if (!(distance >= 1)) throw std::invalid_argument("VirtualViewSettings: distance must be at least 1");
  // Facade: the plane z = 1 of the query's camera. x right, y down.
  const Eigen::Vector3d target(0, 0, 1);
  const Eigen::Vector3d to_camera(std::sin(view.azimuth) * std::cos(view.elevation), -std::sin(view.elevation),
                                  -std::cos(view.azimuth) * std::cos(view.elevation));
  const Eigen::Vector3d centre = target + distance * to_camera;
  // A point of the plane is X = (x, y, 1), so that X - centre = (I - centre e3^T) X.
  const Eigen::Matrix3d H = lookAtFacade(centre) * (Eigen::Matrix3d::Identity() - centre * Eigen::RowVector3d(0, 0, 1));

  // The part of the facade that the query sees bounds the view; parts behind or far beside the virtual camera are cut
  // off.
  const double focal = distance * 0.5 * (camera.fx + camera.fy);  // scale 1 at the target, across the tilt
  const double limit = 0.75 * std::max(camera.width, camera.height);
  Eigen::Vector2d low(limit, limit), high(-limit, -limit);
  for (int i = 0; i <= 16; ++i) {
    for (int side = 0; side < 4; ++side) {
      const double s = i / 16.0;
      const Eigen::Vector2d p(side < 2 ? s * (camera.width - 1) : (side - 2) * (camera.width - 1),
                              side < 2 ? side * (camera.height - 1) : s * (camera.height - 1));
      const Eigen::Vector3d q = H * camera.unproject(p).homogeneous();
      // At grazing angles the view would be mostly of what is nearest; a lens model that folds before the corner has
      // no ray there (NaN).
      if (!(q.z() >= 0.2 * distance)) {
        low = low.cwiseMin(Eigen::Vector2d(-limit, -limit));
        high = high.cwiseMax(Eigen::Vector2d(limit, limit));
        continue;
      }
      const Eigen::Vector2d w = (focal * q.hnormalized()).cwiseMax(-limit).cwiseMin(limit);
      low = low.cwiseMin(w);
      high = high.cwiseMax(w);
    }
  }
  size_ = cv::Size(static_cast<int>(std::ceil(high.x() - low.x())) + 1,
                   static_cast<int>(std::ceil(high.y() - low.y())) + 1);
  Eigen::Matrix3d K;
  K << focal, 0, -low.x(), 0, focal, -low.y(), 0, 0, 1;
  warped_from_plane_ = K * H;
  plane_from_warped_ = warped_from_plane_.inverse();
}

Eigen::Vector2d VirtualViewWarp::toOriginal(const Eigen::Vector2d& warped) const {
  const Eigen::Vector2d d = camera_.distort(transform(plane_from_warped_, warped));
  return {camera_.fx * d.x() + camera_.cx, camera_.fy * d.y() + camera_.cy};
}

Eigen::Vector2d VirtualViewWarp::toWarped(const Eigen::Vector2d& original) const {
  return transform(warped_from_plane_, camera_.unproject(original));
}

Eigen::Matrix2d VirtualViewWarp::jacobian(const Eigen::Vector2d& warped) const {
  constexpr double kStep = 0.5;  // [px]; the map is smooth over many pixels
  Eigen::Matrix2d J;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d step = kStep * Eigen::Vector2d::Unit(axis);
    J.col(axis) = (toOriginal(warped + step) - toOriginal(warped - step)) / (2 * kStep);
  }
  return J;
}

cv::Mat VirtualViewWarp::render(const cv::Mat& grey, bool half) const {
  const double scale = half ? 2 : 1, shift = half ? 0.5 : 0;
  const cv::Size out(size_.width / static_cast<int>(scale), size_.height / static_cast<int>(scale));
  // One pixel of the output covers J of the original: its blur of 0.5 pixels is J J^T / 4 there, of which I / 4 is
  // present.
  const Eigen::Vector2d centre = toWarped({0.5 * (camera_.width - 1), 0.5 * (camera_.height - 1)});
  const Eigen::Matrix2d J = scale * jacobian(centre);
  const Eigen::Vector2d variance = kImageBlur * kImageBlur * ((J * J.transpose()).diagonal() - Eigen::Vector2d::Ones());
  cv::Mat smooth;
  if (variance.maxCoeff() < 0.05)
    smooth = grey;
  else
    cv::GaussianBlur(grey, smooth, cv::Size(0, 0), std::sqrt(std::max(0.01, variance.x())),
                     std::sqrt(std::max(0.01, variance.y())), cv::BORDER_REPLICATE);

  const int columns = (out.width + kGrid - 1) / kGrid + 1, rows = (out.height + kGrid - 1) / kGrid + 1;
  cv::Mat grid(rows, columns, CV_32FC2);
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x) {
      const Eigen::Vector2d p = toOriginal({scale * x * kGrid + shift, scale * y * kGrid + shift});
      // Far outside the query the map may fold back or overflow.
      const bool finite = p.allFinite() && p.cwiseAbs().maxCoeff() < 1e4;
      grid.at<cv::Vec2f>(y, x) = finite ? cv::Vec2f(p.x(), p.y()) : cv::Vec2f(-1e4f, -1e4f);
    }
  cv::Mat map(out, CV_32FC2), warped;
  for (int y = 0; y < out.height; ++y) {
    const float v = static_cast<float>(y % kGrid) / kGrid;
    const cv::Vec2f *top = grid.ptr<cv::Vec2f>(y / kGrid), *bottom = grid.ptr<cv::Vec2f>(y / kGrid + 1);
    cv::Vec2f* row = map.ptr<cv::Vec2f>(y);
    for (int x = 0; x < out.width; x += kGrid, ++top, ++bottom) {
      cv::Vec2f value = top[0] * (1 - v) + bottom[0] * v;
      const cv::Vec2f step = (top[1] * (1 - v) + bottom[1] * v - value) * (1.f / kGrid);
      for (int i = x; i < std::min(x + kGrid, out.width); ++i, value += step) row[i] = value;
    }
  }
  cv::remap(smooth, warped, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  return warped;
}

namespace {

Features extract(const Features* original, const cv::Mat& image, const CameraModel& camera,
                 const VirtualViewSettings& settings) {
  if (image.cols != camera.width || image.rows != camera.height)
    throw std::invalid_argument("virtual views: the image is " + std::to_string(image.cols) + "x" +
                                std::to_string(image.rows) + ", its camera " + std::to_string(camera.width) + "x" +
                                std::to_string(camera.height));
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  const int count = static_cast<int>(settings.views.size());
  std::vector<VirtualViewWarp> warps;
  for (const VirtualView& view : settings.views) warps.emplace_back(camera, view, settings.distance);

  // OpenCV's own loops inside this one run in the calling thread: one image a thread.
  std::vector<Features> found(count + 1);
  cv::parallel_for_(
      cv::Range(0, count + 1),
      [&](const cv::Range& range) {
        for (int i = range.start; i < range.end; ++i) {
          if (i == 0) {
            found[0] = original ? *original : extractFeatures(grey, settings.original);
            for (cv::KeyPoint& k : found[0].keypoints) k.class_id = 0;
            continue;
          }
          const VirtualViewWarp& warp = warps[i - 1];
          found[i] =
              mapBack(settings.warped.double_image ? extractFeatures(warp.render(grey, false), settings.warped)
                                                   : extractHalvedFeatures(warp.render(grey, true), settings.warped),
                      warp, camera, settings.border, i);
        }
      },
      count + 1);
  Merger merger(settings);
  for (const Features& features : found) merger.add(features);
  return merger.result();
}

}  // namespace

Features extractWithVirtualViews(const cv::Mat& image, const CameraModel& camera, const VirtualViewSettings& settings) {
  return extract(nullptr, image, camera, settings);
}

Features addVirtualViews(const Features& original, const cv::Mat& image, const CameraModel& camera,
                         const VirtualViewSettings& settings) {
  return extract(&original, image, camera, settings);
}

}  // namespace streetview_localizer
