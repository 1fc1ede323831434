#include "scale_trial.h"

#include <algorithm>
#include <cmath>

namespace heightmap_mcl {
namespace {

constexpr double kEdge = 0.02;    // [m] to which both maps place an edge, see scaleDeviation
constexpr int kCoarseCells = 36;  // across the aerial map, over all headings and offsets
constexpr int kHeadings = 36;
constexpr std::size_t kPlaces = 6;  // of a scale, that are compared
constexpr std::size_t kFloors = 3;  // places of the floor that are tried at a scale

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

double fitOf(const ScaleTrial& trial, double noise_cost, bool charged) {
  const double cost = charged ? trial.agreement.score : trial.agreement.cost;
  return std::log(variancesOf(trial.zmssd) / (cost + noise_cost));
}

double bendOf(const ScaleTrial& before, const ScaleTrial& middle, const ScaleTrial& after, double step) {
  const double bend = (before.agreement.cost - 2 * middle.agreement.cost + after.agreement.cost) / (step * step);
  return std::isfinite(bend) ? std::max(0.0, bend) : 0;
}

double scaleDeviation(const ScaleTrial& trial, double noise_cost) {
  // As for the pose (covariance.h): the information is n / (2 C) times the curvature of the cost.
  const double information =
      std::max(1.0, trial.independent) * trial.curvature / (2 * (trial.agreement.cost + noise_cost));
  constexpr double kOpen = 0.1;  // where the cost shows no minimum: another peak would have been found beyond
  return std::hypot(1 / std::sqrt(information + 1 / (kOpen * kOpen)), kEdge / std::max(trial.radius, kEdge));
}

/// The clouds' height map at a scale, in the cells of a level of the ground map.
struct ScaleTrials::ScaledMap {
  double scale = 1;
  HeightMap map;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  // [m]
  GroundModel::Level& ground;

  HeightMap onFloor(double floor) const { return std::isnan(floor) ? map : withFloor(map, scale * floor); }
};

ScaleTrials::ScaledMap ScaleTrials::scaledMap(double scale, const LevelCloud& cloud, int cells_across,
                                              int least_factor) const {
  const double fine = settings_.air_map.resolution;
  const int factor = std::max(least_factor, static_cast<int>(std::ceil(scale * cloud.extent / (fine * cells_across))));
  HeightMapSettings how = settings_.air_map;
  how.resolution = fine * factor;
  if (factor > 1 && how.dilation == Dilation::kAll) how.dilation = Dilation::kHoles;  // large cells are dilated already
  how.max_extent = std::max(how.max_extent, 10 * how.resolution);
  std::vector<Eigen::Vector3f> points = cloud.points;
  for (auto& p : points) p *= static_cast<float>(scale);
  return {scale, buildHeightMap(points, how), scale * cloud.centre, ground_.level(factor)};
}

ScaleTrial ScaleTrials::anywhere(double scale, const LevelCloud& cloud) const {
  ScaleTrial trial;
  trial.scale = scale;
  const ScaledMap map = scaledMap(scale, cloud, kCoarseCells, ground_.largeFactor());
  if (map.map.empty()) return trial;
  const HeightMap& fine = ground_.map();
  const auto headings = searchHeadings(kHeadings, prior_);
  const bool circular = static_cast<int>(headings.size()) == kHeadings;
  // Who has seen tables alone takes one for the floor.
  LevelHistogram levels = map.map.levels;
  const double cell = std::pow(map.ground.map.resolution / fine.resolution, 2);
  for (float& cells : levels.cells) cells *= static_cast<float>(cell);
  std::vector<Placement> places;
  Placement best;
  HeightMap best_map;
  const std::vector<double> candidates = floorCandidates(levels, fine.levels, fine.cap, kFloors);
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    // Its own one, too: at another scale it might take another surface for that.
    const double floor = (i == 0 ? map.map.floor : candidates[i]) / scale;
    const HeightMap lifted = i == 0 ? map.map : map.onFloor(floor);
    const CostSettings cost = comparison_.costFor(lifted);
    const CostVolume volume = computeCostVolume(map.ground.fft(), lifted, headings, circular, cost);
    const std::vector<Placement> found =
        placesOfMinima(volume, kPlaces, settings_.rival.distance, settings_.rival.angle, prior_, map.ground.direct,
                       aerialCells(lifted, map.centre), lifted.resolution, M_PI / kHeadings, cost);
    places.insert(places.end(), found.begin(), found.end());
    const Placement lowest = bestOf(found);
    if (!(lowest.agreement.score < best.agreement.score)) continue;
    best = lowest;
    best_map = lifted;
    trial.place = {best.pose, floor};
  }
  if (!std::isfinite(best.agreement.score)) return trial;
  judge(&trial, map, best_map, best.agreement);
  const Placement rival = bestElsewhere(places, best.pose, settings_.rival);
  const double less = comparison_.scoreElsewhere(rival.agreement) - trial.agreement.score;
  const double explained = std::max(0.0, 1 - trial.agreement.score / comparison_.nothingKnown());
  const double by_chance = 1 / (1 + trial.independent);  // a single piece of ground is like many others
  trial.distinctness = logLikelihoodRatio(1, less, settings_.cutoff) * explained * (1 - by_chance);
  return trial;
}

ScaleTrial ScaleTrials::near(double scale, const LevelCloud& cloud, int cells_across, const PlaceOnFloor& start) const {
  ScaleTrial trial;
  trial.scale = scale;
  trial.place = start;
  const ScaledMap map = scaledMap(scale, cloud, cells_across, 1);
  if (map.map.empty()) return trial;
  Agreement there;
  HeightMap lifted;
  // What the floor is off shows where heights agree; tables alone were seen at another scale above it.
  for (int i = 0; i < 2; ++i) {
    lifted = map.onFloor(trial.place.floor);
    const Placement best = descend(map.ground.direct, aerialCells(lifted, map.centre), trial.place.pose,
                                   2 * lifted.resolution, 0.03, comparison_.costFor(lifted));
    trial.place.pose = best.pose;
    there = best.agreement;
    if (i == 0 && std::isfinite(there.cost)) trial.place.floor += there.offset / scale;
  }
  judge(&trial, map, lifted, there);
  return trial;
}

/// What both maps say at the trial's place. `lifted`: on the floor of that.
void ScaleTrials::judge(ScaleTrial* trial, const ScaledMap& map, const HeightMap& lifted,
                        const Agreement& there) const {
  trial->agreement = there;
  trial->radius = rootMeanSquareRadius(lifted, map.centre);
  trial->zmssd = map.ground.direct(aerialCells(lifted, map.centre), trial->place.pose, comparison_.costFor(lifted));
  trial->independent = trial->zmssd.known * std::pow(lifted.resolution, 2) / ground_.piece();
}

}  // namespace heightmap_mcl
