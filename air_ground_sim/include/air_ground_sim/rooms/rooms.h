// Four furnished rooms around a crossing of walls, joined by doors: plan, ways of both robots, furniture.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "air_ground_sim/config.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/trajectory.h"
#include "air_ground_sim/world.h"

namespace air_ground_sim {

/// The room's inner faces [m].
struct Room {
  Eigen::Vector2d low = Eigen::Vector2d::Zero(), high = Eigen::Vector2d::Zero();
  Eigen::Vector2d center() const { return 0.5 * (low + high); }
  bool contains(const Eigen::Vector2d& p) const { return (p - low).minCoeff() > 0 && (high - p).minCoeff() > 0; }
};

/// An opening in the wall between two rooms.
struct Door {
  int from = 0, to = 0;                               ///< rooms
  Eigen::Vector2d center = Eigen::Vector2d::Zero();   ///< [m]
  Eigen::Vector2d normal = Eigen::Vector2d::UnitX();  ///< unit, from room `from` to room `to`
};

/// A straight piece of wall from the floor to the ceiling, or of a lintel above a door.
struct WallPiece {
  Eigen::Vector2d from = Eigen::Vector2d::Zero(), to = Eigen::Vector2d::Zero();  ///< [m]
  double bottom = 0;                                                             ///< [m]
};

struct RoomsPlan {
  std::array<Room, 4> rooms;  ///< counter-clockwise, the first at low x and y
  std::vector<Door> doors;    ///< three or four, between neighbours
  std::vector<WallPiece> walls;
  std::vector<Eigen::Vector2d> flight;  ///< way of the MAV through three rooms, every centimetre [m]
  std::vector<Eigen::Vector2d>
      lane;  ///< points of the ground robot's way: two of these rooms, and a look into the fourth
};

/// `flight_length`: the MAV's way is at least as long [m]; it circles in its last room until then.
RoomsPlan planRooms(const RoomsConfig& config, double flight_length, Rng* rng);

/// Floor, walls, doors, tables, chairs, lamps, shelves and boxes, clear of both ways.
World buildRooms(const SimConfig& config, std::uint64_t seed);

/// Stand still, climb, follow `way` with the camera ahead, low where a door (its centre in `doors`) is near.
BodyTrajectory makeRoomsFlight(const FlightConfig& config, const std::vector<Eigen::Vector2d>& way,
                               const std::vector<Eigen::Vector2d>& doors, std::uint64_t seed);

}  // namespace air_ground_sim
