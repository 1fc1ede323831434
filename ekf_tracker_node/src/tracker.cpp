#include "ekf_tracker/tracker.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <tuple>

#include "air_ground_common/geometry.h"

namespace ekf_tracker {
namespace {

constexpr std::size_t kMaxWaiting = 2000;  // while no odometry comes at all

// Beyond what any vehicle measures; within, no product in the filter overflows.
constexpr double kFarthest = 1e9, kLongestStep = 1e6, kLargestVariance = 1e30;  // [m], [m], [m^2]
constexpr double kLargestScaleStddev = 1e3;                                     // relative: nothing is known

bool isKnown(const Eigen::Ref<const Eigen::MatrixXd>& covariance) {
  return isCovariance(covariance) && covariance.cwiseAbs().maxCoeff() <= kLargestVariance;
}

bool usable(const Measurement& m) {
  const int n = m.size();
  return std::isfinite(m.stamp) && m.value.head(n).allFinite() && m.value.head(n).cwiseAbs().maxCoeff() <= kFarthest &&
         isKnown(m.covariance.topLeftCorner(n, n));
}

// The order in which simultaneous measurements apply must not depend on their arrival.
auto orderOf(const Measurement& m) {
  return std::make_tuple(m.stamp, static_cast<int>(m.source), m.value[0], m.value[1]);
}

}  // namespace

Tracker::Tracker(const TrackerSettings& settings) : settings_(settings), now_(settings.filter) { check(settings); }

void Tracker::reset() { *this = Tracker(settings_); }

void Tracker::report(const Measurement& m, Result result, double delay) {
  Outcome out;
  out.measurement = m;
  out.result = result;
  out.dof = m.size();
  out.delay = delay;
  out.nis = std::numeric_limits<double>::quiet_NaN();
  outcomes_.push_back(out);
}

std::vector<Outcome> Tracker::popOutcomes() {
  std::vector<Outcome> out;
  out.swap(outcomes_);
  return out;
}

IncrementResult Tracker::addIncrement(const Increment& given, bool* covariance_replaced) {
  if (covariance_replaced) *covariance_replaced = false;
  Increment increment = given;
  increment.gap = increment.new_unit = increment.assumed_covariance = false;
  if (!std::isfinite(increment.stamp) || !std::isfinite(increment.previous_stamp) || !increment.motion.allFinite() ||
      increment.motion.cwiseAbs().maxCoeff() > kLongestStep || !std::isfinite(increment.scale_stddev))
    return IncrementResult::kInvalid;
  increment.scale_stddev = std::min(increment.scale_stddev, kLargestScaleStddev);
  if (increment.stamp <= increment.previous_stamp) return IncrementResult::kOutOfOrder;
  if (!isKnown(increment.covariance)) {
    const double stddev = settings_.default_translation_stddev * increment.motion.head<3>().norm() +
                          settings_.filter.min_translation_stddev;
    increment.covariance = Vector4d(stddev, stddev, stddev, settings_.default_yaw_stddev).cwiseAbs2().asDiagonal();
    increment.assumed_covariance = true;
    if (covariance_replaced) *covariance_replaced = true;
  }

  IncrementResult result = IncrementResult::kUsed;
  if (steps_.empty()) {
    begin(increment);
  } else {
    const double newest = steps_.back().increment.stamp, silent = increment.previous_stamp - newest;
    if (silent < -settings_.same_time) return IncrementResult::kOutOfOrder;
    const bool new_map = increment.map_id != map_id_;
    increment.new_unit = increment.metric ? metric_ && new_map : metric_ || new_map;
    if (increment.new_unit && !increment.metric) result = IncrementResult::kNewUnit;
    if (silent > settings_.same_time) {
      Increment gap;
      gap.gap = true;
      gap.previous_stamp = newest;
      gap.stamp = increment.previous_stamp;
      gap.metric = increment.metric;
      const double speed = settings_.filter.gap_speed_stddev * silent;
      // A heading that is anyone's guess is best described by pi / sqrt(3): wider ones make no sense on a circle.
      const double yaw = std::min(settings_.filter.gap_yaw_rate_stddev * silent, M_PI / std::sqrt(3.0));
      gap.covariance = Vector4d(speed, speed, speed, yaw).cwiseAbs2().asDiagonal();
      append(gap);
      if (result == IncrementResult::kUsed) result = IncrementResult::kUsedAfterGap;
    } else {
      increment.previous_stamp = newest;
    }
  }
  map_id_ = increment.map_id;
  metric_ = increment.metric;
  append(increment);

  // Measurements that the odometry has reached now, in time order.
  std::sort(waiting_.begin(), waiting_.end(),
            [](const Kept& a, const Kept& b) { return orderOf(a.measurement) < orderOf(b.measurement); });
  std::size_t ready = 0;
  while (ready < waiting_.size() && waiting_[ready].measurement.stamp <= increment.stamp + settings_.same_time) ++ready;
  for (std::size_t i = 0; i < ready; ++i) insert(waiting_[i]);
  waiting_.erase(waiting_.begin(), waiting_.begin() + static_cast<std::ptrdiff_t>(ready));

  while (steps_.size() > 1 && steps_[1].increment.stamp < increment.stamp - settings_.history) steps_.pop_front();
  return result;
}

void Tracker::begin(const Increment& first) {
  now_.restart(first.metric, first.scale_stddev);
  Step step{Increment(), {}, now_};
  step.increment.stamp = step.increment.previous_stamp = first.previous_stamp;
  steps_.push_back(step);
}

void Tracker::append(const Increment& increment) {
  now_.predict(increment);
  steps_.push_back(Step{increment, {}, now_});
}

void Tracker::addMeasurement(const Measurement& m) {
  const double delay = steps_.empty() || !std::isfinite(m.stamp) ? 0 : steps_.back().increment.stamp - m.stamp;
  if (!usable(m)) return report(m, Result::kInvalid, delay);
  if (-delay > settings_.max_ahead) return report(m, Result::kFromFuture, delay);
  Kept kept{m, delay, {}, {}};
  if (m.source == Source::kFix) kept.measurement.value[3] = air_ground_common::wrapAngle(m.value[3]);
  if (steps_.empty() || delay < -settings_.same_time) {
    const auto same = [&](const Kept& k) { return k.measurement.source == m.source && k.measurement.stamp == m.stamp; };
    if (std::any_of(waiting_.begin(), waiting_.end(), same)) return report(m, Result::kDuplicate, delay);
    if (waiting_.size() >= kMaxWaiting) {
      report(waiting_.front().measurement, Result::kTooOld, 0);
      waiting_.erase(waiting_.begin());
    }
    waiting_.push_back(kept);
    return;
  }
  insert(kept);
}

void Tracker::insert(const Kept& kept) {
  const Measurement& m = kept.measurement;
  if (m.stamp < steps_.front().increment.stamp - settings_.same_time) return report(m, Result::kTooOld, kept.delay);
  // The first step not before the measurement.
  auto step = std::lower_bound(steps_.begin(), steps_.end(), m.stamp,
                               [&](const Step& s, double t) { return s.increment.stamp + settings_.same_time < t; });
  if (step == steps_.end()) step = std::prev(steps_.end());
  std::size_t index = static_cast<std::size_t>(step - steps_.begin());
  if (index > 0 && step->increment.stamp - m.stamp > settings_.same_time) {
    Increment first, second;
    split(step->increment, m.stamp, &first, &second);
    step->increment = second;
    Step inserted{first, {}, PoseFilter(settings_.filter)};
    steps_.insert(step, inserted);
  }
  std::vector<Kept>& here = steps_[index].measurements;
  const auto same = [&](const Kept& k) { return k.measurement.source == m.source && k.measurement.stamp == m.stamp; };
  if (std::any_of(here.begin(), here.end(), same)) return report(m, Result::kDuplicate, kept.delay);
  here.insert(
      std::upper_bound(here.begin(), here.end(), kept,
                       [](const Kept& a, const Kept& b) { return orderOf(a.measurement) < orderOf(b.measurement); }),
      kept);
  replay(index);
}

// Recomputes everything from the step `first` on. Its own snapshot is made anew when it was just split off.
void Tracker::replay(std::size_t first) {
  if (first == 0) {
    now_ = steps_[0].before;
  } else {
    now_ = steps_[first - 1].before;
    for (const Kept& k : steps_[first - 1].measurements) now_.correct(k.measurement);
  }
  for (std::size_t i = first; i < steps_.size(); ++i) {
    Step& step = steps_[i];
    if (i > 0) {
      now_.predict(step.increment);
      step.before = now_;
    }
    for (Kept& k : step.measurements) {
      k.outcome = now_.correct(k.measurement);
      k.outcome.delay = k.delay;
    }
  }
  reportChanges();
}

// Reports every measurement whose result is new, or another one than was told.
void Tracker::reportChanges() {
  std::vector<double> joined;  // fixes that entered the state by a later one
  for (const Step& step : steps_)
    for (const Kept& k : step.measurements)
      joined.insert(joined.end(), k.outcome.joined.begin(), k.outcome.joined.end());
  for (Step& step : steps_) {
    for (Kept& k : step.measurements) {
      Outcome out = k.outcome;
      const bool unused = out.result == Result::kWaiting || out.result == Result::kRefusedByGate;
      if (unused && std::find(joined.begin(), joined.end(), k.measurement.stamp) != joined.end() &&
          k.measurement.source == Source::kFix)
        out.result = Result::kAgreed;
      if (k.reported == out.result) continue;
      out.revised = k.reported.has_value();
      k.reported = out.result;
      outcomes_.push_back(out);
    }
  }
}

namespace {

PoseEstimate estimateOf(const PoseFilter& filter, double stamp) {
  const State& s = filter.state();
  PoseEstimate e;
  e.stamp = stamp;
  e.pose = s.x.head<4>();
  e.covariance = s.covariance.topLeftCorner<4, 4>();
  e.scale_known = s.scale_known;
  e.scale = s.x[4];
  e.scale_stddev = std::sqrt(s.covariance(4, 4));
  e.support = s.support;
  return e;
}

}  // namespace

std::optional<PoseEstimate> Tracker::latest() const {
  if (steps_.empty() || !now_.started()) return std::nullopt;
  return estimateOf(now_, steps_.back().increment.stamp);
}

std::optional<Rate> Tracker::rate() const {
  if (steps_.empty() || !now_.started()) return std::nullopt;
  const State& s = now_.state();
  Increment step = steps_.back().increment;
  const double dt = step.stamp - step.previous_stamp;
  if (!(dt > 0)) return std::nullopt;
  step.tilt_stddev *= std::sqrt(std::min(1.0, dt / kTiltStays));  // of this step alone
  Vector4d unit;
  unit << Eigen::Vector3d::Constant(s.scale_known ? s.x[4] / dt : 0), 1 / dt;
  Rate rate;
  rate.value = unit.cwiseProduct(step.motion);
  rate.covariance = unit.asDiagonal() * noiseOf(step, settings_.filter) * unit.asDiagonal();
  const Eigen::Vector3d by_scale = step.motion.head<3>() / dt;
  if (s.scale_known)
    rate.covariance.topLeftCorner<3, 3>() += s.covariance(4, 4) * by_scale * by_scale.transpose();
  else
    rate.covariance.diagonal().head<3>().setConstant(kUnknownVariance);
  return rate;
}

std::optional<PoseEstimate> Tracker::at(double stamp) const {
  if (steps_.empty() || !(stamp >= steps_.front().increment.stamp) || stamp > steps_.back().increment.stamp)
    return std::nullopt;
  std::size_t i = steps_.size() - 1;
  while (i > 0 && steps_[i].increment.stamp > stamp) --i;
  PoseFilter filter = steps_[i].before;
  for (const Kept& k : steps_[i].measurements) filter.correct(k.measurement);
  if (i + 1 < steps_.size() && stamp > steps_[i].increment.stamp) {
    Increment first, second;
    split(steps_[i + 1].increment, stamp, &first, &second);
    filter.predict(first);
  }
  if (!filter.started()) return std::nullopt;
  return estimateOf(filter, stamp);
}

}  // namespace ekf_tracker
