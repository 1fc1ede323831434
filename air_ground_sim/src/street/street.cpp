#include "air_ground_sim/street/street.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "air_ground_common/text.h"
#include "air_ground_sim/noise.h"

namespace air_ground_sim {
namespace {

using air_ground_common::formatted;
using air_ground_common::Pose;
using Eigen::Vector2d;
using Eigen::Vector3d;

// Rectangle in plan: corner, unit axes, extents.
struct Footprint {
  Vector2d center, axis;
  double half_along, half_across;
};

// Separating axes of two rectangles.
bool overlap(const Footprint& a, const Footprint& b) {
  const Vector2d d = b.center - a.center;
  const auto separated = [&](const Vector2d& axis) {
    const auto reach = [&](const Footprint& f) {
      const Vector2d across(-f.axis.y(), f.axis.x());
      return f.half_along * std::abs(axis.dot(f.axis)) + f.half_across * std::abs(axis.dot(across));
    };
    return std::abs(d.dot(axis)) > reach(a) + reach(b);
  };
  for (const Footprint* f : {&a, &b})
    if (separated(f->axis) || separated({-f->axis.y(), f->axis.x()})) return false;
  return true;
}

Footprint footprintOf(const Building& b) {
  const Vector3d c = b.point(0.5 * b.width, 0.5 * b.depth, 0);
  return {c.head<2>(), b.T_world_front.linear().col(0).head<2>(), 0.5 * b.width, 0.5 * b.depth};
}

Footprint corridorOf(const StreetLineConfig& line, double width) {
  const Vector2d d = line.to - line.from;
  return {0.5 * (line.from + line.to), d.normalized(), 0.5 * d.norm() + 0.5 * width, 0.5 * width - 0.05};
}

double distanceToSegment(const Vector2d& p, const Vector2d& a, const Vector2d& b) {
  const Vector2d d = b - a;
  return (a + std::clamp((p - a).dot(d) / d.squaredNorm(), 0.0, 1.0) * d - p).norm();
}

// Windows in columns, shop windows and doors on the ground floor, balconies on some columns.
// A row of windows: the columns of a facade.
struct WindowGrid {
  double margin, pitch, width, height, sill;
  int columns;
};

WindowGrid drawWindows(const Building& b, Rng* rng) {
  WindowGrid g;
  g.margin = rng->uniform(0.7, 1.2);
  g.width = rng->uniform(0.95, 1.5);
  g.height = std::min(rng->uniform(1.35, 2.1), b.floor_height - 1.0);
  g.sill = std::clamp(b.floor_height - g.height - rng->uniform(0.45, 0.7), 0.2, 1.1);
  const double wanted = g.width + rng->uniform(0.8, 1.7);
  g.columns = std::max(2, static_cast<int>((b.width - 2 * g.margin + wanted - g.width) / wanted));
  g.pitch = (b.width - 2 * g.margin - g.width) / (g.columns - 1);
  return g;
}

void addUpperFloors(const WindowGrid& g, Building* b, Rng* rng) {
  const bool balconies = rng->chance(0.5);
  const int balcony_column = rng->integer(g.columns), balcony_step = 2 + rng->integer(2);
  for (int f = 1; f < b->floors; ++f) {
    const double z0 = b->street_level + b->shop_height + (f - 1) * b->floor_height;
    for (int c = 0; c < g.columns; ++c) {
      Opening o;
      o.floor = f;
      o.column = c;
      o.x = g.margin + c * g.pitch;
      o.width = g.width;
      o.z = z0 + g.sill;
      o.height = g.height;
      const bool balcony = balconies && f > 0 && c % balcony_step == balcony_column % balcony_step;
      if (balcony) {  // a door to it
        o.z = z0 + 0.12;
        o.height = g.sill + g.height - 0.12;
        Opening slab = o;
        slab.x -= 0.35;
        slab.width += 0.7;
        slab.z = z0;
        slab.height = 1.0;
        b->balconies.push_back(slab);
      }
      b->openings.push_back(o);
    }
  }
}

void addShopFronts(double margin, Building* b, Rng* rng) {
  double x = margin;
  const int shops = std::max(1, static_cast<int>(std::lround(b->width / rng->uniform(4.5, 7.0))));
  const double share = (b->width - 2 * margin) / shops;
  for (int i = 0; i < shops; ++i, x += share) {
    const bool door_left = rng->chance(0.5);
    Opening door, pane;
    door.kind = OpeningKind::kDoor;
    pane.kind = OpeningKind::kShopWindow;
    door.width = rng->uniform(0.95, 1.2);
    door.height = rng->uniform(2.15, 2.4);
    door.z = b->street_level + 0.06;
    pane.width = share - door.width - 0.75;
    pane.height = rng->uniform(1.7, 2.1);
    pane.z = b->street_level + rng->uniform(0.35, 0.6);
    door.x = door_left ? x + 0.1 : x + share - door.width - 0.1;
    pane.x = door_left ? door.x + door.width + 0.3 : x + 0.2;
    door.column = pane.column = i;
    b->openings.push_back(door);
    if (pane.width > 0.8) b->openings.push_back(pane);
  }
}

void addGroundFloor(const WindowGrid& g, int door_column, Building* b) {
  for (int c = 0; c < g.columns; ++c) {
    Opening o;
    o.column = c;
    o.x = g.margin + c * g.pitch;
    o.width = g.width;
    if (c == door_column) {
      o.kind = OpeningKind::kDoor;
      o.z = b->street_level + 0.15;
      o.height = 2.25;
    } else {
      o.z = b->street_level + b->shop_height - g.height - 0.75;
      o.height = g.height;
    }
    b->openings.push_back(o);
  }
}

void addOpenings(Building* b, Rng* rng) {
  const WindowGrid windows = drawWindows(*b, rng);
  addUpperFloors(windows, b, rng);
  const int door_column = rng->integer(windows.columns);
  if (b->shop)
    addShopFronts(windows.margin, b, rng);
  else
    addGroundFloor(windows, door_column, b);
}

Building makeBuilding(const Street& street, const Vector2d& front_left, const Vector2d& along, double width, int line,
                      Rng* rng) {
  Building b;
  b.line = line;
  b.width = width;
  b.depth = rng->uniform(9.5, 12.5);
  b.seed = rng->next();
  const Vector2d inward(-along.y(), along.x());
  b.T_world_front.linear().col(0) << along.x(), along.y(), 0;
  b.T_world_front.linear().col(1) << inward.x(), inward.y(), 0;
  b.T_world_front.linear().col(2) = Vector3d::UnitZ();
  double lowest = 1e9, highest_front = -1e9;
  for (const double u : {0.0, 0.5, 1.0})
    for (const double v : {0.0, 1.0}) {
      const double h = street.ground(front_left + u * width * along + v * b.depth * inward);
      lowest = std::min(lowest, h);
      if (v == 0) highest_front = std::max(highest_front, h);
    }
  b.T_world_front.translation() << front_left.x(), front_left.y(), lowest - 0.4;
  b.street_level = highest_front - (lowest - 0.4);
  b.floors = 3 + rng->integer(3);
  b.shop = rng->chance(0.5);
  b.floor_height = rng->uniform(2.75, 3.35);
  b.shop_height = b.shop ? rng->uniform(3.4, 4.0) : rng->uniform(2.95, 3.4);
  b.eaves = b.street_level + b.shop_height + (b.floors - 1) * b.floor_height + rng->uniform(0.3, 0.7);
  const int roof = rng->integer(5);
  b.roof = roof < 2 ? RoofKind::kFlat : roof < 4 ? RoofKind::kGable : RoofKind::kHip;
  b.roof_rise = b.roof == RoofKind::kFlat ? 0 : 0.5 * b.depth * rng->uniform(0.5, 0.85);
  addOpenings(&b, rng);
  return b;
}

void addBuildings(Street* street, Rng* rng) {
  const StreetConfig& c = street->config;
  std::vector<Footprint> taken;
  const auto isFree = [&](const Footprint& f) {
    for (const auto& line : c.lines)
      if (overlap(f, corridorOf(line, c.width))) return false;
    return std::none_of(taken.begin(), taken.end(), [&](const Footprint& t) { return overlap(f, t); });
  };
  const auto place = [&](const Vector2d& front_left, const Vector2d& along, double width, int line) {
    Building b = makeBuilding(*street, front_left, along, width, line, rng);
    if (!isFree(footprintOf(b))) return false;
    b.id = formatted("bldg_%03d", static_cast<int>(street->buildings.size()));
    Footprint f = footprintOf(b);
    f.half_along -= 0.01;  // neighbours share a wall
    taken.push_back(f);
    street->buildings.push_back(b);
    return true;
  };
  for (std::size_t i = 0; i < c.lines.size(); ++i) {
    const Vector2d d = (c.lines[i].to - c.lines[i].from).normalized(), n(-d.y(), d.x());
    const double length = (c.lines[i].to - c.lines[i].from).norm(), half = 0.5 * c.width;
    for (const int side : {1, -1}) {
      const Vector2d along = side * d;  // to the right, seen from the street
      const Vector2d start = (side > 0 ? c.lines[i].from : c.lines[i].to) + side * half * n;
      double s = 0;
      while (s < length - 7) {
        double width = rng->uniform(8.5, 17.0);
        if (s + width > length + 3) width = std::max(7.0, length - s);
        const double setback = rng->chance(0.35) ? rng->uniform(0.1, 0.5) : 0.0;
        if (place(start + s * along + side * setback * n, along, width, static_cast<int>(i))) {
          s += width;
          if (rng->chance(0.2)) s += rng->uniform(1.8, 4.0);  // an alley
        } else {
          s += 2;
        }
      }
    }
    // The view along the street ends at a house across, where no other street goes on.
    for (const int end : {1, -1}) {
      const Vector2d p = (end > 0 ? c.lines[i].to : c.lines[i].from) + end * (half + 4) * d;
      const double width = c.width + rng->uniform(2, 8);
      place(p + end * 0.5 * width * n, -end * n, width, static_cast<int>(i));
    }
  }
  for (auto& b : street->buildings)
    b.model_error = Vector3d(c.model_lateral_stddev * rng->gaussian(), c.model_lateral_stddev * rng->gaussian(),
                             c.model_height_stddev * rng->gaussian());
}

// Photographs in place of painted facades, in turn; what stands out of a painted wall is left off.
void addPhotographs(Street* street) {
  namespace fs = std::filesystem;
  const std::string& folder = street->config.facade_images;
  std::vector<std::string> files;
  if (fs::is_directory(folder))
    for (const auto& entry : fs::directory_iterator(folder)) {
      std::string type = entry.path().extension().string();
      std::transform(type.begin(), type.end(), type.begin(),
                     [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
      if (type == ".jpg" || type == ".jpeg" || type == ".png") files.push_back(entry.path().string());
    }
  if (files.empty()) throw std::invalid_argument("facade_images: no .jpg or .png files in '" + folder + "'");
  std::sort(files.begin(), files.end());
  const std::size_t first = mix(street->seed, 44) % files.size();
  for (std::size_t i = 0; i < street->buildings.size(); ++i) {
    Building& b = street->buildings[i];
    b.photograph = files[(first + i) % files.size()];
    b.openings.clear();
    b.balconies.clear();
  }
}

Stand standAt(const Street& street, const Vector2d& p, double yaw, Rng* rng) {
  Stand s;
  s.position << p.x(), p.y(), street.ground(p);
  s.yaw = yaw;
  s.seed = rng->next();
  return s;
}

// Trees and parked cars in rows, people anywhere on the sidewalks, some on the road.
void addStreetLife(Street* street, Rng* rng) {
  const StreetConfig& c = street->config;
  const double half = 0.5 * c.width, kerb = half - c.sidewalk;
  const Vector2d start = c.route.size() > 1 ? c.route.front() : c.lines[0].from;
  for (std::size_t i = 0; i < c.lines.size(); ++i) {
    const Vector2d d = (c.lines[i].to - c.lines[i].from).normalized(), n(-d.y(), d.x());
    const double length = (c.lines[i].to - c.lines[i].from).norm();
    const auto at = [&](double s, double lateral) -> Vector2d { return c.lines[i].from + s * d + lateral * n; };
    // Nothing stands in a crossing.
    const auto clear = [&](const Vector2d& p, double distance) {
      for (std::size_t j = 0; j < c.lines.size(); ++j)
        if (j != i && distanceToSegment(p, c.lines[j].from, c.lines[j].to) < distance) return false;
      return true;
    };
    const auto count = [&](double on_100m) { return static_cast<int>(std::lround(on_100m * length / 100)); };
    for (int k = 0; k < count(c.trees); ++k) {
      const Vector2d p = at(rng->uniform(6, length - 6), (rng->chance(0.5) ? 1 : -1) * (kerb + 0.9));
      if (clear(p, half + 2)) street->trees.push_back(standAt(*street, p, rng->uniform(0, 2 * M_PI), rng));
    }
    for (const int season : {0, 1}) {
      for (const int side : {1, -1})
        for (double s = rng->uniform(2, 8); s < length - 6; s += 5.6) {
          const Vector2d p = at(s, side * (kerb - 1.0));
          const bool parked = rng->chance(5.6 / 200 * c.cars);
          if (!parked || !clear(p, half + 1) || (p - start).norm() < 16) continue;
          street->cars[season].push_back(
              standAt(*street, p, std::atan2(d.y(), d.x()) + (side > 0 ? M_PI : 0) + 0.02 * rng->gaussian(), rng));
        }
      for (int k = 0; k < count(c.people); ++k) {
        const double lateral = rng->chance(0.8) ? rng->uniform(kerb + 0.3, half - 0.5)
                                                : rng->uniform(0, 0.7);  // not in the ways of MAV and vehicles
        const Vector2d p = at(rng->uniform(2, length - 2), (rng->chance(0.5) ? 1 : -1) * lateral);
        if ((p - start).norm() > 12)
          street->people[season].push_back(standAt(*street, p, rng->uniform(0, 2 * M_PI), rng));
      }
    }
  }
}

void addPanoramas(Street* street, Rng* rng) {
  const StreetConfig& c = street->config;
  // Mean length of a normal vector with standard deviations (1, 1, 1/2), and of one with (1, 1, 1) in three dimensions.
  const double position_unit = c.geotag_position_error / 1.3647,
               angle_unit = c.geotag_orientation_error / std::sqrt(8 / M_PI);
  for (const auto& line : c.lines) {
    if (!line.panoramas) continue;
    const Vector2d d = (line.to - line.from).normalized(), n(-d.y(), d.x());
    const double length = (line.to - line.from).norm();
    Vector3d common(rng->gaussian(), rng->gaussian(), rng->gaussian());
    for (double s = rng->uniform(2, 0.6 * c.panorama_spacing); s < length - 1;
         s += c.panorama_spacing + rng->uniform(-1, 1)) {
      const Vector2d p = line.from + s * d - (1.5 + 0.2 * rng->gaussian()) * n;  // in the right lane
      PanoramaStand stand;
      stand.id = formatted("pano_%04d", static_cast<int>(street->panoramas.size()));
      const double rise = std::atan((street->ground(p + d) - street->ground(p - d)) / 2);
      const double yaw = std::atan2(d.y(), d.x()) + 0.03 * rng->gaussian();
      stand.T_world_panorama.translation() << p.x(), p.y(),
          street->ground(p) + c.panorama_height + 0.02 * rng->gaussian();
      // Yaw, then pitch (nose up is negative about y left), then roll.
      stand.T_world_panorama.linear() = (Eigen::AngleAxisd(yaw, Vector3d::UnitZ()) *
                                         Eigen::AngleAxisd(-rise + 0.008 * rng->gaussian(), Vector3d::UnitY()) *
                                         Eigen::AngleAxisd(0.012 * rng->gaussian(), Vector3d::UnitX()))
                                            .toRotationMatrix();
      // Satellite positions of neighbours err alike; the common part is renewed over some 40 m.
      const double keep = std::exp(-c.panorama_spacing / 40), fresh = std::sqrt(1 - keep * keep);
      Vector3d own, turn;
      for (int k = 0; k < 3; ++k) {
        common[k] = keep * common[k] + fresh * rng->gaussian();
        own[k] = rng->gaussian();
        turn[k] = angle_unit * rng->gaussian();
      }
      const Vector3d error =
          position_unit * (std::sqrt(c.geotag_correlation) * common + std::sqrt(1 - c.geotag_correlation) * own);
      stand.T_world_geotag.translation() =
          stand.T_world_panorama.translation() + Vector3d(error.x(), error.y(), 0.5 * error.z());
      stand.T_world_geotag.linear() = stand.T_world_panorama.linear() * air_ground_common::expSO3(turn);
      street->panoramas.push_back(stand);
    }
  }
}

}  // namespace

double Street::ground(const Vector2d& p) const {
  const Vector2d d = (config.lines[0].to - config.lines[0].from).normalized();
  const auto s = static_cast<std::uint32_t>(mix(seed, 71));
  const double n = fractalNoise(static_cast<float>(p.x() / 45), static_cast<float>(p.y() / 45), s, 2, 0.4f);
  return config.grade * d.dot(p - config.lines[0].from) + config.relief * n;
}

double Street::distanceToLine(const Vector2d& p) const {
  double distance = 1e9;
  for (const auto& line : config.lines) distance = std::min(distance, distanceToSegment(p, line.from, line.to));
  return distance;
}

Street planStreet(const StreetConfig& config, std::uint64_t seed) {
  if (config.lines.empty()) throw std::invalid_argument("a street world needs at least one line");
  Street street;
  street.config = config;
  street.seed = seed;
  Rng houses(mix(seed, 41)), life(mix(seed, 42)), panoramas(mix(seed, 43));
  addBuildings(&street, &houses);
  if (!config.facade_images.empty()) addPhotographs(&street);
  addStreetLife(&street, &life);
  addPanoramas(&street, &panoramas);
  return street;
}

}  // namespace air_ground_sim
