#include "ekf_tracker/pose_filter.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <boost/math/distributions/chi_squared.hpp>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "air_ground_common/geometry.h"
#include "state_layout.h"

namespace ekf_tracker {
namespace {

using air_ground_common::wrapAngle;

using Small = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 4, 1>;
using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 4, 4>;
using Observation = Eigen::Matrix<double, Eigen::Dynamic, 6, 0, 4, 6>;

constexpr double kPlaceMemory = 60;    // so long after its last fix a panorama's error is taken for a new one [s]
constexpr double kShortSilence = 0.5;  // the velocity before it bridges it in an unknown unit, too [s]

// Rows of the state that a measurement observes; the barometer reads z plus its offset.
Observation observation(const Measurement& m) {
  Observation h;
  switch (m.source) {
    case Source::kFix:
      h.setZero(4, 6);
      h.leftCols<4>().setIdentity();
      break;
    case Source::kGps:
      h.setZero(m.size(), 6);
      h.leftCols(m.size()).setIdentity();
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

Small innovationOf(const State& s, const Measurement& m) {
  Small v = m.value.head(m.size()) - observation(m) * s.x;
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

// Equations 12 and 13: the innovation v of what the rows of h observe, with the covariance r.
void update(State* state, const Observation& h, const Small& v, const SmallMatrix& r) {
  Matrix6d& p = state->covariance;
  const SmallMatrix s = h * p * h.transpose() + r;
  const Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, 4> gain = s.llt().solve(h * p).transpose();
  state->x += gain * v;
  state->x[kYaw] = wrapAngle(state->x[kYaw]);
  // In Joseph's form, which rounding cannot make indefinite.
  const Matrix6d a = Matrix6d::Identity() - gain * h;
  p = a * p * a.transpose() + gain * r * gain.transpose();
  symmetrise(&p);
}

// d x motion of a tilt d that stays for some seconds: in proportion to time, its parts are as of steps that long.
Eigen::Matrix3d tiltNoise(const Increment& increment) {
  const double dt = increment.stamp - increment.previous_stamp;
  if (!(increment.tilt_stddev > 0) || !(dt > 0)) return Eigen::Matrix3d::Zero();
  const Eigen::Vector3d& m = increment.motion.head<3>();
  Eigen::Matrix<double, 3, 2> J;
  J << 0, m.z(), -m.z(), 0, m.y(), -m.x();
  return std::pow(increment.tilt_stddev, 2) * std::max(1.0, kTiltStays / dt) * J * J.transpose();
}

}  // namespace

double chiSquareQuantile(int dof, double p) { return boost::math::quantile(boost::math::chi_squared(dof), p); }

const char* describe(Result result) {
  switch (result) {
    case Result::kFused:
      return "fused";
    case Result::kRefusedByGate:
      return "outside the gate";
    case Result::kWaiting:
      return "kept until others agree with it";
    case Result::kNotStarted:
      return "no state to correct yet";
    case Result::kInitialised:
      return "agreed with those kept before: the filter starts with them, or goes on from them after a gap";
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
  // In proportion to time: the parts that split() makes of an increment add up to the same.
  const double steps = std::max(0.0, increment.stamp - increment.previous_stamp) * 20;
  noise.diagonal().head<3>().array() += std::pow(settings.min_translation_stddev, 2) * steps;
  noise(3, 3) += std::pow(settings.min_yaw_stddev, 2) * steps;
  noise.topLeftCorner<3, 3>() += tiltNoise(increment);
  return noise;
}

PoseFilter::PoseFilter(const FilterSettings& settings) : settings_(settings) {
  check(settings);
  for (int dof = 1; dof <= 4; ++dof) gates_[dof] = chiSquareQuantile(dof, settings.gate_probability);
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
  const double dt = increment.stamp - increment.previous_stamp;
  p(kOffset, kOffset) += std::pow(settings_.barometer_drift, 2) * dt;
  symmetrise(&p);
  auto& places = state->places;
  for (UsedPlace& used : places) used.age += dt;
  places.erase(
      std::remove_if(places.begin(), places.end(), [](const UsedPlace& used) { return used.age > kPlaceMemory; }),
      places.end());
}

// A factor of one, as uncertain as odometry states it.
void PoseFilter::takeStatedScale(State* state) const {
  state->scale_known = true;
  state->x[kScale] = 1;
  state->covariance.row(kScale).setZero();
  state->covariance.col(kScale).setZero();
  state->covariance(kScale, kScale) = std::pow(priorScaleStddev(), 2);
}

// The odometry found its own scale: what was known of its old unit says nothing about what is left to apply.
void PoseFilter::becomeMetric() {
  hypotheses_.clear();
  if (state_) takeStatedScale(&*state_);
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

// A silence in the odometry's own unit: its last velocity, wrong by as much all the time, however the gap is split.
Increment PoseFilter::coast(const Increment& gap) const {
  Increment way = gap;
  const double dt = gap.stamp - gap.previous_stamp;
  way.motion.head<3>() = dt * velocity_;
  way.covariance.diagonal().head<3>().setConstant(velocity_.squaredNorm() * dt * (2 * silent_ - dt));
  return way;
}

void PoseFilter::predict(const Increment& given) {
  Increment increment = given;
  const double dt = increment.stamp - increment.previous_stamp;
  if (increment.gap) {
    // A hypothesis that still needs the scale cannot bridge more in the odometry's unit.
    silent_ += dt;
    if (silent_ > kShortSilence)
      hypotheses_.erase(std::remove_if(hypotheses_.begin(), hypotheses_.end(),
                                       [](const Hypothesis& h) { return !h.state.scale_known; }),
                        hypotheses_.end());
  } else {
    silent_ = 0;
    if (dt > 0) velocity_ = increment.motion.head<3>() / dt;
    scale_stddev_ = increment.metric ? increment.scale_stddev : 0;
    if (increment.new_unit && !increment.metric) loseScale();
    if (increment.metric && !metric_) becomeMetric();
    if (increment.new_unit && increment.metric) {
      // Another metric map: what fixes told of the last one's scale is not of this one.
      if (state_) takeStatedScale(&*state_);
      for (Hypothesis& h : hypotheses_) takeStatedScale(&h.state);
    }
    metric_ = increment.metric;
    increment.covariance = noiseOf(given, settings_);
  }
  if (state_) propagate(&*state_, increment);
  const Increment way = increment.gap && !metric_ ? coast(increment) : increment;
  for (Hypothesis& h : hypotheses_) {
    h.age += dt;
    if (h.state.scale_known) propagate(&h.state, increment);
    const MotionJacobians j = motionJacobians(h.travelled, way.motion, 1);
    h.travelled = move<double>(h.travelled, way.motion, 1);
    h.travelled_covariance = j.by_state * h.travelled_covariance * j.by_state.transpose() +
                             j.by_increment * way.covariance * j.by_increment.transpose();
  }
  // Almost anything agrees with a single fix when the odometry since may be far off. Metric one states how far; in an
  // unknown unit, whose scale wanders, time stands in for it.
  const double drift = std::pow(settings_.pairing_drift, 2);
  const auto alone = [&](const Hypothesis& h) {
    if (h.state.support > 1) return false;
    return metric_ ? h.travelled_covariance.diagonal().head<3>().maxCoeff() > drift : h.age > settings_.pairing_time;
  };
  hypotheses_.erase(std::remove_if(hypotheses_.begin(), hypotheses_.end(), alone), hypotheses_.end());
}

Outcome PoseFilter::test(const State& state, const Measurement& m) const {
  const auto h = observation(m);
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
  const int n = m.size();
  if (m.source == Source::kHeading) return fuseHeading(state, m);
  if (m.source == Source::kFix && m.place != 0) {
    auto& places = state->places;
    const auto known =
        std::find_if(places.begin(), places.end(), [&](const UsedPlace& used) { return used.place == m.place; });
    if (known != places.end()) {
      known->age = 0;
      return fuseAgain(state, m);
    }
    places.push_back({m.place, 0});
  }
  update(state, observation(m), innovationOf(*state, m), m.covariance.topLeftCorner(n, n));
}

// A panorama stands wrong by the same in all its fixes: together they tell no more than one, and what one told may be
// in the state already. In the basis V where the fix has unit covariance and the state the variances lambda_i, only
// directions with lambda_i > 1 are corrected, by as much as leaves a variance of 1, that of one fix.
void PoseFilter::fuseAgain(State* state, const Measurement& fix) {
  const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix4d> basis(state->covariance.topLeftCorner<4, 4>(),
                                                                 fix.covariance);  // ascending lambda
  const int n = static_cast<int>((basis.eigenvalues().array() > 1 + 1e-6).count());
  if (n == 0) return;
  const Eigen::Matrix<double, Eigen::Dynamic, 4, 0, 4, 4> directions = basis.eigenvectors().rightCols(n).transpose();
  const Small lambda = basis.eigenvalues().tail(n);
  const SmallMatrix r = lambda.cwiseQuotient((lambda.array() - 1).matrix()).asDiagonal();
  update(state, directions * observation(fix), directions * innovationOf(*state, fix), r);
}

// What bends the field does so for metres, and where the vehicle hovers for as long as it does: such readings, too,
// tell no more than one.
void PoseFilter::fuseHeading(State* state, const Measurement& m) {
  constexpr double kOneField = 3;  // [m]
  const Eigen::Vector3d here = state->x.head<3>();
  const bool again = state->field_at && (here - *state->field_at).norm() < kOneField;
  if (!again) state->field_at = here;
  double variance = m.covariance(0, 0);
  if (again) {
    const double lambda = state->covariance(kYaw, kYaw) / variance;
    if (lambda <= 1 + 1e-6) return;
    variance *= lambda / (lambda - 1);
  }
  update(state, observation(m), innovationOf(*state, m), SmallMatrix::Constant(1, 1, variance));
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
  if (out.result == Result::kFused && needsAnother(m, out.nis)) out.result = Result::kWaiting;
  if (out.result == Result::kFused) {
    const double log_odds = logOdds(*state_, m, out.nis);
    fuse(&*state_, m);
    supportBy(m, &*state_);
    if (state_->scale_known) {
      judgeRivals(m, log_odds);
      return out;
    }
  }
  Hypothesis* supported = correctBestHypothesis(m);
  if (supported)
    supported->stamps.push_back(m.stamp);
  else
    supported = addHypothesis(m);
  if (!isTrusted(*supported, out.result)) return out;
  out.joined.assign(supported->stamps.begin(), supported->stamps.end() - 1);
  if (out.result == Result::kWaiting) {
    out.result = Result::kInitialised;
    ++starts_;
  } else if (out.result == Result::kRefusedByGate) {
    out.result = Result::kRecovered;
    ++recoveries_;
  }
  state_ = supported->state;
  hypotheses_.clear();
  return out;
}

}  // namespace ekf_tracker
