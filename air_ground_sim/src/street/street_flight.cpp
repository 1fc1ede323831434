// The MAV's way through the streets: legs to the right of the route's centre lines, joined by curves, flown slower in
// them.
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "air_ground_sim/street/street.h"

namespace air_ground_sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kStep = 0.1;          // [m]
constexpr double kAcceleration = 0.7;  // along the way [m/s^2]
constexpr double kLateral = 1.0;       // in curves [m/s^2]
constexpr double kYawRate = 0.4;       // [rad/s]

struct Leg {
  Vector2d from, to, direction;
};

void append(std::vector<Vector2d>* path, const Vector2d& p) {
  if (path->empty() || (path->back() - p).norm() > 1e-6) path->push_back(p);
}

// Dense points: straight legs, cubic Bezier curves between them.
std::vector<Vector2d> pathOf(const std::vector<Vector2d>& route, double offset) {
  std::vector<Leg> legs;
  for (std::size_t i = 0; i + 1 < route.size(); ++i) {
    const Vector2d d = (route[i + 1] - route[i]).normalized(), right(d.y(), -d.x());
    legs.push_back({route[i] + offset * right, route[i + 1] + offset * right, d});
  }
  // Room for the curves; a turn back needs it too.
  const double trim = 6;
  for (std::size_t i = 0; i < legs.size(); ++i) {
    if ((legs[i].to - legs[i].from).norm() < 3 * trim)
      throw std::invalid_argument("the legs of the route must be at least 18 m long");
    legs[i].from += trim * legs[i].direction;
    legs[i].to -= trim * legs[i].direction;
  }
  std::vector<Vector2d> path;
  for (std::size_t i = 0; i < legs.size(); ++i) {
    const double length = (legs[i].to - legs[i].from).norm();
    for (double s = 0; s < length; s += kStep) append(&path, legs[i].from + s * legs[i].direction);
    append(&path, legs[i].to);
    if (i + 1 == legs.size()) break;
    const bool back = legs[i].direction.dot(legs[i + 1].direction) < -0.5;
    const Vector2d a = legs[i].to, b = legs[i + 1].from;
    const double handle = back ? std::max(3.0, 0.9 * (b - a).norm()) : 0.5 * (b - a).norm();
    const Vector2d c = a + handle * legs[i].direction, d = b - handle * legs[i + 1].direction;
    const int n = std::max(8, static_cast<int>((2 * handle + (b - a).norm()) / kStep));
    for (int k = 1; k <= n; ++k) {
      const double u = static_cast<double>(k) / n, v = 1 - u;
      append(&path, v * v * v * a + 3 * v * v * u * c + 3 * v * u * u * d + u * u * u * b);
    }
  }
  return path;
}

// Where the MAV is along the path at each time: speed limited by curvature and acceleration.
struct Schedule {
  std::vector<Vector2d> points;
  std::vector<double> arc, heading, time;

  Schedule(std::vector<Vector2d> path, double cruise) : points(std::move(path)) {
    const std::size_t n = points.size();
    arc.assign(n, 0);
    heading.assign(n, 0);
    time.assign(n, 0);
    for (std::size_t i = 1; i < n; ++i) arc[i] = arc[i - 1] + (points[i] - points[i - 1]).norm();
    for (std::size_t i = 0; i < n; ++i) {
      const Vector2d d = points[std::min(n - 1, i + 1)] - points[i ? i - 1 : 0];
      const double h = std::atan2(d.y(), d.x());
      heading[i] = i ? heading[i - 1] + air_ground_common::wrapAngle(h - heading[i - 1]) : h;
    }
    std::vector<double> speed(n, cruise);
    const int reach = 10;
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t a = i > reach ? i - reach : 0, b = std::min(n - 1, i + reach);
      const double curvature = std::abs(heading[b] - heading[a]) / std::max(1e-3, arc[b] - arc[a]);
      if (curvature > 1e-4) speed[i] = std::min({cruise, std::sqrt(kLateral / curvature), kYawRate / curvature});
    }
    speed.front() = speed.back() = 0.1;
    for (std::size_t i = 1; i < n; ++i)
      speed[i] = std::min(speed[i], std::sqrt(speed[i - 1] * speed[i - 1] + 2 * kAcceleration * (arc[i] - arc[i - 1])));
    for (std::size_t i = n - 1; i-- > 0;)
      speed[i] = std::min(speed[i], std::sqrt(speed[i + 1] * speed[i + 1] + 2 * kAcceleration * (arc[i + 1] - arc[i])));
    for (std::size_t i = 1; i < n; ++i)
      time[i] = time[i - 1] + (arc[i] - arc[i - 1]) / (0.5 * (speed[i] + speed[i - 1]));
  }

  // x, y, heading, arc length.
  Eigen::Vector4d at(double t) const {
    const std::size_t i =
        std::clamp<std::size_t>(std::lower_bound(time.begin(), time.end(), t) - time.begin(), 1, time.size() - 1);
    const double u = std::clamp((t - time[i - 1]) / (time[i] - time[i - 1]), 0.0, 1.0);
    const Vector2d p = (1 - u) * points[i - 1] + u * points[i];
    return {p.x(), p.y(), (1 - u) * heading[i - 1] + u * heading[i], (1 - u) * arc[i - 1] + u * arc[i]};
  }
};

std::vector<Vector2d> routeOf(const StreetConfig& c) {
  if (c.route.size() > 1) return c.route;
  return {c.lines[0].from, c.lines[0].to, c.lines[0].from};
}

// Height above ground along the way: low at first and mostly, now and then up to the roofs.
double heightAt(const FlightConfig& f, double arc, double phase) {
  const double a = 0.5 + 0.5 * std::sin(2 * M_PI * arc / 120 + phase),
               b = 0.5 + 0.5 * std::sin(2 * M_PI * arc / 53 + 2 * phase);
  return f.min_height + (f.max_height - f.min_height) * smoothStep(arc / 30) * std::pow(0.75 * a + 0.25 * b, 1.7);
}

}  // namespace

BodyTrajectory makeStreetFlight(const Street& street, const FlightConfig& f, std::uint64_t seed) {
  Rng rng(seed);
  const Schedule schedule(pathOf(routeOf(street.config), street.config.route_offset), f.speed);
  const double phase = rng.uniform(0, 2 * M_PI), yaw_phase = rng.uniform(0, 2 * M_PI);
  const Sway sway(f.sway, f.sway_period, &rng);
  return BodyTrajectory(
      splineAlong(f.duration,
                  [&](double t) -> Eigen::Vector4d {
                    const double tf = t - f.stand_still, envelope = smoothStep(tf / 2.0);
                    const Eigen::Vector4d s = schedule.at(std::max(0.0, tf - 2.0));
                    Vector3d p(s[0], s[1], 0);
                    const double ground = street.ground(p.head<2>());
                    p.z() = ground + kStandingHeight +
                            (heightAt(f, s[3], phase) - kStandingHeight) * smoothStep(tf / kClimbTime);
                    sway.add(envelope, tf, &p);
                    const double yaw = s[2] + envelope * (0.12 * std::sin(2 * M_PI * tf / 13 + yaw_phase) +
                                                          0.04 * std::sin(2 * M_PI * tf / 4.7));
                    return {p.x(), p.y(), p.z(), yaw};
                  }),
      true);
}

std::vector<air_ground_common::Pose> posesAlongLine(const Street& street, int line, const FlightConfig& f,
                                                    double step) {
  const StreetLineConfig& l = street.config.lines.at(line);
  const Vector2d d = (l.to - l.from).normalized(), right(d.y(), -d.x());
  std::vector<air_ground_common::Pose> poses;
  const double length = (l.to - l.from).norm();
  for (double s = 4; s < length - 4; s += step) {
    const Vector2d p = l.from + s * d + street.config.route_offset * right;
    poses.push_back(air_ground_common::yawPose(std::atan2(d.y(), d.x()),
                                               Vector3d(p.x(), p.y(), street.ground(p) + heightAt(f, s, line))));
  }
  return poses;
}

}  // namespace air_ground_sim
