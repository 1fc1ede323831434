#include "ekf_tracker/pose_filter.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <boost/math/distributions/chi_squared.hpp>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "air_ground_common/geometry.h"

namespace ekf_tracker {
namespace {

using air_ground_common::wrapAngle;

enum { kYaw = 3, kScale = 4, kOffset = 5 };

// Of wrong fixes: their share of all, and the heights that they spread over [m].
constexpr double kWrongShare = 0.5, kWrongFixHeights = 10;

// Rows of the state that a measurement observes; the barometer reads z plus its offset.
Eigen::Matrix<double, Eigen::Dynamic, 6, 0, 4, 6> observation(Source source) {
  Eigen::Matrix<double, Eigen::Dynamic, 6, 0, 4, 6> h;
  switch (source) {
    case Source::kFix:
      h.setZero(4, 6);
      h.leftCols<4>().setIdentity();
      break;
    case Source::kGps:
      h.setZero(3, 6);
      h.leftCols<3>().setIdentity();
      break;
    case Source::kHeading:
      h.setZero(1, 6);
      h(0, kYaw) = 1;
      break;
    case Source::kBarometer:
      h.setZero(1, 6);
      h(0, 2) = h(0, kOffset) = 1;
      break;
  }
  return h;
}

using Small = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 4, 1>;
using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 4, 4>;

Small innovationOf(const State& s, const Measurement& m) {
  Small v = m.value.head(m.size()) - observation(m.source) * s.x;
  if (m.source == Source::kFix) v[3] = wrapAngle(v[3]);
  if (m.source == Source::kHeading) v[0] = wrapAngle(v[0]);
  return v;
}

// The first pressure gives the offset, fully correlated with the height.
void readBarometer(const Measurement& m, State* s) {
  s->x[kOffset] = m.value[0] - s->x[2];
  s->covariance.row(kOffset) = -s->covariance.row(2);
  s->covariance.col(kOffset) = -s->covariance.col(2);
  s->covariance(kOffset, kOffset) = s->covariance(2, 2) + m.covariance(0, 0);
  s->barometer_known = true;
}

void symmetrise(Matrix6d* p) { *p = 0.5 * (*p + p->transpose()).eval(); }

}  // namespace

double chiSquareQuantile(int dof, double p) { return boost::math::quantile(boost::math::chi_squared(dof), p); }

const char* describe(Result result) {
  switch (result) {
    case Result::kFused:
      return "fused";
    case Result::kRefusedByGate:
      return "outside the gate";
    case Result::kWaiting:
      return "kept until the start";
    case Result::kNotStarted:
      return "no state to correct yet";
    case Result::kInitialised:
      return "agreed with one kept before, which starts the filter";
    case Result::kRecovered:
      return "replaced a state that was wrong";
    case Result::kAgreed:
      return "used after all: a later one agreed with it";
    case Result::kInvalid:
      return "not finite, or its covariance is not positive definite";
    case Result::kTooOld:
      return "older than the buffered history";
    case Result::kFromFuture:
      return "too far ahead of the odometry";
    case Result::kDuplicate:
      return "taken already";
  }
  return "";
}

bool isUsed(Result result) {
  return result == Result::kFused || result == Result::kInitialised || result == Result::kRecovered ||
         result == Result::kAgreed;
}

Matrix4d noiseOf(const Increment& increment, const FilterSettings& settings) {
  Matrix4d noise = increment.covariance;
  if (increment.gap) return noise;
  if (!increment.assumed_covariance) noise *= settings.covariance_factor;
  // Spread over the parts that split() makes, floors would add up; as a rate at 20 Hz they do not.
  const double steps = std::max(0.0, increment.stamp - increment.previous_stamp) * 20;
  noise.diagonal().head<3>().array() += std::pow(settings.min_translation_stddev, 2) * steps;
  noise(3, 3) += std::pow(settings.min_yaw_stddev, 2) * steps;
  return noise;
}

PoseFilter::PoseFilter(const FilterSettings& settings) : settings_(settings) {
  check(settings);
  for (int dof = 1; dof <= 4; ++dof) gates_[dof] = chiSquareQuantile(dof, settings.gate_probability);
}

int PoseFilter::strongestHypothesis() const {
  int most = 0;
  for (const Hypothesis& h : hypotheses_) most = std::max(most, h.state.support);
  return most;
}

void PoseFilter::restart(bool metric, double scale_stddev) {
  state_.reset();
  hypotheses_.clear();
  metric_ = metric;
  scale_stddev_ = metric ? scale_stddev : 0;
}

double PoseFilter::priorScaleStddev() const {
  // What odometry claims about its own scale is not believed below one per cent.
  return scale_stddev_ > 0 ? std::max(scale_stddev_, 0.01) : settings_.metric_scale_stddev;
}

void PoseFilter::propagate(State* state, const Increment& given) const {
  Increment increment = given;
  if (!state->scale_known && !increment.gap) {
    // The turn is known, the way is not: a random walk as broad, after ten seconds, as a silence of that length.
    increment.gap = true;
    increment.motion.head<3>().setZero();
    increment.covariance.topLeftCorner<3, 4>().setZero();
    increment.covariance.leftCols<3>().setZero();
    increment.covariance.diagonal().head<3>().setConstant(std::pow(settings_.gap_speed_stddev, 2) * 10 *
                                                          (increment.stamp - increment.previous_stamp));
  }
  Vector6d& x = state->x;
  const double scale = increment.gap ? 1.0 : x[kScale];
  const MotionJacobians j = motionJacobians(x.head<4>(), increment.motion, scale);
  x.head<4>() = move<double>(x.head<4>(), increment.motion, scale);
  x[kYaw] = wrapAngle(x[kYaw]);
  Matrix6d f = Matrix6d::Identity();
  f.topLeftCorner<4, 4>() = j.by_state;
  if (!increment.gap) f.block<4, 1>(0, kScale) = j.by_scale;
  Matrix6d& p = state->covariance;
  p = f * p * f.transpose();
  p.topLeftCorner<4, 4>() += j.by_increment * increment.covariance * j.by_increment.transpose();  // equation 8
  const double length = scale * increment.motion.head<3>().norm();
  p(kScale, kScale) += std::pow(x[kScale] * settings_.scale_drift, 2) * length;
  p(kOffset, kOffset) += std::pow(settings_.barometer_drift, 2) * (increment.stamp - increment.previous_stamp);
  symmetrise(&p);
}

// The odometry found its own scale: what was known of its old unit says nothing about what is left to apply.
void PoseFilter::becomeMetric() {
  hypotheses_.clear();
  if (!state_) return;
  state_->scale_known = true;
  state_->x[kScale] = 1;
  state_->covariance.row(kScale).setZero();
  state_->covariance.col(kScale).setZero();
  state_->covariance(kScale, kScale) = std::pow(priorScaleStddev(), 2);
}

void PoseFilter::loseScale() {
  hypotheses_.clear();
  if (!state_) return;
  state_->scale_known = false;
  state_->x[kScale] = 1;  // without meaning from here on
  state_->covariance.row(kScale).setZero();
  state_->covariance.col(kScale).setZero();
  state_->covariance(kScale, kScale) = 1;
}

void PoseFilter::predict(const Increment& given) {
  Increment increment = given;
  if (increment.gap) {
    // A hypothesis that still needs the scale cannot bridge a silence of unknown length in the odometry's unit.
    hypotheses_.erase(std::remove_if(hypotheses_.begin(), hypotheses_.end(),
                                     [](const Hypothesis& h) { return !h.state.scale_known; }),
                      hypotheses_.end());
  } else {
    scale_stddev_ = increment.metric ? increment.scale_stddev : 0;
    if (increment.new_unit) loseScale();
    if (increment.metric && !metric_) becomeMetric();
    metric_ = increment.metric;
    increment.covariance = noiseOf(given, settings_);
  }
  if (state_) propagate(&*state_, increment);
  for (Hypothesis& h : hypotheses_) {
    h.age += increment.stamp - increment.previous_stamp;
    if (h.state.scale_known) propagate(&h.state, increment);
    const MotionJacobians j = motionJacobians(h.travelled, increment.motion, 1);
    h.travelled = move<double>(h.travelled, increment.motion, 1);
    h.travelled_covariance = j.by_state * h.travelled_covariance * j.by_state.transpose() +
                             j.by_increment * increment.covariance * j.by_increment.transpose();
  }
  // When long has passed, or the odometry was silent, almost anything agrees with a single fix.
  const double drift = std::pow(settings_.pairing_drift, 2);
  const auto alone = [&](const Hypothesis& h) {
    return h.state.support < 2 && (h.age > settings_.pairing_time ||
                                   (metric_ && h.travelled_covariance.diagonal().head<3>().maxCoeff() > drift));
  };
  hypotheses_.erase(std::remove_if(hypotheses_.begin(), hypotheses_.end(), alone), hypotheses_.end());
}

Outcome PoseFilter::test(const State& state, const Measurement& m) const {
  const auto h = observation(m.source);
  const int n = m.size();
  Outcome out;
  out.measurement = m;
  out.dof = n;
  out.gate = gates_[n];
  const Small v = innovationOf(state, m);
  const SmallMatrix s = h * state.covariance * h.transpose() + m.covariance.topLeftCorner(n, n);
  out.innovation.head(n) = v;
  out.innovation_stddev.head(n) = s.diagonal().cwiseSqrt();
  out.nis = v.dot(s.llt().solve(v));
  out.result = out.nis <= out.gate ? Result::kFused : Result::kRefusedByGate;
  return out;
}

void PoseFilter::fuse(State* state, const Measurement& m) {
  const auto h = observation(m.source);
  const int n = m.size();
  Matrix6d& p = state->covariance;
  const SmallMatrix r = m.covariance.topLeftCorner(n, n);
  const SmallMatrix s = h * p * h.transpose() + r;
  const Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, 4> gain = s.llt().solve(h * p).transpose();
  state->x += gain * innovationOf(*state, m);  // equation 12
  state->x[kYaw] = wrapAngle(state->x[kYaw]);
  // Equation 13 in Joseph's form, which rounding cannot make indefinite.
  const Matrix6d a = Matrix6d::Identity() - gain * h;
  p = a * p * a.transpose() + gain * r * gain.transpose();
  symmetrise(&p);
  if (m.source == Source::kFix) ++state->support;
}

PoseFilter::Hypothesis PoseFilter::hypothesisFrom(const Measurement& fix) const {
  Hypothesis h;
  h.anchor = fix.value;
  h.anchor[3] = wrapAngle(h.anchor[3]);
  h.anchor_covariance = fix.covariance;
  h.stamps = {fix.stamp};
  h.state.support = 1;
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
  state.scale_known = true;
  if (!(state.x[kScale] > 0)) return Solution::kContradiction;
  // The density of the fix where any scale is as likely that leads to a place within wrong_fix_spread.
  const double scales = settings_.wrong_fix_spread / direction.head<3>().norm();
  countAgreement(-0.5 * (residual.dot(llt.solve(residual)) + std::log(s.determinant()) + std::log(information)) -
                     1.5 * std::log(2 * M_PI) - std::log(scales),
                 h);
  return Solution::kFound;
}

// A fix agreed with a hypothesis: evidence for it is the density that this predicts over that of a wrong fix, which may
// lie anywhere within wrong_fix_spread, kWrongFixHeights and with any heading. By Wald's inequality the product of such
// ratios reaches 1 / p with a probability below p while only wrong fixes agree.
void PoseFilter::countAgreement(double log_density, Hypothesis* h) const {
  const double room = M_PI * std::pow(settings_.wrong_fix_spread, 2) * kWrongFixHeights * 2 * M_PI;
  h->log_odds += std::log(1 - kWrongShare) + std::log(room) + log_density;
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
    const Matrix4d spread = supported->state.covariance.topLeftCorner<4, 4>() + fix.covariance;
    countAgreement(-0.5 * (best + std::log(spread.determinant())) - 2 * std::log(2 * M_PI), supported);
    fuse(&supported->state, fix);
    supported->stamps.push_back(fix.stamp);
    return supported;
  }
  if (metric_) return nullptr;
  for (Hypothesis& h : hypotheses_) {
    if (h.state.support > 1) continue;
    const Solution solution = solveScale(&h, fix);
    if (solution == Solution::kFound) {
      h.stamps.push_back(fix.stamp);
      return &h;
    }
    if (solution == Solution::kContradiction && !h.state.scale_known) h.log_odds += std::log(kWrongShare);
  }
  return nullptr;
}

Outcome PoseFilter::unpredicted(const Measurement& m, Result result) const {
  Outcome out;
  out.measurement = m;
  out.dof = m.size();
  out.gate = gates_[out.dof];
  out.nis = std::numeric_limits<double>::quiet_NaN();
  out.result = result;
  return out;
}

Outcome PoseFilter::correct(const Measurement& m) {
  return m.source == Source::kFix ? correctByFix(m) : correctByPart(m);
}

// Heading, GPS and barometer correct what there is, the hypotheses too; they neither start nor contradict anything.
Outcome PoseFilter::correctByPart(const Measurement& m) {
  const auto apply = [&](State* s) {
    if (m.source == Source::kBarometer && !s->barometer_known) {
      readBarometer(m, s);
      return unpredicted(m, Result::kFused);
    }
    const Outcome out = test(*s, m);
    if (out.result == Result::kFused) fuse(s, m);
    return out;
  };
  for (Hypothesis& h : hypotheses_)
    if (h.state.scale_known) apply(&h.state);
  return state_ ? apply(&*state_) : unpredicted(m, Result::kNotStarted);
}

Outcome PoseFilter::correctByFix(const Measurement& m) {
  Outcome out = state_ ? test(*state_, m) : unpredicted(m, Result::kWaiting);
  if (out.result == Result::kFused) {
    fuse(&*state_, m);
    if (state_->scale_known) {
      hypotheses_.clear();
      return out;
    }
  }
  Hypothesis* supported = correctBestHypothesis(m);
  if (!supported) supported = addHypothesis(m);
  // No contradiction where the scale is all that is missing.
  const bool only_scale = out.result == Result::kFused;
  if (!isTrusted(*supported, only_scale)) return out;
  out.joined.assign(supported->stamps.begin(), supported->stamps.end() - 1);
  if (!only_scale) {
    out.result = state_ ? Result::kRecovered : Result::kInitialised;
    ++(state_ ? recoveries_ : starts_);
  }
  state_ = supported->state;
  hypotheses_.clear();
  return out;
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
// unit, where some scale fits many a wrong pair, at least a third confirms it. A state that few fixes support yields to
// fewer hypotheses.
bool PoseFilter::isTrusted(const Hypothesis& h, bool only_scale) const {
  const int to_start = metric_ ? 2 : settings_.unscaled_start_fixes;
  const int needed = only_scale ? 2 : state_ ? std::min(settings_.recovery_fixes, state_->support + 1) : to_start;
  return h.state.scale_known && h.state.support >= needed && h.log_odds >= -std::log(settings_.max_false_start);
}

}  // namespace ekf_tracker
