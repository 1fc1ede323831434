#include "place_measures.h"

#include <algorithm>
#include <cmath>

#include "cost_shape.h"

namespace heightmap_mcl {

void measure(const FoundPlace& found, const GroundModel& ground, const Comparison& comparison,
             const HeightMapLocalizerSettings& settings, PlaceMeasures* measures) {
  PlaceMeasures& m = *measures;
  const Agreement &best = found.best.agreement, &rival = found.rival.agreement;
  m.rival_ratio = std::isfinite(rival.score) ? rivalRatio(rival, best, settings.noise_cost) : kInfinity;
  m.evidence_lead = comparison.lead(best, rival);
  m.particles_agree = isSame(found.particles, found.best.pose, settings.rival);
  if (!std::isfinite(best.cost)) return;

  const Zmssd zmssd = ground.direct()(found.cells, found.best.pose, found.cost);
  m.overlap = best.overlap / static_cast<double>(found.cells.h.size());
  m.rival_distance = std::isfinite(rival.cost) ? separation(found.rival.pose, found.best.pose) : kInfinity;
  m.cost = zmssd.cost;
  m.relief = std::min(zmssd.relief_air, zmssd.relief_ground);
  m.explained = zmssd.explained;
  m.agreement = best.agreeing;
  m.raised = best.raised * ground.map().resolution * ground.map().resolution;
  const Probe weakest =
      probe(ground.direct(), found.cells, found.best, found.cost, settings.probe_distance, settings.noise_cost);
  m.probe_ratio = weakest.ratio;
  m.flattest = weakest.flattest;
}

}  // namespace heightmap_mcl
