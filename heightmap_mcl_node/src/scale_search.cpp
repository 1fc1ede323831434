// The scale of the aerial clouds, for a MAV whose odometry has none: a logarithmic grid, coarse to fine.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

/// The kept clouds together, level, thinned.
struct HeightMapLocalizer::RawCloud {
  std::vector<Eigen::Vector3f> points;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double extent = 0;  // longer edge in plan
};

/// Their height map at a scale, in the cells of a level of the ground map.
struct HeightMapLocalizer::ScaledMap {
  double scale = 1;
  HeightMap map;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  // [m]
  GroundLevel* ground = nullptr;

  /// See PlaceOnFloor.
  HeightMap onFloor(double floor) const { return std::isnan(floor) ? map : withFloor(map, scale * floor); }
};

struct HeightMapLocalizer::ScaleTrial {
  double scale = 1;
  PlaceOnFloor place;   // the best one
  Agreement agreement;  // there
  Zmssd zmssd;
  /// Logarithm of how much likelier the heights of a piece of ground are there than at the best place elsewhere, times
  /// the share that the place explains of what nothing known would cost. At a wrong scale many places fit about as
  /// well, if it is too small, or none does, if it is too large.
  double distinctness = -kInfinity;
  double independent = 1;  // pieces of ground whose height both maps know
  double curvature = 0;    // of the cost by the logarithm of the scale [m^2], not negative
  double radius = 0;       // root mean square distance of the aerial cells from their centre [m]
};

namespace {

constexpr double kStep = 0.08;        // of the logarithm: half of it moves the rim of 4 m by 8 cm, a cell
constexpr double kAlike = 4 * kStep;  // by so much the scales of one place may differ in large cells
constexpr double kFinest = 0.01;      // with coarse cells; then kSettleStep with the maps' own
constexpr double kSettleStep = 0.01;  // a cell of 2 cm at the rim of such a map
constexpr double kEdge = 0.02;        // [m] to which both maps place an edge, see scaleDeviation
constexpr double kTrackStep = 0.012;  // around a scale that has converged
constexpr double kRestart = 0.015;    // a change by more moves the particles' map too far
constexpr int kCoarseCells = 36;      // across the aerial map, over all headings and offsets ...
constexpr int kFineCells = 100;       // ... and around a place
constexpr int kFullCells = 1000;      // the maps' own cells, unless the aerial map is huge
constexpr int kGroundCells = 64;      // across the ground map in that search
constexpr int kCoarseHeadings = 36;
constexpr std::size_t kPlaces = 6;               // of a scale, that are compared
constexpr std::size_t kFloors = 3;               // places of the floor that are tried at a scale
constexpr double kLargest = 2.5;                 // edges of the ground map that the aerial one may be long
constexpr std::size_t kMostPoints = 20000;       // in large cells
constexpr std::size_t kMostFullPoints = 400000;  // in the maps' own
constexpr std::size_t kPeaks = 5;                // scales that are refined

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

/// Of the ground map's cells in the search over all placements.
int HeightMapLocalizer::coarseFactor() const {
  return std::max(settings_.coarse_factor, (std::max(ground_.width, ground_.height) + kGroundCells - 1) / kGroundCells);
}

double HeightMapLocalizer::groundPiece() {
  if (ground_piece_ <= 0) ground_piece_ = pieceArea(groundLevel(coarseFactor()).map);
  return ground_piece_;
}

HeightMapLocalizer::ScaledMap HeightMapLocalizer::scaledMap(double scale, const RawCloud& raw, int cells_across,
                                                            int least_factor) {
  const double fine = settings_.air_map.resolution;
  const int factor = std::max(least_factor, static_cast<int>(std::ceil(scale * raw.extent / (fine * cells_across))));
  HeightMapSettings how = settings_.air_map;
  how.resolution = fine * factor;
  if (factor > 1 && how.dilation == Dilation::kAll) how.dilation = Dilation::kHoles;  // large cells are dilated already
  how.max_extent = std::max(how.max_extent, 10 * how.resolution);
  std::vector<Eigen::Vector3f> points = raw.points;
  for (auto& p : points) p *= static_cast<float>(scale);
  return {scale, buildHeightMap(points, how), scale * raw.centre, &groundLevel(factor)};
}

/// The best placement over all headings, offsets and floors.
HeightMapLocalizer::ScaleTrial HeightMapLocalizer::placeAnywhere(double scale, const RawCloud& raw) {
  ScaleTrial trial;
  trial.scale = scale;
  const ScaledMap map = scaledMap(scale, raw, kCoarseCells, coarseFactor());
  if (map.map.empty()) return trial;
  GroundLevel& ground = *map.ground;
  if (!ground.fft) ground.fft = std::make_unique<FftCost>(ground.map);
  const auto headings = searchHeadings(kCoarseHeadings, prior_);
  const bool circular = static_cast<int>(headings.size()) == kCoarseHeadings;
  // Who has seen tables alone takes one for the floor.
  LevelHistogram levels = map.map.levels;
  const double cell = std::pow(ground.map.resolution / ground_.resolution, 2);
  for (float& cells : levels.cells) cells *= static_cast<float>(cell);
  std::vector<Placement> places;
  Placement best;
  HeightMap best_map;
  const std::vector<double> candidates = floorCandidates(levels, ground_.levels, ground_.cap, kFloors);
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    // Its own one, too: at another scale it might take another surface for that.
    const double floor = (i == 0 ? map.map.floor : candidates[i]) / scale;
    const HeightMap lifted = i == 0 ? map.map : map.onFloor(floor);
    const CostSettings cost = costFor(lifted);
    const CostVolume volume = computeCostVolume(*ground.fft, lifted, headings, circular, cost);
    const std::vector<Placement> found =
        placesOfMinima(volume, kPlaces, settings_.rival_distance, settings_.rival_angle, *ground.direct,
                       aerialCells(lifted, map.centre), lifted.resolution, M_PI / kCoarseHeadings, cost);
    places.insert(places.end(), found.begin(), found.end());
    const Placement lowest = bestOf(found);
    if (!(lowest.agreement.score < best.agreement.score)) continue;
    best = lowest;
    best_map = lifted;
    trial.place = {best.pose, floor};
  }
  if (!std::isfinite(best.agreement.score)) return trial;
  judgeTrial(&trial, map, best_map, best.agreement);
  const Placement rival = bestElsewhere(places, best.pose);
  const double elsewhere = std::isfinite(rival.agreement.score) ? rival.agreement.score : nothingKnown();
  const double explained = std::max(0.0, 1 - trial.agreement.score / nothingKnown());
  const double by_chance = 1 / (1 + trial.independent);  // a single piece of ground is like many others
  trial.distinctness = logLikelihoodRatio(1, elsewhere - trial.agreement.score) * explained * (1 - by_chance);
  return trial;
}

/// The best placement near that of another scale; whether it stands out is not asked.
HeightMapLocalizer::ScaleTrial HeightMapLocalizer::placeNear(double scale, const RawCloud& raw, int cells_across,
                                                             const PlaceOnFloor& start) {
  ScaleTrial trial;
  trial.scale = scale;
  trial.place = start;
  const ScaledMap map = scaledMap(scale, raw, cells_across, 1);
  if (map.map.empty()) return trial;
  Agreement there;
  HeightMap lifted;
  // What the floor is off shows where heights agree; tables alone were seen at another scale above it.
  for (int i = 0; i < 2; ++i) {
    lifted = map.onFloor(trial.place.floor);
    const Placement best = descend(*map.ground->direct, aerialCells(lifted, map.centre), trial.place.pose,
                                   2 * lifted.resolution, 0.03, costFor(lifted));
    trial.place.pose = best.pose;
    there = best.agreement;
    if (i == 0 && std::isfinite(there.cost)) trial.place.floor += there.offset / scale;
  }
  judgeTrial(&trial, map, lifted, there);
  return trial;
}

/// What both maps say at the trial's place. `lifted`: on the floor of that.
void HeightMapLocalizer::judgeTrial(ScaleTrial* trial, const ScaledMap& map, const HeightMap& lifted,
                                    const Agreement& there) {
  trial->agreement = there;
  trial->radius = rootMeanSquareRadius(lifted, map.centre);
  trial->zmssd = (*map.ground->direct)(aerialCells(lifted, map.centre), trial->place.pose, costFor(lifted));
  trial->independent = trial->zmssd.known * std::pow(lifted.resolution, 2) / groundPiece();
}

/// Of the cost by the logarithm of the scale [m^2]; 0 where it is not convex or not known.
double HeightMapLocalizer::bendOf(const ScaleTrial& before, const ScaleTrial& middle, const ScaleTrial& after,
                                  double step) {
  const double bend = (before.agreement.cost - 2 * middle.agreement.cost + after.agreement.cost) / (step * step);
  return std::isfinite(bend) ? std::max(0.0, bend) : 0;
}

/// How well the heights fit, by piece of ground: a larger map shares more of them, and one with less relief differs by
/// less, which says nothing for either. `charged` for what has no partner, too.
double HeightMapLocalizer::fitOf(const ScaleTrial& trial, bool charged) const {
  const double cost = charged ? trial.agreement.score : trial.agreement.cost;
  return std::log(variancesOf(trial.zmssd) / (cost + settings_.noise_cost));
}

/// Climbs to the best scale around the trial's.
void HeightMapLocalizer::refineScale(ScaleTrial* trial, const RawCloud& raw, double step) {
  *trial = placeNear(trial->scale, raw, kFineCells, trial->place);
  constexpr int kMoves = 4;
  for (; step >= kFinest; step /= 2) {
    for (int move = 0; move < kMoves; ++move) {
      const ScaleTrial middle = *trial;
      const ScaleTrial before = placeNear(middle.scale * std::exp(-step), raw, kFineCells, middle.place),
                       after = placeNear(middle.scale * std::exp(step), raw, kFineCells, middle.place);
      if (fitOf(before, true) > fitOf(*trial, true)) *trial = before;
      if (fitOf(after, true) > fitOf(*trial, true)) *trial = after;
      trial->curvature = bendOf(before, middle, after, step);
      if (trial->scale == middle.scale) break;
    }
  }
}

/// With the maps' own cells. Larger ones widen each face by half a cell towards where it was seen from, and what lies
/// behind it is a hole: far faces move inwards, near ones do not, and the best scale came out 2 % too small.
void HeightMapLocalizer::settleScale(ScaleTrial* trial) {
  const RawCloud raw = rawCloud(kMostFullPoints);
  const PlaceOnFloor start = trial->place;
  const auto at = [&](double scale) { return placeNear(scale, raw, kFullCells, start); };
  ScaleTrial middle = at(trial->scale), before = at(trial->scale * std::exp(-kSettleStep)),
             after = at(trial->scale * std::exp(kSettleStep));
  constexpr int kMoves = 6;
  for (int move = 0; move < kMoves && std::max(fitOf(before), fitOf(after)) > fitOf(middle); ++move) {
    if (fitOf(before) > fitOf(after)) {
      after = std::exchange(middle, before);
      before = at(middle.scale * std::exp(-kSettleStep));
    } else {
      before = std::exchange(middle, after);
      after = at(middle.scale * std::exp(kSettleStep));
    }
  }
  if (!std::isfinite(fitOf(middle))) return;
  *trial = middle;
  const double bend = fitOf(before) - 2 * fitOf(middle) + fitOf(after);
  if (std::isfinite(bend) && bend < 0) {
    const double vertex = 0.5 * (fitOf(before) - fitOf(after)) / bend;
    *trial = at(middle.scale * std::exp(std::clamp(vertex, -1.0, 1.0) * kSettleStep));
    trial->curvature = bendOf(before, middle, after, kSettleStep);
  }
}

/// Relative. What the heights fix, and that both maps round edges in a way that more of them do not average out: a
/// face is as thick in the ground map as its depths scatter and cells are wide, towards where it was seen from.
double HeightMapLocalizer::scaleDeviation(const ScaleTrial& trial) const {
  // As for the pose (setCovariance): the information is n / (2 C) times the curvature of the cost.
  const double information =
      std::max(1.0, trial.independent) * trial.curvature / (2 * (trial.agreement.cost + settings_.noise_cost));
  constexpr double kOpen = 0.1;  // where the cost shows no minimum: another peak would have been found beyond
  return std::hypot(1 / std::sqrt(information + 1 / (kOpen * kOpen)), kEdge / std::max(trial.radius, kEdge));
}

void HeightMapLocalizer::updateScale() {
  if (!own_unit_ || !hasGround() || aerial_.empty()) return;
  const double scale_before = scale_;
  const bool levelled = updateLevel();
  searchScales();
  if (!levelled && scale_ == scale_before) return;
  remakeKeptMaps();
  boundKeptMaps();
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

/// Of the grid's peaks the one whose place stands out most; sets scale_evidence_.
HeightMapLocalizer::ScaleTrial HeightMapLocalizer::bestOfScales(const RawCloud& raw) {
  std::vector<ScaleTrial> trials;
  for (const double scale : scalesToTry(raw.extent)) trials.push_back(placeAnywhere(scale, raw));
  std::vector<std::size_t> peaks;
  for (std::size_t i = 0; i < trials.size(); ++i) {
    const bool peak = std::isfinite(trials[i].distinctness) &&
                      (i == 0 || trials[i].distinctness >= trials[i - 1].distinctness) &&
                      (i + 1 == trials.size() || trials[i].distinctness > trials[i + 1].distinctness);
    if (peak) peaks.push_back(i);
  }
  std::sort(peaks.begin(), peaks.end(),
            [&](std::size_t a, std::size_t b) { return trials[a].distinctness > trials[b].distinctness; });
  if (peaks.size() > kPeaks) peaks.resize(kPeaks);
  ScaleTrial best;
  std::vector<ScaleTrial> refined;
  scale_peaks_.clear();
  for (const std::size_t i : peaks) {
    ScaleTrial trial = trials[i];
    refineScale(&trial, raw, kStep);
    trial.distinctness = trials[i].distinctness;
    if (trial.scale != trials[i].scale)
      trial.distinctness = std::max(trial.distinctness, placeAnywhere(trial.scale, raw).distinctness);
    scale_peaks_.push_back(trial.scale);
    refined.push_back(trial);
    if (trial.distinctness > best.distinctness) best = trial;
  }
  // Without another peak the alternative is that nothing fits: evidence 0.
  double lead = std::max(0.0, best.distinctness);
  ScaleTrial fittest = best;
  for (const ScaleTrial& other : refined) {
    // Neighbours that place the map alike are one answer, whose scale is the one that fits.
    const bool alike =
        std::abs(std::log(other.scale / best.scale)) < kAlike && isSame(other.place.pose, best.place.pose);
    if (!alike) lead = std::min(lead, best.distinctness - other.distinctness);
    if (alike && fitOf(other) > fitOf(fittest)) fittest = other;
  }
  scale_evidence_ = lead * best.independent;
  return fittest;
}

void HeightMapLocalizer::searchScales() {
  const RawCloud raw = rawCloud(kMostPoints);
  if (raw.points.empty() || !(raw.extent > 0)) return;
  ScaleTrial best;
  if (estimate_.status == Status::kConverged) {
    best.scale = scale_;
    best.place = {planarOf(estimate_.T_ground_mav, scale_ * raw.centre), scale_floor_};
    refineScale(&best, raw, kTrackStep);
  } else {
    best = bestOfScales(raw);
  }
  if (!std::isfinite(best.agreement.cost)) return;
  settleScale(&best);
  scale_stddev_ = best.scale * scaleDeviation(best);
  scale_ = best.scale;
  scale_floor_ = best.place.floor;
}

}  // namespace heightmap_mcl
