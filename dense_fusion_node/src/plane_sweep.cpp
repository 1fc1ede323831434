#include "dense_fusion/plane_sweep.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>

#include "air_ground_common/first_exception.h"
#include "dense_fusion/cost_kernels.h"
#include "other_surfaces.h"

namespace dense_fusion {
namespace {

constexpr double kBorder = 0.5;    // samples stay this far inside the image [px]
constexpr int kStrip = 96;         // columns worked on at once, at most
constexpr int kFewSamples = 2;     // of a pixel where frames lie far apart ...
constexpr double kFewRatio = 0.7;  // ... whose best cost must then be this share of max_peak_ratio

kernels::RowOfFrame rowOfFrame(const Eigen::Matrix3d& H, const Eigen::Vector3d& b, int y) {
  return {{float(H(0, 1) * y + H(0, 2)), float(H(1, 1) * y + H(1, 2)), float(H(2, 1) * y + H(2, 2))},
          {float(H(0, 0)), float(H(1, 0)), float(H(2, 0))},
          {float(b.x()), float(b.y()), float(b.z())}};
}

// Interval of x in [0, width) where lower <= (a + x b) holds; intersects it with [*begin, *end].
void clipHalfLine(double a, double b, double* begin, double* end) {
  if (std::abs(b) < 1e-12) {
    if (a < 0) *end = *begin - 1;
  } else if (b > 0) {
    *begin = std::max(*begin, -a / b);
  } else {
    *end = std::min(*end, -a / b);
  }
}

// Pixels [x0, x1) of a row whose samples stay in the image for one hypothesis: they form an interval, because the set
// of pixels that a homography with positive w maps into a rectangle is convex.
void clipRow(const Eigen::Vector3d& at_zero, const Eigen::Vector3d& per_x, int width, int height, double* begin,
             double* end) {
  clipHalfLine(at_zero.z() - 1e-3, per_x.z(), begin, end);
  clipHalfLine(at_zero.x() - kBorder * at_zero.z(), per_x.x() - kBorder * per_x.z(), begin, end);
  clipHalfLine(at_zero.y() - kBorder * at_zero.z(), per_x.y() - kBorder * per_x.z(), begin, end);
  const double right = width - 1 - kBorder, bottom = height - 1 - kBorder;
  clipHalfLine(right * at_zero.z() - at_zero.x(), right * per_x.z() - per_x.x(), begin, end);
  clipHalfLine(bottom * at_zero.z() - at_zero.y(), bottom * per_x.z() - per_x.y(), begin, end);
}

}  // namespace

PlaneSweep::PlaneSweep(const air_ground_common::CameraModel& camera, const PlaneSweepSettings& settings)
    : camera_(camera), settings_(settings) {
  camera.validate();
  if (camera.hasDistortion()) throw std::invalid_argument("plane sweep: needs an undistorted camera");
  if (settings.hypotheses < 16 || settings.hypotheses > 1000)
    throw std::invalid_argument("plane sweep: hypotheses must lie in 16..1000, not " +
                                std::to_string(settings.hypotheses));
  if (settings.max_frames < 1 || settings.max_frames > 64)
    throw std::invalid_argument("plane sweep: max_frames must lie in 1..64, not " +
                                std::to_string(settings.max_frames));
  if (settings.aggregation_radius < 0 || settings.aggregation_radius > 8)
    throw std::invalid_argument("plane sweep: aggregation_radius must lie in 0..8");
  if (settings.threads < 1) throw std::invalid_argument("plane sweep: threads must be at least 1");
}

void PlaneSweep::start(const Frame& reference, double depth_min, double depth_max) {
  constexpr double kNearest = 1e-6;  // [m]; inverse depths are numbers
  if (!(depth_min >= kNearest) || !(depth_max > depth_min) || !std::isfinite(depth_max))
    throw std::invalid_argument("plane sweep: depth range [" + std::to_string(depth_min) + ", " +
                                std::to_string(depth_max) + "] m must be positive and rising");
  if (reference.normalized.cols != camera_.width || reference.normalized.rows != camera_.height)
    throw std::invalid_argument("plane sweep: the reference image's size differs from the camera's");
  reference_ = reference;
  const int D = settings_.hypotheses;
  inverse_depth_.resize(D);
  for (int d = 0; d < D; ++d) {
    const double s = static_cast<double>(d) / (D - 1);
    inverse_depth_[d] = static_cast<float>((1 - s) / depth_max + s / depth_min);
  }
  views_.clear();
  squared_parallax_ = 0;
  started_ = true;
}

double PlaneSweep::parallax() const { return views_.empty() ? 0 : std::sqrt(squared_parallax_ / frames()); }

bool PlaneSweep::add(const Frame& frame) {
  if (!started_) throw std::logic_error("plane sweep: add() before start()");
  if (frame.normalized.cols != camera_.width || frame.normalized.rows != camera_.height)
    throw std::invalid_argument("plane sweep: the frame's size differs from the camera's");
  if (full()) return false;
  const int width = camera_.width, height = camera_.height;
  // A point at inverse depth rho on the reference pixel x = (u, v, 1): K (R K^-1 x + rho t), up to scale.
  const Eigen::Isometry3d T_frame_reference = frame.T_map_camera.inverse() * reference_.T_map_camera;
  const Eigen::Matrix3d K = camera_.K();
  const Eigen::Matrix3d H = K * T_frame_reference.linear() * K.inverse();
  const Eigen::Vector3d b = K * T_frame_reference.translation();
  View view;
  const double rho[2] = {inverse_depth_.front(), inverse_depth_.back()};

  if (!H.allFinite() || !b.allFinite()) return false;
  bool any = false;
  for (int y = 0; y < height; ++y) {
    double begin = 0, end = width - 1;
    const Eigen::Vector3d at_zero = H * Eigen::Vector3d(0, y, 1);
    for (const double r : rho) clipRow(at_zero + r * b, H.col(0), width, height, &begin, &end);
    view.x0.push_back(begin <= end ? static_cast<int>(std::ceil(begin)) : 0);
    view.x1.push_back(begin <= end ? static_cast<int>(std::floor(end)) + 1 : 0);
    any = any || view.x1.back() > view.x0.back();
    view.rows.push_back(rowOfFrame(H, b, y));
    view.between.push_back(kernels::hypothesesBetween(view.x0.back(), view.x1.back(), view.rows.back(),
                                                      inverse_depth_.data(), settings_.hypotheses));
  }
  if (!any) return false;

  view.packed.resize(static_cast<std::size_t>(width) * height);
  kernels::packNeighborhoods(frame.normalized.ptr<std::uint8_t>(), width, height, view.packed.data());
  // Shift of the image centre's sample between the two end planes.
  const Eigen::Vector3d centre(camera_.cx, camera_.cy, 1);
  const Eigen::Vector2d far = (H * centre + rho[0] * b).hnormalized(), near = (H * centre + rho[1] * b).hnormalized();
  squared_parallax_ += (near - far).squaredNorm();
  views_.push_back(std::move(view));
  return true;
}

void PlaneSweep::sumCosts(int y, const Strip& strip, CostRow* row) const {
  const int width = camera_.width, D = settings_.hypotheses, at_zero = strip.begin - settings_.aggregation_radius;
  row->cost.resize(static_cast<std::size_t>(D) * strip.stride);
  std::memset(row->cost.data(), 0, row->cost.size() * sizeof row->cost[0]);
  row->samples.assign(strip.stride, 0);
  for (const View& view : views_) {
    const int x0 = std::max(view.x0[y], at_zero), x1 = std::min(view.x1[y], strip.end + settings_.aggregation_radius);
    if (x1 <= x0) continue;
    kernels::addRow(reference_.normalized.ptr<std::uint8_t>(y), x0, x1, view.rows[y], inverse_depth_.data(), D,
                    view.between[y], view.packed.data(), width, row->cost.data() + (x0 - at_zero), strip.stride);
    for (int x = x0; x < x1; ++x) ++row->samples[x - at_zero];
  }
}

void PlaneSweep::estimateRow(int y, const Strip& strip, const Winners& winners, const CostRow& own,
                             const Judgement& judgement, DepthMap* map, cv::Mat* cost) const {
  const int D = settings_.hypotheses;
  float* depth = map->depth.ptr<float>(y) + strip.begin;
  float* confidence = map->confidence.ptr<float>(y) + strip.begin;
  const double rho_step = (static_cast<double>(inverse_depth_.back()) - inverse_depth_.front()) / (D - 1);
  // Least-squares parabola c0 + c1 k + c2 k^2 over k = -w..w: closed form from the moments of k.
  const int w = judgement.half_width;
  double m2 = 0, m4 = 0;
  for (int k = -w; k <= w; ++k) {
    m2 += k * k;
    m4 += double(k) * k * k * k;
  }
  const double n_fit = 2 * w + 1, determinant = n_fit * m4 - m2 * m2;
  for (int i = 0; i < strip.end - strip.begin; ++i) {
    const int frames = own.samples[i + settings_.aggregation_radius];
    if (frames < judgement.least_samples) continue;
    const int d = winners.index[i];
    const double ratio =
        frames < settings_.min_samples ? kFewRatio * settings_.max_peak_ratio : settings_.max_peak_ratio;
    const double best = winners.best[i], limit = ratio * winners.second[i];
    if (d < w || d + w >= D || !(best < limit)) continue;
    double s0 = 0, s1 = 0, s2 = 0;
    for (int k = -w; k <= w; ++k) {
      const double c = winners.cost[static_cast<std::size_t>(d + k) * strip.stride + i];
      s0 += c;
      s1 += c * k;
      s2 += c * k * k;
    }
    const double curvature = (n_fit * s2 - m2 * s0) / determinant, slope = s1 / m2;
    if (!(curvature > 0)) continue;
    const double offset = -slope / (2 * curvature);
    if (!(std::abs(offset) < w)) continue;
    // A floor of one unit a sample (two grey levels) stands for the quantisation.
    const double n = winners.samples[i], noise = std::max(1.0, best / n);
    const double sigma_rho = rho_step * std::sqrt(noise / curvature);
    const double rho = inverse_depth_[d] + offset * rho_step;
    const double z = 1 / rho, sigma_z = z * z * sigma_rho / settings_.confidence_sigma;
    const double uniqueness = 1 - best / limit;
    const double c = std::min(1.0, 2 * uniqueness) / (1 + sigma_z * sigma_z);
    if (c < settings_.min_confidence) continue;
    depth[i] = static_cast<float>(z);
    confidence[i] = static_cast<float>(c);
    cost->at<float>(y, strip.begin + i) = static_cast<float>(best / n);
  }
}

// Rows [first, last) of a strip, one after the other: a window's columns are those of the row before, with one row more
// and one less.
void PlaneSweep::sweepStrip(const Strip& strip, int first, int last, const Judgement& judgement, DepthMap* map,
                            cv::Mat* cost) const {
  const int height = camera_.height, D = settings_.hypotheses, r = settings_.aggregation_radius;
  const int slab = D * strip.stride, n = (strip.end - strip.begin + 15) / 16 * 16;  // whole vectors
  std::vector<std::uint32_t> column(slab, 0), count(strip.stride, 0);
  Winners winners;
  winners.cost.resize(slab);
  for (auto* of_pixel : {&winners.best, &winners.second, &winners.samples}) of_pixel->resize(n);
  winners.index.resize(n);
  std::vector<CostRow> rows(2 * r + 2);  // from the one that leaves the window to the one that enters it
  const auto rowAt = [&rows](int y) -> CostRow& { return rows[static_cast<std::size_t>(y) % rows.size()]; };
  const auto slide = [&](int enter, int leave) {
    const bool in = enter < height, out = leave >= 0;
    if (in) sumCosts(enter, strip, &rowAt(enter));
    kernels::slideSum(column.data(), in ? rowAt(enter).cost.data() : nullptr, out ? rowAt(leave).cost.data() : nullptr,
                      slab);
    kernels::slideSum(count.data(), in ? rowAt(enter).samples.data() : nullptr,
                      out ? rowAt(leave).samples.data() : nullptr, strip.stride);
  };
  for (int y = std::max(0, first - r); y < first + r; ++y) slide(y, -1);
  for (int y = first; y < last; ++y) {
    slide(y + r, y == first ? -1 : y - r - 1);
    kernels::boxRows(column.data(), D, strip.stride, n, r, winners.cost.data());
    kernels::boxRows(count.data(), 1, strip.stride, n, r, winners.samples.data());
    kernels::winnerTakesAll(winners.cost.data(), D, strip.stride, n, 2 * judgement.half_width, winners.best.data(),
                            winners.index.data(), winners.second.data());
    estimateRow(y, strip, winners, rowAt(y), judgement, map, cost);
  }
}

// A window that straddles an edge finds either surface, and carries it over the edge; the pixel's nearest neighbourhood
// tells on which side it lies.
void PlaneSweep::chooseSurfaces(const cv::Mat& cost, DepthMap* map) const {
  const cv::Mat depth = map->depth.clone(), confidence = map->confidence.clone();
  const cv::Mat others = otherSurfaces(depth, cost, settings_.aggregation_radius, settings_.threads);
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(dynamic, 8) num_threads(settings_.threads)
  for (int y = 0; y < depth.rows; ++y)
    failure.guard([&] {
      std::vector<std::int32_t> x;
      std::vector<float> own, other;  // inverse depths
      for (int u = 0; u < depth.cols; ++u) {
        const int elsewhere = others.at<int>(y, u);
        if (elsewhere < 0) continue;
        x.push_back(u);
        own.push_back(1 / depth.at<float>(y, u));
        other.push_back(1 / depth.ptr<float>()[elsewhere]);
      }
      const std::vector<float> cost_own = costsAround(y, x, own), cost_other = costsAround(y, x, other);
      for (std::size_t i = 0; i < x.size(); ++i) {
        if (!(cost_other[i] < cost_own[i])) continue;
        const int elsewhere = others.at<int>(y, x[i]);
        map->depth.at<float>(y, x[i]) = depth.ptr<float>()[elsewhere];
        map->confidence.at<float>(y, x[i]) = confidence.ptr<float>()[elsewhere];
      }
    });
  failure.rethrow();
}

std::vector<float> PlaneSweep::costsAround(int y, const std::vector<std::int32_t>& x,
                                           const std::vector<float>& rho) const {
  constexpr int kRadius = 1;
  std::vector<float> sums(x.size(), 0.F);
  for (int v = std::max(0, y - kRadius); v <= std::min(camera_.height - 1, y + kRadius); ++v)
    for (const View& view : views_) {
      if (view.x1[v] <= view.x0[v]) continue;
      for (int dx = -kRadius; dx <= kRadius; ++dx)
        kernels::addSquaredDifferences(reference_.normalized.ptr<std::uint8_t>(v), x.data(), rho.data(),
                                       static_cast<int>(x.size()), dx, view.x0[v], view.x1[v], view.rows[v],
                                       view.packed.data(), camera_.width, sums.data());
    }
  return sums;
}

DepthMap PlaneSweep::depthMap(bool few) const {
  if (!started_) throw std::logic_error("plane sweep: depthMap() before start()");
  const int width = camera_.width, height = camera_.height, D = settings_.hypotheses;
  DepthMap map;
  map.stamp = reference_.stamp;
  map.camera = camera_;
  map.T_map_camera = reference_.T_map_camera;
  map.intensity = reference_.intensity;
  map.frames = frames() + 1;
  map.depth = cv::Mat(height, width, CV_32F, cv::Scalar(std::numeric_limits<float>::quiet_NaN()));
  map.confidence = cv::Mat::zeros(height, width, CV_32F);
  if (parallax() < settings_.min_parallax) return map;
  // The cost is near-quadratic within half a pixel of its minimum; fit over that range.
  const double per_hypothesis = parallax() / (D - 1);
  const Judgement judgement{std::clamp(static_cast<int>(std::lround(0.5 / per_hypothesis)), 1, D / 10),
                            few ? std::min(kFewSamples, settings_.min_samples) : settings_.min_samples};
  const int bands = settings_.threads, band = (height + bands - 1) / bands;
  const int strips = (width + kStrip - 1) / kStrip, columns = (width + strips - 1) / strips;
  cv::Mat cost(height, width, CV_32F);
  air_ground_common::FirstException failure;
#pragma omp parallel for collapse(2) schedule(dynamic, 1) num_threads(settings_.threads)
  for (int b = 0; b < bands; ++b)
    for (int s = 0; s < strips; ++s)
      failure.guard([&] {
        const int begin = std::min(width, s * columns), end = std::min(width, begin + columns);
        const int stride = kernels::costStride(end - begin + 2 * settings_.aggregation_radius);
        sweepStrip({begin, end, stride}, b * band, std::min(height, (b + 1) * band), judgement, &map, &cost);
      });
  failure.rethrow();
  chooseSurfaces(cost, &map);
  return map;
}

}  // namespace dense_fusion
