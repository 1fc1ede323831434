#include "heightmap_mcl/fft_cost.h"

#include <fftw3.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <mutex>
#include <new>
#include <stdexcept>
#include <utility>

#include "air_ground_common/geometry.h"
#include "cell_box.h"
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

/// A map as the cost sees it: heights above base, holes, levels of bounds.
struct Cells {
  explicit Cells(const HeightMap& map) : width(map.width), height(map.height), cap(map.cap), h(map.heights) {
    const auto base = static_cast<float>(baseHeight(map));
    for (float& value : h) {
      value -= base;
      defined += !std::isnan(value);
    }
    if (map.bounds.empty()) return;
    level.resize(h.size());
    for (std::size_t k = 0; k < h.size(); ++k) {
      level[k] = static_cast<std::uint8_t>(boundLevel(map, k));
      has[level[k]] = true;
    }
  }
  bool bounds() const { return std::find(has + 1, has + kBoundLevels + 1, true) != has + kBoundLevels + 1; }
  float levelHeight(int k) const { return static_cast<float>(cap * k / kBoundLevels); }

  /// Zero-padded `f(height, level)` of each cell, in rows of `columns`.
  template <typename F>
  void fill(const Plans& plans, float* real, const F& f) const {
    std::fill(real, real + plans.realSize(), 0.f);
    for (int r = 0; r < height; ++r) {
      float* out = real + static_cast<std::size_t>(r) * plans.columns;
      for (int c = 0; c < width; ++c) {
        const std::size_t k = static_cast<std::size_t>(r) * width + c;
        if (!std::isnan(h[k])) out[c] = f(h[k], level.empty() ? 0 : level[k]);
      }
    }
  }

  int width, height;
  double cap;
  std::vector<float> h;
  std::vector<std::uint8_t> level;  // empty: 0 throughout
  bool has[kBoundLevels + 1] = {};
  std::size_t defined = 0;
};

/// Transforms of a map: mask, heights and squared heights of the cells with a height, and of all with bounds at their
/// levels; for one level at a time mask of the bounds and what the heights lack of it, squared.
class Spectra {
 public:
  explicit Spectra(const Plans& plans) : floats_(2 * plans.spectrumSize()) {
    for (auto& s : known_) s = allocate(floats_);
    level_ = allocate(floats_);
  }

  void compute(const Plans& plans, const Cells& cells, float* real) {
    const auto transform = [&](Buffer& to, const auto& f) {
      if (!to) to = allocate(floats_);
      cells.fill(plans, real, f);
      plans.toSpectrum(real, to.get());
    };
    bounds_ = cells.bounds();
    transform(known_[0], [](float, int level) { return level ? 0.f : 1.f; });
    transform(known_[1], [](float h, int level) { return level ? 0.f : h; });
    transform(known_[2], [](float h, int level) { return level ? 0.f : h * h; });
    if (!bounds_) return;
    const auto value = [&](float h, int level) { return level ? cells.levelHeight(level) : h; };
    transform(all_[0], [](float, int) { return 1.f; });
    transform(all_[1], [&](float h, int level) { return value(h, level); });
    transform(all_[2], [&](float h, int level) { return value(h, level) * value(h, level); });
  }
  const float* boundsAt(const Plans& plans, const Cells& cells, int k, float* real) {
    cells.fill(plans, real, [k](float, int level) { return level == k ? 1.f : 0.f; });
    plans.toSpectrum(real, level_.get());
    return level_.get();
  }
  /// `level`: height of the level above the floor [m].
  const float* lackingAt(const Plans& plans, const Cells& cells, float level, float* real) {
    cells.fill(plans, real, [level](float h, int k) {
      const float lack = k ? 0.f : std::max(0.f, level - h);
      return lack * lack;
    });
    plans.toSpectrum(real, level_.get());
    return level_.get();
  }
  bool bounds() const { return bounds_; }
  kernel::MapSpectra known() const { return {known_[0].get(), known_[1].get(), known_[2].get()}; }
  kernel::MapSpectra all() const {
    return bounds_ ? kernel::MapSpectra{all_[0].get(), all_[1].get(), all_[2].get()} : known();
  }

 private:
  std::size_t floats_;
  Buffer known_[3], all_[3], level_;
  bool bounds_ = false;
};

/// The part of a map that holds its defined cells; rows and columns before it, and behind.
struct Cropped {
  explicit Cropped(const HeightMap& whole) {
    const auto [r0, r1, c0, c1] = definedBox(whole).value_or(CellBox{0, 0, 0, 0});
    row[0] = r0;
    row[1] = whole.height - 1 - r1;
    column[0] = c0;
    column[1] = whole.width - 1 - c1;
    map.resolution = whole.resolution;
    map.floor = whole.floor;
    map.cap = whole.cap;
    map.width = c1 - c0 + 1;
    map.height = r1 - r0 + 1;
    for (int r = r0; r <= r1; ++r) {
      const std::ptrdiff_t from = static_cast<std::ptrdiff_t>(r) * whole.width;
      map.heights.insert(map.heights.end(), whole.heights.begin() + from + c0, whole.heights.begin() + from + c1 + 1);
      if (whole.bounds.empty()) continue;
      map.bounds.insert(map.bounds.end(), whole.bounds.begin() + from + c0, whole.bounds.begin() + from + c1 + 1);
    }
  }

  HeightMap map;
  int row[2], column[2];
};

/// Defined cells in the first and in the last k rows, or columns.
struct Margins {
  Margins(const HeightMap& map, bool of_rows) {
    std::vector<int> count(of_rows ? map.height : map.width);
    for (int r = 0; r < map.height; ++r)
      for (int c = 0; c < map.width; ++c) count[of_rows ? r : c] += !std::isnan(map.at(r, c));
    first.push_back(0);
    last.push_back(0);
    for (auto n = count.begin(); n != count.end(); ++n) first.push_back(first.back() + *n);
    for (auto n = count.rbegin(); n != count.rend(); ++n) last.push_back(last.back() + *n);
  }
  int lines() const { return static_cast<int>(first.size()) - 1; }

  std::vector<int> first, last;
};

/// Rows (or columns) that a cyclic correlation needs. Offsets where the maps share too few lines for `needed` cells may
/// fall on each other, whichever way the aerial map is turned: together they have too few cells as well.
int linesFor(const Margins& air, const Margins& ground, double needed) {
  const int fewer = std::min(air.lines(), ground.lines());
  int shared = 0;
  for (int k = 1; k < fewer; ++k, ++shared) {
    const auto both = [k](const std::vector<int>& a, const std::vector<int>& b) { return std::min(a[k], b[k]); };
    const int straight = both(air.last, ground.first) + both(air.first, ground.last);
    const int opposite = both(air.first, ground.first) + both(air.last, ground.last);
    if (std::max(straight, opposite) >= needed) break;
  }
  return air.lines() + ground.lines() - 1 - shared;
}

struct Workspace {
  explicit Workspace(const Plans& plans) : air(plans) {
    for (auto& p : product) p = allocate(2 * plans.spectrumSize());
    for (auto& s : sum) s = allocate(plans.realSize());
  }
  Spectra air;
  Buffer product[kernel::kSums], sum[kernel::kSums];  // of correlate
  Buffer levels[2];                                   // what all levels of bounds add to product[3]; half a turn on
};

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
    Buffer bounds[kBoundLevels + 1],
        lacking[kBoundLevels + 1];                 // of the ground map, by level; bounds where it has some
    std::vector<std::unique_ptr<Workspace>> idle;  // guarded by Impl::mutex
  };

  explicit Impl(const HeightMap& map) : ground(map), cells(map), rows(map, true), columns(map, false) {
    if (cells.defined == 0) throw std::invalid_argument("FftCost: the ground height map has no defined cell");
  }

  std::shared_ptr<Size> sizeFor(int rows, int columns) {
    const std::lock_guard<std::mutex> lock(mutex);
    for (const auto& size : sizes) {
      if (size->is(rows, columns)) return size;
    }
    auto size = std::make_shared<Size>(rows, columns);
    const Plans& plans = size->plans;
    const Buffer real = allocate(plans.realSize());
    size->ground.compute(plans, cells, real.get());
    const auto keep = [&plans](const float* spectrum) {
      Buffer copy = allocate(2 * plans.spectrumSize());
      std::copy(spectrum, spectrum + 2 * plans.spectrumSize(), copy.get());
      return copy;
    };
    for (int k = 1; k <= kBoundLevels && !ground.bounds.empty(); ++k) {
      if (cells.has[k]) size->bounds[k] = keep(size->ground.boundsAt(plans, cells, k, real.get()));
      size->lacking[k] = keep(size->ground.lackingAt(plans, cells, cells.levelHeight(k), real.get()));
    }
    sizes.push_back(size);
    if (sizes.size() > kSizesKept) sizes.pop_front();
    return size;
  }

  std::unique_ptr<Workspace> acquire(Size& size) {
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

  void release(Size& size, std::unique_ptr<Workspace> workspace) {
    const std::lock_guard<std::mutex> lock(mutex);
    size.idle.push_back(std::move(workspace));
  }

  bool bounds(const Cells& air, const Size& size) const { return air.bounds() || size.ground.bounds(); }

  /// Transforms of the aerial map into work.air, of its levels into work.levels: `ways` of them (see sums).
  void transform(const Cells& air, Size& size, int ways, Workspace& work) const {
    const Plans& plans = size.plans;
    const int n = static_cast<int>(plans.spectrumSize());
    float* const real = work.sum[0].get();
    work.air.compute(plans, air, real);
    if (!bounds(air, size)) return;
    for (int way = 0; way < ways; ++way) {
      if (!work.levels[way]) work.levels[way] = allocate(2 * plans.spectrumSize());
      std::fill_n(work.levels[way].get(), 2 * plans.spectrumSize(), 0.f);
    }
    const auto add = [&](const float* of_air, const Buffer& of_ground) {
      for (int way = 0; way < ways; ++way)
        kernel::addCorrelation(of_air, of_ground.get(), n, way == 1, work.levels[way].get());
    };
    for (int k = 1; k <= kBoundLevels; ++k) {
      if (size.bounds[k]) add(work.air.lackingAt(plans, air, cells.levelHeight(k), real), size.bounds[k]);
      if (air.has[k]) add(work.air.boundsAt(plans, air, k, real), size.lacking[k]);
    }
  }

  /// Leaves the sums over the overlap at every offset in work.sum, in the order of OverlapSums, still to be scaled.
  /// Way 1: of the aerial map turned by half a turn, whose spectra are the conjugate ones but for a shift: offset u
  /// lies at u + size of the aerial map - 1.
  void sums(const Cells& air, const Size& size, int way, Workspace& work) const {
    const Plans& plans = size.plans;
    const int n = static_cast<int>(plans.spectrumSize());
    float* products[kernel::kSums];
    for (int k = 0; k < kernel::kSums; ++k) products[k] = work.product[k].get();
    const bool with_bounds = bounds(air, size);
    kernel::correlate(work.air.known(), work.air.all(), size.ground.known(), size.ground.all(), n, with_bounds,
                      way == 1, products);
    if (with_bounds) kernel::addTo(work.levels[way].get(), 2 * n, products[3]);
    for (int k = 0; k < kernel::kSums; ++k) {
      if (with_bounds || (k != 1 && k != 6)) plans.toReal(products[k], work.sum[k].get());
    }
    if (with_bounds) return;
    for (std::size_t i = 0; i < plans.realSize(); ++i) {
      work.sum[1][i] = work.sum[0][i];
      work.sum[6][i] = work.sum[4][i] - work.sum[2][i];
    }
  }

  FftSize neededFor(const Cropped& air, const CostSettings& settings) const {
    const Margins air_rows(air.map, true), air_columns(air.map, false);
    const double needed = settings.min_overlap * smaller(air_rows.first.back(), settings);
    return {paddedSize(linesFor(air_rows, rows, needed)), paddedSize(linesFor(air_columns, columns, needed))};
  }

  double smaller(double aerial_cells, const CostSettings& settings) const {
    return std::max(settings.cells(aerial_cells, static_cast<double>(cells.defined)), 1.0);
  }

  HeightMap ground;
  Cells cells;
  Margins rows, columns;
  std::mutex mutex;
  // The merged map grows and moves: of the sizes it has had, the filter's and the verification's last ones matter.
  static constexpr std::size_t kSizesKept = 2;
  std::deque<std::shared_ptr<Size>> sizes;
};

FftCost::FftCost(const HeightMap& ground) : impl_(std::make_unique<Impl>(ground)) {}
FftCost::~FftCost() = default;
FftCost::FftCost(FftCost&&) noexcept = default;
FftCost& FftCost::operator=(FftCost&&) noexcept = default;

namespace {

/// No offset has a cost.
CostMap emptyMap(const HeightMap& ground, const HeightMap& turned, double yaw, int way) {
  CostMap map;
  map.resolution = ground.resolution;
  map.yaw = way == 0 ? yaw : air_ground_common::wrapAngle(yaw + M_PI);
  map.width = ground.width + turned.width - 1;
  map.height = ground.height + turned.height - 1;
  // Aerial cell (0, 0) lies on ground cell u = (column - turned.width + 1, row - turned.height + 1).
  const auto corner = [&](double origin, int cells) { return way == 0 ? origin : -origin - cells * turned.resolution; };
  map.x0 = ground.origin_x - corner(turned.origin_x, turned.width) - (turned.width - 1) * ground.resolution;
  map.y0 = ground.origin_y - corner(turned.origin_y, turned.height) - (turned.height - 1) * ground.resolution;
  map.cost.assign(static_cast<std::size_t>(map.width) * map.height, std::numeric_limits<float>::infinity());
  return map;
}

}  // namespace

FftSize FftCost::sizeFor(const HeightMap& turned, const CostSettings& settings) const {
  return impl_->neededFor(Cropped(turned), settings);
}

CostMap FftCost::operator()(const HeightMap& turned, double yaw, const CostSettings& settings,
                            const FftSize& least) const {
  CostMap map;
  compute(turned, yaw, settings, least, 1, &map);
  return map;
}

std::array<CostMap, 2> FftCost::andOpposite(const HeightMap& turned, double yaw, const CostSettings& settings,
                                            const FftSize& least) const {
  std::array<CostMap, 2> maps;
  compute(turned, yaw, settings, least, 2, maps.data());
  return maps;
}

void FftCost::compute(const HeightMap& turned, double yaw, const CostSettings& settings, const FftSize& least, int ways,
                      CostMap* maps) const {
  const HeightMap& ground = impl_->ground;
  if (std::abs(turned.resolution - ground.resolution) > 1e-9) {
    throw std::invalid_argument("FftCost: aerial and ground height map must have the same resolution");
  }
  const Cropped cropped(turned);
  const Cells air(cropped.map);
  if (air.bounds() && (ground.bounds.empty() || ground.cap != turned.cap)) {
    throw std::invalid_argument("FftCost: maps with bounds must have the same cap");
  }
  const FftSize needed = impl_->neededFor(cropped, settings);
  const auto size = impl_->sizeFor(std::max(needed.rows, least.rows), std::max(needed.columns, least.columns));
  const Plans& plans = size->plans;
  auto workspace = impl_->acquire(*size);
  impl_->transform(air, *size, ways, *workspace);

  const auto scale = static_cast<float>(1.0 / static_cast<double>(plans.realSize()));
  const auto smaller = static_cast<float>(impl_->smaller(static_cast<double>(air.defined), settings));
  for (int way = 0; way < ways; ++way) {
    CostMap& map = maps[way] = emptyMap(ground, turned, yaw, way);
    impl_->sums(air, *size, way, *workspace);
    // Offset u of the cropped map lies at u, cyclically; of the one turned by half a turn at u + its size - 1.
    const int row0 = way == 0 ? 0 : air.height - 1, column0 = way == 0 ? 0 : air.width - 1;
    const auto cyclic = [](int index, int period) { return (index + period) % period; };
    for (int u = 1 - air.height; u < ground.height; ++u) {
      const int row = u + turned.height - 1 - cropped.row[way];
      const std::size_t line = static_cast<std::size_t>(cyclic(u + row0, plans.rows)) * plans.columns;
      int column = turned.width - cropped.column[way] - air.width,
          from = cyclic(1 - air.width + column0, plans.columns);
      for (int left = air.width + ground.width - 1, count = 0; left > 0; left -= count, column += count, from = 0) {
        count = std::min(left, plans.columns - from);
        const float* sums[kernel::kSums];
        for (int k = 0; k < kernel::kSums; ++k) sums[k] = workspace->sum[k].get() + line + from;
        kernel::scoreRow(sums, count, scale, smaller, settings,
                         map.cost.data() + static_cast<std::size_t>(row) * map.width + column);
      }
    }
  }
  impl_->release(*size, std::move(workspace));
}

}  // namespace heightmap_mcl
