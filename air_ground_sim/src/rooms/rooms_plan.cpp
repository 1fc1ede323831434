// Where walls, doors and the two ways are.
#include <algorithm>
#include <cmath>

#include "air_ground_sim/rooms/rooms.h"

namespace air_ground_sim {
namespace {

using Eigen::Vector2d;

constexpr double kFromWall = 0.95;    // of the ways where they circle in a room [m]
constexpr double kThroughDoor = 0.5;  // they pass a door straight from so far before it to as far behind [m]
constexpr double kJoin = 0.6;         // angle by which a way leaves its circle before the door [rad]

Vector2d ellipse(const Room& room, double angle) {
  const Vector2d axes = 0.5 * (room.high - room.low) - Vector2d(kFromWall, kFromWall);
  return room.center() + Vector2d(axes.x() * std::cos(angle), axes.y() * std::sin(angle));
}

double angleOf(const Room& room, const Vector2d& p) {
  const Vector2d axes = 0.5 * (room.high - room.low) - Vector2d(kFromWall, kFromWall);
  const Vector2d d = (p - room.center()).cwiseQuotient(axes);
  return std::atan2(d.y(), d.x());
}

// Points of the room's ellipse from one angle on over `sweep` (its sign is the sense of the turn).
void circle(const Room& room, double from, double sweep, std::vector<Vector2d>* way) {
  const int n = std::max(1, static_cast<int>(std::lround(std::abs(sweep) / 0.5)));
  for (int i = 0; i <= n; ++i) way->push_back(ellipse(room, from + sweep * i / n));
}

// The angle from `from` to `to` in the sense of `turn`, at least `least`.
double sweepTo(double from, double to, double turn, double least) {
  double sweep = std::fmod(turn * (to - from), 2 * M_PI);
  while (sweep < least) sweep += 2 * M_PI;
  return turn * sweep;
}

Door doorBetween(const std::vector<Door>& doors, int from, int to) {
  for (Door d : doors) {
    if (d.from == from && d.to == to) return d;
    if (d.from == to && d.to == from) return {from, to, d.center, -d.normal};
  }
  return {};
}

void pass(const Door& door, std::vector<Vector2d>* way) {
  way->push_back(door.center - kThroughDoor * door.normal);
  way->push_back(door.center + kThroughDoor * door.normal);
}

// A wall between two rooms with its door, if it has one, and the lintel above.
void addWall(const Vector2d& from, const Vector2d& to, const RoomsConfig& c, const Door* door,
             std::vector<WallPiece>* walls) {
  if (!door) return walls->push_back({from, to, 0});
  const Vector2d along = (to - from).normalized(), a = door->center - 0.5 * c.door_width * along,
                 b = door->center + 0.5 * c.door_width * along;
  walls->push_back({from, a, 0});
  walls->push_back({a, b, c.door_height});
  walls->push_back({b, to, 0});
}

void planWalls(const RoomsConfig& c, Rng* rng, RoomsPlan* plan) {
  const double x = 0.5 * c.size_x, y = 0.5 * c.size_y, t = 0.5 * c.wall_thickness;
  const double middle = rng->uniform(-0.35, 0.35), left = rng->uniform(-0.3, 0.3), right = rng->uniform(-0.3, 0.3);
  plan->rooms = {Room{{-x, -y}, {middle - t, left - t}}, Room{{middle + t, -y}, {x, right - t}},
                 Room{{middle + t, right + t}, {x, y}}, Room{{-x, left + t}, {middle - t, y}}};
  struct Side {
    Vector2d from, to, normal;  // the wall's centre line; towards the next room
    double low, high;           // where along it both rooms are
  };
  const double below = std::min(left, right), above = std::max(left, right);
  const Side sides[4] = {{{middle, -y}, {middle, below}, {1, 0}, -y, below},
                         {{middle, right}, {x, right}, {0, 1}, middle, x},
                         {{middle, above}, {middle, y}, {-1, 0}, above, y},
                         {{-x, left}, {middle, left}, {0, -1}, -x, middle}};
  const int closed = rng->chance(0.5) ? 3 : -1;  // no door between the rooms 3 and 0
  const double margin = 0.55 + 0.5 * c.door_width;
  for (int i = 0; i < 4; ++i) {
    const double at = rng->uniform(sides[i].low + margin, sides[i].high - margin);
    const bool vertical = sides[i].normal.x() != 0;
    if (i != closed)
      plan->doors.push_back(
          {i, (i + 1) % 4, vertical ? Vector2d(middle, at) : Vector2d(at, sides[i].from.y()), sides[i].normal});
    addWall(sides[i].from, sides[i].to, c, i != closed ? &plan->doors.back() : nullptr, &plan->walls);
  }
  if (above - below > 1e-6) plan->walls.push_back({{middle, below}, {middle, above}, 0});
}

// Room after room; the last one is circled until the way is long enough.
std::vector<Vector2d> planFlight(const RoomsPlan& plan, const int rooms[3], double length, Rng* rng) {
  std::vector<Vector2d> way;
  double turn = rng->chance(0.5) ? 1 : -1;
  Door door = doorBetween(plan.doors, rooms[0], rooms[1]);
  const double out = angleOf(plan.rooms[rooms[0]], door.center) - turn * kJoin;
  const double sweep = turn * rng->uniform(4.5, 5.5);
  circle(plan.rooms[rooms[0]], out - sweep, sweep, &way);
  for (int i = 1; i < 3; ++i) {
    pass(door, &way);
    turn = rng->chance(0.5) ? 1 : -1;
    const Room& room = plan.rooms[rooms[i]];
    const double in = angleOf(room, door.center) + turn * kJoin;
    if (i == 2) {
      const int laps = 1 + static_cast<int>(length / 5);
      circle(room, in, turn * 2 * M_PI * laps, &way);
    } else {
      door = doorBetween(plan.doors, rooms[i], rooms[i + 1]);
      circle(room, in, sweepTo(in, angleOf(room, door.center) - turn * kJoin, turn, 2.5), &way);
    }
  }
  std::vector<Vector2d> dense = smoothLane(way);
  double arc = 0;
  for (std::size_t i = 1; i < dense.size(); ++i) {
    arc += (dense[i] - dense[i - 1]).norm();
    if (arc > length) dense.resize(i + 1);
  }
  return dense;
}

std::vector<Vector2d> planLane(const RoomsPlan& plan, const int rooms[3], Rng* rng) {
  std::vector<Vector2d> lane;
  const double turn = rng->chance(0.5) ? 1 : -1;
  Door door = doorBetween(plan.doors, rooms[0], rooms[1]);
  const double out = angleOf(plan.rooms[rooms[0]], door.center) - turn * kJoin;
  const double sweep = turn * rng->uniform(2.6, 3.4);
  circle(plan.rooms[rooms[0]], out - sweep, sweep, &lane);
  pass(door, &lane);
  const Room& room = plan.rooms[rooms[1]];
  const Door next = doorBetween(plan.doors, rooms[1], rooms[2]);
  // The longer way round, so that the room is seen.
  const double entry = angleOf(room, door.center), exit = angleOf(room, next.center);
  const double sense = std::abs(sweepTo(entry, exit, 1, 0)) > M_PI ? 1 : -1;
  circle(room, entry + sense * kJoin, sweepTo(entry + sense * kJoin, exit - sense * kJoin, sense, 0.3), &lane);
  pass(next, &lane);
  lane.push_back(next.center + (kThroughDoor + 0.35) * next.normal);
  return lane;
}

}  // namespace

RoomsPlan planRooms(const RoomsConfig& config, double flight_length, Rng* rng) {
  RoomsPlan plan;
  planWalls(config, rng, &plan);
  // With a wall in place of a door, the ways begin at its sides: 0 1 2 3 or back.
  const bool forward = rng->chance(0.5);
  const bool ring = plan.doors.size() == 4;
  const int first = ring ? rng->integer(4) : (forward ? 0 : 3), step = forward ? 1 : 3;
  int order[4];
  for (int i = 0; i < 4; ++i) order[i] = (first + i * step) % 4;
  plan.flight = planFlight(plan, order, flight_length, rng);
  plan.lane = planLane(plan, order + 1, rng);
  return plan;
}

BodyTrajectory makeRoomsFlight(const FlightConfig& f, const std::vector<Vector2d>& way,
                               const std::vector<Vector2d>& doors, std::uint64_t seed) {
  Rng rng(seed);
  const int n = static_cast<int>(way.size());
  std::vector<double> arc(n, 0.0), heading(n, 0.0);
  for (int i = 1; i < n; ++i) arc[i] = arc[i - 1] + (way[i] - way[i - 1]).norm();
  for (int i = 0; i < n; ++i) {  // towards what lies 0.7 m ahead
    const Vector2d d = way[std::min(n - 1, i + 70)] - way[std::max(0, i - 20)];
    const double h = std::atan2(d.y(), d.x());
    heading[i] = i ? heading[i - 1] + air_ground_common::wrapAngle(h - heading[i - 1]) : h;
  }
  const double height_phase = rng.uniform(0, 2 * M_PI), yaw_phase = rng.uniform(0, 2 * M_PI);
  const Sway sway(f.sway, f.sway_period, &rng);
  const auto heightAt = [&](const Vector2d& p, double s) {
    double from_door = 10;
    for (const Vector2d& d : doors) from_door = std::min(from_door, (p - d).norm());
    const double high = 0.5 * (f.max_height - f.min_height) * (1 + std::sin(2 * M_PI * s / 9 + height_phase));
    return f.min_height + high * smoothStep((from_door - 0.4) / 0.8);
  };
  return BodyTrajectory(
      splineAlong(f.duration,
                  [&](double t) -> Eigen::Vector4d {
                    const double tf = t - f.stand_still, envelope = smoothStep(tf / 2.0);
                    const double run = std::max(0.0, tf - 2.0), ramp = 2.0;
                    const double s = f.speed * (run < ramp ? 0.5 * run * run / ramp : run - 0.5 * ramp);
                    const int i = std::clamp<int>(
                        static_cast<int>(std::lower_bound(arc.begin(), arc.end(), s) - arc.begin()), 1, n - 1);
                    const double u = std::clamp((s - arc[i - 1]) / (arc[i] - arc[i - 1]), 0.0, 1.0);
                    const Vector2d p = way[i - 1] + u * (way[i] - way[i - 1]);
                    const double z = kStandingHeight + (heightAt(p, s) - kStandingHeight) * smoothStep(tf / kClimbTime);
                    Eigen::Vector3d q(p.x(), p.y(), z);
                    sway.add(envelope, tf, &q);
                    const double yaw = heading[i - 1] + u * (heading[i] - heading[i - 1]) +
                                       envelope * 0.2 * std::sin(2 * M_PI * tf / 7.3 + yaw_phase);
                    return {q.x(), q.y(), q.z(), yaw};
                  }),
      true);
}

}  // namespace air_ground_sim
