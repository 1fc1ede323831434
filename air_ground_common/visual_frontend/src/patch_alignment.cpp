#include "patch_alignment.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>

namespace visual_frontend {

namespace {

constexpr float kFlat = 1e-3f;         // deviation of a patch without contrast [grey levels]
constexpr float kMaxShift = 3.f;       // from the start of an alignment [px]
constexpr float kConvergence = 0.02f;  // step at which its iterations end [px]

float bilinear(const cv::Mat& image, float x, float y) {
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const float fx = x - x0, fy = y - y0;
  const std::uint8_t* row = image.ptr(y0) + x0;
  const std::uint8_t* below = image.ptr(y0 + 1) + x0;
  return (1 - fy) * ((1 - fx) * row[0] + fx * row[1]) + fy * ((1 - fx) * below[0] + fx * below[1]);
}

/// Patch around `centre` whose steps of one pixel in the patch are the columns of A in the image; false outside it.
bool extract(const cv::Mat& image, const Eigen::Vector2f& centre, const Eigen::Matrix2f& A, int half, float* out) {
  for (int v = -half; v < half; ++v) {
    for (int u = -half; u < half; ++u) {
      const Eigen::Vector2f p = centre + A * Eigen::Vector2f(u + 0.5f, v + 0.5f);
      if (!sampleBilinear(image, p.x(), p.y(), out++)) return false;
    }
  }
  return true;
}

/// The same with steps of one pixel of the image: all values share their weights.
bool extractWindow(const cv::Mat& image, const Eigen::Vector2f& centre, Patch* window) {
  const int half = window->half, side = 2 * half;
  const Eigen::Vector2f first = centre.array() + (0.5f - static_cast<float>(half));
  if (!(first.x() >= 0 && first.y() >= 0 && first.x() + static_cast<float>(side) < static_cast<float>(image.cols) &&
        first.y() + static_cast<float>(side) < static_cast<float>(image.rows)))
    return false;
  const int x0 = static_cast<int>(first.x()), y0 = static_cast<int>(first.y());
  const float fx = first.x() - static_cast<float>(x0), fy = first.y() - static_cast<float>(y0);
  const float w00 = (1 - fx) * (1 - fy), w10 = fx * (1 - fy), w01 = (1 - fx) * fy, w11 = fx * fy;
  for (int v = 0; v < side; ++v) {
    const std::uint8_t *row = image.ptr(y0 + v) + x0, *below = image.ptr(y0 + v + 1) + x0;
    float* out = window->values + v * side;
    for (int u = 0; u < side; ++u) out[u] = w00 * row[u] + w10 * row[u + 1] + w01 * below[u] + w11 * below[u + 1];
  }
  window->statistics();
  return true;
}

using Values = Eigen::Map<const Eigen::ArrayXf>;

Values valuesOf(const Patch& patch) { return {patch.values, patch.area()}; }

/// Derivatives of a template's values about their mean: an offset in brightness is eliminated.
struct Gradients {
  Eigen::Array<float, Eigen::Dynamic, 2, Eigen::ColMajor, 4 * kMaxHalfPatch * kMaxHalfPatch, 2> d;  // by x, by y

  explicit Gradients(const PatchTemplate& of) : d(of.patch.area(), 2) {
    const int side = 2 * of.patch.half, rim = side + 2;
    for (int v = 0, i = 0; v < side; ++v) {
      for (int u = 0; u < side; ++u, ++i) {
        const float* c = of.rimmed + (v + 1) * rim + u + 1;
        d(i, 0) = 0.5f * (c[1] - c[-1]);
        d(i, 1) = 0.5f * (c[rim] - c[-rim]);
      }
    }
    for (const int k : {0, 1}) d.col(k) -= d.col(k).mean();
  }
  Eigen::Vector2f dot(const Values& values) const { return {(d.col(0) * values).sum(), (d.col(1) * values).sum()}; }
  Eigen::Matrix2f information() const { return d.matrix().transpose() * d.matrix(); }
};

}  // namespace

void Patch::statistics() {
  const Values all = valuesOf(*this);
  mean = all.mean();
  deviation = std::sqrt((all - mean).square().sum());
}

bool sampleBilinear(const cv::Mat& image, float x, float y, float* value) {
  if (!(x >= 0 && y >= 0 && x < image.cols - 1 && y < image.rows - 1)) return false;
  *value = bilinear(image, x, y);
  return true;
}

float patchDifference(const cv::Mat& a, const cv::Point2f& pa, const cv::Mat& b, const cv::Point2f& pb) {
  constexpr int kHalf = 4, kSize = 2 * kHalf + 1;
  const auto inside = [](const cv::Mat& m, const cv::Point2f& p) {
    return p.x >= kHalf && p.y >= kHalf && p.x < m.cols - kHalf - 1 && p.y < m.rows - kHalf - 1;
  };
  if (!inside(a, pa) || !inside(b, pb)) return 1e6f;
  float wa[kSize * kSize], wb[kSize * kSize], mean_a = 0, mean_b = 0;
  int i = 0;
  for (int v = -kHalf; v <= kHalf; ++v) {
    for (int u = -kHalf; u <= kHalf; ++u, ++i) {
      wa[i] = bilinear(a, pa.x + u, pa.y + v);
      wb[i] = bilinear(b, pb.x + u, pb.y + v);
      mean_a += wa[i];
      mean_b += wb[i];
    }
  }
  const float shift = (mean_a - mean_b) / (kSize * kSize);
  float sum = 0;
  for (i = 0; i < kSize * kSize; ++i) sum += std::abs(wa[i] - wb[i] - shift);
  return sum / (kSize * kSize);
}

float zncc(const Patch& a, const Patch& b) {
  if (a.deviation < kFlat || b.deviation < kFlat) return 0;
  return ((valuesOf(a) - a.mean) * (valuesOf(b) - b.mean)).sum() / (a.deviation * b.deviation);
}

std::optional<Eigen::Matrix2d> patchWarp(const CameraModel& camera, const Eigen::Vector2d& pixel, double depth,
                                         const Pose& T_current_reference) {
  constexpr double kStep = 4;
  const auto moved = [&](const Eigen::Vector2d& step) {
    return camera.project(T_current_reference * (depth * camera.unproject(pixel + step).homogeneous()));
  };
  const auto centre = moved(Eigen::Vector2d::Zero()), right = moved({kStep, 0}), down = moved({0, kStep});
  if (!centre || !right || !down) return std::nullopt;
  Eigen::Matrix2d A;
  A << *right - *centre, *down - *centre;
  return A / kStep;
}

bool makeTemplate(const cv::Mat& image, const Eigen::Vector2d& centre, const Eigen::Matrix2d& B, int half,
                  PatchTemplate* result) {
  if (!extract(image, centre.cast<float>(), B.cast<float>(), half + 1, result->rimmed)) return false;
  result->patch.half = half;
  const int side = 2 * half, rim = side + 2;
  for (int v = 0; v < side; ++v) std::copy_n(result->rimmed + (v + 1) * rim + 1, side, result->patch.values + v * side);
  result->patch.statistics();
  return true;
}

float alignPatch(const cv::Mat& image, const PatchTemplate& reference, int max_iterations, Eigen::Vector2f* centre) {
  const Patch& wanted = reference.patch;
  const Gradients gradients(reference);
  const Eigen::Matrix2f information = gradients.information();
  const float texture = static_cast<float>(wanted.area()) * static_cast<float>(wanted.area());
  if (!(information.determinant() > 1e-2f * texture)) return -1;
  const Eigen::Matrix2f covariance = information.inverse();
  // Means drop out of both, since the gradients have none.
  const Eigen::Vector2f of_wanted = gradients.dot(valuesOf(wanted));
  const Eigen::Vector2f start = *centre;
  Patch window;
  window.half = wanted.half;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    if (!extractWindow(image, *centre, &window) || window.deviation < kFlat) return -1;
    const float gain = wanted.deviation / window.deviation;
    const Eigen::Vector2f step = covariance * (of_wanted - gain * gradients.dot(valuesOf(window)));
    *centre += step;
    if (!centre->allFinite() || (*centre - start).squaredNorm() > kMaxShift * kMaxShift) return -1;
    if (step.squaredNorm() < kConvergence * kConvergence) break;
  }
  return extractWindow(image, *centre, &window) ? zncc(wanted, window) : -1;
}

}  // namespace visual_frontend
