#include "visual_frontend/feature_tracker.h"

#include <algorithm>
#include <cmath>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <stdexcept>
#include <string>
#include <unordered_set>

#include "air_ground_common/parameters.h"
#include "brightness.h"
#include "patch_alignment.h"

namespace visual_frontend {

namespace {

constexpr double kFewFound = 0.7;  // of the features, below which the light may have leapt

void require(bool ok, const char* field, const char* what) {
  if (!ok) throw std::invalid_argument(std::string("TrackerSettings::") + field + " " + what);
}

/// Smaller eigenvalue of the mean structure tensor over a 9x9 window; image scaled to [0, 1].
double shiTomasiScore(const cv::Mat& image, int x, int y) {
  constexpr int kHalf = 4;
  if (x < kHalf + 1 || y < kHalf + 1 || x >= image.cols - kHalf - 1 || y >= image.rows - kHalf - 1) return 0;
  long sxx = 0, syy = 0, sxy = 0;
  for (int v = y - kHalf; v <= y + kHalf; ++v) {
    const std::uint8_t* row = image.ptr(v);
    const std::uint8_t* above = image.ptr(v - 1);
    const std::uint8_t* below = image.ptr(v + 1);
    for (int u = x - kHalf; u <= x + kHalf; ++u) {
      const int gx = row[u + 1] - row[u - 1];
      const int gy = below[u] - above[u];
      sxx += gx * gx;
      syy += gy * gy;
      sxy += gx * gy;
    }
  }
  const double norm = 1.0 / (4.0 * 255.0 * 255.0 * (2 * kHalf + 1) * (2 * kHalf + 1));
  const double a = sxx * norm, b = syy * norm, c = sxy * norm;
  return 0.5 * (a + b - std::sqrt((a - b) * (a - b) + 4 * c * c));
}

cv::Point2f toCv(const Eigen::Vector2d& p) { return {static_cast<float>(p.x()), static_cast<float>(p.y())}; }

}  // namespace

void describe(air_ground_common::ParameterVisitor& v, TrackerSettings& t) {
  v("max_features", t.max_features, {40, 2000}, "", "tracked at a time");
  v("feature_distance", t.min_distance, {4, 100}, "px", "between features");
  v("fast_threshold", t.fast_threshold, {2, 100}, "grey levels", "corner threshold");
  v("clahe", t.clahe, "local contrast equalisation, for dark or flat images");
}

void TrackerSettings::validate() const {
  require(max_features > 0, "max_features", "must be positive");
  require(min_distance >= 1, "min_distance", "must be at least 1 px");
  require(fast_threshold >= 2 && fast_threshold < 255, "fast_threshold", "must be in [2, 254]");
  require(window >= 5 && window % 2 == 1, "window", "must be odd and at least 5");
  require(pyramid_levels >= 1 && pyramid_levels <= 8, "pyramid_levels", "must be in [1, 8]");
  require(max_iterations >= 1, "max_iterations", "must be positive");
  require(convergence > 0, "convergence", "must be positive");
  require(max_forward_backward > 0, "max_forward_backward", "must be positive");
  require(max_patch_difference > 0, "max_patch_difference", "must be positive");
  require(border >= 5, "border", "must be at least 5 px");
}

ImagePyramid buildPyramid(const cv::Mat& gray, int levels) {
  if (gray.empty() || gray.type() != CV_8UC1) throw std::invalid_argument("buildPyramid: needs a CV_8UC1 image");
  ImagePyramid pyramid{gray};
  while (static_cast<int>(pyramid.size()) < levels && pyramid.back().cols > 32 && pyramid.back().rows > 32) {
    cv::Mat next;
    cv::pyrDown(pyramid.back(), next);
    pyramid.push_back(next);
  }
  return pyramid;
}

struct FeatureTracker::Impl {
  CameraModel camera;
  TrackerSettings settings;
  std::vector<Feature> features;
  std::vector<cv::Mat> lk_pyramid;  // images at even, derivatives at odd indices
  ImagePyramid pyramid;
  cv::Ptr<cv::CLAHE> clahe;
  TrackId next_id = 0;
  double survival = 1;

  bool inside(const cv::Point2f& p) const { return camera.contains({p.x, p.y}, settings.border); }

  std::vector<cv::Mat> lkPyramid(const cv::Mat& image) const {
    std::vector<cv::Mat> result;
    cv::buildOpticalFlowPyramid(image, result, cv::Size(settings.window, settings.window), settings.pyramid_levels - 1,
                                true, cv::BORDER_REFLECT_101, cv::BORDER_CONSTANT, false);
    return result;
  }

  Feature makeFeature(const Eigen::Vector2d& pixel, float response) {
    Feature f;
    f.id = next_id++;
    f.pixel = f.previous_pixel = pixel;
    f.normalized = camera.unproject(pixel);
    f.response = response;
    return f;
  }

  std::vector<cv::Point2f> predict(const TrackPrediction& prediction) const {
    std::vector<cv::Point2f> result;
    result.reserve(features.size());
    for (const Feature& f : features) {
      cv::Point2f guess = toCv(f.pixel);
      const auto given = prediction.pixels.find(f.id);
      if (given != prediction.pixels.end() && given->second.allFinite()) {
        guess = toCv(given->second);
      } else if (prediction.R_current_previous) {
        const Eigen::Vector3d ray = *prediction.R_current_previous * f.normalized.homogeneous();
        if (ray.z() > 0.1) {
          if (const auto pixel = camera.project(ray)) guess = toCv(*pixel);
        }
      }
      result.push_back(guess);
    }
    return result;
  }

  /// The features where they are in the current image, as far as they are found.
  std::vector<Feature> follow(const std::vector<cv::Mat>& current, const TrackPrediction& prediction) const {
    std::vector<cv::Point2f> before, after = predict(prediction);
    for (const Feature& f : features) before.push_back(toCv(f.pixel));
    const std::vector<unsigned char> status = flow(current, before, &after);
    std::vector<Feature> found;
    found.reserve(features.size());
    for (std::size_t i = 0; i < before.size(); ++i) {
      if (!status[i] || !inside(after[i])) continue;
      if (patchDifference(lk_pyramid[0], before[i], current[0], after[i]) > settings.max_patch_difference) continue;
      Feature f = features[i];
      f.previous_pixel = f.pixel;
      f.pixel = {after[i].x, after[i].y};
      f.normalized = camera.unproject(f.pixel);
      if (!f.normalized.allFinite()) continue;
      ++f.age;
      found.push_back(f);
    }
    return found;
  }

  /// Takes over the current image for the next one.
  void keep(std::vector<cv::Mat> current) {
    lk_pyramid = std::move(current);
    pyramid.clear();
    for (std::size_t i = 0; i < lk_pyramid.size(); i += 2) pyramid.push_back(lk_pyramid[i]);
  }

  /// Where the features of the image before are in this one, from `after` on; of each whether it was found.
  std::vector<unsigned char> flow(const std::vector<cv::Mat>& current, const std::vector<cv::Point2f>& before,
                                  std::vector<cv::Point2f>* after) const {
    const cv::Size window(settings.window, settings.window);
    const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, settings.max_iterations,
                                    settings.convergence);
    const int levels = settings.pyramid_levels - 1;
    std::vector<unsigned char> status;
    std::vector<float> error;
    cv::calcOpticalFlowPyrLK(lk_pyramid, current, before, *after, status, error, window, levels, criteria,
                             cv::OPTFLOW_USE_INITIAL_FLOW, 1e-4);
    std::vector<cv::Point2f> back = before;
    std::vector<unsigned char> back_status;
    // From a near start the coarse levels only cost time.
    cv::calcOpticalFlowPyrLK(current, lk_pyramid, *after, back, back_status, error, window, std::min(levels, 1),
                             criteria, cv::OPTFLOW_USE_INITIAL_FLOW, 1e-4);
    for (std::size_t i = 0; i < before.size(); ++i) {
      const cv::Point2f d = back[i] - before[i];
      if (!back_status[i] || d.dot(d) > settings.max_forward_backward * settings.max_forward_backward) status[i] = 0;
    }
    return status;
  }

  /// Of two tracks that ran together, which measure the same point, the older stays.
  void keepApart(std::vector<Feature> found) {
    std::stable_sort(found.begin(), found.end(), [](const Feature& a, const Feature& b) { return a.age > b.age; });
    cv::Mat taken(camera.height, camera.width, CV_8UC1, cv::Scalar(0));
    const int radius = std::max(1, settings.min_distance / 3);
    features.clear();
    for (const Feature& f : found) {
      const cv::Point p(cvRound(f.pixel.x()), cvRound(f.pixel.y()));
      if (taken.at<std::uint8_t>(p)) continue;
      cv::circle(taken, p, radius, cv::Scalar(255), -1);
      features.push_back(f);
    }
  }

  bool full() const { return static_cast<int>(features.size()) >= settings.max_features; }

  /// Where `mask` (empty: everywhere) allows features and none is within `spacing` [px]: 255.
  cv::Mat freeArea(const cv::Mat& mask, int spacing) const {
    cv::Mat free(pyramid[0].size(), CV_8UC1, cv::Scalar(255));
    for (const Feature& f : features)
      cv::circle(free, cv::Point(cvRound(f.pixel.x()), cvRound(f.pixel.y())), spacing, cv::Scalar(0), -1);
    if (!mask.empty()) cv::bitwise_and(free, mask, free);
    return free;
  }

  /// The image's cells, about as many as there may be features.
  std::vector<cv::Rect> grid(int cell) const {
    const cv::Mat& image = pyramid[0];
    const int border = settings.border;
    std::vector<cv::Rect> cells;
    for (int y = border; y < image.rows - border; y += cell) {
      for (int x = border; x < image.cols - border; x += cell)
        cells.emplace_back(x, y, std::min(cell, image.cols - border - x), std::min(cell, image.rows - border - y));
    }
    return cells;
  }

  /// Features in each cell of that grid.
  std::vector<int> occupation(std::size_t cells, int cell) const {
    std::vector<int> occupied(cells, 0);
    const int border = settings.border, columns = (pyramid[0].cols - 2 * border + cell - 1) / cell;
    for (const Feature& f : features) {
      const int cx = (cvRound(f.pixel.x()) - border) / cell, cy = (cvRound(f.pixel.y()) - border) / cell;
      const std::size_t i = static_cast<std::size_t>(cy) * columns + cx;
      if (i < occupied.size()) ++occupied[i];
    }
    return occupied;
  }

  /// Makes a feature of the corner where there is room for it and it is not too weak.
  bool tryAdd(const cv::KeyPoint& k, int spacing, double weakest, cv::Mat* free) {
    const cv::Point p(cvRound(k.pt.x), cvRound(k.pt.y));
    if (full() || k.response < weakest || !inside(k.pt) || !free->at<std::uint8_t>(p)) return false;
    features.push_back(makeFeature({k.pt.x, k.pt.y}, k.response));
    cv::circle(*free, p, spacing, cv::Scalar(0), -1);
    return true;
  }

  /// The same for many, strongest first.
  void addStrongest(std::vector<cv::KeyPoint> corners, int spacing, double weakest, cv::Mat* free) {
    std::stable_sort(corners.begin(), corners.end(),
                     [](const auto& a, const auto& b) { return a.response > b.response; });
    for (const cv::KeyPoint& k : corners) tryAdd(k, spacing, weakest, free);
  }

  /// Corners of a region, strongest Shi-Tomasi score first.
  std::vector<cv::KeyPoint> corners(const cv::Mat& image, const cv::Rect& cell, int threshold) const {
    std::vector<cv::KeyPoint> found;
    // FAST looks 3 px around a corner and leaves that border out.
    const cv::Rect roi =
        cv::Rect(cell.x - 3, cell.y - 3, cell.width + 6, cell.height + 6) & cv::Rect(0, 0, image.cols, image.rows);
    if (settings.detector == CornerDetector::kFast) {
      cv::FAST(image(roi), found, threshold, true);
      if (found.size() > 12) {
        std::nth_element(found.begin(), found.begin() + 12, found.end(),
                         [](const auto& a, const auto& b) { return a.response > b.response; });
        found.resize(12);
      }
      for (cv::KeyPoint& k : found) {
        k.pt += cv::Point2f(static_cast<float>(roi.x), static_cast<float>(roi.y));
        k.response = static_cast<float>(shiTomasiScore(image, cvRound(k.pt.x), cvRound(k.pt.y)));
      }
    } else {
      std::vector<cv::Point2f> points;
      cv::goodFeaturesToTrack(image(roi), points, 6, 0.05, settings.min_distance / 2.0, cv::noArray(), 5);
      for (cv::Point2f p : points) {
        p += cv::Point2f(static_cast<float>(roi.x), static_cast<float>(roi.y));
        found.emplace_back(p, 7.f, -1.f, static_cast<float>(shiTomasiScore(image, cvRound(p.x), cvRound(p.y))));
      }
    }
    std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) {
      return std::tie(b.response, a.pt.y, a.pt.x) < std::tie(a.response, b.pt.y, b.pt.x);
    });
    return found;
  }
};

FeatureTracker::FeatureTracker(const CameraModel& camera, const TrackerSettings& settings) : impl_(new Impl) {
  camera.validate();
  settings.validate();
  impl_->camera = camera;
  impl_->settings = settings;
  if (settings.clahe) impl_->clahe = cv::createCLAHE(3.0, cv::Size(8, 8));
}

FeatureTracker::~FeatureTracker() = default;
FeatureTracker::FeatureTracker(FeatureTracker&&) noexcept = default;
FeatureTracker& FeatureTracker::operator=(FeatureTracker&&) noexcept = default;

const std::vector<Feature>& FeatureTracker::track(const cv::Mat& gray, const TrackPrediction& prediction) {
  Impl& s = *impl_;
  if (gray.type() != CV_8UC1 || gray.cols != s.camera.width || gray.rows != s.camera.height) {
    throw std::invalid_argument("FeatureTracker::track: needs a CV_8UC1 image of " + std::to_string(s.camera.width) +
                                "x" + std::to_string(s.camera.height) + ", got " + std::to_string(gray.cols) + "x" +
                                std::to_string(gray.rows) + " of OpenCV type " + std::to_string(gray.type()));
  }
  cv::Mat image = gray;
  if (s.clahe) {
    image = cv::Mat();
    s.clahe->apply(gray, image);
  }
  std::vector<cv::Mat> current = s.lkPyramid(image);
  s.survival = 1;
  if (s.lk_pyramid.empty() || s.features.empty()) {
    s.keep(std::move(current));
    return s.features;
  }

  const std::size_t before = s.features.size();
  std::vector<Feature> found = s.follow(current, prediction);
  // Only then: what comes into view looks like a leap of light, too.
  const bool few = static_cast<double>(found.size()) < kFewFound * static_cast<double>(before);
  if (const cv::Mat leap = few ? brightnessLeap(s.lk_pyramid[0], current[0]) : cv::Mat(); !leap.empty()) {
    s.lk_pyramid = s.lkPyramid(brightened(s.lk_pyramid[0], leap));
    std::vector<Feature> again = s.follow(current, prediction);
    if (again.size() > found.size()) found = std::move(again);
  }
  s.keepApart(std::move(found));
  s.survival = static_cast<double>(s.features.size()) / static_cast<double>(before);
  s.keep(std::move(current));
  return s.features;
}

int FeatureTracker::replenish(const cv::Mat& mask) {
  Impl& s = *impl_;
  if (s.pyramid.empty()) return 0;
  const cv::Mat& image = s.pyramid[0];
  if (!mask.empty() && (mask.size() != image.size() || mask.type() != CV_8UC1)) {
    throw std::invalid_argument("FeatureTracker::replenish: the mask must be CV_8UC1 of the image's size");
  }
  const std::size_t before = s.features.size();
  const TrackerSettings& settings = s.settings;
  const int cell = std::max(settings.min_distance + 2,
                            static_cast<int>(std::sqrt(double(image.cols) * image.rows / settings.max_features)));
  const std::vector<cv::Rect> cells = s.grid(cell);
  const std::vector<int> occupied = s.occupation(cells.size(), cell);
  cv::Mat free = s.freeArea(mask, settings.min_distance);
  std::vector<cv::KeyPoint> spare;  // second choices of the cells, for what the empty cells leave over
  for (std::size_t i = 0; i < cells.size() && !s.full(); ++i) {
    if (occupied[i] || cv::countNonZero(free(cells[i])) == 0) continue;
    auto found = s.corners(image, cells[i], settings.fast_threshold);
    if (found.empty() && settings.detector == CornerDetector::kFast)
      found = s.corners(image, cells[i], std::max(2, settings.fast_threshold / 2));
    bool done = false;
    for (const cv::KeyPoint& k : found) {
      if (!done)
        done = s.tryAdd(k, settings.min_distance, settings.min_shi_tomasi, &free);
      else
        spare.push_back(k);
    }
  }
  s.addStrongest(std::move(spare), settings.min_distance, settings.min_shi_tomasi, &free);
  if (settings.sparse_distance > 0 && 2 * static_cast<int>(s.features.size()) < settings.max_features) {
    // Weak texture: what there is stands in few places, so features may stand closer there, and weaker ones do.
    free = s.freeArea(mask, settings.sparse_distance);
    std::vector<cv::KeyPoint> weak;
    for (const cv::Rect& area : cells) {
      const auto found = s.corners(image, area, std::max(2, settings.fast_threshold / 4));
      weak.insert(weak.end(), found.begin(), found.end());
    }
    s.addStrongest(std::move(weak), settings.sparse_distance,
                   std::min<double>(settings.min_shi_tomasi, settings.weak_shi_tomasi), &free);
  }
  return static_cast<int>(s.features.size() - before);
}

TrackId FeatureTracker::addFeature(const Eigen::Vector2d& pixel) {
  Impl& s = *impl_;
  if (s.pyramid.empty() || !pixel.allFinite() || !s.inside(toCv(pixel))) return kNoTrack;
  const double limit = s.settings.min_distance / 3.0;
  for (const Feature& f : s.features) {
    if ((f.pixel - pixel).squaredNorm() < limit * limit) return kNoTrack;
  }
  s.features.push_back(
      s.makeFeature(pixel, static_cast<float>(shiTomasiScore(s.pyramid[0], cvRound(pixel.x()), cvRound(pixel.y())))));
  return s.features.back().id;
}

void FeatureTracker::remove(const std::vector<TrackId>& ids) {
  const std::unordered_set<TrackId> gone(ids.begin(), ids.end());
  auto& f = impl_->features;
  f.erase(std::remove_if(f.begin(), f.end(), [&](const Feature& x) { return gone.count(x.id) > 0; }), f.end());
}

void FeatureTracker::move(const std::vector<std::optional<Eigen::Vector2d>>& pixels) {
  if (pixels.size() != impl_->features.size())
    throw std::invalid_argument("FeatureTracker::move: needs a pixel, or none, for each of the " +
                                std::to_string(impl_->features.size()) + " features, got " +
                                std::to_string(pixels.size()));
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    if (!pixels[i]) continue;
    impl_->features[i].pixel = *pixels[i];
    impl_->features[i].normalized = impl_->camera.unproject(*pixels[i]);
  }
}

void FeatureTracker::reset() {
  impl_->features.clear();
  impl_->lk_pyramid.clear();
  impl_->pyramid.clear();
  impl_->survival = 1;
}

const std::vector<Feature>& FeatureTracker::features() const { return impl_->features; }
const ImagePyramid& FeatureTracker::pyramid() const { return impl_->pyramid; }
const CameraModel& FeatureTracker::camera() const { return impl_->camera; }
void FeatureTracker::setCamera(const CameraModel& camera) {
  impl_->camera = camera;
  for (Feature& f : impl_->features) {
    const Eigen::Vector2d ray = camera.unproject(f.pixel);
    if (ray.allFinite()) f.normalized = ray;  // at the rim the better calibration may see nothing
  }
}
const TrackerSettings& FeatureTracker::settings() const { return impl_->settings; }
double FeatureTracker::lastSurvival() const { return impl_->survival; }

cv::Mat drawTracks(const cv::Mat& gray, const std::vector<Feature>& features, const std::vector<bool>& mapped) {
  cv::Mat image;
  cv::cvtColor(gray, image, cv::COLOR_GRAY2BGR);
  for (std::size_t i = 0; i < features.size(); ++i) {
    const Feature& f = features[i];
    const double s = std::min(1.0, f.age / 20.0);
    const cv::Scalar colour(0, 255 * s, 255 * (1 - s));
    cv::line(image, toCv(f.previous_pixel), toCv(f.pixel), colour, 1, cv::LINE_AA);
    cv::circle(image, toCv(f.pixel), 3, colour, i < mapped.size() && mapped[i] ? -1 : 1, cv::LINE_AA);
  }
  return image;
}

}  // namespace visual_frontend
