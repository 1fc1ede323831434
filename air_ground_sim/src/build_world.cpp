#include "air_ground_sim/build_world.h"

#include <algorithm>
#include <cmath>

#include "air_ground_sim/layout.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/rooms/rooms.h"
#include "air_ground_sim/street/street.h"
#include "air_ground_sim/trajectory.h"

namespace air_ground_sim {
namespace {

double distanceToWall(const WallConfig& wall, const Eigen::Vector2d& p) {
  const Eigen::Vector2d d = wall.to - wall.from;
  const double s = std::clamp((p - wall.from).dot(d) / std::max(1e-9, d.squaredNorm()), 0.0, 1.0);
  return (wall.from + s * d - p).norm();
}

// The seed mirrors the layout, moves heaps and changes counts.
void varyLayout(WorldConfig* c, Rng* rng, World* world) {
  const Eigen::Vector2d mirror(rng->chance(0.5) ? -1 : 1, rng->chance(0.5) ? -1 : 1);
  const auto flip = [&](Eigen::Vector2d* p) { *p = p->cwiseProduct(mirror); };
  for (auto& p : world->lane.points) flip(&p);
  flip(&world->lane.look_at);
  flip(&world->flight.center);
  for (auto& w : c->walls) {
    flip(&w.from);
    flip(&w.to);
  }
  for (auto& k : c->clusters) {
    flip(&k.center);
    k.center += Eigen::Vector2d(rng->uniform(-0.25, 0.25), rng->uniform(-0.25, 0.25));
    k.boxes = std::max(0, k.boxes + rng->integer(3) - 1);
    k.debris = std::max(0, k.debris + rng->integer(5) - 2);
    k.max_height *= rng->uniform(0.9, 1.05);
  }
  if (rng->chance(0.5)) std::reverse(world->lane.points.begin(), world->lane.points.end());
}

// The MAV takes off opposite to where the ground robot begins, give or take, and away from walls.
Eigen::Vector2d takeOffPlace(const World& world, const std::vector<WallConfig>& walls, Rng* rng) {
  const Eigen::Vector2d away = world.flight.center - world.lane.points.front();
  double spread = 0.6;
  Eigen::Vector2d place;
  do {
    const double angle = std::atan2(away.y(), away.x()) + rng->uniform(-spread, spread);
    place = world.flight.center + world.flight.start_radius * Eigen::Vector2d(std::cos(angle), std::sin(angle));
    spread += 0.1;
  } while (spread < 4 && std::any_of(walls.begin(), walls.end(),
                                     [&](const WallConfig& w) { return distanceToWall(w, place) < 0.7; }));
  return place;
}

}  // namespace

World buildWorld(const SimConfig& config, std::uint64_t seed) {
  if (config.hasCity()) return buildStreetWorld(planStreet(config.street, seed), Season::kFlight);
  if (config.world.kind == WorldKind::kRooms) return buildRooms(config, seed);
  Rng rng(mix(seed, 1));
  World world;
  WorldConfig c = config.world;
  world.lane = config.lane;
  world.flight = config.flight;
  if (c.vary_layout) varyLayout(&c, &rng, &world);
  const double azimuth = rng.uniform(-M_PI, M_PI);
  world.sun = Eigen::Vector3f(0.45f * std::cos(azimuth), 0.45f * std::sin(azimuth), 0.85f).normalized();

  FreeSpace free;
  free.lane = smoothLane(world.lane.points);
  free.lane_half_width = world.lane.half_width;
  world.mav_start = takeOffPlace(world, c.walls, &rng);
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

}  // namespace air_ground_sim
