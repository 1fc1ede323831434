#include "air_ground_sim/world.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "air_ground_sim/layout.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/rooms/rooms.h"
#include "air_ground_sim/street.h"
#include "air_ground_sim/trajectory.h"

namespace air_ground_sim {
namespace {

// A finely textured centre and four coarser strips around it.
void addFloor(const WorldConfig& c, std::uint64_t seed, World* world) {
  const double half = 0.5 * c.floor_size, inner = std::min(half, 4.2);
  const auto add = [&](double x0, double y0, double x1, double y1, double texel, bool printed) {
    if (x1 - x0 < 0.01 || y1 - y0 < 0.01) return;
    Patch p = rectanglePatch({x0, y0, 0}, {x1 - x0, 0, 0}, {0, y1 - y0, 0});
    p.material = floorMaterial(c.floor);
    p.texel = static_cast<float>(texel);
    p.printed = printed;
    p.seed = p.object = seed;
    world->patches.push_back(p);
  };
  add(-inner, -inner, inner, inner, c.texel, true);
  add(-half, -half, half, -inner, 3 * c.texel, false);
  add(-half, inner, half, half, 3 * c.texel, false);
  add(-half, -inner, -inner, inner, 3 * c.texel, false);
  add(inner, -inner, half, inner, 3 * c.texel, false);
}

void addRoom(const WorldConfig& c, std::uint64_t seed, World* world) {
  const double h = 0.5 * c.floor_size;
  const Eigen::Vector3d corners[4] = {{-h, -h, 0}, {h, -h, 0}, {h, h, 0}, {-h, h, 0}};
  for (int i = 0; i < 4; ++i) {
    // Seen from inside: the direction of columns runs clockwise.
    Patch p =
        rectanglePatch(corners[(i + 1) % 4], corners[i] - corners[(i + 1) % 4], Eigen::Vector3d(0, 0, c.room_height));
    p.material = Material::kPlaster;
    p.texel = static_cast<float>(4 * c.texel);
    p.printed = true;
    p.seed = mix(seed, 17 + i);
    p.object = seed;
    world->patches.push_back(p);
  }
}

double distanceToWall(const WallConfig& wall, const Eigen::Vector2d& p) {
  const Eigen::Vector2d d = wall.to - wall.from;
  const double s = std::clamp((p - wall.from).dot(d) / std::max(1e-9, d.squaredNorm()), 0.0, 1.0);
  return (wall.from + s * d - p).norm();
}

}  // namespace

Patch rectanglePatch(const Eigen::Vector3d& origin, const Eigen::Vector3d& u, const Eigen::Vector3d& v) {
  Patch p;
  p.vertices = {origin.cast<float>(), (origin + u).cast<float>(), (origin + v).cast<float>(),
                (origin + u + v).cast<float>()};
  p.width = static_cast<float>(u.norm());
  p.height = static_cast<float>(v.norm());
  return p;
}

Material floorMaterial(FloorStyle style) {
  switch (style) {
    case FloorStyle::kPlanks:
      return Material::kPlanks;
    case FloorStyle::kTiles:
      return Material::kTiles;
    case FloorStyle::kGravel:
      return Material::kGravel;
    case FloorStyle::kPlain:
      return Material::kPlain;
    case FloorStyle::kConcrete:
      break;
  }
  return Material::kConcrete;
}

Eigen::Vector3f Patch::point(float u, float v) const {
  if (!column_at.empty()) {  // uneven grids are flat rectangles
    const Eigen::Vector3f &a = vertices.front(), &b = vertices[columns],
                          &c = vertices[static_cast<std::size_t>(rows) * (columns + 1)];
    return a + u * (b - a) + v * (c - a);
  }
  const float x = u * columns, y = v * rows;
  const int ix = std::clamp(static_cast<int>(x), 0, columns - 1), iy = std::clamp(static_cast<int>(y), 0, rows - 1);
  const float a = x - ix, b = y - iy;
  const Eigen::Vector3f* p = &vertices[iy * (columns + 1) + ix];
  return (1 - b) * ((1 - a) * p[0] + a * p[1]) + b * ((1 - a) * p[columns + 1] + a * p[columns + 2]);
}

void addCuboid(const Cuboid& c, double texel, World* world) {
  const Eigen::Vector3d h(0.5 * c.size.x(), 0.5 * c.size.y(), c.size.z());
  const auto at = [&](double x, double y, double z) -> Eigen::Vector3d {
    return c.T_world_base * Eigen::Vector3d(x * h.x(), y * h.y(), z * h.z());
  };
  // Each face: origin, end of columns, end of rows; columns x rows points outwards.
  const Eigen::Vector3d faces[6][3] = {
      {at(-1, -1, 1), at(1, -1, 1), at(-1, 1, 1)},  {at(-1, 1, 0), at(1, 1, 0), at(-1, -1, 0)},
      {at(-1, -1, 0), at(1, -1, 0), at(-1, -1, 1)}, {at(1, 1, 0), at(-1, 1, 0), at(1, 1, 1)},
      {at(1, -1, 0), at(1, 1, 0), at(1, -1, 1)},    {at(-1, 1, 0), at(-1, -1, 0), at(-1, 1, 1)}};
  for (int i = 0; i < 6; ++i) {
    Patch p = rectanglePatch(faces[i][0], faces[i][1] - faces[i][0], faces[i][2] - faces[i][0]);
    p.material = c.material;
    p.printed = c.printed && i != 1;
    p.top = i == 0;
    p.texel = static_cast<float>(i == 1 ? 8 * texel : texel);
    p.seed = mix(c.seed, i);
    p.object = c.seed;
    world->patches.push_back(p);
  }
}

World buildWorld(const SimConfig& config, std::uint64_t seed) {
  if (config.hasCity()) return buildStreetWorld(planStreet(config.street, seed), Season::kFlight);
  if (config.world.kind == WorldKind::kRooms) return buildRooms(config, seed);
  Rng rng(mix(seed, 1));
  World world;
  WorldConfig c = config.world;
  world.lane = config.lane;
  world.flight = config.flight;
  if (c.vary_layout) {
    const Eigen::Vector2d mirror(rng.chance(0.5) ? -1 : 1, rng.chance(0.5) ? -1 : 1);
    const auto flip = [&](Eigen::Vector2d* p) { *p = p->cwiseProduct(mirror); };
    for (auto& p : world.lane.points) flip(&p);
    flip(&world.lane.look_at);
    flip(&world.flight.center);
    for (auto& w : c.walls) {
      flip(&w.from);
      flip(&w.to);
    }
    for (auto& k : c.clusters) {
      flip(&k.center);
      k.center += Eigen::Vector2d(rng.uniform(-0.25, 0.25), rng.uniform(-0.25, 0.25));
      k.boxes = std::max(0, k.boxes + rng.integer(3) - 1);
      k.debris = std::max(0, k.debris + rng.integer(5) - 2);
      k.max_height *= rng.uniform(0.9, 1.05);
    }
    if (rng.chance(0.5)) std::reverse(world.lane.points.begin(), world.lane.points.end());
  }
  const double azimuth = rng.uniform(-M_PI, M_PI);
  world.sun = Eigen::Vector3f(0.45f * std::cos(azimuth), 0.45f * std::sin(azimuth), 0.85f).normalized();

  FreeSpace free;
  free.lane = smoothLane(world.lane.points);
  free.lane_half_width = world.lane.half_width;
  // The MAV takes off opposite to where the ground robot begins, give or take, and away from walls.
  const Eigen::Vector2d away = world.flight.center - world.lane.points.front();
  double spread = 0.6;
  do {
    const double angle = std::atan2(away.y(), away.x()) + rng.uniform(-spread, spread);
    world.mav_start =
        world.flight.center + world.flight.start_radius * Eigen::Vector2d(std::cos(angle), std::sin(angle));
    spread += 0.1;
  } while (spread < 4 && std::any_of(c.walls.begin(), c.walls.end(),
                                     [&](const WallConfig& w) { return distanceToWall(w, world.mav_start) < 0.7; }));
  free.start = world.mav_start;

  switch (c.kind) {
    case WorldKind::kIndoor:
      addFloor(c, mix(seed, 2), &world);
      addClusters(c.clusters, free, c.texel, &rng, &world);
      for (std::size_t i = 0; i < c.walls.size(); ++i) addWall(c.walls[i], c.texel, mix(seed, 100 + i), &world);
      break;
    case WorldKind::kRubble:
      world.ambient = 0.35f;
      world.sky = 0.8f;
      addRubble(c, free, &rng, &world);
      break;
    case WorldKind::kFlat:
      addFloor(c, mix(seed, 2), &world);
      break;
    case WorldKind::kGrid:
      addFloor(c, mix(seed, 2), &world);
      addGrid(c, &world);
      break;
    case WorldKind::kStreet:
    case WorldKind::kRooms:
      break;  // built above
  }
  if (c.room_height > 0 && c.kind != WorldKind::kRubble) addRoom(c, mix(seed, 3), &world);
  return world;
}

air_ground_common::TriangleMesh meshOf(const World& world) {
  air_ground_common::TriangleMesh mesh;
  for (const Patch& p : world.patches) {
    const int base = static_cast<int>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), p.vertices.begin(), p.vertices.end());
    for (int r = 0; r < p.rows; ++r)
      for (int c = 0; c < p.columns; ++c) {
        if (p.isHole(c, r)) continue;
        const int i = base + r * (p.columns + 1) + c, below = i + p.columns + 1;
        mesh.triangles.emplace_back(i, i + 1, below + 1);
        mesh.triangles.emplace_back(i, below + 1, below);
      }
  }
  return mesh;
}

HeightLookup::HeightLookup(const air_ground_common::TriangleMesh& mesh) {
  const double half = 8.0;  // the robots stay well inside
  size_ = static_cast<int>(2 * half / kCell);
  origin_ = -half;
  cells_.assign(static_cast<std::size_t>(size_) * size_, 0.0f);
  const auto raise = [&](const Eigen::Vector3f& p) {
    const int x = static_cast<int>(std::floor((p.x() - origin_) / kCell)),
              y = static_cast<int>(std::floor((p.y() - origin_) / kCell));
    if (x < 0 || y < 0 || x >= size_ || y >= size_) return;
    float& cell = cells_[static_cast<std::size_t>(y) * size_ + x];
    cell = std::max(cell, p.z());
  };
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3f &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
    if (std::max({std::abs(a.x()), std::abs(b.x()), std::abs(c.x())}) >= half - 0.5 ||
        std::max({std::abs(a.y()), std::abs(b.y()), std::abs(c.y())}) >= half - 0.5)
      continue;  // outer walls and the floor's rim do not concern the robots
    if (std::max({a.z(), b.z(), c.z()}) < 0.02f) continue;
    const int n = 1 + static_cast<int>(std::max((b - a).norm(), (c - a).norm()) / (0.5 * kCell));
    for (int i = 0; i <= n; ++i)
      for (int j = 0; i + j <= n; ++j)
        raise(a + (b - a) * (static_cast<float>(i) / n) + (c - a) * (static_cast<float>(j) / n));
  }
}

double HeightLookup::operator()(const Eigen::Vector2d& place, double radius) const {
  const int r = static_cast<int>(radius / kCell);
  const int cx = static_cast<int>((place.x() - origin_) / kCell), cy = static_cast<int>((place.y() - origin_) / kCell);
  float highest = 0;
  for (int y = std::max(0, cy - r); y <= std::min(size_ - 1, cy + r); ++y)
    for (int x = std::max(0, cx - r); x <= std::min(size_ - 1, cx + r); ++x)
      highest = std::max(highest, cells_[static_cast<std::size_t>(y) * size_ + x]);
  return highest;
}

}  // namespace air_ground_sim
