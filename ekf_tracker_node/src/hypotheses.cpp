// Fixes that wait for others: the start, the scale, the return after a gap, the recovery.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "air_ground_common/geometry.h"
#include "ekf_tracker/pose_filter.h"
#include "state_layout.h"

namespace ekf_tracker {
namespace {

using air_ground_common::wrapAngle;

// Of wrong fixes: their share of all, and the heights that they spread over [m].
constexpr double kWrongShare = 0.5, kWrongFixHeights = 10;

// A fix that is far more precise than the state, in some direction by this factor of variances, is fused only where it
// is this much likelier right than wrong. In normal tracking hardly any is: a wrong one that passes the gate then moves
// the state by no more than this admits. After a gap nearly any passes, and the state would rest on it alone: ten
// seconds after, the odds of one where it was expected are even, of one 40 m away 1:34.
constexpr double kOutweighs = 9, kMinOdds = 100;

// A rival that fits the fixes which the state takes, but far worse than it, is given up below these odds (1:55).
constexpr double kHopeless = -4;

}  // namespace

int PoseFilter::strongestHypothesis() const {
  int most = 0;
  for (const Hypothesis& h : hypotheses_) most = std::max(most, h.state.support);
  return most;
}

PoseFilter::Hypothesis PoseFilter::hypothesisFrom(const Measurement& fix) const {
  Hypothesis h;
  h.anchor = fix.value;
  h.anchor[3] = wrapAngle(h.anchor[3]);
  h.anchor_covariance = fix.covariance;
  h.stamps = {fix.stamp};
  if (fix.place != 0) h.state.places = {{fix.place, 0}};
  supportBy(fix, &h.state);
  h.state.scale_known = false;
  h.state.x << h.anchor, 1, 0;
  h.state.covariance.setZero();
  h.state.covariance.topLeftCorner<4, 4>() = fix.covariance;
  h.state.covariance(kOffset, kOffset) = 1;  // without meaning until the first pressure
  if (metric_) {
    h.state.scale_known = true;
    h.state.x[kScale] = state_ && state_->scale_known ? state_->x[kScale] : 1;
    h.state.covariance(kScale, kScale) = std::pow(priorScaleStddev(), 2);
  } else if (state_ && state_->scale_known) {
    // Likely the scale is right although the pose is not; solveScale() answers where it is not.
    h.state.scale_known = true;
    h.state.x[kScale] = state_->x[kScale];
    h.state.covariance(kScale, kScale) = std::max(state_->covariance(kScale, kScale),
                                                  std::pow(settings_.max_initial_scale_stddev * state_->x[kScale], 2));
  }
  return h;
}

// B-III.E: the scale from two global fixes and the odometry between them. The paper divides the two lengths; this is
// the weighted least-squares factor, which noise does not bias upwards, and whose residual (three degrees of freedom:
// the direction of travel twice, and the yaw) tells whether the two fixes belong together at all.
PoseFilter::Solution PoseFilter::solveScale(Hypothesis* h, const Measurement& fix) const {
  const double length = h->travelled.head<3>().norm();
  const double ratio = (fix.value.head<3>() - h->anchor.head<3>()).norm() / length;
  if (!(length > 0) || !std::isfinite(ratio) || ratio <= 0) return Solution::kNone;
  const MotionJacobians j = motionJacobians(h->anchor, h->travelled, ratio);
  const Matrix4d s = j.by_state * h->anchor_covariance * j.by_state.transpose() +
                     j.by_increment * h->travelled_covariance * j.by_increment.transpose() + fix.covariance;
  const Vector4d& direction = j.by_scale;
  Vector4d difference = fix.value - move<double>(h->anchor, h->travelled, 0.0);
  difference[3] = wrapAngle(difference[3]);
  const Eigen::LLT<Matrix4d> llt(s);
  const double information = direction.dot(llt.solve(direction));
  const double scale = direction.dot(llt.solve(difference)) / information;
  // Too close together, to go by the lengths, for a useful scale: neither for nor against this hypothesis.
  if (1 / std::sqrt(information) > settings_.max_initial_scale_stddev * ratio) return Solution::kNone;
  const Vector4d residual = difference - scale * direction;
  if (residual.dot(llt.solve(residual)) > gates_[3] ||
      1 / std::sqrt(information) > settings_.max_initial_scale_stddev * scale)
    return Solution::kContradiction;

  // The joint posterior of pose and scale: from the anchor with a scale that is as good as unknown, moved and
  // corrected.
  State& state = h->state;
  state.x << h->anchor, scale, 0;
  state.covariance.setZero();
  state.covariance.topLeftCorner<4, 4>() = h->anchor_covariance;
  state.covariance(kScale, kScale) = std::pow(10 * scale, 2);
  state.covariance(kOffset, kOffset) = 1;
  state.barometer_known = false;
  state.support = 1;
  Matrix6d f = Matrix6d::Identity();
  const MotionJacobians at = motionJacobians(h->anchor, h->travelled, scale);
  f.topLeftCorner<4, 4>() = at.by_state;
  f.block<4, 1>(0, kScale) = at.by_scale;
  state.x.head<4>() = move<double>(h->anchor, h->travelled, scale);
  state.x[kYaw] = wrapAngle(state.x[kYaw]);
  state.covariance = f * state.covariance * f.transpose();
  state.covariance.topLeftCorner<4, 4>() += at.by_increment * h->travelled_covariance * at.by_increment.transpose();
  symmetrise(&state.covariance);
  fuse(&state, fix);
  supportBy(fix, &state);
  state.scale_known = true;
  if (!(state.x[kScale] > 0)) return Solution::kContradiction;
  // The density of the fix where any scale is as likely that leads to a place within wrong_fix_spread.
  const double scales = settings_.wrong_fix_spread / direction.head<3>().norm();
  h->log_odds +=
      logOdds(-0.5 * (residual.dot(llt.solve(residual)) + std::log(s.determinant()) + std::log(information)) -
              1.5 * std::log(2 * M_PI) - std::log(scales));
  return Solution::kFound;
}

// A fix agreed with what was predicted: evidence for it is the density that this gives it over that of a wrong fix,
// which may lie anywhere within wrong_fix_spread, kWrongFixHeights and with any heading. By Wald's inequality the
// product of such ratios reaches 1 / p with a probability below p while only wrong fixes agree.
double PoseFilter::logOdds(double log_density) const {
  const double room = M_PI * std::pow(settings_.wrong_fix_spread, 2) * kWrongFixHeights * 2 * M_PI;
  return std::log(1 - kWrongShare) + std::log(room) + log_density;
}

double PoseFilter::logOdds(const State& state, const Measurement& fix, double nis) const {
  const Matrix4d spread = state.covariance.topLeftCorner<4, 4>() + fix.covariance;
  return logOdds(-0.5 * (nis + std::log(spread.determinant())) - 2 * std::log(2 * M_PI));
}

// True where the state would rest on this fix alone although it may well be wrong.
bool PoseFilter::needsAnother(const Measurement& fix, double nis) const {
  const Matrix4d rest = kOutweighs * fix.covariance - state_->covariance.topLeftCorner<4, 4>();
  return rest.llt().info() != Eigen::Success && logOdds(*state_, fix, nis) < std::log(kMinOdds);
}

// A fix whose panorama is not known, as where its match comes late, tells nothing of how many there are.
void PoseFilter::supportBy(const Measurement& fix, State* state) {
  ++state->support;
  if (fix.place == 0) return;
  if (state->place == 0) state->place = fix.place;
  if (fix.place != state->place) state->several_places = true;
}

// The state took the fix at these odds. It ends the rivals that it contradicts; one that it fits too, as a vague fix
// may, is corrected, and supported no more than the fix is more likely by it than by the state.
void PoseFilter::judgeRivals(const Measurement& fix, double log_odds) {
  std::vector<Hypothesis> left;
  for (Hypothesis& h : hypotheses_) {
    const Outcome o = test(h.state, fix);
    h.log_odds += logOdds(h.state, fix, o.nis) - log_odds;
    if (o.result != Result::kFused || h.log_odds < kHopeless) continue;
    fuse(&h.state, fix);
    left.push_back(std::move(h));
  }
  hypotheses_ = std::move(left);
}

// The hypothesis that the fix agrees with best, corrected by it; null when it agrees with none.
PoseFilter::Hypothesis* PoseFilter::correctBestHypothesis(const Measurement& fix) {
  Hypothesis* supported = nullptr;
  double best = std::numeric_limits<double>::infinity();
  for (Hypothesis& h : hypotheses_) {
    if (!h.state.scale_known) continue;
    const Outcome o = test(h.state, fix);
    if (o.result != Result::kFused)
      h.log_odds += std::log(kWrongShare);
    else if (o.nis < best)
      best = o.nis, supported = &h;
  }
  if (supported) {
    supported->log_odds += logOdds(supported->state, fix, best);
    fuse(&supported->state, fix);
    supportBy(fix, &supported->state);
    return supported;
  }
  if (metric_) return nullptr;
  for (Hypothesis& h : hypotheses_) {
    if (h.state.support > 1) continue;
    const Solution solution = solveScale(&h, fix);
    if (solution == Solution::kFound) return &h;
    if (solution == Solution::kContradiction && !h.state.scale_known) h.log_odds += std::log(kWrongShare);
  }
  return nullptr;
}

PoseFilter::Hypothesis* PoseFilter::addHypothesis(const Measurement& fix) {
  if (static_cast<int>(hypotheses_.size()) >= settings_.max_hypotheses) {
    // The least plausible goes; among equals the newest, as the oldest has the longest way behind it to give the scale.
    auto worst = hypotheses_.begin();
    for (auto h = hypotheses_.begin(); h != hypotheses_.end(); ++h)
      if (h->log_odds <= worst->log_odds) worst = h;
    hypotheses_.erase(worst);
  }
  hypotheses_.push_back(hypothesisFrom(fix));
  return &hypotheses_.back();
}

// Fixes that agree by the odometry between them start the filter (B-III.E): a single one may be wrong, and as a prior
// it would keep the localizer from finding out. Two do where wrong ones hardly agree so well by chance; in an unknown
// unit, where some scale fits many a wrong pair, at least a third confirms it. After a gap that left little of the
// state it is no other. A state that few fixes support yields to fewer. One that more support than replace it yields to
// fixes of a single panorama, which agree with each other, be they right or wrong, only where it rests on a single one
// itself, and on fewer fixes. `latest`: what the newest fix did.
bool PoseFilter::isTrusted(const Hypothesis& h, Result latest) const {
  int needed = metric_ ? 2 : settings_.unscaled_start_fixes;
  if (latest == Result::kFused) needed = 2;  // the scale is all that is missing
  if (latest == Result::kRefusedByGate) {
    needed = std::min(settings_.recovery_fixes, state_->support + 1);
    if (h.state.ofOnePlace() && state_->support > settings_.recovery_fixes &&
        !(state_->ofOnePlace() && state_->support < h.state.support))
      return false;
  }
  return h.state.scale_known && h.state.support >= needed && h.log_odds >= -std::log(settings_.max_false_start);
}

}  // namespace ekf_tracker
