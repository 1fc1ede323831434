// Which floor the aerial maps stand on, and how much speaks for a place.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

void Localizer::updateFloor() {
  constexpr std::size_t kMost = 4;
  floor_ = std::numeric_limits<double>::quiet_NaN();
  floor_rivals_.clear();
  // A scale that is searched for leaves no level to compare with.
  if (settings_.mode == Mode::kPaper || settings_.scale_sigma > 0 || aerial_.empty()) return;
  const HeightMap raw = merge(keptMaps(settings_.verify), settings_.merge);
  const std::vector<double> floors = floorCandidates(raw.levels, ground_.levels, ground_.cap, kMost);
  if (floors.size() < 2) return;
  std::vector<ScaleTrial> trials;
  for (double floor : floors) trials.push_back(tryScale(1, withFloor(raw, floor), nullptr));
  std::size_t best = 0;
  for (std::size_t i = 1; i < trials.size(); ++i) {
    if (trials[i].best.zmssd.score < trials[best].best.zmssd.score) best = i;
  }
  for (std::size_t i = 0; i < trials.size(); ++i) {
    if (i != best) floor_rivals_.push_back(trials[i].best);
  }
  floor_ = floors[best];
}

double Localizer::evidence(const Zmssd& z) const {
  if (!std::isfinite(z.cost)) return 0;
  const double unexplained = 2 * (z.cost + settings_.noise_cost) / z.variance;
  return std::max(0.0, -0.5 * z.overlap / settings_.cells_per_independent * std::log(unexplained));
}

void Localizer::gatherEvidence() {
  const LocalizerSettings& s = settings_;
  const bool told_apart = estimate_.relief >= s.min_relief && estimate_.probe_ratio >= s.probe_ratio &&
                          estimate_.rival_ratio >= s.ambiguity_ratio && estimate_.explained >= s.min_explained;
  const auto place = [this](const air_ground_common::Pose& T) {
    return PlanarPose{(T * (scale_ * aerial_.back().reference)).x(), (T * (scale_ * aerial_.back().reference)).y(),
                      air_ground_common::yawOf(T.rotation())};
  };
  const PlanarPose now = place(estimate_.T_ground_mav), before = place(evidence_pose_);
  if (std::hypot(now.x - before.x, now.y - before.y) > settings_.rival_distance ||
      std::abs(air_ground_common::wrapAngle(now.yaw - before.yaw)) > settings_.rival_angle) {
    evidence_ = 0;
  }
  evidence_pose_ = estimate_.T_ground_mav;
  if (new_map_) {
    const double most = settings_.min_evidence / 2;
    const double lead = std::clamp(estimate_.evidence_lead, -most, told_apart ? most : 0.0);
    evidence_ = std::clamp(evidence_ + lead, 0.0, 2 * settings_.min_evidence);
  }
  estimate_.evidence = evidence_;
}

}  // namespace heightmap_mcl
