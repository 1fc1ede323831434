// How sure a place is said to be.
#include "covariance.h"

#include <gtest/gtest.h>

#include <cmath>

#include "heightmap_mcl/height_map.h"

namespace heightmap_mcl {
namespace {

// The cost's curvature at the place is that of edges, however little moves of a quarter of a metre change it.
TEST(Covariance, ClaimsNoMoreThanTheProbeShows) {
  const HeightMapLocalizerSettings settings;
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 200; ++i)
    for (int j = 0; j < 200; ++j)
      points.emplace_back(0.02f * i + 0.01f, 0.02f * j + 0.01f, i % 50 < 25 && j % 50 < 25 ? 0.5f : 0.f);
  const HeightMap map = buildHeightMap(points, settings.ground_map);
  const GroundModel ground(map, settings);
  FoundPlace place;
  place.cells = aerialCells(map, {2, 2});
  place.cost.min_overlap = 0.2;
  place.best = placementAt(ground.direct(), place.cells, {2, 2, 0}, place.cost);
  ParticleMode particles;
  particles.weight = 1;
  const double independent = place.best.agreement.overlap * std::pow(map.resolution, 2) / settings.independent_area;
  const auto variance = [&](double ratio, int axis) {
    PlaceMeasures measures;
    measures.relief = 0.2;
    measures.probe_ratio = ratio;
    measures.flattest = {0.25, 0, 0};
    return covarianceOf(place, measures, Status::kConverged, ground, particles, {2, 2}, settings)(axis, axis);
  };
  const double sure = variance(1e6, 0), floor = std::pow(settings.covariance.floor_position, 2);
  ASSERT_LT(sure - floor, std::pow(0.01, 2)) << "by its curvature alone";
  EXPECT_NEAR(variance(1.2, 0) - floor, 0.0625 / (0.2 * independent), 1e-6);
  EXPECT_DOUBLE_EQ(variance(1.2, 1), variance(1e6, 1)) << "the other axis";
}

}  // namespace
}  // namespace heightmap_mcl
