#include "heightmap_mcl/localizer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/text.h"
#include "covariance.h"
#include "evidence_sum.h"
#include "heightmap_mcl/dominant_floor.h"
#include "kept_maps.h"
#include "paper_estimate.h"
#include "place_measures.h"
#include "scale_search.h"
#include "verdict.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::formatted;

/// Of heights where the particles' sigma is as set [m^2]. Where less stands, costs differ by less.
constexpr double kUsualVariance = 0.03;
constexpr double kOtherScale = 0.015;  // a change of its logarithm by more moves the particles' map too far

}  // namespace

HeightMapLocalizer::HeightMapLocalizer(const HeightMapLocalizerSettings& settings)
    : settings_(settings),
      kept_(std::make_unique<KeptMaps>(settings)),
      scale_(std::make_unique<ScaleSearch>(settings)),
      evidence_(std::make_unique<EvidenceSum>(settings.verdict.min_evidence, settings.rival)),
      filter_(settings.filter, settings.seed) {
  validate(settings_);
  restart(true);
}
HeightMapLocalizer::~HeightMapLocalizer() = default;

bool HeightMapLocalizer::hasAerial() const { return !kept_->empty(); }
Eigen::Vector3d HeightMapLocalizer::reference() const {
  return kept_->empty() ? Eigen::Vector3d(Eigen::Vector3d::Zero()) : kept_->newestCloud().reference;
}
std::size_t HeightMapLocalizer::farMapsDropped() const { return kept_->farDropped(); }

const HeightMap& HeightMapLocalizer::groundMap() const {
  static const HeightMap none;
  return ground_ ? ground_->map() : none;
}

void HeightMapLocalizer::setPrior(const Prior& prior) {
  prior_ = prior;
  verify_volume_.reset();
}

void HeightMapLocalizer::setOwnUnit(bool own_unit) {
  if (own_unit == kept_->ownUnit()) return;
  kept_->setOwnUnit(own_unit);
  restart(true);
}

void HeightMapLocalizer::setVertical(const air_ground_common::Vertical& vertical) { kept_->setVertical(vertical); }

void HeightMapLocalizer::forgetGround() {
  ground_.reset();
  restart(false);
}

void HeightMapLocalizer::restart(bool forget_aerial) {
  filter_.clear();
  maps_ = 0;
  restarts_ = 0;
  evidence_->clear();
  scale_->clear();
  estimate_ = CoarseEstimate();  // what was CONVERGED would hold the scale where it was
  if (forget_aerial) {
    kept_->clear();
    corrections_.clear();
    floor_rivals_.clear();
    filter_map_ = HeightMap();
  }
  drawFromKeptMaps();
  updateEstimate(false);
  hearKeptMaps();
}

bool HeightMapLocalizer::keepGround(const std::vector<Eigen::Vector3f>& points, std::size_t* cropped) {
  std::vector<Eigen::Vector3f> turned;
  HeightMap map = buildHeightMap(levelGround(points, &turned), settings_.ground_map, cropped);
  if (map.empty()) {
    forgetGround();
    return false;
  }
  ground_ = std::make_unique<GroundModel>(std::move(map), settings_);
  filter_.setSigmaShare(settings_.mode == Mode::kPaper ? 1
                                                       : std::clamp(ground_->variance() / kUsualVariance, 0.02, 1.0));
  verify_volume_.reset();
  if (hasAerial()) updateLevel();
  return true;
}

bool HeightMapLocalizer::setGround(const std::vector<Eigen::Vector3f>& points, std::size_t* cropped, bool corrected) {
  if (!keepGround(points, cropped)) return false;
  if (!corrected && stillStands()) return true;
  if (estimate_.status != Status::kConverged) {
    if (corrected) evidence_->clear();
    // What the particles drawn so far could not know lies in the new part of the map.
    drawFromKeptMaps();
  }
  updateEstimate(false);
  hearKeptMaps();
  return true;
}

void HeightMapLocalizer::correct(const air_ground_common::CloudCorrections& corrections) {
  const auto since = air_ground_common::correctionsSince(std::exchange(corrections_, corrections), corrections);
  const double moved = kept_->correct(since);
  if (moved == 0) return;
  verify_volume_.reset();
  if (moved > settings_.air_map.resolution) restart(false);
}

bool HeightMapLocalizer::keep(const AerialCloud& given, std::size_t* cropped) {
  if (cropped) *cropped = 0;
  AerialCloud cloud = given;
  if (const auto it = corrections_.find(cloud.stamp); it != corrections_.end()) {
    if (!it->second) return false;
    moveBy(*it->second, &cloud);
  }
  if (!cloud.reference.allFinite() || !kept_->add(cloud, cropped)) return false;
  dropFarMaps();
  return true;
}

bool HeightMapLocalizer::keepAerial(const AerialCloud& cloud, std::size_t* cropped) {
  if (!keep(cloud, cropped)) return false;
  ++maps_;
  return true;
}

bool HeightMapLocalizer::addAerial(const AerialCloud& cloud, std::size_t* cropped) {
  if (!keep(cloud, cropped)) return false;
  if (hasGround()) {
    updateLevel();
    updateScale();
    updateFloor();
  }
  useNewestMap();
  return true;
}

const std::vector<Eigen::Vector3f>& HeightMapLocalizer::levelGround(const std::vector<Eigen::Vector3f>& points,
                                                                    std::vector<Eigen::Vector3f>* turned) {
  constexpr double kLevel = 0.002;  // [rad]
  ground_is_flat_ = false;
  R_ground_level_.setIdentity();
  if (settings_.max_slope <= 0 || settings_.mode == Mode::kPaper) return points;
  const auto floor = findDominantFloor(points, Eigen::Vector3d::UnitZ(), flatFloorRule(settings_.max_slope));
  if (!floor) return points;
  ground_is_flat_ = true;
  const Eigen::Matrix3d R = air_ground_common::levelingRotation(floor->up);
  if (air_ground_common::rotationAngle(R, Eigen::Matrix3d::Identity()) < kLevel) return points;
  R_ground_level_ = R;
  const Eigen::Matrix3f R_float = R.cast<float>();
  turned->reserve(points.size());
  for (const Eigen::Vector3f& p : points) turned->push_back(R_float * p);
  return *turned;
}

Comparison HeightMapLocalizer::comparison() const { return {settings_, *ground_, kept_->largest(), kept_->ownUnit()}; }

PlaceSearch HeightMapLocalizer::search() const { return {settings_, *ground_, prior_, comparison()}; }

const CostVolume& HeightMapLocalizer::verifyVolume(const HeightMap& verify_map) {
  if (!verify_volume_) verify_volume_ = search().volumeOf(verify_map);
  return *verify_volume_;
}

bool HeightMapLocalizer::scaleIsOpen() const {
  return kept_->ownUnit() && scale_->estimate().evidence < settings_.own_unit.scale_evidence;
}

bool HeightMapLocalizer::stillStands() const {
  constexpr double kGrowth = 1.1, kWorse = 1.1;
  if (!estimate_.has_pose || settings_.mode == Mode::kPaper) return false;
  const auto now = static_cast<double>(ground_->map().defined()), then = static_cast<double>(searched_cells_);
  if (now > kGrowth * then || then > kGrowth * now) return false;
  const HeightMap map = kept_->merged();
  const Comparison compare = comparison();
  const AerialCells cells = compare.cellsOf(map, centerOf(map));
  const Placement place =
      placementAt(ground_->direct(), cells, planarOf(estimate_.T_ground_mav, cells.reference), compare.costFor(map));
  const double score = place.agreement.score;
  if (score > kWorse * score_) return false;
  // What was not CONVERGED may be so where it fits better now.
  return estimate_.status == Status::kConverged ? place.agreement.agreeing >= settings_.verdict.min_agreement
                                                : score_ <= kWorse * score;
}

void HeightMapLocalizer::drawFromKeptMaps() {
  if (!hasGround() || !hasAerial()) return;
  maps_ = static_cast<int>(kept_->size());
  updateScale();
  updateFloor();
  filter_map_ = kept_->merged(settings_.accumulate);
  filter_.initialize(verifyVolume(kept_->merged()), prior_, kept_->reference());
}

void HeightMapLocalizer::hearKeptMaps() {
  if (settings_.mode == Mode::kPaper || !estimate_.has_pose || kept_->size() < 2) return;
  // What counts for a guess must not keep the same maps from counting for more.
  const bool unheard = (evidence_->sum() == 0 && speaksFor(estimate_, settings_.verdict)) ||
                       (evidence_->guessSum() == 0 && speaksForGuess(estimate_, settings_.verdict));
  if (!unheard) return;
  filter_.clear();
  maps_ = 0;
  evidence_->clear();
  std::deque<KeptMaps::Cloud> clouds = kept_->takeAll();
  // The newest tell enough: each takes as long as a search.
  auto silent = static_cast<std::ptrdiff_t>(clouds.size()) - settings_.verify;
  for (KeptMaps::Cloud& cloud : clouds) {
    kept_->giveBack(std::move(cloud));
    if (silent-- > 0) continue;
    updateFloor();
    useNewestMap();
  }
}

void HeightMapLocalizer::useNewestMap() {
  filter_map_ = kept_->merged(settings_.accumulate);
  if (hasGround()) updateFilter();
  updateEstimate(true);
}

void HeightMapLocalizer::dropFarMaps() {
  // Nobody knows how large those without scale are before they have been placed.
  if (!kept_->ownUnit() || estimate_.status == Status::kConverged) kept_->dropFar();
}

/// Of clouds in metres; the kept maps are made anew where it has changed.
void HeightMapLocalizer::updateLevel() {
  if (!kept_->ownUnit() && kept_->updateLevel(ground_is_flat_)) kept_->remake();
}

/// Level and scale at which the kept clouds fit best; the kept maps are made anew where these have changed.
void HeightMapLocalizer::updateScale() {
  if (!kept_->ownUnit() || !hasGround() || !hasAerial()) return;
  const double before = kept_->scale();
  const bool levelled = kept_->updateLevel(ground_is_flat_);
  std::optional<air_ground_common::Pose> converged;
  if (estimate_.status == Status::kConverged) converged = estimate_.T_ground_mav;
  scale_->update(*kept_, *ground_, prior_, comparison(), converged);
  const double now = scale_->estimate().value;
  if (!levelled && now == before) return;
  kept_->remake(now);
  dropFarMaps();
  if (levelled || std::abs(std::log(now / before)) > kOtherScale) filter_.clear();
}

void HeightMapLocalizer::updateFloor() {
  FloorChoice choice;
  if (settings_.mode != Mode::kPaper && hasAerial()) choice = search().chooseFloor(kept_->mergedOnOwnFloor());
  kept_->setFloor(choice.floor);
  floor_rivals_ = std::move(choice.rivals);
  verify_volume_ = std::move(choice.volume);
}

void HeightMapLocalizer::updateFilter() {
  const Eigen::Vector2d reference = kept_->reference();
  ++maps_;
  if (filter_.initialized()) {
    const Comparison compare = comparison();
    const auto weighBy = [&](const HeightMap& map) {
      return filter_.weigh(ground_->direct(), compare.cellsOf(map, reference), compare.costFor(map));
    };
    filter_.move(reference);
    weighed_ = weighBy(filter_map_);
    if (weighed_ || settings_.mode == Mode::kPaper) return;
    // The last clouds lie outside the ground map: those before them still tell.
    weighed_ = weighBy(kept_->merged());
    if (weighed_) return;
    ++restarts_;
  }
  if (!filter_.initialize(search().volumeOf(filter_map_), prior_, reference)) maps_ = 0;
}

void HeightMapLocalizer::updateEstimate(bool new_map) {
  CoarseEstimate& e = estimate_;
  e = CoarseEstimate();
  e.scale = scale_->estimate().value;
  e.scale_stddev = scale_->estimate().stddev;
  e.R_level = kept_->level();
  e.R_ground_level = R_ground_level_;
  if (kept_->ownUnit()) e.scale_evidence = scale_->estimate().evidence;
  e.maps = maps_;
  e.restarts = restarts_;
  e.reason = missing();
  if (!e.reason.empty()) return;
  const auto spread = filter_.spread();
  e.particle_spread = spread.position;
  e.particle_spread_yaw = spread.yaw;
  e.particle_mean = filter_.mean();
  if (settings_.mode == Mode::kPaper) {
    estimateFromParticles(filter_map_, filter_.reference(), ground_->direct(), comparison().costFor(filter_map_),
                          settings_, &e);
    if (weighed_) filter_.resample(nullptr, prior_);
    weighed_ = false;
    return;
  }
  estimateFromPlaces(new_map);
  verify_volume_.reset();  // tens of megabytes
}

std::string HeightMapLocalizer::missing() const {
  if (!hasGround()) return "waiting for the ground map";
  if (!hasAerial()) return "waiting for an aerial cloud";
  if (!filter_.initialized()) {
    return formatted(
        "no placement where the maps share %.0f %% of the smaller one's cells: fly over what the ground robot saw",
        100 * settings_.min_overlap);
  }
  // At a scale that nothing singles out there is no place to verify.
  if (scaleIsOpen()) {
    return formatted("another scale than %.3g fits about as well: evidence %.1f, %.1f is needed", estimate_.scale,
                     estimate_.scale_evidence, settings_.own_unit.scale_evidence);
  }
  return "";
}

/// The best of all places, its rivals and the verdict on it.
void HeightMapLocalizer::estimateFromPlaces(bool new_map) {
  CoarseEstimate& e = estimate_;
  const ParticleMode mode = filter_.modes(settings_.rival.distance, settings_.rival.angle).front();
  e.mode_weight = mode.weight;
  e.mode_spread = std::sqrt(mode.covariance.topLeftCorner<2, 2>().trace() / 2);
  e.mode_spread_yaw = std::sqrt(mode.covariance(2, 2));

  const HeightMap map = kept_->merged();
  const CostVolume& volume = verifyVolume(map);
  const PlanarPose mean = changeReference(mode.mean, filter_.reference(), centerOf(map));
  const auto found = search().find(map, volume, {mean, evidence_->place(), floor_rivals_});
  if (!found) {
    e.reason = "nothing fits near the initial guess: give another (initialpose), or none (call relocalize)";
    return;
  }
  score_ = found->best.agreement.score;
  searched_cells_ = ground_->map().defined();
  measure(*found, *ground_, comparison(), settings_, &e);
  e.has_pose = std::isfinite(found->best.agreement.cost);
  if (!e.has_pose) {
    e.reason = "the maps do not overlap where the particles are";
    filter_.clear();
    return;
  }
  believe(*found, new_map);
  e.covariance = covarianceOf(*found, e, e.status, *ground_, mode, filter_.reference(), settings_);
  renewParticles(volume);
}

/// Pose, evidence and verdict.
void HeightMapLocalizer::believe(const FoundPlace& found, bool new_map) {
  CoarseEstimate& e = estimate_;
  const Placement& best = found.best;
  const PlanarPose origin = changeReference(best.pose, found.cells.reference, Eigen::Vector2d::Zero());
  e.T_ground_mav = air_ground_common::yawPose(origin.yaw, {origin.x, origin.y, best.agreement.dz});
  // Height of the overlap's middle: the aerial maps' mean, lifted.
  e.reference_point = {best.pose.x, best.pose.y, found.cells.mean_height + best.agreement.dz};
  evidence_->placeAt(e.T_ground_mav, kept_->reference());
  if (new_map) evidence_->add(e.evidence_lead, speaksFor(e, settings_.verdict), speaksForGuess(e, settings_.verdict));
  e.evidence = evidence_->sum();
  e.guess_evidence = evidence_->guessSum();
  Verdict verdict = judge(e, settings_.verdict);
  e.status = verdict.status;
  e.reason = std::move(verdict.reason);
  e.guess = verdict.guess;
}

void HeightMapLocalizer::renewParticles(const CostVolume& volume) {
  if (!estimate_.particles_agree && estimate_.rival_ratio >= settings_.verdict.ambiguity_ratio) {
    // The merged maps single out a place that the particles have missed: sensor resetting (Lenser and Veloso 2000).
    filter_.initialize(volume, prior_, filter_.reference());
    ++restarts_;
  } else if (weighed_) {
    filter_.resample(&volume, prior_);
  }
  weighed_ = false;
}

CostMap HeightMapLocalizer::costMap(Eigen::Vector2d* pivot) {
  if (!hasGround() || filter_map_.empty()) return {};
  const double yaw = air_ground_common::yawOf(estimate_.T_ground_mav.rotation());
  CostVolume volume =
      computeCostVolume(ground_->fullFft(), filter_map_, {yaw}, false, comparison().costFor(filter_map_));
  *pivot = volume.pivot;
  return std::move(volume.slices.front());
}

}  // namespace heightmap_mcl
