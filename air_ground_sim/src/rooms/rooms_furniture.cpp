// What stands in the rooms and how they are built.
#include <algorithm>
#include <cmath>

#include "air_ground_sim/layout.h"
#include "air_ground_sim/rooms/rooms.h"

namespace air_ground_sim {
namespace {

using air_ground_common::Pose;
using air_ground_common::yawPose;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kFlyHeight = 0.95;  // what is higher must keep clear of the MAV's way [m]

double distanceTo(const Footprint& f, const Vector2d& p) {
  const Vector2d d = Eigen::Rotation2Dd(-f.yaw) * (p - f.center);
  return Vector2d(std::max(0.0, std::abs(d.x()) - f.hx), std::max(0.0, std::abs(d.y()) - f.hy)).norm();
}

class Furnisher {
 public:
  Furnisher(const RoomsPlan& plan, const LaneConfig& lane, double texel, Rng* rng, World* world)
      : plan_(plan), texel_(texel), rng_(*rng), world_(*world), lane_half_width_(lane.half_width) {
    for (const Vector2d& p : smoothLane(plan.lane)) lane_.push_back(p);
    for (const Door& d : plan.doors)  // nothing stands in a door, used or not
      for (double s = -0.7; s <= 0.7; s += 0.02) lane_.push_back(d.center + s * d.normal);
  }

  void furnish(const Room& room, bool lamp) {
    table(room, lamp);
    for (int i = 0, n = 2 + rng_.integer(3); i < n; ++i) shelf(room);
    for (int i = 0, n = 3 + rng_.integer(4); i < n; ++i) pile(room);
  }

 private:
  void box(const Pose& T, const Vector3d& center_base, const Vector3d& size, Material material, std::uint64_t seed,
           bool printed = false) {
    Cuboid c;
    c.T_world_base = T * Eigen::Translation3d(center_base);
    c.size = size;
    c.material = material;
    c.printed = printed;
    c.seed = seed;
    addCuboid(c, texel_, &world_);
  }

  bool isFree(const Footprint& f, const Room& room) const {
    for (const double x : {-1.0, 1.0})
      for (const double y : {-1.0, 1.0})
        if (!room.contains(f.center + Eigen::Rotation2Dd(f.yaw) * Vector2d(x * f.hx, y * f.hy))) return false;
    for (const Vector2d& p : lane_)
      if (distanceTo(f, p) < lane_half_width_) return false;
    if (!isClearOfFlight(f)) return false;
    return std::none_of(placed_.begin(), placed_.end(), [&](const Footprint& o) { return overlap(f, o, 0.03); });
  }

  // Low things may stand below the MAV's way, but not where it takes off.
  bool isClearOfFlight(const Footprint& f) const {
    const double reach = 0.5, climb = 2.0;
    double arc = 0;
    for (std::size_t i = 0; i < plan_.flight.size(); i += 4) {
      if (i) arc += (plan_.flight[i] - plan_.flight[i - 4]).norm();
      if ((f.top > kFlyHeight || arc < climb) && distanceTo(f, plan_.flight[i]) < reach) return false;
    }
    return true;
  }

  // Tries places that `propose` makes.
  template <class Propose>
  bool place(const Room& room, int attempts, const Propose& propose, Footprint* placed) {
    for (int i = 0; i < attempts; ++i) {
      const Footprint f = propose();
      if (!isFree(f, room)) continue;
      placed_.push_back(f);
      *placed = f;
      return true;
    }
    return false;
  }

  // With things on it, chairs around it and, perhaps, a lamp that hangs above it.
  void table(const Room& room, bool lamp) {
    const double top = rng_.uniform(0.71, 0.76);
    Footprint f;
    if (!place(
            room, 300,
            [&] {
              Footprint t;
              t.hx = rng_.uniform(0.5, 0.75);
              t.hy = rng_.uniform(0.3, 0.4);
              t.center = room.center() + Vector2d(rng_.uniform(-0.5, 0.5), rng_.uniform(-0.35, 0.35));
              t.yaw = (rng_.chance(0.5) ? 0 : M_PI / 2) + rng_.uniform(-0.12, 0.12);
              t.top = top;
              return t;
            },
            &f))
      return;
    const Pose T = standing(f, 0);
    const std::uint64_t seed = rng_.next();
    box(T, {0, 0, top - 0.03}, {2 * f.hx, 2 * f.hy, 0.03}, Material::kWood, seed);
    for (const double x : {-1.0, 1.0})
      for (const double y : {-1.0, 1.0})
        box(T, {x * (f.hx - 0.05), y * (f.hy - 0.05), 0}, {0.05, 0.05, top - 0.03}, Material::kWood, seed);
    for (int i = 0, n = 2 + rng_.integer(4); i < n; ++i) {
      const Vector3d size(rng_.uniform(0.08, 0.32), rng_.uniform(0.08, 0.25), rng_.uniform(0.01, 0.22));
      const double x = (f.hx - 0.2) * (2.0 * (i + 0.5) / n - 1), y = rng_.uniform(-1, 1) * (f.hy - 0.16);
      box(T * yawPose(rng_.uniform(-0.5, 0.5), {x, y, top}), Vector3d::Zero(), size,
          rng_.chance(0.5) ? Material::kCardboard : Material::kPaintedBox, rng_.next(), true);
    }
    if (lamp) hangLamp(f);
    for (int i = 0, n = 1 + rng_.integer(3); i < n; ++i) chair(room, f);
  }

  // A pendant lamp: its lower edge about 0.65 m above the table.
  void hangLamp(const Footprint& table) {
    const double bottom = rng_.uniform(1.35, 1.5), size = rng_.uniform(0.28, 0.4), height = rng_.uniform(0.16, 0.24);
    Footprint f = table;
    f.hx = f.hy = 0.5 * size;
    f.top = bottom + height;
    if (!isClearOfFlight(f)) return;
    const std::uint64_t seed = rng_.next();
    const Pose T = standing(f, 0);
    box(T, {0, 0, bottom}, {size, size, height}, Material::kPaintedBox, seed, true);
    box(T, {0, 0, bottom + height}, {0.03, 0.03, 2.5 - bottom - height}, Material::kPaintedBox, seed);
  }

  void chair(const Room& room, const Footprint& table) {
    Footprint f;
    if (!place(
            room, 60,
            [&] {
              Footprint c;
              c.hx = c.hy = 0.21;
              c.top = 0.88;
              const double side = rng_.chance(0.5) ? 1 : -1;
              c.yaw = table.yaw - side * M_PI / 2 + rng_.uniform(-0.4, 0.4);
              c.center =
                  table.center + Eigen::Rotation2Dd(table.yaw) * Vector2d(rng_.uniform(-0.8, 0.8) * table.hx,
                                                                          side * (table.hy + rng_.uniform(0.26, 0.45)));
              return c;
            },
            &f))
      return;
    const Pose T = standing(f, 0);
    const std::uint64_t seed = rng_.next();
    box(T, {0, 0, 0.43}, {0.42, 0.42, 0.03}, Material::kPaintedBox, seed);
    box(T, {-0.2, 0, 0.46}, {0.03, 0.4, 0.42}, Material::kPaintedBox, seed, true);
    for (const double x : {-0.19, 0.19})
      for (const double y : {-0.19, 0.19}) box(T, {x, y, 0}, {0.035, 0.035, 0.43}, Material::kWood, seed);
  }

  // Against a wall: boards with books and boxes between two sides.
  void shelf(const Room& room) {
    const double depth = rng_.uniform(0.28, 0.36), width = rng_.uniform(0.7, 1.2), height = rng_.uniform(1.1, 2.0);
    Footprint f;
    if (!place(
            room, 80,
            [&] {
              const int side = rng_.integer(4);
              const Vector2d out = Eigen::Rotation2Dd(side * M_PI / 2) * Vector2d::UnitX();  // into the room
              const Vector2d along(-out.y(), out.x()), half = 0.5 * (room.high - room.low);
              Footprint s;
              s.hx = 0.5 * depth;
              s.hy = 0.5 * width;
              s.yaw = side * M_PI / 2;
              s.top = height;
              const double across = std::abs(out.dot(half)), wide = std::abs(along.dot(half));
              s.center = room.center() - (across - s.hx - 0.01) * out + rng_.uniform(-1, 1) * (wide - s.hy) * along;
              return s;
            },
            &f))
      return;
    const Pose T = standing(f, 0);
    const std::uint64_t seed = rng_.next();
    for (const double y : {-1.0, 1.0}) box(T, {0, y * (f.hy - 0.01), 0}, {depth, 0.02, height}, Material::kWood, seed);
    box(T, {-f.hx + 0.006, 0, 0}, {0.012, width - 0.04, height}, Material::kWood, seed);
    const int boards = std::max(3, static_cast<int>(height / 0.36));
    const double step = (height - 0.1) / boards;
    for (int i = 0; i <= boards; ++i) {
      const double z = 0.06 + i * step;
      box(T, {0.006, 0, z}, {depth - 0.012, width - 0.04, 0.02}, Material::kWood, seed);
      if (i == boards) break;
      for (double y = -f.hy + 0.04; y < f.hy - 0.16;) {
        const double w = rng_.uniform(0.06, 0.2), h = rng_.uniform(0.4, 0.85) * (step - 0.03),
                     d = rng_.uniform(0.5, 0.9) * depth;
        if (rng_.chance(0.8))
          box(T, {0.5 * (d - depth) + 0.02, y + 0.5 * w, z + 0.02}, {d, w - 0.008, h},
              rng_.chance(0.5) ? Material::kPaintedBox : Material::kCardboard, rng_.next(), true);
        y += w;
      }
    }
  }

  // One or two cardboard boxes.
  void pile(const Room& room) {
    Cuboid below = randomBox(&rng_);
    const bool two = rng_.chance(0.4);
    Cuboid above = randomBox(&rng_);
    above.size = above.size.cwiseMin(below.size);
    above.size.z() = std::min(above.size.z(), 0.35);
    Footprint f;
    if (!place(
            room, 60,
            [&] {
              Footprint b;
              b.hx = 0.5 * below.size.x();
              b.hy = 0.5 * below.size.y();
              b.yaw = rng_.uniform(-M_PI, M_PI);
              b.top = below.size.z() + (two ? above.size.z() : 0);
              b.center = room.low + Vector2d(rng_.uniform(), rng_.uniform()).cwiseProduct(room.high - room.low);
              return b;
            },
            &f))
      return;
    below.T_world_base = standing(f, 0);
    addCuboid(below, texel_, &world_);
    if (!two) return;
    above.T_world_base = yawPose(f.yaw + rng_.uniform(-0.2, 0.2), {f.center.x(), f.center.y(), below.size.z()});
    addCuboid(above, texel_, &world_);
  }

  const RoomsPlan& plan_;
  double texel_;
  Rng& rng_;
  World& world_;
  double lane_half_width_;
  std::vector<Vector2d> lane_;  // dense
  std::vector<Footprint> placed_;
};

void addShell(const SimConfig& config, const RoomsPlan& plan, std::uint64_t seed, World* world) {
  const WorldConfig& c = config.world;
  const RoomsConfig& rooms = c.rooms;
  const double x = 0.5 * rooms.size_x, y = 0.5 * rooms.size_y;
  Patch floor = rectanglePatch({-x, -y, 0}, {2 * x, 0, 0}, {0, 2 * y, 0});
  floor.material = floorMaterial(c.floor);
  floor.printed = c.floor != FloorStyle::kPlain;
  floor.texel = static_cast<float>(floor.printed ? c.texel : 4 * c.texel);
  floor.seed = floor.object = mix(seed, 2);
  world->patches.push_back(floor);
  // The outer walls' inner faces, seen from inside: the direction of columns runs clockwise.
  const Vector3d corners[4] = {{-x, -y, 0}, {x, -y, 0}, {x, y, 0}, {-x, y, 0}};
  for (int i = 0; i < 4; ++i) {
    Patch p = rectanglePatch(corners[(i + 1) % 4], corners[i] - corners[(i + 1) % 4], {0, 0, c.room_height});
    p.material = Material::kPlaster;
    p.texel = static_cast<float>(c.texel);
    p.printed = true;
    p.seed = mix(seed, 17 + i);
    p.object = mix(seed, 3);
    world->patches.push_back(p);
  }
  const auto piece = [&](const Vector2d& from, const Vector2d& to, double bottom, double top, double thickness,
                         Material material, std::uint64_t id) {
    const Vector2d d = to - from, mid = 0.5 * (from + to);
    Cuboid wall;
    wall.T_world_base = yawPose(std::atan2(d.y(), d.x()), {mid.x(), mid.y(), bottom});
    wall.size = {d.norm(), thickness, top - bottom};
    wall.material = material;
    wall.printed = material == Material::kPlaster;
    wall.seed = mix(seed, id);
    addCuboid(wall, c.texel, world);
  };
  std::uint64_t id = 100;
  for (const WallPiece& w : plan.walls)
    piece(w.from, w.to, w.bottom, c.room_height, rooms.wall_thickness, Material::kPlaster, ++id);
  for (const Door& d : plan.doors) {  // frames
    const Vector2d along(-d.normal.y(), d.normal.x());
    for (const double side : {-0.5, 0.5}) {
      const Vector2d jamb = d.center + side * (rooms.door_width - 0.04) * along;
      piece(jamb - 0.02 * along, jamb + 0.02 * along, 0, rooms.door_height, rooms.wall_thickness + 0.04,
            Material::kWood, ++id);
    }
  }
}

}  // namespace

World buildRooms(const SimConfig& config, std::uint64_t seed) {
  const WorldConfig& c = config.world;
  Rng rng(mix(c.vary_layout ? seed : 0, 1));
  // Longer than the flight by what a recording that starts in motion leaves out.
  const double length = config.flight.speed * (config.flight.duration + 10);
  const RoomsPlan plan = planRooms(c.rooms, length, &rng);
  World world;
  world.flight = config.flight;
  world.flight_way = plan.flight;
  world.mav_start = plan.flight.front();
  for (const Door& d : plan.doors) world.doors.push_back(d.center);
  world.lane = config.lane;
  world.lane.points = plan.lane;
  world.lane.look_ahead = true;
  // Lamps overhead: steep key light, much of it from everywhere.
  const double azimuth = rng.uniform(-M_PI, M_PI);
  world.sun = Eigen::Vector3f(0.3f * std::cos(azimuth), 0.3f * std::sin(azimuth), 0.9f).normalized();
  world.ambient = 0.6f;

  addShell(config, plan, seed, &world);
  Furnisher furnisher(plan, world.lane, c.texel, &rng, &world);
  for (std::size_t i = 0; i < plan.rooms.size(); ++i) furnisher.furnish(plan.rooms[i], i % 2 == 0 || rng.chance(0.5));
  return world;
}

}  // namespace air_ground_sim
