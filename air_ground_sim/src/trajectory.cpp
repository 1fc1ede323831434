#include "air_ground_sim/trajectory.h"

#include <algorithm>
#include <cmath>

#include "air_ground_sim/random.h"

namespace air_ground_sim {
namespace {

constexpr double kKnot = 0.2;  // spline interval [s]

double lengthOf(const QuinticSpline& s, double from, double to) {
  double length = 0;
  const double step = 0.01;
  for (double t = from; t < to; t += step) length += s.evaluate(t + 0.5 * step, 1).head<3>().norm() * step;
  return length;
}

}  // namespace

// The spline smooths what is left of the higher derivatives.
double smoothStep(double x) {
  x = std::clamp(x, 0.0, 1.0);
  return x * x * x * (x * (6 * x - 15) + 10);
}

QuinticSpline splineAlong(double duration, const std::function<Eigen::Vector4d(double)>& f) {
  const int n = static_cast<int>(std::ceil(duration / kKnot)) + 6;
  std::vector<Eigen::Vector4d> control;
  for (int i = 0; i < n; ++i) control.push_back(f((i - 2) * kKnot));
  return QuinticSpline(std::move(control), 0.0, kKnot);
}

void BodyTrajectory::attitude(double time, Eigen::Matrix3d* R, Eigen::Vector3d* omega) const {
  const Eigen::Vector4d p = spline_.evaluate(time), v = spline_.evaluate(time, 1);
  if (!flies_) {
    *R = Eigen::AngleAxisd(p[3], Eigen::Vector3d::UnitZ()).toRotationMatrix();
    *omega = Eigen::Vector3d(0, 0, v[3]);
    return;
  }
  // Body z along thrust, body x in the vertical plane of the yaw direction; derivatives by the product rule.
  const Eigen::Vector3d thrust = spline_.evaluate(time, 2).head<3>() + Eigen::Vector3d(0, 0, kGravity);
  const Eigen::Vector3d jerk = spline_.evaluate(time, 3).head<3>();
  const auto unitRate = [](const Eigen::Vector3d& unit, const Eigen::Vector3d& rate, double norm) -> Eigen::Vector3d {
    return (rate - unit * unit.dot(rate)) / norm;
  };
  const Eigen::Vector3d z = thrust.normalized(), dz = unitRate(z, jerk, thrust.norm());
  const Eigen::Vector3d heading(std::cos(p[3]), std::sin(p[3]), 0);
  const Eigen::Vector3d d_heading = v[3] * Eigen::Vector3d(-std::sin(p[3]), std::cos(p[3]), 0);
  const Eigen::Vector3d n = z.cross(heading), dn = dz.cross(heading) + z.cross(d_heading);
  const Eigen::Vector3d y = n.normalized(), dy = unitRate(y, dn, n.norm());
  const Eigen::Vector3d x = y.cross(z), dx = dy.cross(z) + y.cross(dz);
  R->col(0) = x;
  R->col(1) = y;
  R->col(2) = z;
  Eigen::Matrix3d dR;
  dR.col(0) = dx;
  dR.col(1) = dy;
  dR.col(2) = dz;
  const Eigen::Matrix3d W = R->transpose() * dR;
  *omega = Eigen::Vector3d(W(2, 1), W(0, 2), W(1, 0));
}

BodyState BodyTrajectory::state(double time) const {
  BodyState s;
  Eigen::Matrix3d R, unused;
  Eigen::Vector3d omega, before, after;
  attitude(time, &R, &omega);
  s.T_world_body.linear() = R;
  s.T_world_body.translation() = spline_.evaluate(time).head<3>();
  s.velocity = spline_.evaluate(time, 1).head<3>();
  s.acceleration = spline_.evaluate(time, 2).head<3>();
  s.angular_velocity = omega;
  const double h = 1e-4;
  attitude(time - h, &unused, &before);
  attitude(time + h, &unused, &after);
  s.angular_acceleration = (after - before) / (2 * h);
  return s;
}

air_ground_common::Pose BodyTrajectory::pose(double time) const {
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  Eigen::Matrix3d R;
  Eigen::Vector3d omega;
  attitude(time, &R, &omega);
  T.linear() = R;
  T.translation() = spline_.evaluate(time).head<3>();
  return T;
}

double BodyTrajectory::pathLength(double from, double to) const { return lengthOf(spline_, from, to); }

Sway::Sway(double amplitude, double period, Rng* rng) {
  for (int axis = 0; axis < 3; ++axis)
    for (int k = 0; k < 2; ++k) {
      amplitude_[axis][k] = amplitude * rng->uniform(0.6, 1.0) * (axis == 2 ? 0.6 : 1.0) * (k ? 0.7 : 1.0);
      period_[axis][k] = period * rng->uniform(0.8, 1.1) * (k ? 1.45 : 1.0);
      phase_[axis][k] = rng->uniform(0, 2 * M_PI);
    }
}

void Sway::add(double envelope, double time, Eigen::Vector3d* position) const {
  for (int axis = 0; axis < 3; ++axis)
    for (int k = 0; k < 2; ++k) {
      const double w = 2 * M_PI / period_[axis][k];
      (*position)[axis] += envelope * amplitude_[axis][k] * std::sin(w * time + phase_[axis][k]);
    }
}

BodyTrajectory makeFlight(const FlightConfig& c, const Eigen::Vector2d& start, const ClearanceMap& clearance,
                          std::uint64_t seed) {
  Rng rng(seed);
  const double yaw0 = rng.uniform(-M_PI, M_PI);
  const double turn = rng.chance(0.5) ? 1 : -1;
  const Eigen::Vector2d from_center = start - c.center;
  const double phi0 = std::atan2(from_center.y() / c.loop_y, from_center.x() / c.loop_x);
  const double start_scale = Eigen::Vector2d(from_center.x() / c.loop_x, from_center.y() / c.loop_y).norm();
  const Sway sway(c.sway, c.sway_period, &rng);
  const double height_phase = rng.uniform(0, 2 * M_PI), radius_phase = rng.uniform(0, 2 * M_PI),
               yaw_phase = rng.uniform(0, 2 * M_PI);
  const double yaw_swing = rng.uniform(0.4, 0.8), yaw_drift = rng.uniform(-0.02, 0.02);

  const auto build = [&](double progress_speed) {
    const double mean_radius = 0.5 * (c.loop_x + c.loop_y);
    const auto path = [&, progress_speed, mean_radius](double t) -> Eigen::Vector4d {
      const double tf = t - c.stand_still;  // time since take-off
      const double envelope = smoothStep(tf / 2.0);
      const double run = std::max(0.0, tf - 2.0);  // progress along the loops starts while still climbing
      const double ramp = 2.0;
      const double s = progress_speed * (run < ramp ? 0.5 * run * run / ramp : run - 0.5 * ramp);
      const double phi = phi0 + turn * s / mean_radius;
      const double inward = smoothStep(s / 4.0);
      const double scale =
          start_scale + (1 + 0.18 * std::sin(0.62 * (phi - phi0) + radius_phase) - start_scale) * inward;
      Eigen::Vector3d p;
      p.x() = c.center.x() + c.loop_x * scale * std::cos(phi);
      p.y() = c.center.y() + c.loop_y * scale * std::sin(phi);
      const double cruise = 0.5 * (c.min_height + c.max_height) +
                            0.5 * (c.max_height - c.min_height) * std::sin(0.55 * (phi - phi0) + height_phase);
      p.z() = kStandingHeight + (std::max(cruise, clearance(p.head<2>(), 0.6) + c.clearance) - kStandingHeight) *
                                    smoothStep(tf / kClimbTime);
      sway.add(envelope, tf, &p);
      const double yaw = yaw0 +
                         envelope * (yaw_swing * (std::sin(2 * M_PI * tf / 17.0 + yaw_phase) - std::sin(yaw_phase)) +
                                     0.15 * std::sin(2 * M_PI * tf / 5.3)) +
                         yaw_drift * std::max(0.0, tf);
      return {p.x(), p.y(), p.z(), yaw};
    };
    // The obstacle clearance has steps: average the height over 1.2 s before it becomes control points.
    return splineAlong(c.duration, [&path, &c](double t) {
      Eigen::Vector4d p = path(t);
      if (t <= c.stand_still) return p;
      double z = 0;
      for (int i = -6; i <= 6; ++i) z += path(t + 0.1 * i).z();
      p.z() = z / 13;
      return p;
    });
  };

  // Progress along the loop so that the mean speed over ground, corrections included, is the one asked for.
  const double target = c.speed * std::max(1.0, c.duration - c.stand_still - 1.0);
  double low = 0.05, high = 2 * c.speed;
  for (int i = 0; i < 20; ++i) {
    const double mid = 0.5 * (low + high);
    (lengthOf(build(mid), 0, c.duration) < target ? low : high) = mid;
  }
  return BodyTrajectory(build(0.5 * (low + high)), true);
}

std::vector<Eigen::Vector2d> smoothLane(const std::vector<Eigen::Vector2d>& points) {
  std::vector<Eigen::Vector2d> curve;
  const int n = static_cast<int>(points.size());
  for (int i = 0; i + 1 < n; ++i) {
    const Eigen::Vector2d p0 = i > 0 ? points[i - 1] : Eigen::Vector2d(2 * points[0] - points[1]), p1 = points[i],
                          p2 = points[i + 1];
    const Eigen::Vector2d p3 = i + 2 < n ? points[i + 2] : Eigen::Vector2d(2 * p2 - p1);
    const int steps = std::max(2, static_cast<int>((p2 - p1).norm() / 0.01));
    for (int k = 0; k < steps; ++k) {
      const double u = static_cast<double>(k) / steps;
      curve.push_back(0.5 * (2 * p1 + u * (p2 - p0) + u * u * (2 * p0 - 5 * p1 + 4 * p2 - p3) +
                             u * u * u * (3 * p1 - p0 - 3 * p2 + p3)));
    }
  }
  curve.push_back(points.back());
  return curve;
}

BodyTrajectory makeDrive(const LaneConfig& lane, double duration, std::uint64_t seed) {
  Rng rng(seed);
  const std::vector<Eigen::Vector2d> curve = smoothLane(lane.points);
  std::vector<double> arc(curve.size(), 0.0);
  for (std::size_t i = 1; i < curve.size(); ++i) arc[i] = arc[i - 1] + (curve[i] - curve[i - 1]).norm();
  const double ramp = kDriveRamp, moving = std::max(2 * ramp + 0.1, duration - lane.stand_still - 0.5);
  const double speed = arc.back() / (moving - ramp);
  const double phase = rng.uniform(0, 2 * M_PI), period = rng.uniform(8, 11);
  double previous_yaw = 0;
  bool first = true;
  return BodyTrajectory(
      splineAlong(duration,
                  [&](double t) -> Eigen::Vector4d {
                    const double m = std::clamp(t - lane.stand_still, 0.0, moving);
                    double s = 0;
                    if (m < ramp)
                      s = 0.5 * speed * m * m / ramp;
                    else if (m < moving - ramp)
                      s = speed * (m - 0.5 * ramp);
                    else
                      s = arc.back() - 0.5 * speed * (moving - m) * (moving - m) / ramp;
                    const auto it = std::lower_bound(arc.begin(), arc.end(), s);
                    const std::size_t i = std::clamp<std::size_t>(it - arc.begin(), 1, arc.size() - 1);
                    const double u = std::clamp((s - arc[i - 1]) / std::max(1e-9, arc[i] - arc[i - 1]), 0.0, 1.0);
                    const Eigen::Vector2d p = curve[i - 1] + u * (curve[i] - curve[i - 1]);
                    const Eigen::Vector2d d =
                        lane.look_ahead
                            ? Eigen::Vector2d(curve[std::min(curve.size() - 1, i + 60)] - curve[i > 20 ? i - 20 : 0])
                            : Eigen::Vector2d(lane.look_at - p);
                    double yaw =
                        std::atan2(d.y(), d.x()) + lane.heading_swing * std::sin(2 * M_PI * m / period + phase);
                    if (!first) yaw = previous_yaw + air_ground_common::wrapAngle(yaw - previous_yaw);
                    first = false;
                    previous_yaw = yaw;
                    return {p.x(), p.y(), 0, yaw};
                  }),
      false);
}

}  // namespace air_ground_sim
