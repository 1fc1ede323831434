// A town's streets: where buildings, trees, cars, panoramas and the MAV's way are, before anything is drawn.
// Everything follows from the configuration and the seed.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "air_ground_sim/config.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/trajectory.h"
#include "air_ground_sim/world.h"

namespace air_ground_sim {

/// The panoramas are taken on another day than the flight: light, foliage, curtains, awnings, cars and people differ.
enum class Season { kPanoramas, kFlight };

enum class OpeningKind { kWindow, kShopWindow, kDoor };

/// A hole in a facade with a pane set back in it; facade coordinates (x right, z up from the facade's lower left
/// corner).
struct Opening {
  OpeningKind kind = OpeningKind::kWindow;
  double x = 0, z = 0, width = 1, height = 1;  ///< [m]
  int floor = 0, column = 0;
};

enum class RoofKind { kFlat, kGable, kHip };

struct Building {
  std::string id;
  /// Frame of the facade: origin at its lower left corner seen from the street, x along it to the right, y into the
  /// building, z up. The origin lies below the lowest ground, at the height of the GroundSurface.
  air_ground_common::Pose T_world_front = air_ground_common::Pose::Identity();
  double width = 12, depth = 11;  ///< [m]
  double eaves = 12;              ///< height of the walls above the origin [m]
  double roof_rise = 3;           ///< of the ridge above the eaves [m]
  RoofKind roof = RoofKind::kGable;
  double street_level = 0.5;                     ///< height of the ground floor above the origin [m]
  double floor_height = 3.1, shop_height = 3.6;  ///< upper floors and ground floor [m]
  int floors = 4;
  bool shop = false;
  std::vector<Opening> openings;
  std::vector<Opening> balconies;  ///< extent of slab and railing
  std::string photograph;          ///< file shown on the facade in place of a painted one
  std::uint64_t seed = 0;
  int line = 0;  ///< index of its street
  /// Error of the cadastral model: the model's building is the true one moved by this [m].
  Eigen::Vector3d model_error = Eigen::Vector3d::Zero();

  double hipInset() const {
    return roof == RoofKind::kHip ? std::min(0.5 * depth, 0.35 * width) : 0;
  }  ///< of the ridge's ends [m]
  Eigen::Vector3d point(double x, double y, double z) const { return T_world_front * Eigen::Vector3d(x, y, z); }
};

/// A place on the ground with a heading.
struct Stand {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< on the ground [m]
  double yaw = 0;                                      ///< [rad]
  std::uint64_t seed = 0;
};

struct PanoramaStand {
  std::string id;
  air_ground_common::Pose T_world_panorama =
      air_ground_common::Pose::Identity();  ///< x to the image's centre, y left, z up
  air_ground_common::Pose T_world_geotag = air_ground_common::Pose::Identity();  ///< as the vehicle believes
};

struct Street {
  StreetConfig config;
  std::uint64_t seed = 0;
  std::vector<Building> buildings;
  std::vector<Stand> trees;
  std::vector<Stand> cars[2], people[2];  ///< by Season
  std::vector<PanoramaStand> panoramas;

  double ground(const Eigen::Vector2d& p) const;          ///< height of the terrain [m]
  double distanceToLine(const Eigen::Vector2d& p) const;  ///< to the nearest centre line [m]
};

/// Plans the street; throws std::invalid_argument when `lines` or the folder of photographs is empty.
Street planStreet(const StreetConfig& config, std::uint64_t seed);

/// Draws the plan as it looks in one season.
World buildStreetWorld(const Street& street, Season season);

/// Stand still, climb, follow the route at some height above the ground, slower in turns.
BodyTrajectory makeStreetFlight(const Street& street, const FlightConfig& flight, std::uint64_t seed);

/// A way along a line of the street, for pictures of places other than the route's: a pose every `step` [m], level.
std::vector<air_ground_common::Pose> posesAlongLine(const Street& street, int line, const FlightConfig& flight,
                                                    double step);

}  // namespace air_ground_sim
