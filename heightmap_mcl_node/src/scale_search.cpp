// Scale of the aerial clouds, for a MAV whose odometry is not metric: a logarithmic grid, coarse to fine.
#include <algorithm>
#include <cmath>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {
namespace {

constexpr double kStep = 0.025;     // of the logarithm: over half of a map of 4 m, 5 cm
constexpr double kReach = 2.5;      // standard deviations that are searched
constexpr double kFinest = 0.003;   // what a cell of 2 cm at the rim of such a map can show
constexpr double kRestart = 0.015;  // a change by more moves the particles' map too far

double badness(const Zmssd& z, double noise_cost) {
  // A smaller map has less height to be wrong about: what it leaves unexplained is compared, not what it costs.
  return z.variance > 0 && std::isfinite(z.score) ? (z.score + noise_cost) / z.variance : kInfinity;
}

}  // namespace

Localizer::ScaleTrial Localizer::tryScale(double scale, const HeightMap& raw, const PlanarPose* start) const {
  ScaleTrial trial;
  trial.scale = scale;
  const HeightMap map = scaled(raw, scale);
  const AerialCells cells = aerialCells(map, scale * centerOf(raw));
  trial.cells = static_cast<int>(cells.h.size());
  const CostSettings cost = costFor(map);
  const double cell = ground_.resolution;
  if (start) {
    trial.best = descend(*direct_, cells, *start, 2 * cell, 0.03, cost);
    return trial;
  }
  const CostVolume volume = coarseVolume(map);
  for (const PlanarPose& minimum : findLocalMinima(volume, 3, settings_.rival_distance, settings_.rival_angle)) {
    const PlanarPose pose = changeReference(minimum, volume.pivot, cells.reference);
    const Candidate found =
        descend(*direct_, cells, pose, settings_.coarse_factor * cell, M_PI / settings_.headings, cost);
    if (found.zmssd.score < trial.best.zmssd.score) trial.best = found;
  }
  return trial;
}

void Localizer::updateScale() {
  if (settings_.scale_sigma <= 0 || settings_.mode == Mode::kPaper || aerial_.empty()) return;
  const HeightMap raw = merge(keptMaps(settings_.verify), settings_.merge);
  const auto bad = [this](const ScaleTrial& t) { return badness(t.best.zmssd, settings_.noise_cost); };
  ScaleTrial best;
  if (estimate_.status == Status::kConverged) {
    const PlanarPose pose = [&] {
      const Eigen::Vector2d reference = scale_ * centerOf(raw);
      const Eigen::Vector3d p = estimate_.T_ground_mav * Eigen::Vector3d(reference.x(), reference.y(), 0);
      return PlanarPose{p.x(), p.y(), air_ground_common::yawOf(estimate_.T_ground_mav.rotation())};
    }();
    best = tryScale(scale_, raw, &pose);
  } else {
    const int half = static_cast<int>(std::ceil(kReach * settings_.scale_sigma / kStep));
    for (int i = -half; i <= half; ++i) {
      const ScaleTrial trial = tryScale(std::exp(i * kStep), raw, nullptr);
      if (bad(trial) < bad(best)) best = trial;
    }
  }
  if (!std::isfinite(bad(best))) return;
  double step = kStep / 2, curvature = 0;
  for (; step >= kFinest; step /= 2) {
    const ScaleTrial before = tryScale(best.scale * std::exp(-step), raw, &best.best.pose),
                     after = tryScale(best.scale * std::exp(step), raw, &best.best.pose);
    const double bend = (before.best.zmssd.cost - 2 * best.best.zmssd.cost + after.best.zmssd.cost) / (step * step);
    if (std::isfinite(bend) && bend > 0) curvature = bend;
    if (bad(before) < bad(best)) best = before;
    if (bad(after) < bad(best)) best = after;
  }
  // As for the pose (setCovariance): the information is n / (2 C) times the curvature of the cost.
  const double independent = std::max(best.best.zmssd.overlap / settings_.cells_per_independent, 1.0);
  const double information = independent * curvature / (2 * (best.best.zmssd.cost + settings_.noise_cost));
  const double prior = 1 / (settings_.scale_sigma * settings_.scale_sigma);
  scale_stddev_ = best.scale * std::hypot(1 / std::sqrt(information + prior), kFinest);
  if (std::abs(std::log(best.scale / scale_)) > kRestart) filter_.clear();
  scale_ = best.scale;
}

}  // namespace heightmap_mcl
