#include "streetview_localizer/facade_consistency.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "streetview_localizer/panorama_views.h"
#include "streetview_localizer/plane_index.h"
#include "streetview_localizer/recent_cache.h"

namespace streetview_localizer {
namespace {

constexpr int kSide = 12;                                   // samples along a patch
constexpr std::size_t kKeptBytes = std::size_t{512} << 20;  // of images in memory

std::size_t bytesOf(const cv::Mat& image) { return image.total() * image.elemSize(); }

using Patch = std::array<float, kSide * kSide>;

// Bilinear; the column of a panorama wraps round.
float sample(const cv::Mat& grey, const Eigen::Vector2d& p, bool wraps) {
  const double x = wraps ? p.x() : std::clamp(p.x(), 0.0, grey.cols - 1.001),
               y = std::clamp(p.y(), 0.0, grey.rows - 1.001);
  const int u = static_cast<int>(std::floor(x)), v = static_cast<int>(y);
  const float a = static_cast<float>(x - u), b = static_cast<float>(y - v);
  const int u0 = (u + grey.cols) % grey.cols, u1 = (u0 + 1) % grey.cols;
  const std::uint8_t* r0 = grey.ptr(v);
  const std::uint8_t* r1 = grey.ptr(v + 1);
  return (1 - b) * ((1 - a) * r0[u0] + a * r0[u1]) + b * ((1 - a) * r1[u0] + a * r1[u1]);
}

// Zero mean, unit length; false for a patch without texture.
bool normalise(Patch* patch) {
  float mean = 0, norm = 0;
  for (const float v : *patch) mean += v / patch->size();
  for (float& v : *patch) {
    v -= mean;
    norm += v * v;
  }
  if (norm < 4.f * patch->size()) return false;  // two grey levels: noise
  for (float& v : *patch) v /= std::sqrt(norm);
  return true;
}

/// In plan, those that may be asked.
PlaneIndex usableOf(const std::vector<ConsistencyImage>& images) {
  std::vector<std::pair<Eigen::Vector2d, int>> places;
  for (std::size_t i = 0; i < images.size(); ++i)
    if (images[i].usable) places.emplace_back(images[i].T_world_image.translation().head<2>(), static_cast<int>(i));
  return PlaneIndex(places);
}

}  // namespace

struct FacadeConsistency::Impl {
  const BackProjector& model;
  std::vector<ConsistencyImage> images;
  std::function<cv::Mat(int)> load;
  ConsistencySettings settings;
  PlaneIndex usable;
  mutable RecentCache<cv::Mat> cache{kKeptBytes, bytesOf};

  cv::Mat image(int index) const {
    return cache.get(index, [&] { return reduced(load(index)); });
  }

  cv::Mat reduced(cv::Mat grey) const {
    if (!grey.empty() && grey.channels() == 3) cv::cvtColor(grey, grey, cv::COLOR_BGR2GRAY);
    if (grey.cols > settings.image_width) {
      const double factor = double(settings.image_width) / grey.cols;
      cv::resize(grey, grey, {settings.image_width, static_cast<int>(std::lround(grey.rows * factor))}, 0, 0,
                 cv::INTER_AREA);
    }
    return grey;
  }

  // Samples a square of side x side points around `centre`; false where a photograph does not show all of it.
  bool window(int index, const cv::Mat& grey, const Eigen::Vector3d& centre, const Eigen::Vector3d& right,
              const Eigen::Vector3d& up, int side, float* out) const {
    const ConsistencyImage& info = images[index];
    const air_ground_common::Pose T = info.T_world_image.inverse();
    const air_ground_common::CameraModel camera =
        info.equirectangular ? info.camera : info.camera.scaled(double(grey.cols) / info.camera.width);
    const double step = settings.patch / kSide;
    for (int i = 0; i < side; ++i)
      for (int j = 0; j < side; ++j) {
        const Eigen::Vector3d p =
            T * (centre + step * (j - 0.5 * (side - 1)) * right + step * (i - 0.5 * (side - 1)) * up);
        if (info.equirectangular) {
          *out++ = sample(grey, panoramaPixel(grey.size(), p), true);
          continue;
        }
        const auto pixel = camera.project(p);
        if (!pixel || !camera.contains(*pixel)) return false;
        *out++ = sample(grey, *pixel, false);
      }
    return true;
  }

  bool sees(int index, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const {
    const ConsistencyImage& info = images[index];
    const Eigen::Vector3d ray = point - info.T_world_image.translation();
    const double distance = ray.norm();
    if (distance < 1 || -normal.dot(ray) < 0.26 * distance) return false;  // beyond 75 degrees
    if (!info.equirectangular) {
      const auto pixel = info.camera.project(info.T_world_image.inverse() * point);
      if (!pixel || !info.camera.contains(*pixel)) return false;
    }
    const Eigen::Vector3d origin = point - ray;
    return !model.scene().occluded(origin.cast<float>(), (ray / distance).cast<float>(),
                                   static_cast<float>(distance - 0.3));
  }

  // Samples the neighbour once over patch and search range, then slides. NaN if it does not show all of that.
  double bestCorrelation(int index, const cv::Mat& grey, const Patch& own, const Eigen::Vector3d& centre,
                         const Eigen::Vector3d& right, const Eigen::Vector3d& up) const {
    const int reach = static_cast<int>(std::lround(settings.search * kSide / settings.patch)), side = kSide + 2 * reach;
    std::vector<float> area(static_cast<std::size_t>(side * side));
    if (!window(index, grey, centre, right, up, side, area.data())) return std::numeric_limits<double>::quiet_NaN();
    double best = -1;
    for (int di = 0; di <= 2 * reach; ++di)
      for (int dj = 0; dj <= 2 * reach; ++dj) {
        Patch other;
        for (int i = 0; i < kSide; ++i) std::copy_n(&area[(i + di) * side + dj], kSide, &other[i * kSide]);
        if (!normalise(&other)) continue;
        float sum = 0;
        for (std::size_t k = 0; k < own.size(); ++k) sum += own[k] * other[k];
        best = std::max<double>(best, sum);
      }
    return best;
  }

  double correlation(int own, const std::vector<int>& neighbours, const Eigen::Vector3d& point,
                     const Eigen::Vector3d& normal) const {
    constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
    if (std::abs(normal.z()) > 0.9) return kUnknown;
    const Eigen::Vector3d right = Eigen::Vector3d::UnitZ().cross(normal).normalized(), up = normal.cross(right);
    const cv::Mat grey = image(own);
    Patch patch;
    if (grey.empty() || !window(own, grey, point, right, up, kSide, patch.data()) || !normalise(&patch))
      return kUnknown;
    double best = kUnknown;
    int asked = 0;
    for (const int index : neighbours) {
      if (asked == settings.neighbours) break;
      if (!sees(index, point, normal)) continue;
      const cv::Mat other = image(index);
      if (other.empty()) continue;
      const double found = bestCorrelation(index, other, patch, point, right, up);
      if (std::isnan(found)) continue;
      ++asked;
      best = std::fmax(best, found);
    }
    return best;
  }
};

FacadeConsistency::FacadeConsistency(const BackProjector& model, std::vector<ConsistencyImage> images,
                                     std::function<cv::Mat(int)> load, const ConsistencySettings& settings) {
  PlaneIndex usable = usableOf(images);
  impl_.reset(new Impl{model, std::move(images), std::move(load), settings, std::move(usable)});
}
FacadeConsistency::~FacadeConsistency() = default;

std::vector<int> FacadeConsistency::neighbours(int own) const {
  const Impl& d = *impl_;
  std::vector<std::pair<double, int>> near;
  const Eigen::Vector3d place = d.images[own].T_world_image.translation();
  for (const int i : d.usable.inSquare(place.head<2>(), d.settings.max_distance)) {
    const double distance = (d.images[i].T_world_image.translation() - place).norm();
    if (i != own && distance > d.settings.min_distance && distance < d.settings.max_distance)
      near.emplace_back(distance, i);
  }
  std::sort(near.begin(), near.end());
  std::vector<int> indices;
  for (const auto& [distance, index] : near) indices.push_back(index);
  return indices;
}

double FacadeConsistency::correlation(int own, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const {
  return impl_->correlation(own, neighbours(own), point, normal);
}

int FacadeConsistency::apply(int own, View* view) const {
  Features kept;
  std::vector<Eigen::Vector3f> points, normals;
  std::vector<int> rows;
  const std::vector<int> near = neighbours(own);
  for (std::size_t i = 0; i < view->features.size(); ++i) {
    const double c = impl_->correlation(own, near, view->points[i].cast<double>(), view->normals[i].cast<double>());
    if (c < impl_->settings.min_correlation) continue;  // NaN stays
    rows.push_back(static_cast<int>(i));
    kept.keypoints.push_back(view->features.keypoints[i]);
    points.push_back(view->points[i]);
    normals.push_back(view->normals[i]);
  }
  const int dropped = static_cast<int>(view->features.size() - rows.size());
  kept.descriptors.create(static_cast<int>(rows.size()), view->features.descriptors.cols,
                          view->features.descriptors.type());
  for (std::size_t i = 0; i < rows.size(); ++i)
    view->features.descriptors.row(rows[i]).copyTo(kept.descriptors.row(static_cast<int>(i)));
  view->features = std::move(kept);
  view->points = std::move(points);
  view->normals = std::move(normals);
  return dropped;
}

}  // namespace streetview_localizer
