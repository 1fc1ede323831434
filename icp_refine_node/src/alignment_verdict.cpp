// What becomes of the end of an ICP: compared with what images and height maps tell, and judged.
#include <cmath>
#include <string>

#include "air_ground_common/covariance.h"
#include "air_ground_common/text.h"
#include "air_ground_common/units.h"
#include "icp_refine/alignment_refiner.h"

namespace icp_refine {
namespace {

using air_ground_common::formatted;
using air_ground_common::kDegree;

constexpr int kTellingCells = 8;  // off the floor, that may contradict a pose though they are too few to verify one

/// ICP may move along what its last level finds open in levels before: it is put back where that is known.
void hold(const KnownAlignment& known, RefineOutcome& out) {
  if (out.icp.localizability.complete()) return;
  out.T_ground_map_mav_map = heldAt(known, out.icp);
  out.covariance = heldBy(known, out.icp);
}

}  // namespace

void AlignmentRefiner::compareWithViews(RefineOutcome& out) const {
  if (!views_) return;
  const double squared = squaredSigmas(*views_, out.icp);
  out.view_sigmas = std::sqrt(squared);
  out.seen = squared < settings_.known_squared_sigmas && isNearAlongOpen(*views_, out.icp);
  if (out.seen) hold(*views_, out);
}

void AlignmentRefiner::compareWithCoarse(RefineOutcome& out) const {
  const Localizability& geometry = out.icp.localizability;
  if (!coarse_known_ || out.seen || geometry.complete()) return;
  if (geometry.needs_scale && !geometry.scale.localizable) return;
  out.held = squaredSigmas(*coarse_known_, out.icp) < settings_.known_squared_sigmas &&
             isNearAlongOpen(*coarse_known_, out.icp);
  if (out.held) hold(*coarse_known_, out);
}

void AlignmentRefiner::judge(RefineOutcome& out) const {
  const IcpResult& icp = out.icp;
  const auto verdict = [&out](RefineStatus status, const std::string& reason) {
    out.status = status;
    out.reason = reason;
  };
  const auto rejected = [&](const std::string& reason) { verdict(RefineStatus::kRejected, reason); };
  const auto degenerate = [&](const std::string& reason) { verdict(RefineStatus::kDegenerate, reason); };
  if (icp.outcome != IcpResult::Outcome::kConverged) return rejected(icp.reason);
  if (out.overlap < settings_.min_overlap) {
    return rejected(formatted("the maps overlap in %.0f %% of the aerial one, %.0f %% needed", 100 * out.overlap,
                              100 * settings_.min_overlap));
  }
  if (!icp.localizability.complete() && !out.seen && !out.held)
    return degenerate("the geometry does not fix: " + icp.localizability.describeMissing());
  const double sigma = positionStddev(out.covariance);
  const double sigma_angle = air_ground_common::largestStddev(out.covariance.bottomRightCorner<3, 3>());
  if (sigma > settings_.max_sigma || sigma_angle > settings_.max_sigma_angle) {
    return degenerate(
        formatted("the geometry fixes the pose only to %.2f m and %.1f deg (1 sigma)", sigma, sigma_angle / kDegree));
  }
  if (icp.residual_rms > settings_.max_rms)
    return rejected(formatted("residual %.3f m RMS, at most %.3f m", icp.residual_rms, settings_.max_rms));
  // Beyond what odometry and clouds leave open with 99.99 % (normal, one degree of freedom): bent to fit a wrong place.
  const double scale = out.T_ground_map_mav_map.scale;
  const ScalePrior prior = priors().scale;
  const double excess = std::abs(scale - prior.mean) / std::hypot(prior.stddev, out.scale_stddev);
  if (prior.mode == ScalePrior::Mode::kPrior && excess > 3.9) {
    return rejected(formatted("scale %.3f, %.1f standard deviations from what the odometry can err by (%.1f %%)", scale,
                              excess, 100 * prior.stddev));
  }
  if (!out.heights.conclusive && !out.seen) {
    return degenerate(formatted("only %d cells off the floor were seen by both: too few to verify the pose",
                                out.heights.relief_cells));
  }
  if (!out.heights.conclusive && out.heights.relief_cells >= kTellingCells &&
      out.heights.agreement() < settings_.min_agreement) {
    return degenerate(
        formatted("the images agree, but of the %d cells off the floor that both saw %.0f %% do, %.0f %% needed",
                  out.heights.relief_cells, 100 * out.heights.agreement(), 100 * settings_.min_agreement));
  }
  if (out.heights.conclusive && out.heights.agreement() < settings_.min_agreement) {
    return rejected(formatted("heights contradict: %.0f %% of %d cells off the floor agree, %.0f %% needed",
                              100 * out.heights.agreement(), out.heights.relief_cells, 100 * settings_.min_agreement));
  }
  verdict(RefineStatus::kConverged,
          formatted("residual %.3f m, overlap %.0f %%, heights agree in %.0f %% of %d cells, 1 sigma %.3f m %.2f deg, ",
                    icp.residual_rms, 100 * out.overlap, 100 * out.heights.agreement(), out.heights.relief_cells, sigma,
                    sigma_angle / kDegree) +
              (icp.scale_estimated ? formatted("scale %.4f +- %.4f", scale, out.scale_stddev)
                                   : formatted("scale held at %.4f: the geometry does not fix it", scale)) +
              (out.seen ? formatted(", the images agree within %.1f sigma", out.view_sigmas) : "") +
              (out.held ? "; as the coarse alignment has it, since the geometry does not fix it: " +
                              icp.localizability.describeMissing()
                        : ""));
}

// Two that know nothing of each other, clouds and images, lead to the tracked pose: rather than both being wrong, much
// of what stands off the floor was elsewhere when the other robot came by. Poses that are wrong agree in less.
bool AlignmentRefiner::imagesHold(const RefineOutcome& out) const {
  return out.seen && out.icp.localizability.complete() && out.residual_rms <= settings_.max_rms &&
         out.heights.agreement() >= settings_.held_agreement;
}

}  // namespace icp_refine
