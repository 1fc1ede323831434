#include "heightmap_mcl/dominant_floor.h"

#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <pcl/sample_consensus/ransac.h>
#include <pcl/sample_consensus/sac_model_perpendicular_plane.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "air_ground_common/statistics.h"

namespace heightmap_mcl {
namespace {

constexpr std::size_t kMost = 8000;     // points, evenly taken
constexpr std::size_t kProbes = 150;    // whose nearest neighbours tell the spacing
constexpr double kSpacings = 2;         // within so many of the plane a point lies on it
constexpr double kProbability = 0.999;  // of having drawn from the plane alone

/// Median distance of a point to its nearest neighbour.
double spacingOf(const pcl::PointCloud<pcl::PointXYZ>& cloud) {
  std::vector<float> nearest;
  const std::size_t step = std::max<std::size_t>(1, cloud.size() / kProbes);
  for (std::size_t i = 0; i < cloud.size(); i += step) {
    float best = std::numeric_limits<float>::infinity();
    for (std::size_t j = 0; j < cloud.size(); ++j) {
      if (j == i) continue;
      best = std::min(best, (cloud[i].getVector3fMap() - cloud[j].getVector3fMap()).squaredNorm());
    }
    nearest.push_back(best);
  }
  return std::sqrt(air_ground_common::median(std::move(nearest)));
}

}  // namespace

FloorRule flatFloorRule(double max_slope) { return {max_slope, 0.2, 0.03, 0.7}; }

std::optional<DominantFloor> findDominantFloor(const std::vector<Eigen::Vector3f>& points, const Eigen::Vector3d& up,
                                               const FloorRule& rule) {
  auto cloud = pcl::make_shared<pcl::PointCloud<pcl::PointXYZ>>();
  const double step = std::max(1.0, static_cast<double>(points.size()) / kMost);
  for (double i = 0; i < static_cast<double>(points.size()); i += step) {
    const Eigen::Vector3f& p = points[static_cast<std::size_t>(i)];
    if (p.allFinite()) cloud->emplace_back(p.x(), p.y(), p.z());
  }
  if (cloud->size() < 100) return std::nullopt;
  const double tolerance = rule.tolerance > 0 ? rule.tolerance : kSpacings * spacingOf(*cloud);
  if (!(tolerance > 0)) return std::nullopt;

  using Model = pcl::SampleConsensusModelPerpendicularPlane<pcl::PointXYZ>;
  auto model = pcl::make_shared<Model>(cloud);
  model->setAxis(up.cast<float>());
  model->setEpsAngle(rule.max_tilt);
  pcl::RandomSampleConsensus<pcl::PointXYZ> ransac(model, tolerance);
  ransac.setProbability(kProbability);
  ransac.setMaxIterations(1000);
  if (!ransac.computeModel()) return std::nullopt;
  pcl::Indices inliers;
  ransac.getInliers(inliers);
  Eigen::VectorXf plane, refined;
  ransac.getModelCoefficients(plane);
  model->optimizeModelCoefficients(inliers, plane, refined);
  model->selectWithinDistance(refined, tolerance, inliers);
  DominantFloor floor;
  floor.share = static_cast<double>(inliers.size()) / static_cast<double>(cloud->size());
  if (floor.share < rule.min_share || refined.size() != 4) return std::nullopt;
  pcl::Indices near;
  model->selectWithinDistance(refined, 4 * tolerance, near);
  if (static_cast<double>(inliers.size()) < rule.min_flatness * static_cast<double>(near.size())) return std::nullopt;
  floor.up = refined.head<3>().cast<double>().normalized();
  if (floor.up.dot(up) < 0) floor.up = -floor.up;
  if (std::acos(std::min(1.0, floor.up.dot(up))) > rule.max_tilt) return std::nullopt;
  return floor;
}

}  // namespace heightmap_mcl
