// Level and scale of the aerial clouds, for a MAV whose odometry has neither: the dominant floor, and a logarithmic
// grid of scales, coarse to fine.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "heightmap_mcl/dominant_floor.h"
#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

/// The kept clouds together, level, thinned.
struct HeightMapLocalizer::RawCloud {
  std::vector<Eigen::Vector3f> points;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double extent = 0;  // longer edge in plan
};

struct HeightMapLocalizer::ScaleTrial {
  double scale = 1;
  Placement best;  // of scale * centre
  Zmssd zmssd;     // there
  ScaleBackground background;
  /// Logarithm of the likelihood that the heights in the overlap belong together, over that of their being unrelated:
  /// each independent piece of ground counts by how much less the maps differ than at other places.
  double evidence = -kInfinity;
  double independent = 1;  // pieces of ground
  double radius = 0;       // root mean square distance of the aerial cells from their centre [m]
};

namespace {

constexpr double kStep = 0.08;        // of the logarithm: half of it moves the rim of 4 m by 8 cm, a cell
constexpr double kFinest = 0.01;      // with coarse cells; then kSettleStep with the maps' own
constexpr double kSettleStep = 0.01;  // a cell of 2 cm at the rim of such a map
constexpr double kEdge = 0.02;        // [m] to which both maps place an edge, see scaleDeviation
constexpr double kTrackStep = 0.012;  // around a scale that has converged
constexpr double kRestart = 0.015;    // a change by more moves the particles' map too far
constexpr double kLevelStep = 0.004;  // a smaller change of the level is not worth new maps [rad]
constexpr double kFloorShare = 0.10;  // of the points, that a floor must hold
constexpr int kCoarseCells = 36;      // across the aerial map, over all headings and offsets ...
constexpr int kFineCells = 100;       // ... and around a place
constexpr int kFullCells = 1000;      // the maps' own cells, unless the aerial map is huge
constexpr int kGroundCells = 64;      // across the ground map in that search
constexpr int kCoarseHeadings = 36;
constexpr std::size_t kPlaces = 6;               // of a scale, that are compared
constexpr std::size_t kFloors = 3;               // places of the floor that are tried at a scale
constexpr int kUnrelated = 200;                  // placements that show what a wrong one costs
constexpr double kLargest = 2.5;                 // edges of the ground map that the aerial one may be long
constexpr std::size_t kMostPoints = 20000;       // in large cells
constexpr std::size_t kMostFullPoints = 400000;  // in the maps' own
constexpr std::size_t kPeaks = 3;                // scales that are refined

double quantile(std::vector<float>& values, double q) {
  const auto k = values.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), k, values.end());
  return *k;
}

/// Area over which heights are alike: twice the distance at which their correlation has fallen to a half, squared
/// [m^2].
double pieceArea(const HeightMap& map) {
  double sum = 0, squares = 0, count = 0;
  for (const float h : map.heights) {
    if (std::isnan(h)) continue;
    sum += h;
    squares += static_cast<double>(h) * h;
    ++count;
  }
  const double variance = count > 0 ? squares / count - sum / count * (sum / count) : 0;
  const int most = std::max(map.width, map.height) / 2;
  double apart = most, before = 0;  // cells; by linear interpolation, since a whole lag is a step of half an area
  for (int lag = 1; lag < most; ++lag) {
    double difference = 0, pairs = 0;
    const auto add = [&](float a, float b) {
      if (std::isnan(a) || std::isnan(b)) return;
      difference += (static_cast<double>(a) - b) * (static_cast<double>(a) - b);
      ++pairs;
    };
    for (int r = 0; r < map.height; ++r)
      for (int c = 0; c < map.width; ++c) {
        if (c + lag < map.width) add(map.at(r, c), map.at(r, c + lag));
        if (r + lag < map.height) add(map.at(r, c), map.at(r + lag, c));
      }
    if (pairs < 1) continue;
    const double mean = difference / pairs;
    if (mean > variance) {
      apart = std::max(1.0, lag - (mean - variance) / (mean - before));
      break;
    }
    before = mean;
  }
  return std::pow(2 * std::max(1.0, apart) * map.resolution, 2);
}

/// Median cost of the same maps at placements spread over the volume: what two maps cost that have nothing to do with
/// each other there. Negative where there is none.
double unrelatedCost(const CostVolume& volume, const DirectCost& direct, const AerialCells& cells,
                     const CostSettings& settings) {
  std::size_t total = 0;
  for (const CostMap& slice : volume.slices)
    total += static_cast<std::size_t>(
        std::count_if(slice.cost.begin(), slice.cost.end(), [](float c) { return std::isfinite(c); }));
  const std::size_t step = std::max<std::size_t>(1, total / kUnrelated);
  std::vector<PlanarPose> poses;
  std::size_t i = 0;
  for (const CostMap& slice : volume.slices) {
    for (std::size_t k = 0; k < slice.cost.size(); ++k) {
      if (!std::isfinite(slice.cost[k]) || i++ % step != 0) continue;
      const int row = static_cast<int>(k / slice.width), column = static_cast<int>(k % slice.width);
      poses.push_back(changeReference(slice.pose(row, column), volume.pivot, cells.reference));
    }
  }
  std::vector<float> costs;
  for (const Zmssd& z : direct(cells, poses, settings))
    if (std::isfinite(z.cost)) costs.push_back(static_cast<float>(z.cost));
  return costs.empty() ? -1 : quantile(costs, 0.5);
}

/// Of both maps' heights in the overlap, their sum [m^2].
double variancesOf(const Zmssd& z) { return std::pow(z.relief_air, 2) + std::pow(z.relief_ground, 2); }

double rootMeanSquareRadius(const HeightMap& map, const Eigen::Vector2d& centre) {
  double sum = 0, n = 0;
  for (int r = 0; r < map.height; ++r)
    for (int c = 0; c < map.width; ++c) {
      if (std::isnan(map.at(r, c))) continue;
      sum += (map.center(r, c) - centre).squaredNorm();
      ++n;
    }
  return n > 0 ? std::sqrt(sum / n) : 0;
}

}  // namespace

std::vector<Eigen::Vector3f> HeightMapLocalizer::kept(const std::vector<Eigen::Vector3f>& points) const {
  constexpr std::size_t kMostKept = 40000;
  const std::size_t step = (points.size() + kMostKept - 1) / kMostKept;
  std::vector<Eigen::Vector3f> some;
  for (std::size_t i = 0; i < points.size(); i += step) some.push_back(points[i]);
  return some;
}

void HeightMapLocalizer::setOwnUnit(bool own_unit) {
  if (own_unit == own_unit_) return;
  own_unit_ = own_unit;
  restart(true);
}

HeightMap HeightMapLocalizer::mapOf(const std::vector<Eigen::Vector3f>& points, const LevelHistogram& earlier,
                                    std::size_t* cropped) const {
  if (!own_unit_) return buildHeightMap(points, settings_.air_map, cropped, &earlier);
  const Eigen::Matrix3f S = (scale_ * R_level_).cast<float>();
  std::vector<Eigen::Vector3f> metric;
  metric.reserve(points.size());
  for (const auto& p : points) metric.push_back(S * p);
  return buildHeightMap(metric, settings_.air_map, cropped, &earlier);
}

void HeightMapLocalizer::remakeKeptMaps() {
  LevelHistogram levels;
  for (Kept& kept : aerial_) {
    kept.map = mapOf(kept.points, levels);
    levels.add(kept.map.levels);
  }
}

HeightMapLocalizer::RawCloud HeightMapLocalizer::rawCloud(std::size_t most) const {
  std::size_t count = 0;
  for (const Kept& kept : aerial_) count += kept.points.size();
  const std::size_t step = std::max<std::size_t>(1, (count + most - 1) / most);
  RawCloud raw;
  const Eigen::Matrix3f R = R_level_.cast<float>();
  std::size_t i = 0;
  std::vector<float> x, y;
  for (const Kept& kept : aerial_) {
    for (const auto& p : kept.points) {
      if (i++ % step != 0 || !p.allFinite()) continue;
      raw.points.push_back(R * p);
      x.push_back(raw.points.back().x());
      y.push_back(raw.points.back().y());
    }
  }
  if (raw.points.empty()) return raw;
  constexpr double kTail = 0.005;
  const Eigen::Vector2d low(quantile(x, kTail), quantile(y, kTail)),
      high(quantile(x, 1 - kTail), quantile(y, 1 - kTail));
  raw.centre = 0.5 * (low + high);
  raw.extent = (high - low).maxCoeff();
  return raw;
}

HeightMapLocalizer::GroundLevel& HeightMapLocalizer::groundLevel(int factor) {
  auto& level = ground_levels_[factor];
  if (!level) {
    level = std::make_unique<GroundLevel>();
    level->map = downsample(ground_, factor);
    level->direct = std::make_unique<DirectCost>(level->map);
  }
  return *level;
}

/// The best placement over all headings and offsets, and what others cost.
HeightMapLocalizer::ScaleTrial HeightMapLocalizer::placeAnywhere(const HeightMap& map, const Eigen::Vector2d& centre,
                                                                 GroundLevel& ground) {
  ScaleTrial trial;
  const AerialCells cells = aerialCells(map, centre);
  const CostSettings cost = costFor(map);
  if (!ground.fft) ground.fft = std::make_unique<FftCost>(ground.map);
  const auto headings = searchHeadings(kCoarseHeadings, prior_);
  const bool circular = static_cast<int>(headings.size()) == kCoarseHeadings;
  const CostVolume volume = computeCostVolume(*ground.fft, map, headings, circular, cost);
  trial.best = bestOfMinima(volume, kPlaces, settings_.rival_distance, settings_.rival_angle, *ground.direct, cells,
                            map.resolution, M_PI / kCoarseHeadings, cost);
  trial.zmssd = (*ground.direct)(cells, trial.best.pose, cost);
  trial.background.unrelated = unrelatedCost(volume, *ground.direct, cells, cost);
  return trial;
}

HeightMapLocalizer::ScaleTrial HeightMapLocalizer::tryScale(double scale, const RawCloud& raw, int cells_across,
                                                            const PlanarPose* start,
                                                            const ScaleBackground& background) {
  ScaleTrial trial;
  trial.scale = scale;
  const double fine = settings_.air_map.resolution;
  int factor = std::max(1, static_cast<int>(std::ceil(scale * raw.extent / (fine * cells_across))));
  if (!start)
    factor = std::max(
        {factor, settings_.coarse_factor, (std::max(ground_.width, ground_.height) + kGroundCells - 1) / kGroundCells});
  HeightMapSettings how = settings_.air_map;
  how.resolution = fine * factor;
  if (factor > 1 && how.dilation == Dilation::kAll) how.dilation = Dilation::kHoles;  // large cells are dilated already
  how.max_extent = std::max(how.max_extent, 10 * how.resolution);
  std::vector<Eigen::Vector3f> points = raw.points;
  for (auto& p : points) p *= static_cast<float>(scale);
  HeightMap map = buildHeightMap(points, how);
  if (map.empty()) return trial;
  GroundLevel& ground = groundLevel(factor);
  const Eigen::Vector2d centre = scale * raw.centre;
  if (start) {
    if (!std::isnan(background.floor)) map = withFloor(std::move(map), scale * background.floor);
    trial.background = background;
    const AerialCells cells = aerialCells(map, centre);
    const CostSettings cost = costFor(map);
    trial.best = descend(*ground.direct, cells, *start, 2 * how.resolution, 0.03, cost);
    trial.zmssd = (*ground.direct)(cells, trial.best.pose, cost);
  } else {
    // Who has seen tables alone takes one for the floor.
    LevelHistogram levels = map.levels;
    for (float& cells : levels.cells) cells *= static_cast<float>(factor * factor);
    std::vector<double> floors = floorCandidates(levels, ground_.levels, ground_.cap, kFloors);
    const HeightMap own = map;
    for (std::size_t i = 0; i < floors.size(); ++i) {
      const HeightMap lifted = i == 0 ? own : withFloor(own, floors[i]);
      ScaleTrial placed = placeAnywhere(lifted, centre, ground);
      if (i > 0 && !(placed.best.agreement.score < trial.best.agreement.score)) continue;
      trial.best = placed.best;
      trial.zmssd = placed.zmssd;
      trial.background.unrelated = placed.background.unrelated;
      trial.background.floor = i == 0 ? std::numeric_limits<double>::quiet_NaN() : floors[i] / scale;
      map = lifted;
    }
    if (ground.piece <= 0) ground.piece = pieceArea(ground.map);
    trial.background.piece = std::max(ground.piece, pieceArea(map));
  }
  trial.radius = rootMeanSquareRadius(map, centre);
  if (trial.background.unrelated < 0 || !std::isfinite(trial.best.agreement.cost)) return trial;
  // Unrelated maps cost half the sum of their variances: heights that shrink with the scale do not fit the better for
  // it.
  const double variances = variancesOf(trial.zmssd);
  if (!start) trial.background.variances = variances;
  const double unrelated =
      trial.background.unrelated * (trial.background.variances > 0 ? variances / trial.background.variances : 1);
  trial.independent =
      std::max(1.0, trial.best.agreement.overlap * how.resolution * how.resolution / trial.background.piece);
  trial.evidence = 0.5 * trial.independent *
                   std::log((unrelated + settings_.noise_cost) / (trial.zmssd.cost + settings_.noise_cost));
  return trial;
}

/// `curvature`: of the cost by the logarithm of the scale.
void HeightMapLocalizer::refineScale(ScaleTrial* trial, const RawCloud& raw, double step, double* curvature) {
  const ScaleBackground background = trial->background;
  *trial = tryScale(trial->scale, raw, kFineCells, &trial->best.pose, background);
  *curvature = 0;
  constexpr int kMoves = 4;
  for (; step >= kFinest; step /= 2) {
    for (int move = 0; move < kMoves; ++move) {
      const PlanarPose start = trial->best.pose;
      const double middle = trial->best.agreement.cost, here = trial->evidence;
      const ScaleTrial before = tryScale(trial->scale * std::exp(-step), raw, kFineCells, &start, background),
                       after = tryScale(trial->scale * std::exp(step), raw, kFineCells, &start, background);
      const double bend = (before.best.agreement.cost - 2 * middle + after.best.agreement.cost) / (step * step);
      if (std::isfinite(bend) && bend > 0) *curvature = bend;
      if (before.evidence > trial->evidence) *trial = before;
      if (after.evidence > trial->evidence) *trial = after;
      if (trial->evidence <= here) break;
    }
  }
}

/// With the maps' own cells. Larger ones widen each face by half a cell towards where it was seen from, and what lies
/// behind it is a hole: far faces move inwards, near ones do not, and the best scale came out 2 % too small.
void HeightMapLocalizer::settleScale(ScaleTrial* trial, double* curvature) {
  RawCloud raw = rawCloud(kMostFullPoints);
  const ScaleBackground background = trial->background;
  const auto at = [&](double scale) { return tryScale(scale, raw, kFullCells, &trial->best.pose, background); };
  // By piece of ground: that a larger map shares more of them says nothing about how well it fits.
  const auto fit = [this](const ScaleTrial& t) {
    return std::log(variancesOf(t.zmssd) / (t.best.agreement.cost + settings_.noise_cost));
  };
  ScaleTrial middle = at(trial->scale), before = at(trial->scale * std::exp(-kSettleStep)),
             after = at(trial->scale * std::exp(kSettleStep));
  constexpr int kMoves = 6;
  for (int move = 0; move < kMoves && std::max(fit(before), fit(after)) > fit(middle); ++move) {
    if (fit(before) > fit(after)) {
      after = std::exchange(middle, before);
      before = at(middle.scale * std::exp(-kSettleStep));
    } else {
      before = std::exchange(middle, after);
      after = at(middle.scale * std::exp(kSettleStep));
    }
  }
  if (!std::isfinite(fit(middle))) return;
  const double evidence = trial->evidence;
  *trial = middle;
  const double bend = fit(before) - 2 * fit(middle) + fit(after);
  if (std::isfinite(bend) && bend < 0) {
    const double vertex = 0.5 * (fit(before) - fit(after)) / bend;
    *trial = at(middle.scale * std::exp(std::clamp(vertex, -1.0, 1.0) * kSettleStep));
    *curvature =
        std::max(0.0, before.best.agreement.cost - 2 * middle.best.agreement.cost + after.best.agreement.cost) /
        (kSettleStep * kSettleStep);
  }
  trial->evidence = evidence;  // compares with that of other scales, in large cells
}

/// Relative. What the heights fix, and that both maps round edges in a way that more of them do not average out: a
/// face is as thick in the ground map as its depths scatter and cells are wide, towards where it was seen from.
double HeightMapLocalizer::scaleDeviation(const ScaleTrial& trial, double curvature) const {
  // As for the pose (setCovariance): the information is n / (2 C) times the curvature of the cost.
  const double information = trial.independent * curvature / (2 * (trial.best.agreement.cost + settings_.noise_cost));
  constexpr double kOpen = 0.1;  // where the cost shows no minimum: another peak would have been found beyond
  return std::hypot(1 / std::sqrt(information + 1 / (kOpen * kOpen)), kEdge / std::max(trial.radius, kEdge));
}

bool HeightMapLocalizer::updateLevel() {
  if (settings_.max_tilt <= 0) return false;
  std::vector<Eigen::Vector3f> all;
  for (const Kept& kept : aerial_) all.insert(all.end(), kept.points.begin(), kept.points.end());
  const auto floor = findDominantFloor(all, settings_.max_tilt, kFloorShare);
  if (!floor) return false;
  const Eigen::Matrix3d R = air_ground_common::levelingRotation(floor->up);
  if (air_ground_common::rotationAngle(R, R_level_) < kLevelStep) return false;
  R_level_ = R;
  return true;
}

void HeightMapLocalizer::updateScale() {
  if (!own_unit_ || !hasGround() || aerial_.empty()) return;
  const double scale_before = scale_;
  const bool levelled = updateLevel();
  searchScales();
  if (!levelled && scale_ == scale_before) return;
  remakeKeptMaps();
  if (levelled || std::abs(std::log(scale_ / scale_before)) > kRestart) filter_.clear();
}

/// The whole grid, less and less often, or what is around the last grid's best ones. Scales at which the aerial map
/// would dwarf the ground map are left out: nothing could prove them right.
std::vector<double> HeightMapLocalizer::scalesToTry(double extent) {
  const double largest =
      kLargest * std::max(ground_.width, ground_.height) * ground_.resolution / std::max(extent, 1e-9);
  std::vector<double> scales;
  if (++clouds_since_grid_ < grids_ && !scale_peaks_.empty()) {
    std::sort(scale_peaks_.begin(), scale_peaks_.end());
    for (const double peak : scale_peaks_)
      for (const double step : {-kStep, 0.0, kStep})
        if (scales.empty() || peak * std::exp(step) > scales.back() * (1 + 1e-6))
          scales.push_back(peak * std::exp(step));
    return scales;
  }
  ++grids_;
  clouds_since_grid_ = 0;
  const double to = std::min(settings_.scale_max, std::max(settings_.scale_min, largest));
  for (double scale = settings_.scale_min; scale < to * std::exp(0.5 * kStep); scale *= std::exp(kStep))
    scales.push_back(scale);
  return scales;
}

void HeightMapLocalizer::searchScales() {
  const RawCloud raw = rawCloud(kMostPoints);
  if (raw.points.empty() || !(raw.extent > 0)) return;
  ScaleTrial best;
  double curvature = 0;
  if (estimate_.status == Status::kConverged) {
    const Eigen::Vector2d reference = scale_ * raw.centre;
    const Eigen::Vector3d p = estimate_.T_ground_mav * Eigen::Vector3d(reference.x(), reference.y(), 0);
    best.scale = scale_;
    best.background = background_;
    best.best.pose = {p.x(), p.y(), air_ground_common::yawOf(estimate_.T_ground_mav.rotation())};
    refineScale(&best, raw, kTrackStep, &curvature);
  } else {
    std::vector<ScaleTrial> trials;
    for (const double scale : scalesToTry(raw.extent))
      trials.push_back(tryScale(scale, raw, kCoarseCells, nullptr, {}));
    std::vector<std::size_t> peaks;
    for (std::size_t i = 0; i < trials.size(); ++i) {
      const bool peak = std::isfinite(trials[i].evidence) && (i == 0 || trials[i].evidence >= trials[i - 1].evidence) &&
                        (i + 1 == trials.size() || trials[i].evidence > trials[i + 1].evidence);
      if (peak) peaks.push_back(i);
    }
    std::sort(peaks.begin(), peaks.end(),
              [&](std::size_t a, std::size_t b) { return trials[a].evidence > trials[b].evidence; });
    if (peaks.size() > kPeaks) peaks.resize(kPeaks);
    std::vector<ScaleTrial> refined;
    scale_peaks_.clear();
    for (const std::size_t i : peaks) {
      refined.push_back(trials[i]);
      double bend = 0;
      refineScale(&refined.back(), raw, kStep / 2, &bend);
      scale_peaks_.push_back(refined.back().scale);
      if (refined.back().evidence > best.evidence) {
        best = refined.back();
        curvature = bend;
      }
    }
    // Without another peak the alternative is that nothing fits: evidence 0, that of unrelated heights.
    scale_evidence_ = std::max(0.0, best.evidence);
    for (const ScaleTrial& other : refined)
      if (std::abs(std::log(other.scale / best.scale)) > kStep)
        scale_evidence_ = std::min(scale_evidence_, best.evidence - other.evidence);
  }
  if (!std::isfinite(best.evidence)) return;
  settleScale(&best, &curvature);
  scale_stddev_ = best.scale * scaleDeviation(best, curvature);
  scale_ = best.scale;
  background_ = best.background;
}

}  // namespace heightmap_mcl
