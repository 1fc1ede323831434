#include "verdict.h"

#include "air_ground_common/text.h"
#include "air_ground_common/units.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::formatted;
using air_ground_common::kDegree;

bool toldApart(const PlaceMeasures& p, const VerdictSettings& s, double agreement, double rival_ratio) {
  return p.relief >= s.min_relief && p.raised >= s.min_raised && p.agreement >= agreement &&
         p.rival_ratio >= rival_ratio;
}

/// Status and reason.
Verdict statusOf(const PlaceMeasures& p, const VerdictSettings& s) {
  // Particles follow eq. 2: where much more speaks for the place, they are not asked.
  const bool asked = p.evidence < 2 * s.min_evidence;
  if (p.relief < s.min_relief)
    return {Status::kDegenerate,
            formatted("the overlap is flat: heights vary by %.3f m, %.3f m are needed. Fly over what stands there",
                      p.relief, s.min_relief)};
  if (p.raised < s.min_raised)
    return {
        Status::kDegenerate,
        formatted(
            "the overlap is bare: something stands on %.2f m^2 of it, %.2f m^2 are needed. Fly over what stands there",
            p.raised, s.min_raised)};
  if (p.probe_ratio < s.probe_ratio)
    return {
        Status::kDegenerate,
        formatted(
            "moved by (%.2f m, %.2f m, %.1f deg) the map costs %.2f times as much, %.2f times are needed: it may slide "
            "there. Fly over what stands across that way",
            p.flattest.x(), p.flattest.y(), p.flattest.z() / kDegree, p.probe_ratio, s.probe_ratio)};
  if (p.rival_ratio < s.ambiguity_ratio)
    return {
        Status::kAmbiguous,
        formatted(
            "another place %.2f m away fits about as well: it costs %.2f times as much, %.2f times are needed. Fly on, "
            "to where the two differ",
            p.rival_distance, p.rival_ratio, s.ambiguity_ratio)};
  if (p.agreement < s.min_agreement)
    return {Status::kSearching, formatted("of what stands on the floor %.0f %% agree, %.0f %% are needed",
                                          100 * p.agreement, 100 * s.min_agreement)};
  if (p.maps < s.min_maps) return {Status::kSearching, formatted("%d of %d aerial maps seen", p.maps, s.min_maps)};
  if (p.evidence < s.min_evidence)
    return {Status::kSearching, formatted("evidence for the place: %.1f of %.1f", p.evidence, s.min_evidence)};
  if (asked && !p.particles_agree) return {Status::kSearching, "the particles have not gathered at the best place yet"};
  if (asked && p.mode_weight < s.min_mode_weight)
    return {Status::kSearching, formatted("%.0f %% of the particles are at the best place, %.0f %% are needed",
                                          100 * p.mode_weight, 100 * s.min_mode_weight)};
  if (asked && (p.mode_spread > s.max_spread || p.mode_spread_yaw > s.max_spread_yaw))
    return {Status::kSearching,
            formatted("the particles spread over %.2f m, %.1f deg", p.mode_spread, p.mode_spread_yaw / kDegree)};
  return {Status::kConverged, formatted("%d maps; the next best place is %.1f times as bad; overlap %.0f %%", p.maps,
                                        p.rival_ratio, 100 * p.overlap)};
}

}  // namespace

bool speaksFor(const PlaceMeasures& place, const VerdictSettings& settings) {
  return place.probe_ratio >= settings.probe_ratio &&
         toldApart(place, settings, settings.min_agreement, settings.ambiguity_ratio);
}

bool speaksForGuess(const PlaceMeasures& place, const VerdictSettings& settings) {
  return place.probe_ratio >= settings.guess_ratio &&
         toldApart(place, settings, settings.guess_agreement, settings.guess_ratio);
}

Verdict judge(const PlaceMeasures& place, const VerdictSettings& settings) {
  Verdict verdict = statusOf(place, settings);
  verdict.guess = verdict.status != Status::kConverged && place.maps >= settings.min_maps &&
                  speaksForGuess(place, settings) && place.guess_evidence >= settings.min_evidence;
  if (verdict.guess) verdict.reason += "; a guess for the refinement: no other place has as much evidence";
  return verdict;
}

}  // namespace heightmap_mcl
