#include "heightmap_mcl/localizer.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <stdexcept>

#include "air_ground_common/text.h"
#include "air_ground_common/units.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::formatted;
using air_ground_common::kDegree;
using air_ground_common::wrapAngle;

/// Minima of eq. 2 that are compared: the right place is often not its lowest one.
constexpr std::size_t kPlaces = 16;
/// Of heights where the particles' sigma is as set [m^2]. Where less stands, costs differ by less.
constexpr double kUsualVariance = 0.03;

double separation(const PlanarPose& a, const PlanarPose& b) { return std::hypot(a.x - b.x, a.y - b.y); }

}  // namespace

HeightMapLocalizer::HeightMapLocalizer(const HeightMapLocalizerSettings& settings)
    : settings_(settings), filter_(settings.filter, settings.seed) {
  validate(settings_);
  restart(true);
}
HeightMapLocalizer::~HeightMapLocalizer() = default;

air_ground_common::Pose CoarseEstimate::similarityPose() const {
  air_ground_common::Pose T = T_ground_mav;
  T.linear() = T_ground_mav.linear() * R_level;
  return T;
}

void HeightMapLocalizer::forgetGround() {
  ground_ = HeightMap();
  ground_levels_.clear();
  ground_piece_ = 0;
  direct_.reset();
  coarse_fft_.reset();
  full_fft_.reset();
  restart(false);
}

void HeightMapLocalizer::restart(bool forget_aerial) {
  filter_.clear();
  maps_ = 0;
  restarts_ = 0;
  evidence_ = guess_evidence_ = 0;
  place_before_.reset();
  new_map_ = false;
  if (forget_aerial) {
    floor_ = std::numeric_limits<double>::quiet_NaN();
    floor_rivals_.clear();
    scale_ = 1;
    scale_stddev_ = scale_evidence_ = 0;
    R_level_.setIdentity();
    scale_peaks_.clear();
    grids_ = clouds_since_grid_ = 0;
    aerial_.clear();
    filter_map_ = HeightMap();
  }
  drawFromKeptMaps();
  updateEstimate();
  hearKeptMaps();
}

void HeightMapLocalizer::drawFromKeptMaps() {
  if (!hasGround() || !hasAerial()) return;
  maps_ = static_cast<int>(aerial_.size());
  if (scale_stddev_ == 0 || scale_evidence_ < settings_.scale_evidence) updateScale();
  updateFloor();
  filter_map_ = lastMaps(settings_.accumulate);
  filter_.initialize(verifyVolume(lastMaps(settings_.verify)), prior_, lastReference());
}

void HeightMapLocalizer::hearKeptMaps() {
  const bool heard = evidence_ > 0 || guess_evidence_ > 0;
  if (settings_.mode == Mode::kPaper || heard || aerial_.size() < 2 || !(speaksFor() || speaksForGuess())) return;
  std::deque<Kept> maps;
  maps.swap(aerial_);
  filter_.clear();
  maps_ = 0;
  place_before_.reset();
  for (Kept& map : maps) {
    aerial_.push_back(std::move(map));
    updateFloor();
    useNewestMap();
  }
}

void HeightMapLocalizer::useNewestMap() {
  filter_map_ = lastMaps(settings_.accumulate);
  if (hasGround()) updateFilter();
  new_map_ = true;
  updateEstimate();
  new_map_ = false;
}

bool HeightMapLocalizer::setGround(const std::vector<Eigen::Vector3f>& points, std::size_t* cropped) {
  HeightMap map = buildHeightMap(points, settings_.ground_map, cropped);
  if (map.empty()) {
    forgetGround();
    return false;
  }
  // All or nothing: what throws here leaves the map before it whole.
  auto direct = std::make_unique<DirectCost>(map);
  auto coarse_fft = std::make_unique<FftCost>(downsample(map, settings_.coarse_factor));
  ground_ = std::move(map);
  ground_levels_.clear();
  ground_piece_ = 0;
  ground_variance_ = std::pow(heightDeviation(ground_), 2);
  ground_raised_ = raisedShare(ground_, kRaised * settings_.cutoff);
  filter_.setSigmaShare(settings_.mode == Mode::kPaper ? 1 : std::clamp(ground_variance_ / kUsualVariance, 0.02, 1.0));
  direct_ = std::move(direct);
  coarse_fft_ = std::move(coarse_fft);
  full_fft_.reset();
  verify_volume_.reset();
  if (stillStands()) return true;
  // What the particles drawn so far could not know lies in the new part of the map.
  if (estimate_.status != Status::kConverged) drawFromKeptMaps();
  updateEstimate();
  hearKeptMaps();
  return true;
}

bool HeightMapLocalizer::stillStands() const {
  constexpr double kGrowth = 1.1, kWorse = 1.1;
  if (!estimate_.has_pose || settings_.mode == Mode::kPaper) return false;
  const auto now = static_cast<double>(ground_.defined()), then = static_cast<double>(searched_cells_);
  if (now > kGrowth * then || then > kGrowth * now) return false;
  if (estimate_.status != Status::kConverged) return true;
  const HeightMap map = lastMaps(settings_.verify);
  const AerialCells cells = cellsOf(map, centerOf(map));
  const Placement place = placementAt(*direct_, cells, planarOf(estimate_.T_ground_mav, cells.reference), costFor(map));
  return place.agreement.score <= kWorse * score_ && place.agreement.agreeing >= settings_.min_agreement;
}

bool HeightMapLocalizer::addAerial(const AerialCloud& cloud, std::size_t* cropped) {
  if (cropped) *cropped = 0;
  if (!cloud.reference.allFinite()) return false;
  // A cloud that shows a table alone has the floor of those before it.
  LevelHistogram levels;
  for (const Kept& kept : aerial_) levels.add(kept.map.levels);
  HeightMap map = mapOf(cloud.points, levels, cropped);
  if (map.empty()) return false;
  aerial_.push_back({std::move(map), cloud.reference, {}});
  if (own_unit_) aerial_.back().points = kept(cloud.points);
  while (static_cast<int>(aerial_.size()) > settings_.verify) aerial_.pop_front();
  boundKeptMaps();
  if (hasGround()) {
    updateScale();
    updateFloor();
  }
  useNewestMap();
  return true;
}

void HeightMapLocalizer::boundKeptMaps() {
  if (own_unit_ && scale_evidence_ < settings_.scale_evidence) return;  // nobody knows yet how large they are
  // A single map has a border of a cell.
  const double bound = settings_.air_map.max_extent + 3 * settings_.air_map.resolution;
  while (aerial_.size() > 1 && unionExtent(keptMaps(settings_.verify)) > bound) {
    aerial_.pop_front();
    ++far_maps_dropped_;
  }
}

std::vector<const HeightMap*> HeightMapLocalizer::keptMaps(int count) const {
  std::vector<const HeightMap*> maps;
  const int n = static_cast<int>(aerial_.size());
  for (int i = std::max(0, n - count); i < n; ++i) maps.push_back(&aerial_[i].map);
  return maps;
}

CostSettings HeightMapLocalizer::costFor(const HeightMap& air) const {
  // Of unrelated heights, eq. 2 is on average half the sum of both variances.
  const double unrelated = 0.5 * (std::pow(heightDeviation(air), 2) + ground_variance_);
  // The paper's share is of one cloud: what other clouds saw elsewhere takes nothing from what this one shares.
  double largest = 0;
  for (const Kept& kept : aerial_) largest = std::max(largest, static_cast<double>(kept.map.defined()));
  const double smaller = static_cast<double>(std::min(air.defined(), ground_.defined()));
  return {settings_.min_overlap * std::min(1.0, largest / std::max(smaller, 1.0)),
          settings_.unknown_weight * unrelated,
          settings_.min_explained,
          settings_.min_relief,
          settings_.overlap_of_air,
          settings_.cutoff,
          unknownShare()};
}

AerialCells HeightMapLocalizer::cellsOf(const HeightMap& air, const Eigen::Vector2d& reference) const {
  return aerialCells(air, reference, static_cast<int>(std::lround(settings_.edge_width / air.resolution)));
}

CostVolume HeightMapLocalizer::coarseVolume(const HeightMap& map) const {
  const auto headings = searchHeadings(settings_.headings, prior_);
  const bool circular = static_cast<int>(headings.size()) == settings_.headings;
  return computeCostVolume(*coarse_fft_, downsample(map, settings_.coarse_factor), headings, circular, costFor(map));
}

const CostVolume& HeightMapLocalizer::verifyVolume(const HeightMap& verify_map) {
  if (!verify_volume_) verify_volume_ = coarseVolume(verify_map);
  return *verify_volume_;
}

void HeightMapLocalizer::updateFilter() {
  const Eigen::Vector2d reference = lastReference();
  ++maps_;
  if (filter_.initialized()) {
    filter_.move(reference);
    weighed_ = filter_.weigh(*direct_, cellsOf(filter_map_, reference), costFor(filter_map_));
    if (weighed_ || settings_.mode == Mode::kPaper) return;
    // The last clouds lie outside the ground map: those before them still tell.
    const HeightMap verify_map = lastMaps(settings_.verify);
    weighed_ = filter_.weigh(*direct_, cellsOf(verify_map, reference), costFor(verify_map));
    if (weighed_) return;
    ++restarts_;
  }
  if (!filter_.initialize(coarseVolume(filter_map_), prior_, reference)) maps_ = 0;
}

void HeightMapLocalizer::updateEstimate() {
  estimate_ = CoarseEstimate();
  estimate_.scale = scale_;
  estimate_.scale_stddev = scale_stddev_;
  estimate_.R_level = R_level_;
  if (own_unit_) estimate_.scale_evidence = scale_evidence_;
  estimate_.maps = maps_;
  estimate_.restarts = restarts_;
  if (!hasGround() || !hasAerial()) {
    estimate_.reason = !hasGround() ? "waiting for the ground map" : "waiting for an aerial cloud";
    return;
  }
  if (!filter_.initialized()) {
    estimate_.reason =
        formatted("no placement where the maps share %.0f %% of the smaller one's cells", 100 * settings_.min_overlap);
    return;
  }
  if (own_unit_ && scale_evidence_ < settings_.scale_evidence) {
    // At a scale that nothing singles out there is no place to verify.
    estimate_.status = Status::kSearching;
    estimate_.reason = formatted("another scale than %.3g fits about as well: evidence %.1f, %.1f is needed", scale_,
                                 scale_evidence_, settings_.scale_evidence);
    return;
  }
  const auto spread = filter_.spread();
  estimate_.particle_spread = spread.position;
  estimate_.particle_spread_yaw = spread.yaw;
  estimate_.particle_mean = filter_.mean();
  if (settings_.mode == Mode::kPaper) {
    estimateFromParticles();
    return;
  }
  const ParticleMode mode = filter_.modes(settings_.rival_distance, settings_.rival_angle).front();
  estimate_.mode_weight = mode.weight;
  estimate_.mode_spread = std::sqrt(mode.covariance.topLeftCorner<2, 2>().trace() / 2);
  estimate_.mode_spread_yaw = std::sqrt(mode.covariance(2, 2));

  estimateFromPlaces(mode);
  verify_volume_.reset();  // tens of megabytes
}

/// The best of all places, its rivals and the verdict on it. Sought about the merged maps' centre, compared and judged
/// about that of the overlap, where heading and position hardly interact.
void HeightMapLocalizer::estimateFromPlaces(const ParticleMode& mode) {
  const HeightMap verify_map = lastMaps(settings_.verify);
  AerialCells cells = cellsOf(verify_map, centerOf(verify_map));
  const CostSettings cost = costFor(verify_map);
  PlanarPose mean = changeReference(mode.mean, filter_.reference(), cells.reference);
  Placement best = descend(*direct_, cells, mean, 2 * ground_.resolution, 2 * kDegree, cost);
  if (!std::isfinite(best.agreement.cost) || separation(best.pose, mean) > settings_.rival_distance) {
    best = placementAt(*direct_, cells, mean, cost);
  }

  const CostVolume& volume = verifyVolume(verify_map);
  std::vector<Placement> places = findPlaces(volume, cells, cost, best);
  if (places.empty()) {
    estimate_.reason = "nothing fits near the initial guess";
    return;
  }
  best = bestOf(places);
  const Eigen::Vector2d merged_center = cells.reference;
  cells = about(std::move(cells), overlapCenter(cells, best.pose));
  for (Placement& place : places) place.pose = changeReference(place.pose, merged_center, cells.reference);
  mean = changeReference(mean, merged_center, cells.reference);
  best.pose = changeReference(best.pose, merged_center, cells.reference);
  const Placement refined = descend(*direct_, cells, best.pose, ground_.resolution, kDegree, cost);
  if (refined.agreement.score < best.agreement.score) best = refined;
  score_ = best.agreement.score;
  searched_cells_ = ground_.defined();
  const Placement rival = compareWithRivals(best, places);
  const bool particles_agree = isSame(mean, best.pose);

  estimate_.has_pose = std::isfinite(best.agreement.cost);
  if (!estimate_.has_pose) {
    estimate_.reason = "the maps do not overlap where the particles are";
    filter_.clear();
    return;
  }
  const PlanarPose origin = changeReference(best.pose, cells.reference, Eigen::Vector2d::Zero());
  estimate_.T_ground_mav = air_ground_common::yawPose(origin.yaw, {origin.x, origin.y, best.agreement.dz});
  estimate_.overlap = best.agreement.overlap / static_cast<double>(cells.h.size());
  estimate_.rival_distance = std::isfinite(rival.agreement.cost) ? separation(rival.pose, best.pose) : kInfinity;
  const Eigen::Vector3d flattest = judge(best, cells, cost, particles_agree);
  setCovariance(best, rival, cells, cost, mode, flattest);
  if (!particles_agree && estimate_.rival_ratio >= settings_.ambiguity_ratio) {
    // The merged maps single out a place that the particles have missed: sensor resetting (Lenser and Veloso 2000).
    filter_.initialize(volume, prior_, filter_.reference());
    ++restarts_;
  } else if (weighed_) {
    filter_.resample(&volume, prior_);
  }
  weighed_ = false;
}

/// In the aerial frame.
Eigen::Vector2d HeightMapLocalizer::overlapCenter(const AerialCells& cells, const PlanarPose& pose) const {
  const Eigen::Vector2d center = direct_->overlapAt(cells, pose).center;
  return cells.reference + Eigen::Rotation2Dd(-pose.yaw) * (center - Eigen::Vector2d(pose.x, pose.y));
}

/// The lowest places of the full search beside the particles' mode. Where one fits better than that, it is the
/// estimate, and the particles have yet to follow.
std::vector<Placement> HeightMapLocalizer::findPlaces(const CostVolume& volume, const AerialCells& cells,
                                                      const CostSettings& cost, const Placement& mode) const {
  std::vector<Placement> places =
      placesOfMinima(volume, kPlaces, settings_.rival_distance, settings_.rival_angle, *direct_, cells,
                     settings_.coarse_factor * ground_.resolution, M_PI / settings_.headings, cost);
  places.push_back(mode);
  // Where the maps were before: few new cells may hide that place from the search over coarse ones.
  if (place_before_)
    places.push_back(
        descend(*direct_, cells, planarOf(*place_before_, cells.reference), 2 * ground_.resolution, 2 * kDegree, cost));
  places.insert(places.end(), floor_rivals_.begin(), floor_rivals_.end());
  // Where a position is known, places beyond three standard deviations are no rivals.
  places.erase(std::remove_if(places.begin(), places.end(),
                              [&](const Placement& c) { return prior_.logDensity(c.pose, cells.reference) < -4.5; }),
               places.end());
  return places;
}

bool HeightMapLocalizer::isSame(const PlanarPose& a, const PlanarPose& b) const {
  return separation(a, b) < settings_.rival_distance && std::abs(wrapAngle(a.yaw - b.yaw)) < settings_.rival_angle;
}

Placement HeightMapLocalizer::bestElsewhere(const std::vector<Placement>& places, const PlanarPose& pose) const {
  std::vector<Placement> others;
  std::copy_if(places.begin(), places.end(), std::back_inserter(others),
               [&](const Placement& place) { return !isSame(place.pose, pose); });
  return bestOf(others);
}

/// Sets rival_ratio and evidence_lead; returns the best rival, without a finite cost where there is none.
Placement HeightMapLocalizer::compareWithRivals(const Placement& best, const std::vector<Placement>& places) {
  const Placement rival = bestElsewhere(places, best.pose);
  const bool alone = !std::isfinite(rival.agreement.score);
  estimate_.rival_ratio = alone ? kInfinity : rivalRatio(rival.agreement, best.agreement);
  // Without any other place: the lead over nothing known.
  estimate_.evidence_lead = evidenceLead(best.agreement, alone ? nothingKnown() : rival.agreement.score);
  return rival;
}

CostMap HeightMapLocalizer::costMap(Eigen::Vector2d* pivot) {
  if (!hasGround() || filter_map_.empty()) return {};
  if (!full_fft_) full_fft_ = std::make_unique<FftCost>(ground_);
  const double yaw = air_ground_common::yawOf(estimate_.T_ground_mav.rotation());
  CostVolume volume = computeCostVolume(*full_fft_, filter_map_, {yaw}, false, costFor(filter_map_));
  *pivot = volume.pivot;
  return std::move(volume.slices.front());
}

}  // namespace heightmap_mcl
