#include "heightmap_mcl/localizer.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <stdexcept>

namespace heightmap_mcl {
namespace {

using air_ground_common::wrapAngle;
constexpr double kDegree = M_PI / 180;

template <typename... Args>
std::string format(const char* text, Args... args) {
  char buffer[256];
  std::snprintf(buffer, sizeof(buffer), text, args...);
  return buffer;
}

double separation(const PlanarPose& a, const PlanarPose& b) { return std::hypot(a.x - b.x, a.y - b.y); }

/// Curvature of eq. 2 in (x, y, yaw) at a pose by central differences [m^2 per m^2, m rad, rad^2]. What unknown cells
/// are charged has no part in it: where the maps end fixes nothing.
Eigen::Matrix3d curvature(const DirectCost& cost, const AerialCells& cells, const PlanarPose& p,
                          const CostSettings& settings, const Eigen::Vector3d& step) {
  std::vector<PlanarPose> poses{p};
  const auto push = [&](const Eigen::Vector3d& d) { poses.push_back({p.x + d.x(), p.y + d.y(), p.yaw + d.z()}); };
  for (int i = 0; i < 3; ++i) {
    for (int sign : {-1, 1}) push(sign * step[i] * Eigen::Vector3d::Unit(i));
  }
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    for (int a : {-1, 1}) {
      for (int b : {-1, 1}) push(a * step[i] * Eigen::Vector3d::Unit(i) + b * step[j] * Eigen::Vector3d::Unit(j));
    }
  }
  const auto values = cost(cells, poses, settings);
  const auto c = [&](std::size_t k) { return std::isfinite(values[k].cost) ? values[k].cost : values[0].cost; };
  Eigen::Matrix3d H;
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    H(i, i) = (c(1 + 2 * i) - 2 * c(0) + c(2 + 2 * i)) / (step[i] * step[i]);
    const std::size_t k = 7 + 4 * i;
    H(i, j) = H(j, i) = (c(k) - c(k + 1) - c(k + 2) + c(k + 3)) / (4 * step[i] * step[j]);
  }
  return H;
}

}  // namespace

Localizer::Localizer(const LocalizerSettings& settings) : settings_(settings), filter_(settings.filter, settings.seed) {
  validate(settings_);
  restart(true);
}
Localizer::~Localizer() = default;

air_ground_common::Pose Estimate::similarityPose() const {
  air_ground_common::Pose T = T_ground_mav;
  T.linear() = T_ground_mav.linear() * R_level;
  return T;
}

void Localizer::forgetGround() {
  ground_ = HeightMap();
  ground_levels_.clear();
  direct_.reset();
  coarse_fft_.reset();
  full_fft_.reset();
  restart(false);
}

void Localizer::restart(bool forget_aerial) {
  filter_.clear();
  maps_ = 0;
  restarts_ = 0;
  evidence_ = 0;
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
}

void Localizer::drawFromKeptMaps() {
  if (!hasGround() || !hasAerial()) return;
  maps_ = static_cast<int>(aerial_.size());
  if (scale_stddev_ == 0) updateScale();
  updateFloor();
  filter_map_ = lastMaps(settings_.accumulate);
  filter_.initialize(coarseVolume(lastMaps(settings_.verify)), prior_, lastReference());
}

bool Localizer::setGround(const std::vector<Eigen::Vector3f>& points, std::size_t* cropped) {
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
  ground_variance_ = std::pow(heightDeviation(ground_), 2);
  direct_ = std::move(direct);
  coarse_fft_ = std::move(coarse_fft);
  full_fft_.reset();
  // What the particles drawn so far could not know lies in the new part of the map.
  if (estimate_.status != Status::kConverged) drawFromKeptMaps();
  updateEstimate();
  return true;
}

bool Localizer::addAerial(const AerialCloud& cloud, std::size_t* cropped) {
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
  // A bound on the memory of the merged map and of the search over it. A single map has a border of a cell.
  const double bound = settings_.air_map.max_extent + 3 * settings_.air_map.resolution;
  while (!own_unit_ && aerial_.size() > 1 && unionExtent(keptMaps(settings_.verify)) > bound) {
    aerial_.pop_front();
    ++far_maps_dropped_;
  }
  if (hasGround()) {
    updateScale();
    updateFloor();
  }
  filter_map_ = lastMaps(settings_.accumulate);
  if (hasGround()) updateFilter();
  new_map_ = true;
  updateEstimate();
  new_map_ = false;
  return true;
}

std::vector<const HeightMap*> Localizer::keptMaps(int count) const {
  std::vector<const HeightMap*> maps;
  const int n = static_cast<int>(aerial_.size());
  for (int i = std::max(0, n - count); i < n; ++i) maps.push_back(&aerial_[i].map);
  return maps;
}

CostSettings Localizer::costFor(const HeightMap& air) const {
  // Of unrelated heights, eq. 2 is on average half the sum of both variances.
  const double unrelated = 0.5 * (std::pow(heightDeviation(air), 2) + ground_variance_);
  return {settings_.min_overlap, settings_.unknown_weight * unrelated, settings_.min_explained, settings_.min_relief,
          settings_.overlap_of_air};
}

CostVolume Localizer::coarseVolume(const HeightMap& map) const {
  const auto headings = searchHeadings(settings_.headings, prior_);
  const bool circular = static_cast<int>(headings.size()) == settings_.headings;
  return computeCostVolume(*coarse_fft_, downsample(map, settings_.coarse_factor), headings, circular, costFor(map));
}

void Localizer::updateFilter() {
  const Eigen::Vector2d reference = lastReference();
  ++maps_;
  if (filter_.initialized()) {
    filter_.move(reference);
    weighed_ = filter_.weigh(*direct_, aerialCells(filter_map_, reference), costFor(filter_map_));
    if (weighed_ || settings_.mode == Mode::kPaper) return;
    ++restarts_;
  }
  if (!filter_.initialize(coarseVolume(filter_map_), prior_, reference)) maps_ = 0;
}

void Localizer::updateEstimate() {
  estimate_ = Estimate();
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
        format("no placement where the maps share %.0f %% of the smaller one's cells", 100 * settings_.min_overlap);
    return;
  }
  if (own_unit_ && scale_evidence_ < settings_.scale_evidence) {
    // At a scale that nothing singles out there is no place to verify.
    estimate_.status = Status::kSearching;
    estimate_.reason = format("another scale than %.3g fits about as well: evidence %.1f, %.1f is needed", scale_,
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

  // Everything from here on uses the merged maps about their own centre, where heading and position hardly interact.
  const HeightMap verify_map = lastMaps(settings_.verify);
  const AerialCells cells = aerialCells(verify_map, centerOf(verify_map));
  const CostSettings cost = costFor(verify_map);
  const PlanarPose mean = changeReference(mode.mean, filter_.reference(), cells.reference);
  Candidate best = descend(*direct_, cells, mean, 2 * ground_.resolution, 2 * kDegree, cost);
  if (!std::isfinite(best.zmssd.cost) || separation(best.pose, mean) > settings_.rival_distance) {
    best = {mean, (*direct_)(cells, mean, cost)};
  }

  // Rivals: the lowest places of the full search that are not this one. Where one fits better than the particles' mode,
  // it is the estimate, and the particles have yet to follow.
  const CostVolume volume = coarseVolume(verify_map);
  const auto starts = findLocalMinima(volume, 8, settings_.rival_distance, settings_.rival_angle);
  std::vector<Candidate> places(starts.size());
  const double coarse_cell = settings_.coarse_factor * ground_.resolution;
  const int n = static_cast<int>(starts.size());
#pragma omp parallel for schedule(dynamic)
  for (int i = 0; i < n; ++i) {
    places[i] = descend(*direct_, cells, starts[i], coarse_cell, M_PI / settings_.headings, cost);
  }
  places.push_back(best);
  places.insert(places.end(), floor_rivals_.begin(), floor_rivals_.end());
  // Where a position is known, places beyond three standard deviations are no rivals.
  places.erase(std::remove_if(places.begin(), places.end(),
                              [&](const Candidate& c) { return prior_.logDensity(c.pose, cells.reference) < -4.5; }),
               places.end());
  if (places.empty()) {
    estimate_.reason = "nothing fits near the initial guess";
    return;
  }
  const auto same = [&](const Candidate& a, const Candidate& b) {
    return separation(a.pose, b.pose) < settings_.rival_distance &&
           std::abs(wrapAngle(a.pose.yaw - b.pose.yaw)) < settings_.rival_angle;
  };
  best = *std::min_element(places.begin(), places.end(),
                           [](const Candidate& a, const Candidate& b) { return a.zmssd.score < b.zmssd.score; });
  Candidate rival;
  estimate_.rival_ratio = kInfinity;
  estimate_.evidence_lead = evidence(best.zmssd);
  for (const Candidate& c : places) {
    if (same(c, best)) continue;
    estimate_.evidence_lead = std::min(estimate_.evidence_lead, evidence(best.zmssd) - evidence(c.zmssd));
    const double ratio = rivalRatio(c.zmssd, best.zmssd);
    if (ratio < estimate_.rival_ratio) {
      estimate_.rival_ratio = ratio;
      rival = c;
    }
  }
  const bool particles_agree = same({mean, {}}, best);

  estimate_.has_pose = std::isfinite(best.zmssd.cost);
  if (!estimate_.has_pose) {
    estimate_.reason = "the maps do not overlap where the particles are";
    filter_.clear();
    return;
  }
  const PlanarPose origin = changeReference(best.pose, cells.reference, Eigen::Vector2d::Zero());
  estimate_.T_ground_mav = air_ground_common::yawPose(origin.yaw, {origin.x, origin.y, best.zmssd.dz});
  estimate_.cost = best.zmssd.cost;
  estimate_.overlap = best.zmssd.overlap / static_cast<double>(cells.h.size());
  estimate_.rival_distance = std::isfinite(rival.zmssd.cost) ? separation(rival.pose, best.pose) : kInfinity;
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

Eigen::Vector3d Localizer::judge(const Candidate& best, const AerialCells& cells, const CostSettings& cost,
                                 bool particles_agree) {
  const LocalizerSettings& s = settings_;
  Estimate& e = estimate_;
  e.relief = std::min(best.zmssd.relief_air, best.zmssd.relief_ground);
  e.explained = best.zmssd.explained;

  // The flattest direction of the cost, with the heading scaled so that it moves the rim of the map as far as a shift.
  double radius = 0;
  for (std::size_t i = 0; i < cells.h.size(); ++i) {
    radius += static_cast<double>(cells.x[i]) * cells.x[i] + static_cast<double>(cells.y[i]) * cells.y[i];
  }
  radius = std::max(std::sqrt(radius / static_cast<double>(cells.h.size())), 0.1);
  const Eigen::Vector3d scale(1, 1, 1 / radius);
  const Eigen::Matrix3d H = scale.asDiagonal() *
                            curvature(*direct_, cells, best.pose, cost, 0.5 * s.probe_distance * scale) *
                            scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(H);
  const Eigen::Vector3d weakest = scale.cwiseProduct(eigen.eigenvectors().col(0)) * s.probe_distance;
  e.probe_ratio = kInfinity;
  for (int sign : {-1, 1}) {
    const PlanarPose p{best.pose.x + sign * weakest.x(), best.pose.y + sign * weakest.y(),
                       best.pose.yaw + sign * weakest.z()};
    e.probe_ratio =
        std::min(e.probe_ratio, ((*direct_)(cells, p, cost).cost + s.noise_cost) / (best.zmssd.cost + s.noise_cost));
  }

  gatherEvidence();
  if (e.relief < s.min_relief) {
    e.status = Status::kDegenerate;
    e.reason = format("the overlap is flat: heights vary by %.3f m, %.3f m are needed", e.relief, s.min_relief);
  } else if (e.probe_ratio < s.probe_ratio) {
    e.status = Status::kDegenerate;
    e.reason = format("a move of (%.2f m, %.2f m, %.1f deg) changes the cost by a factor of %.2f only", weakest.x(),
                      weakest.y(), weakest.z() / kDegree, e.probe_ratio);
  } else if (e.rival_ratio < s.ambiguity_ratio) {
    e.status = Status::kAmbiguous;
    e.reason = format("another place %.2f m away fits about as well: it costs or leaves unexplained %.2f times as much",
                      e.rival_distance, e.rival_ratio);
  } else if (e.explained < s.min_explained) {
    e.reason = format("the maps explain %.0f %% of each other's heights, %.0f %% are needed", 100 * e.explained,
                      100 * s.min_explained);
  } else if (e.maps < s.min_maps) {
    e.reason = format("%d of %d aerial maps seen", e.maps, s.min_maps);
  } else if (e.evidence < s.min_evidence) {
    e.reason = format("evidence for the place: %.1f of %.1f", e.evidence, s.min_evidence);
  } else if (!particles_agree) {
    e.reason = "the particles have not gathered at the best place yet";
  } else if (e.mode_weight < s.min_mode_weight) {
    e.reason = format("%.0f %% of the particles are at the best place, %.0f %% are needed", 100 * e.mode_weight,
                      100 * s.min_mode_weight);
  } else if (e.mode_spread > s.max_spread || e.mode_spread_yaw > s.max_spread_yaw) {
    e.reason = format("the particles spread over %.2f m, %.1f deg", e.mode_spread, e.mode_spread_yaw / kDegree);
  } else {
    e.status = Status::kConverged;
    e.reason = format("%d maps; the next best place is %.1f times as bad; overlap %.0f %%", e.maps, e.rival_ratio,
                      100 * e.overlap);
  }
  return weakest;
}

void Localizer::setCovariance(const Candidate& best, const Candidate& rival, const AerialCells& cells,
                              const CostSettings& cost, const ParticleMode& mode, const Eigen::Vector3d& flattest) {
  const LocalizerSettings& s = settings_;
  Estimate& e = estimate_;
  const Eigen::Vector2d center = direct_->overlapCenter(cells, best.pose);
  const Eigen::Isometry3d& T = e.T_ground_mav;
  // Height of the overlap's middle: the aerial maps' mean, lifted.
  e.reference_point = {center.x(), center.y(), cells.mean_height + best.zmssd.dz};
  if (e.status == Status::kSearching) return;  // the covariance of not knowing, as it was set up

  // Residuals of variance 2C, one independent in cells_per_independent: -log p = n C(u) / (2 C_min), so that the
  // information is n / (2 C_min) times the curvature of the cost.
  const double independent = std::max(best.zmssd.overlap / s.cells_per_independent, 1.0);
  const double residual_variance = 2 * (best.zmssd.cost + s.noise_cost);
  const Eigen::Vector2d center_mav = (T.inverse() * e.reference_point).head<2>();
  const PlanarPose at_center = changeReference(best.pose, cells.reference, center_mav);
  AerialCells about_center = cells;
  about_center.reference = center_mav;
  const Eigen::Vector2d shift = center_mav - cells.reference;
  for (std::size_t i = 0; i < cells.h.size(); ++i) {
    about_center.x[i] -= static_cast<float>(shift.x());
    about_center.y[i] -= static_cast<float>(shift.y());
  }
  const Eigen::Matrix3d H =
      curvature(*direct_, about_center, at_center, cost, {2 * ground_.resolution, 2 * ground_.resolution, 2 * kDegree});
  // A direction without curvature gets a limit as its deviation: the rival distance (or angle) where the verdict has
  // excluded more, else all that the ground map leaves open.
  const bool degenerate = e.status == Status::kDegenerate;
  const double extent = std::max(ground_.width, ground_.height) * ground_.resolution;
  const Eigen::Vector3d limit = degenerate ? Eigen::Vector3d(extent, extent, M_PI)
                                           : Eigen::Vector3d(s.rival_distance, s.rival_distance, s.rival_angle);
  Eigen::Matrix3d information = H * independent / residual_variance;
  // The curvature of a flat floor is that of its noise.
  if (e.relief < s.min_relief) information.setZero();
  information = 0.5 * (information + information.transpose()).eval();
  const Eigen::Matrix3d scaled = limit.asDiagonal() * information * limit.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scaled);
  const Eigen::Vector3d variances = eigen.eigenvalues().cwiseMax(0.0).unaryExpr([](double v) { return 1 / (1 + v); });
  Eigen::Matrix3d planar = limit.asDiagonal() *
                           (eigen.eigenvectors() * variances.asDiagonal() * eigen.eigenvectors().transpose()) *
                           limit.asDiagonal();

  const auto carriedBy = [](const Eigen::Vector2d& lever) {
    Eigen::Matrix3d carry = Eigen::Matrix3d::Identity();
    carry(0, 2) = -lever.y();
    carry(1, 2) = lever.x();
    return carry;
  };
  if (degenerate) {
    // The flattest direction changes the cost too little to be told from noise, whatever its curvature just here.
    const double reach =
        std::min(extent / std::max(flattest.head<2>().norm(), 1e-9), M_PI / std::max(std::abs(flattest.z()), 1e-9));
    const Eigen::Vector3d open = reach * (carriedBy(center - Eigen::Vector2d(best.pose.x, best.pose.y)) * flattest);
    planar += open * open.transpose();
  }

  // The particles' own scatter, carried from the MAV to the centre of the overlap.
  const Eigen::Vector2d lever =
      center - Eigen::Vector2d(changeReference(best.pose, cells.reference, filter_.reference()).x,
                               changeReference(best.pose, cells.reference, filter_.reference()).y);
  const Eigen::Matrix3d carry = carriedBy(lever);
  const Eigen::Matrix3d particles = carry * mode.covariance * carry.transpose();

  e.covariance.setZero();
  const int index[3] = {0, 1, 5};
  const bool sharp = mode.weight > 0.9;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) e.covariance(index[i], index[j]) = planar(i, j) + (sharp ? 0.0 : particles(i, j));
  }
  e.covariance(0, 0) += s.floor_position * s.floor_position;
  e.covariance(1, 1) += s.floor_position * s.floor_position;
  e.covariance(2, 2) = s.floor_z * s.floor_z + residual_variance / independent;
  e.covariance(3, 3) = e.covariance(4, 4) = 2 * s.gravity_sigma * s.gravity_sigma;
  e.covariance(5, 5) += s.floor_yaw * s.floor_yaw;
  if (e.status == Status::kAmbiguous) {
    // The truth may as well be over there.
    const PlanarPose there = changeReference(rival.pose, cells.reference, center_mav);
    air_ground_common::Vector6d way = air_ground_common::Vector6d::Zero();
    way[0] = there.x - at_center.x;
    way[1] = there.y - at_center.y;
    way[2] = rival.zmssd.dz - best.zmssd.dz;
    way[5] = wrapAngle(there.yaw - at_center.yaw);
    e.covariance += way * way.transpose();
  }
}

CostMap Localizer::costMap(Eigen::Vector2d* pivot) {
  if (!hasGround() || filter_map_.empty()) return {};
  if (!full_fft_) full_fft_ = std::make_unique<FftCost>(ground_);
  const double yaw = air_ground_common::yawOf(estimate_.T_ground_mav.rotation());
  CostVolume volume = computeCostVolume(*full_fft_, filter_map_, {yaw}, false, costFor(filter_map_));
  *pivot = volume.pivot;
  return std::move(volume.slices.front());
}

}  // namespace heightmap_mcl
