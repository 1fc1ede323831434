#include "heightmap_mcl/agreement.h"

#include <algorithm>
#include <cmath>

#include "partners.h"
#include "zmssd_kernel.h"

namespace heightmap_mcl {
namespace {

/// `cells`: defined ones of the smaller map. `lift`: of the aerial map at offset 0 [m].
Agreement fromSums(const kernel::AgreementSums& sums, double cells, double offset, double lift,
                   const CostSettings& settings) {
  Agreement result;
  result.overlap = static_cast<int>(sums.n + 0.5);
  result.offset = sums.inliers > 0.5 ? sums.d / sums.inliers : offset;
  if (sums.n < 1 || sums.n < settings.min_overlap * cells) return result;
  result.cost = sums.squares / sums.n;
  const double share = std::min(1.0, sums.n / cells);
  result.score = share * result.cost + (1 - share) * settings.unknown_share * settings.cutoff * settings.cutoff;
  result.raised = static_cast<int>(sums.raised + 0.5);
  result.agreeing = sums.raised > 0 ? sums.agree / sums.raised : 0;
  result.dz = lift - result.offset;
  return result;
}

}  // namespace

Agreement agreementReference(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                             const PlanarPose& pose, double offset, const CostSettings& settings, int edge) {
  kernel::AgreementSums sums;
  for (const auto& [a, g] : partnersOf(air, ground, reference, pose, edge)) {
    const bool known = a.known() && !g.bound;
    const double d = a.value - g.value, residual = known ? std::abs(d - offset) : lackOf(a, g);
    ++sums.n;
    sums.squares += std::pow(std::min(residual, settings.cutoff), 2);
    if (std::max(a.low, g.value) > kRaised * settings.cutoff) {
      ++sums.raised;
      sums.agree += residual < kAgreeing * settings.cutoff;
    }
    if (!known || residual >= settings.cutoff) continue;
    ++sums.inliers;
    sums.d += d;
  }
  const double smaller = settings.cells(static_cast<double>(air.defined()), static_cast<double>(ground.defined()));
  return fromSums(sums, smaller, offset, baseHeight(ground) - baseHeight(air), settings);
}

Agreement DirectCost::agreement(const AerialCells& cells, const PlanarPose& pose, double offset,
                                const CostSettings& settings) const {
  const auto share = [&settings](double part) { return static_cast<float>(part * settings.cutoff); };
  auto sums = kernel::agreementSums(kernel::viewOf(cells), {pose, resolution_, origin_x_, origin_y_},
                                    {heights_.data(), width_, height_},
                                    {static_cast<float>(offset), share(1), share(kAgreeing), share(kRaised)});
  for (double* sum : {&sums.n, &sums.squares, &sums.raised, &sums.agree, &sums.inliers, &sums.d}) *sum *= cells.weight;
  const double smaller = settings.cells(static_cast<double>(cells.weight * cells.h.size()), defined_);
  return fromSums(sums, smaller, offset, base_ - cells.base, settings);
}

double DirectCost::medianOffset(const AerialCells& cells, const PlanarPose& pose) const {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  std::vector<float> differences;
  for (std::size_t i = 0; i < cells.h.size(); ++i) {
    if (cells.low[i] != cells.high[i]) continue;
    const float g = groundAt(pose.x + c * cells.x[i] - s * cells.y[i], pose.y + s * cells.x[i] + c * cells.y[i]);
    if (g < 0.5f * kernel::kBoundOffset) differences.push_back(cells.h[i] - g);  // no NaN, no bound
  }
  if (differences.empty()) return 0;
  const auto middle = differences.begin() + static_cast<std::ptrdiff_t>(differences.size() / 2);
  std::nth_element(differences.begin(), middle, differences.end());
  return *middle;
}

Placement placementAt(const DirectCost& cost, const AerialCells& cells, const PlanarPose& pose,
                      const CostSettings& settings) {
  Placement placement{pose, {}};
  double offset = cost.medianOffset(cells, pose);
  for (int i = 0; i < 3; ++i) {
    placement.agreement = cost.agreement(cells, pose, offset, settings);
    offset = placement.agreement.offset;
  }
  return placement;
}

}  // namespace heightmap_mcl
