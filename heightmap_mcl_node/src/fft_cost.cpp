#include "heightmap_mcl/fft_cost.h"

#include <fftw3.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <mutex>
#include <new>
#include <stdexcept>
#include <utility>

#include "zmssd_kernel.h"

namespace heightmap_mcl {
namespace {

/// FFTW's planner is not thread-safe; executing plans is.
std::mutex planner_mutex;

struct FftwFree {
  void operator()(float* p) const { fftwf_free(p); }
};
using Buffer = std::unique_ptr<float[], FftwFree>;
Buffer allocate(std::size_t floats) {
  Buffer buffer(fftwf_alloc_real(floats));
  if (!buffer) throw std::bad_alloc();
  return buffer;
}

/// Rounds up so that maps of nearly the same size share plans and spectra.
int paddedSize(int n) { return fiveSmoothSize((n + 15) / 16 * 16); }

struct Plans {
  Plans(int rows_, int columns_) : rows(rows_), columns(columns_) {
    const Buffer real = allocate(realSize());
    const Buffer spectrum = allocate(2 * spectrumSize());
    auto* complex = reinterpret_cast<fftwf_complex*>(spectrum.get());
    const std::lock_guard<std::mutex> lock(planner_mutex);
    // ESTIMATE: a measured plan may differ from run to run, and with it the last bit of a cost.
    forward = fftwf_plan_dft_r2c_2d(rows, columns, real.get(), complex, FFTW_ESTIMATE);
    backward = fftwf_plan_dft_c2r_2d(rows, columns, complex, real.get(), FFTW_ESTIMATE);
  }
  ~Plans() {
    const std::lock_guard<std::mutex> lock(planner_mutex);
    fftwf_destroy_plan(forward);
    fftwf_destroy_plan(backward);
  }
  Plans(const Plans&) = delete;
  Plans& operator=(const Plans&) = delete;

  std::size_t realSize() const { return static_cast<std::size_t>(rows) * columns; }
  std::size_t spectrumSize() const { return static_cast<std::size_t>(rows) * (columns / 2 + 1); }
  void toSpectrum(float* real, float* spectrum) const {
    fftwf_execute_dft_r2c(forward, real, reinterpret_cast<fftwf_complex*>(spectrum));
  }
  void toReal(float* spectrum, float* real) const {
    fftwf_execute_dft_c2r(backward, reinterpret_cast<fftwf_complex*>(spectrum), real);
  }

  int rows, columns;
  fftwf_plan forward, backward;
};

/// Transforms of mask, heights and squared heights of a map.
struct Spectra {
  explicit Spectra(const Plans& plans) {
    for (auto& s : spectrum) s = allocate(2 * plans.spectrumSize());
  }

  void compute(const Plans& plans, const HeightMap& map, float mean, float* real) {
    for (int power = 0; power < 3; ++power) {
      std::fill(real, real + plans.realSize(), 0.f);
      for (int r = 0; r < map.height; ++r) {
        float* out = real + static_cast<std::size_t>(r) * plans.columns;
        const float* in = map.heights.data() + static_cast<std::size_t>(r) * map.width;
        for (int c = 0; c < map.width; ++c) {
          if (std::isnan(in[c])) continue;
          const float h = in[c] - mean;
          out[c] = power == 0 ? 1.f : power == 1 ? h : h * h;
        }
      }
      plans.toSpectrum(real, spectrum[power].get());
    }
  }

  Buffer spectrum[3];
};

struct Workspace {
  explicit Workspace(const Plans& plans) : air(plans) {
    for (auto& p : product) p = allocate(2 * plans.spectrumSize());
    for (auto& s : sum) s = allocate(plans.realSize());
  }
  Spectra air;
  Buffer product[6], sum[6];  // of correlate
};

double meanHeight(const HeightMap& map, std::size_t& cells) {
  double sum = 0;
  cells = 0;
  for (float h : map.heights) {
    if (std::isnan(h)) continue;
    sum += h;
    ++cells;
  }
  return cells > 0 ? sum / static_cast<double>(cells) : 0;
}

}  // namespace

int fiveSmoothSize(int n) {
  if (n < 1) throw std::invalid_argument("fiveSmoothSize: size must be positive");
  for (int candidate = n;; ++candidate) {
    int rest = candidate;
    for (int prime : {2, 3, 5}) {
      while (rest % prime == 0) rest /= prime;
    }
    if (rest == 1) return candidate;
  }
}

struct FftCost::Impl {
  /// All that belongs to one padded size.
  struct Size {
    Size(int rows, int columns) : plans(rows, columns), ground(plans) {}
    bool is(int rows, int columns) const { return plans.rows == rows && plans.columns == columns; }
    Plans plans;
    Spectra ground;
    std::vector<std::unique_ptr<Workspace>> idle;  // guarded by Impl::mutex
  };

  explicit Impl(const HeightMap& map) : ground(map) {
    mean = static_cast<float>(meanHeight(ground, cells));
    if (cells == 0) throw std::invalid_argument("FftCost: the ground height map has no defined cell");
  }

  std::shared_ptr<Size> sizeFor(int rows, int columns) {
    const std::lock_guard<std::mutex> lock(mutex);
    for (const auto& size : sizes) {
      if (size->is(rows, columns)) return size;
    }
    auto size = std::make_shared<Size>(rows, columns);
    const Buffer real = allocate(size->plans.realSize());
    size->ground.compute(size->plans, ground, mean, real.get());
    sizes.push_back(size);
    if (sizes.size() > kSizesKept) sizes.pop_front();
    return size;
  }

  std::unique_ptr<Workspace> take(Size& size) {
    {
      const std::lock_guard<std::mutex> lock(mutex);
      if (!size.idle.empty()) {
        auto workspace = std::move(size.idle.back());
        size.idle.pop_back();
        return workspace;
      }
    }
    return std::make_unique<Workspace>(size.plans);
  }

  void give(Size& size, std::unique_ptr<Workspace> workspace) {
    const std::lock_guard<std::mutex> lock(mutex);
    size.idle.push_back(std::move(workspace));
  }

  HeightMap ground;
  std::size_t cells = 0;  // defined ones
  float mean = 0;
  std::mutex mutex;
  // The merged map grows and moves: of the sizes it has had, the filter's and the verification's last ones matter.
  static constexpr std::size_t kSizesKept = 2;
  std::deque<std::shared_ptr<Size>> sizes;
};

FftCost::FftCost(const HeightMap& ground) : impl_(std::make_unique<Impl>(ground)) {}
FftCost::~FftCost() = default;
FftCost::FftCost(FftCost&&) noexcept = default;
FftCost& FftCost::operator=(FftCost&&) noexcept = default;

CostMap FftCost::operator()(const HeightMap& turned, double yaw, const CostSettings& settings) const {
  const HeightMap& ground = impl_->ground;
  if (std::abs(turned.resolution - ground.resolution) > 1e-9) {
    throw std::invalid_argument("FftCost: aerial and ground height map must have the same resolution");
  }
  CostMap result;
  result.resolution = ground.resolution;
  result.yaw = yaw;
  result.width = ground.width + turned.width - 1;
  result.height = ground.height + turned.height - 1;
  // Aerial cell (0, 0) lies on ground cell u = (column - turned.width + 1, row - turned.height + 1).
  result.x0 = ground.origin_x - turned.origin_x - (turned.width - 1) * ground.resolution;
  result.y0 = ground.origin_y - turned.origin_y - (turned.height - 1) * ground.resolution;

  std::size_t cells = 0;
  const auto mean = static_cast<float>(meanHeight(turned, cells));
  const auto size = impl_->sizeFor(paddedSize(result.height), paddedSize(result.width));
  const Plans& plans = size->plans;
  auto workspace = impl_->take(*size);
  workspace->air.compute(plans, turned, mean, workspace->sum[0].get());
  const auto& a = workspace->air.spectrum;
  const auto& g = size->ground.spectrum;
  const float* const air[3] = {a[0].get(), a[1].get(), a[2].get()};
  const float* const below[3] = {g[0].get(), g[1].get(), g[2].get()};
  float* products[6];
  for (int k = 0; k < 6; ++k) products[k] = workspace->product[k].get();
  kernel::correlate(air, below, static_cast<int>(plans.spectrumSize()), products);
  for (int k = 0; k < 6; ++k) plans.toReal(products[k], workspace->sum[k].get());

  // Negative offsets wrap to the far end of the padded grid.
  result.cost.resize(static_cast<std::size_t>(result.width) * result.height);
  const auto scale = static_cast<float>(1.0 / static_cast<double>(plans.realSize()));
  const std::size_t smaller = std::max<std::size_t>(std::min(cells, impl_->cells), 1);
  const int negative = turned.width - 1;
  for (int row = 0; row < result.height; ++row) {
    const int u = row - (turned.height - 1);
    const std::size_t line = static_cast<std::size_t>(u < 0 ? u + plans.rows : u) * plans.columns;
    float* out = result.cost.data() + static_cast<std::size_t>(row) * result.width;
    const auto segment = [&](std::size_t from, int count, float* to) {
      const float* sums[6];
      for (int k = 0; k < 6; ++k) sums[k] = workspace->sum[k].get() + from;
      kernel::scoreRow(sums, count, scale, static_cast<float>(smaller), settings, to);
    };
    segment(line + static_cast<std::size_t>(plans.columns - negative), negative, out);
    segment(line, ground.width, out + negative);
  }
  impl_->give(*size, std::move(workspace));
  return result;
}

CostMinimum findMinimum(const CostMap& map, const HeightMap& turned, const HeightMap& ground,
                        const CostSettings& settings) {
  CostMinimum best;
  float lowest = std::numeric_limits<float>::infinity(), highest = 0;
  for (float c : map.cost) {
    if (!std::isfinite(c)) continue;
    lowest = std::min(lowest, c);
    highest = std::max(highest, c);
  }
  if (!std::isfinite(lowest)) return best;
  const float bound = lowest + 1e-4f * highest + 1e-9f;
  for (int row = 0; row < map.height; ++row) {
    for (int column = 0; column < map.width; ++column) {
      if (map.at(row, column) > bound) continue;
      const PlanarPose pose = map.pose(row, column);
      // The map is turned already and its pivot is its origin.
      const Zmssd value = zmssdReference(turned, ground, Eigen::Vector2d::Zero(), {pose.x, pose.y, 0}, settings);
      if (value.score < best.zmssd.score) best = {row, column, pose, pose, value};
    }
  }
  const auto vertex = [&](float before, float after) {
    const double centre = best.zmssd.score, bend = before - 2 * centre + after;
    if (!std::isfinite(bend) || bend <= 0) return 0.0;
    return std::clamp(0.5 * (before - after) / bend, -0.5, 0.5);
  };
  if (best.column > 0 && best.column + 1 < map.width) {
    best.subcell.x += map.resolution * vertex(map.at(best.row, best.column - 1), map.at(best.row, best.column + 1));
  }
  if (best.row > 0 && best.row + 1 < map.height) {
    best.subcell.y += map.resolution * vertex(map.at(best.row - 1, best.column), map.at(best.row + 1, best.column));
  }
  return best;
}

}  // namespace heightmap_mcl
