#include "icp_refine/alignment_refiner.h"

#include <cmath>
#include <limits>
#include <utility>

#include "air_ground_common/text.h"
#include "icp_refine/ceilings.h"

namespace icp_refine {
namespace {

using air_ground_common::formatted;

/// No pose to be believed: nor does its covariance tell of one.
void withhold(RefineStatus status, const std::string& reason, RefineOutcome* out) {
  out->status = status;
  out->reason = reason;
  out->covariance = 1e6 * Matrix6d::Identity();
  out->scale_stddev = 0;
}

}  // namespace

AlignmentRefiner::AlignmentRefiner(IcpChain chain, const RefinerSettings& settings)
    : chain_(std::move(chain)),
      settings_(settings),
      aerial_(settings.accumulation_leaf, settings.recent_clouds),
      scale_(settings.scale) {}

void AlignmentRefiner::setGround(Cloud cloud) {
  ground_ = std::move(cloud);
  new_ground_ = true;
  stale_ground_ = false;
  reference_.reset();
}

void AlignmentRefiner::prepareGround() {
  if (tracked_ && !reference_ && !ground_.empty()) makeReference();
}

void AlignmentRefiner::makeReference() {
  reference_ = referenceBelowCeilings(chain_, ground_, ground_camera_);
  heights_.emplace(reference_->cloud(), settings_.height_check);
}

void AlignmentRefiner::addAerial(std::int64_t stamp, Cloud cloud) { aerial_.add(stamp, std::move(cloud)); }

void AlignmentRefiner::correctAerial(const air_ground_common::CloudCorrections& corrections) {
  const Similarity newest = aerial_.correct(corrections);
  // Of the map around the clouds that a pose was found with, which may lie far behind.
  const auto follow = [&](std::int64_t stamp, Similarity* T_ground_map_mav_map) {
    const auto it = corrections.find(stamp);
    const Similarity& S = it != corrections.end() && it->second ? *it->second : newest;
    *T_ground_map_mav_map = compose(*T_ground_map_mav_map, inverse(S));
  };
  if (tracked_) follow(tracked_stamp_, &tracked_->T_ground_map_mav_map);
  if (UnconfirmedPose* first = unconfirmed_.first()) follow(first->stamp, &first->T_ground_map_mav_map);
  if (coarse_known_) follow(coarse_stamp_, &coarse_known_->T_ground_map_mav_map);
}

void AlignmentRefiner::setCoarse(const Similarity& T, bool sure) {
  coarse_ = T;
  coarse_sure_ = sure;
  coarse_known_.reset();
}

void AlignmentRefiner::setCoarse(const KnownAlignment& coarse) {
  setCoarse(coarse.T_ground_map_mav_map);
  coarse_known_ = coarse;
  // Of a metric map the coarse stage estimates no scale: the lever to its centre is as sure as the odometry's.
  coarse_known_->scale_stddev = std::max(coarse.scale_stddev, scale_.stddev);
  coarse_stamp_ = aerial_.newestStamp();
}

void AlignmentRefiner::setGroundCamera(double z) {
  // What hangs between both heights counts as a ceiling now; a higher camera waits for the next map.
  if (z < ground_camera_) reference_.reset();
  ground_camera_ = z;
}

void AlignmentRefiner::groundMoved(bool at_hand) {
  moved_grounds_ = kMovedGrounds;
  stale_ground_ = !at_hand;
  unproven_ = tracked_.has_value();
  disagreements_ = 0;
  coarse_.reset();
  coarse_known_.reset();
  views_.reset();
}

void AlignmentRefiner::forgetAerial() {
  aerial_.clear();
  coarse_known_.reset();
  views_.reset();
}

void AlignmentRefiner::setViews(const KnownAlignment& views) { views_ = views; }

void AlignmentRefiner::withdrawViews() {
  views_.reset();
  if (rests_on_views_) tracked_.reset();
}

void AlignmentRefiner::setManual(const Pose& T) { manual_ = T; }

void AlignmentRefiner::setScaleDeviation(double stddev) {
  if (std::isfinite(stddev)) scale_.stddev = std::max(settings_.scale.stddev, stddev);
}

void AlignmentRefiner::setScalePrior(double mean, double stddev) {
  scale_.mean = mean;
  setScaleDeviation(stddev);
}

Priors AlignmentRefiner::priors() const {
  Priors out(scale_);
  if (views_ && views_->tells_scale && views_->scale_stddev < out.scale.stddev) {
    out.scale.mean = views_->T_ground_map_mav_map.scale;
    out.scale.stddev = views_->scale_stddev;
  }
  if (aerial_vertical_.stddev > 0 && ground_vertical_.stddev > 0) {
    out.up_reading = aerial_vertical_.up;
    out.up_reference = ground_vertical_.up;
    out.tilt_stddev = std::hypot(settings_.tilt_stddev, aerial_vertical_.stddev, ground_vertical_.stddev);
  }
  return out;
}

void AlignmentRefiner::startMap() {
  aerial_.clear();
  scale_ = settings_.scale;
  aerial_vertical_ = {};
  forgetPoses();
}

void AlignmentRefiner::startGround() {
  ground_ = Cloud();
  ground_camera_ = std::numeric_limits<double>::infinity();
  ground_vertical_ = {};
  reference_.reset();
  moved_grounds_ = 0;
  stale_ground_ = false;
  forgetPoses();
}

void AlignmentRefiner::reset() {
  startMap();
  startGround();
}

void AlignmentRefiner::forgetPoses() {
  coarse_.reset();
  coarse_known_.reset();
  manual_.reset();
  views_.reset();
  tracked_.reset();
  unconfirmed_.clear();
  contradicted_stamp_ = 0;
  rejections_ = disagreements_ = 0;
}

std::string AlignmentRefiner::missing() const {
  if (!tracked_ && !coarse_ && !views_ && !manual_) return "waiting for a coarse alignment or a manual guess";
  if (aerial_.empty()) return "waiting for aerial clouds";
  if (ground_.empty()) return "waiting for the ground map";
  return "";
}

// While a pose is tracked the newest clouds tell; a guess may be about those that the MAV has left behind.
Cloud AlignmentRefiner::prepareReading() {
  const auto on = [this](const Similarity& T) { return aerial_.on(*heights_, T); };
  AerialClouds::Reading reading = tracked_  ? aerial_.newest()
                                  : manual_ ? on(similarity(*manual_))
                                  : views_  ? on(views_->T_ground_map_mav_map)
                                            : on(*coarse_);
  reading_stamp_ = reading.stamp;
  return chain_.prepareReading(std::move(reading.cloud));
}

// A coarse pose that keeps disagreeing competes with the tracked one; the heights decide.
void AlignmentRefiner::countDisagreement(const Eigen::Vector3d& centre) {
  if (!tracked_ || !coarse_ || !coarse_sure_) return;
  const Similarity& T = tracked_->T_ground_map_mav_map;
  const double distance = (T * centre - *coarse_ * centre).head<2>().norm();
  const double angle =
      std::abs(air_ground_common::wrapAngle(air_ground_common::yawOf(T.R) - air_ground_common::yawOf(coarse_->R)));
  const bool disagrees = distance > settings_.coarse_distance || angle > settings_.coarse_angle;
  disagreements_ = disagrees ? disagreements_ + 1 : 0;
}

RefineOutcome AlignmentRefiner::refineTracked(const Cloud& reading) {
  const Similarity& T_tracked = tracked_->T_ground_map_mav_map;
  RefineOutcome out = attempt(reading, T_tracked);
  keepIfKnownBetter(reading, &out);
  // Along what the geometry leaves open ICP may have gone anywhere: it is the pose itself that must not be
  // contradicted.
  if (out.contradicted && !out.icp.localizability.complete()) {
    out.contradicted = contradict(heights_->check(transformed(reading, T_tracked), ground_camera_));
  }
  // A loop closure moves the ground map by more than ICP reaches from the last pose.
  const bool too_little = out.icp.outcome == IcpResult::Outcome::kConverged && out.overlap < settings_.min_overlap;
  if (moved_grounds_ > 0 && out.status != RefineStatus::kConverged && !too_little) {
    RefineOutcome other = attemptFromGuess(reading, T_tracked, true);
    if (other.status == RefineStatus::kConverged) out = other;
  }
  out.tracking = true;
  const bool unproven = unproven_ && out.status != RefineStatus::kConverged;
  if (unproven && views_) {
    RefineOutcome other = attempt(reading, views_->T_ground_map_mav_map);
    if (other.status == RefineStatus::kConverged && other.seen) {
      other.reason = "the ground map was corrected; found where the images tell";
      other.instead = true;
      return other;
    }
  }
  if (disagreements_ < (unproven ? 1 : settings_.coarse_disagreements)) return out;
  disagreements_ = 0;
  RefineOutcome other = attemptFromGuess(reading, *coarse_);
  if (other.status == RefineStatus::kConverged &&
      (out.status != RefineStatus::kConverged || other.heights.agreement() > out.heights.agreement())) {
    other.reason = "the coarse alignment disagreed and fits better: taken instead";
    other.instead = true;
    return other;
  }
  return out;
}

bool AlignmentRefiner::contradict(const HeightCheck& heights) const {
  return heights.conclusive && heights.agreement() < settings_.min_agreement;
}

// Where little of the geometry is in view, the pose is better known from before.
void AlignmentRefiner::keepIfKnownBetter(const Cloud& reading, RefineOutcome* out) const {
  constexpr double kLess = 2;
  if (out->status != RefineStatus::kConverged || groundHasMoved() || unproven_) return;
  const Matrix6d covariance = covarianceAbout(*tracked_, out->reference_point);
  const double known = positionStddev(covariance), alone = positionStddev(out->covariance);
  if (!(alone > kLess * known) || !(squaredSigmas(*tracked_, out->icp) < settings_.known_squared_sigmas)) return;
  const Similarity& T = tracked_->T_ground_map_mav_map;
  const HeightCheck heights = heights_->check(transformed(reading, T), ground_camera_);
  if (contradict(heights)) return;
  out->kept = true;
  out->heights = heights;
  out->overlap = heights.overlap();
  out->T_ground_map_mav_map = T;
  out->covariance = covariance;
  out->scale_stddev = tracked_->scale_stddev * T.scale;
  out->reason = formatted(
      "the last refined pose, known to %.3f m there, is kept: this cloud agrees, and alone tells it to %.3f m", known,
      alone);
}

// What the attempt says of the tracked pose.
void AlignmentRefiner::follow(bool from_tracking, RefineOutcome* out) {
  if (out->status == RefineStatus::kConverged) {
    rejections_ = 0;
    if (!stale_ground_) {
      unproven_ = false;
      moved_grounds_ = 0;
    }
    if (out->kept) return;
    tracked_ = KnownAlignment{out->T_ground_map_mav_map, out->covariance, out->reference_point,
                              out->scale_stddev / out->T_ground_map_mav_map.scale};
    tracked_stamp_ = out->stamp;
    rests_on_views_ = out->seen && !(out->icp.localizability.complete() && out->heights.conclusive);
  } else if (from_tracking && out->contradicted && imagesHold(*out)) {
    rejections_ = 0;
    out->reason += "; the last refined pose is kept, since the images agree: things have moved";
  } else if (from_tracking && out->contradicted) {
    // Whatever the status: a pose that is also degenerate is no excuse for heights that cannot be. The same clouds
    // once more are no other contradiction, but on another ground map where the last one has moved.
    const bool other_data = out->stamp > std::exchange(contradicted_stamp_, out->stamp) || (unproven_ && new_ground_);
    if (other_data && ++rejections_ >= settings_.lost_after) {
      tracked_.reset();
      rejections_ = disagreements_ = 0;
      out->lost = true;
      out->reason += formatted("; lost after %d contradictions, back to the coarse alignment", settings_.lost_after);
    }
  } else if (from_tracking) {
    // Too little overlap or structure just now says nothing against the pose.
    out->reason += "; the last refined pose is kept";
  }
}

bool AlignmentRefiner::leaps(const RefineOutcome& out, const Eigen::Vector3d& centre) const {
  constexpr double kFar = 0.15, kTurned = 0.06;  // [m], [rad]; right ones move by a third of it
  constexpr double kScaled = 0.05;               // relative
  if (out.status != RefineStatus::kConverged || out.instead || groundHasMoved()) return false;
  const Similarity &before = tracked_->T_ground_map_mav_map, &T = out.T_ground_map_mav_map;
  return (before * centre - T * centre).norm() > kFar || air_ground_common::rotationAngle(before.R, T.R) > kTurned ||
         std::abs(std::log(T.scale / before.scale)) > kScaled;
}

void AlignmentRefiner::demandConfirmation(const char* what, const Eigen::Vector3d& centre, RefineOutcome* out) {
  if (out->heights.conclusive && out->heights.agreement() < settings_.guess_agreement) {
    return withhold(
        RefineStatus::kRejected,
        formatted("%s, and heights contradict: %.0f %% of %d cells agree, %.0f %% needed", what,
                  100 * out->heights.agreement(), out->heights.relief_cells, 100 * settings_.guess_agreement),
        out);
  }
  if (unconfirmed_.confirmedBy({out->stamp, out->heights.relief_cells, out->T_ground_map_mav_map}, centre)) return;
  withhold(RefineStatus::kSearching,
           formatted("%s: waits until another aerial cloud, or a ground map that shows more, confirms it", what), out);
}

RefineOutcome AlignmentRefiner::refine() {
  RefineOutcome out;
  const auto wait = [&out](const std::string& reason) {
    out.status = RefineStatus::kSearching;
    out.reason = reason;
    return out;
  };
  if (const std::string what = missing(); !what.empty()) return wait(what);
  if (!reference_) makeReference();
  const Cloud reading = prepareReading();
  const std::size_t needed = static_cast<std::size_t>(settings_.min_points);
  const auto few = [&](std::size_t count, const char* whose) {
    return wait(formatted("only %zu %s points with a valid normal, %d are needed", count, whose, settings_.min_points));
  };
  if (reading.size() < needed) return few(reading.size(), "aerial");
  if (reference_->cloud().size() < needed) return few(reference_->cloud().size(), "ground");

  const Eigen::Vector3d centre = middle(reading);
  countDisagreement(centre);
  // A person's guess is tried once, before all else; what is tracked stays until it has proved right.
  std::string refused;
  bool decided = false;
  if (manual_) {
    out = attemptFromGuess(reading, similarity(*manual_));
    manual_.reset();
    decided = out.status == RefineStatus::kConverged || (!tracked_ && !coarse_ && !views_);
    if (decided)
      disagreements_ = 0;
    else
      refused = "; the manual guess was not taken: " + out.reason;
  }
  const bool from_tracking = tracked_ && !decided;
  if (!decided) out = from_tracking ? refineTracked(reading) : refineGuessed(reading);
  const bool guessed = !decided && !from_tracking && coarse_ && !coarse_sure_ && !out.seen;
  if (guessed && out.status == RefineStatus::kConverged) demandConfirmation("refined from a guess", centre, &out);
  if (from_tracking && leaps(out, centre)) demandConfirmation("far from the last pose", centre, &out);
  if (from_tracking || guessed || out.status == RefineStatus::kConverged) coarse_.reset();
  follow(from_tracking, &out);
  if (std::exchange(new_ground_, false) && !stale_ground_ && moved_grounds_ > 0) --moved_grounds_;
  out.reason += refused;
  return out;
}

RefineOutcome AlignmentRefiner::refineGuessed(const Cloud& reading) {
  if (!views_) return attemptFromGuess(reading, *coarse_);
  RefineOutcome out = attempt(reading, views_->T_ground_map_mav_map);
  if (out.status == RefineStatus::kConverged && !out.seen)
    withhold(RefineStatus::kRejected, "the clouds fit elsewhere than where the images tell", &out);
  if (out.status == RefineStatus::kConverged || !coarse_) return out;
  RefineOutcome other = attemptFromGuess(reading, *coarse_);
  return other.status == RefineStatus::kConverged ? other : out;
}

Similarity AlignmentRefiner::startAt(const Pose& guess, const Eigen::Vector3d& point) const {
  return {scale_.mean, guess.linear(), guess * point - scale_.mean * (guess.linear() * point)};
}

RefineOutcome AlignmentRefiner::attemptFromGuess(const Cloud& reading, const Similarity& from, bool until_converged) {
  const Eigen::Vector3d point = middle(reading);
  Pose guess = rigidAt(from, point);
  // The height is the one thing that the maps tell at once, and a guess drawn on a plane knows nothing of it.
  const auto dz = heights_->offset(transformed(reading, startAt(guess, point)));
  if (dz) guess.translation().z() += *dz;
  RefineOutcome best = attempt(reading, startAt(guess, point));
  const Eigen::Vector3d centre = guess * point;
  const auto open = [&] {
    return best.status == RefineStatus::kRejected || best.contradicted ||
           (until_converged && best.status != RefineStatus::kConverged);
  };
  for (int k = 0; k < settings_.retries && open(); ++k) {
    const double heading = 2 * M_PI * k / settings_.retries, yaw = (k % 2 ? 1 : -1) * settings_.retry_angle;
    const Eigen::Matrix3d R = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    Pose shift = Pose::Identity();
    shift.linear() = R;
    shift.translation() =
        centre + settings_.retry_distance * Eigen::Vector3d(std::cos(heading), std::sin(heading), 0) - R * centre;
    RefineOutcome other = attempt(reading, startAt(shift * guess, point));
    if (other.status == RefineStatus::kConverged) {
      other.reason += formatted("; from a start %.2f m beside the guess", settings_.retry_distance);
      best = other;
    }
  }
  return best;
}

RefineOutcome AlignmentRefiner::attempt(const Cloud& whole, const Similarity& guess) {
  RefineOutcome out;
  out.stamp = reading_stamp_;
  // What lies beyond the ground map cannot match, and would take the samples of what can.
  Cloud reading = whole;
  reading.keep(heights_->near(transformed(whole, guess)));
  out.icp = chain_.align(reading, *reference_, guess, priors());
  const IcpResult& icp = out.icp;
  out.T_ground_map_mav_map = icp.T_reference_reading;
  out.covariance = icp.covariance.topLeftCorner<6, 6>();
  out.scale_stddev = icp.T_reference_reading.scale * std::sqrt(icp.covariance(6, 6));
  out.reference_point = icp.centre;
  out.residual_rms = icp.residual_rms;
  out.iterations = icp.iterations;
  if (icp.outcome == IcpResult::Outcome::kConverged) {
    compareWithViews(out);
    compareWithCoarse(out);
    out.heights = heights_->check(transformed(whole, out.T_ground_map_mav_map), ground_camera_);
    out.overlap = out.heights.overlap();
    out.contradicted = out.overlap >= settings_.min_overlap &&
                       (contradict(out.heights) || (out.heights.conclusive && icp.residual_rms > settings_.max_rms));
  }
  judge(out);
  if (out.status == RefineStatus::kRejected) withhold(out.status, out.reason, &out);
  return out;
}

}  // namespace icp_refine
