#include "scale_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace heightmap_mcl {
namespace {

constexpr double kStep = 0.08;                   // of the logarithm: half of it moves the rim of 4 m by 8 cm, a cell
constexpr double kAlike = 4 * kStep;             // by so much the scales of one place may differ in large cells
constexpr double kFinest = 0.01;                 // with coarse cells; then kSettleStep with the maps' own
constexpr double kSettleStep = 0.01;             // a cell of 2 cm at the rim of such a map
constexpr double kTrackStep = 0.012;             // around a scale that has converged
constexpr int kFineCells = 100;                  // across the aerial map, around a place
constexpr int kFullCells = 1000;                 // the maps' own cells, unless the aerial map is huge
constexpr double kLargest = 2.5;                 // edges of the ground map that the aerial one may be long
constexpr double kSmallest = 1.0;                // that its edge may be [m]: less stands nowhere alone
constexpr std::size_t kMostPoints = 20000;       // in large cells
constexpr std::size_t kMostFullPoints = 400000;  // in the maps' own
constexpr std::size_t kPeaks = 5;                // scales that are refined

/// Trials of a grid that stand out more than their neighbours, the best first.
std::vector<std::size_t> peaksOf(const std::vector<ScaleTrial>& trials) {
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
  return peaks;
}

}  // namespace

void ScaleSearch::update(const KeptMaps& maps, GroundModel& ground, const Prior& prior, const Comparison& comparison,
                         const std::optional<air_ground_common::Pose>& converged) {
  const LevelCloud cloud = maps.levelCloud(kMostPoints);
  if (cloud.points.empty() || !(cloud.extent > 0)) return;
  const ScaleTrials trials(settings_, ground, prior, comparison);
  ScaleTrial best;
  if (converged) {
    best.scale = estimate_.value;
    best.place = {planarOf(*converged, estimate_.value * cloud.centre), floor_};
    refine(&best, trials, cloud, kTrackStep);
  } else {
    best = bestOfScales(trials, cloud, ground);
  }
  if (!std::isfinite(best.agreement.cost)) return;
  settle(&best, trials, maps.levelCloud(kMostFullPoints));
  estimate_.stddev = best.scale * scaleDeviation(best, settings_.noise_cost);
  estimate_.value = best.scale;
  floor_ = best.place.floor;
}

/// The whole grid, less and less often, or what is around the last grid's best ones. Scales at which the aerial map
/// would dwarf the ground map, or be a spot of it, are left out: nothing could prove them right.
std::vector<double> ScaleSearch::scalesToTry(double extent, const GroundModel& ground) {
  const double largest = kLargest * ground.edge() * ground.map().resolution / std::max(extent, 1e-9);
  std::vector<double> scales;
  if (++clouds_since_grid_ < grids_ && !peaks_.empty()) {
    std::sort(peaks_.begin(), peaks_.end());
    for (const double peak : peaks_)
      for (const double step : {-kStep, 0.0, kStep})
        if (scales.empty() || peak * std::exp(step) > scales.back() * (1 + 1e-6))
          scales.push_back(peak * std::exp(step));
    return scales;
  }
  ++grids_;
  clouds_since_grid_ = 0;
  const double least = std::max(settings_.own_unit.scale_min, kSmallest / std::max(extent, 1e-9));
  const double to = std::min(settings_.own_unit.scale_max, std::max(least, largest));
  for (double scale = least; scale < to * std::exp(0.5 * kStep); scale *= std::exp(kStep)) scales.push_back(scale);
  return scales;
}

/// Of the grid's peaks the one whose place stands out most.
ScaleTrial ScaleSearch::bestOfScales(const ScaleTrials& trials, const LevelCloud& cloud, const GroundModel& ground) {
  std::vector<ScaleTrial> grid;
  for (const double scale : scalesToTry(cloud.extent, ground)) grid.push_back(trials.anywhere(scale, cloud));
  ScaleTrial best;
  std::vector<ScaleTrial> refined;
  peaks_.clear();
  for (const std::size_t i : peaksOf(grid)) {
    ScaleTrial trial = grid[i];
    refine(&trial, trials, cloud, kStep);
    trial.distinctness = grid[i].distinctness;
    if (trial.scale != grid[i].scale)
      trial.distinctness = std::max(trial.distinctness, trials.anywhere(trial.scale, cloud).distinctness);
    peaks_.push_back(trial.scale);
    refined.push_back(trial);
    if (trial.distinctness > best.distinctness) best = trial;
  }
  setEvidence(best, refined);
  ScaleTrial fittest = best;
  for (const ScaleTrial& other : refined)
    if (isAlike(other, best) && fit(other) > fit(fittest)) fittest = other;
  return fittest;
}

/// Neighbours that place the map alike are one answer, whose scale is the one that fits.
bool ScaleSearch::isAlike(const ScaleTrial& a, const ScaleTrial& b) const {
  return std::abs(std::log(a.scale / b.scale)) < kAlike && isSame(a.place.pose, b.place.pose, settings_.rival);
}

void ScaleSearch::setEvidence(const ScaleTrial& best, const std::vector<ScaleTrial>& refined) {
  // Without another peak the alternative is that nothing fits: evidence 0.
  double lead = std::max(0.0, best.distinctness);
  for (const ScaleTrial& other : refined)
    if (!isAlike(other, best)) lead = std::min(lead, best.distinctness - other.distinctness);
  estimate_.evidence = lead * best.independent;
}

/// Climbs to the best scale around the trial's.
void ScaleSearch::refine(ScaleTrial* trial, const ScaleTrials& trials, const LevelCloud& cloud, double step) const {
  const auto near = [&](double scale, const PlaceOnFloor& start) {
    return trials.near(scale, cloud, kFineCells, start);
  };
  *trial = near(trial->scale, trial->place);
  constexpr int kMoves = 4;
  for (; step >= kFinest; step /= 2) {
    for (int move = 0; move < kMoves; ++move) {
      const ScaleTrial middle = *trial;
      const ScaleTrial before = near(middle.scale * std::exp(-step), middle.place),
                       after = near(middle.scale * std::exp(step), middle.place);
      if (chargedFit(before) > chargedFit(*trial)) *trial = before;
      if (chargedFit(after) > chargedFit(*trial)) *trial = after;
      trial->curvature = bendOf(before, middle, after, step);
      if (trial->scale == middle.scale) break;
    }
  }
}

/// With the maps' own cells. Larger ones widen each face by half a cell towards where it was seen from, and what lies
/// behind it is a hole: far faces move inwards, near ones do not, and the best scale came out 2 % too small.
void ScaleSearch::settle(ScaleTrial* trial, const ScaleTrials& trials, const LevelCloud& cloud) const {
  const PlaceOnFloor start = trial->place;
  const auto at = [&](double scale) { return trials.near(scale, cloud, kFullCells, start); };
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
  *trial = middle;
  const double bend = fit(before) - 2 * fit(middle) + fit(after);
  if (std::isfinite(bend) && bend < 0) {
    const double vertex = 0.5 * (fit(before) - fit(after)) / bend;
    *trial = at(middle.scale * std::exp(std::clamp(vertex, -1.0, 1.0) * kSettleStep));
    trial->curvature = bendOf(before, middle, after, kSettleStep);
  }
}

}  // namespace heightmap_mcl
