#include "air_ground_sim/layout.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "air_ground_sim/noise.h"

namespace air_ground_sim {
namespace {

using air_ground_common::Pose;
using air_ground_common::yawPose;

// A pallet of three stringers and seven deck boards, 1.2 x 0.8 x 0.144 m.
void addPallet(const Footprint& f, double texel, std::uint64_t seed, World* world) {
  const Pose T = standing(f, 0);
  const auto board = [&](double x, double y, double z, double lx, double ly, double lz, int id) {
    Cuboid c;
    c.T_world_base = T * Eigen::Translation3d(x, y, z);
    c.size = {lx, ly, lz};
    c.material = Material::kWood;
    c.printed = false;
    c.seed = mix(seed, id);
    addCuboid(c, texel, world);
  };
  for (int i = -1; i <= 1; ++i) board(0, 0.35 * i, 0, 1.2, 0.1, 0.122, 10 + i);
  for (int i = -3; i <= 3; ++i) board(0.182 * i, 0, 0.122, 0.1, 0.8, 0.022, 30 + i);
}

void addDebris(const Eigen::Vector2d& center, double yaw, double texel, Rng* rng, World* world) {
  Cuboid c;
  c.seed = rng->next();
  const int kind = rng->integer(4);
  double tilt = 0, lift = 0;
  if (kind == 0) {  // plank, one end propped up a little
    c.size = {rng->uniform(0.6, 1.1), rng->uniform(0.08, 0.16), 0.025};
    c.material = Material::kWood;
    c.printed = false;
    tilt = rng->uniform(0, 0.15);
    lift = 0.5 * c.size.x() * std::sin(tilt);
  } else if (kind == 1) {
    c.size = {0.21, 0.10, 0.065};
    c.material = Material::kBrick;
    c.printed = false;
  } else if (kind == 2) {
    c.size = {rng->uniform(0.12, 0.25), rng->uniform(0.10, 0.2), rng->uniform(0.08, 0.2)};
    c.material = rng->chance(0.5) ? Material::kPaintedBox : Material::kCardboard;
  } else {  // flattened cardboard
    c.size = {rng->uniform(0.4, 0.7), rng->uniform(0.3, 0.5), 0.012};
  }
  c.T_world_base = yawPose(yaw, {center.x(), center.y(), lift}) * Eigen::AngleAxisd(-tilt, Eigen::Vector3d::UnitY());
  addCuboid(c, texel, world);
}

// A lump: cube faces pushed to a sphere, displaced by noise and flattened.
void addRock(const Eigen::Vector3d& center, double radius, double texel, Rng* rng, World* world) {
  const auto noise_seed = static_cast<std::uint32_t>(rng->next());
  const std::uint64_t seed = rng->next();
  const double yaw = rng->uniform(-M_PI, M_PI), flat = rng->uniform(0.55, 0.9), stretch = rng->uniform(0.8, 1.3);
  const int n = 12;
  const Eigen::Matrix3d R = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  static const int axes[6][3] = {{0, 1, 2}, {1, 0, 2}, {1, 2, 0}, {2, 1, 0}, {2, 0, 1}, {0, 2, 1}};
  for (int f = 0; f < 6; ++f) {
    Patch p;
    p.columns = p.rows = n;
    p.material = Material::kRock;
    p.texel = static_cast<float>(texel);
    p.seed = mix(seed, f);
    p.object = seed;
    p.width = p.height = static_cast<float>(1.57 * radius);
    for (int r = 0; r <= n; ++r)
      for (int c = 0; c <= n; ++c) {
        Eigen::Vector3d d = Eigen::Vector3d::Zero();
        d[axes[f][0]] = std::tan(M_PI / 4 * (2.0 * c / n - 1));
        d[axes[f][1]] = std::tan(M_PI / 4 * (2.0 * r / n - 1));
        d[axes[f][2]] = f % 2 ? -1 : 1;
        d.normalize();
        // Facets: broken stone is flat in places. Displacement is a function of direction, so faces meet.
        const auto df = (2.2 * d).cast<float>().eval();
        const double bump = 1 + 0.28 * fractalNoise(df.x() + 7, df.y() - 3, df.z() + 1, noise_seed, 4, 0.55f);
        p.vertices.push_back(
            (center + R * (radius * bump * Eigen::Vector3d(stretch * d.x(), d.y(), flat * d.z()))).cast<float>());
      }
    world->patches.push_back(p);
  }
}

}  // namespace

bool overlap(const Footprint& a, const Footprint& b, double gap) {
  const auto axes = [](const Footprint& f) {
    return std::array<Eigen::Vector2d, 2>{Eigen::Vector2d(std::cos(f.yaw), std::sin(f.yaw)),
                                          Eigen::Vector2d(-std::sin(f.yaw), std::cos(f.yaw))};
  };
  const auto A = axes(a), B = axes(b);
  const auto reach = [](const Footprint& f, const std::array<Eigen::Vector2d, 2>& own, const Eigen::Vector2d& axis) {
    return f.hx * std::abs(own[0].dot(axis)) + f.hy * std::abs(own[1].dot(axis));
  };
  for (const Eigen::Vector2d& axis : {A[0], A[1], B[0], B[1]})
    if (std::abs(axis.dot(b.center - a.center)) > reach(a, A, axis) + reach(b, B, axis) + gap) return false;
  return true;
}

Pose standing(const Footprint& f, double z) { return yawPose(f.yaw, {f.center.x(), f.center.y(), z}); }

Cuboid randomBox(Rng* rng) {
  static const double sizes[][3] = {{0.60, 0.40, 0.40}, {0.40, 0.30, 0.30}, {0.50, 0.35, 0.25}, {0.70, 0.50, 0.45},
                                    {0.35, 0.25, 0.20}, {0.45, 0.45, 0.50}, {0.55, 0.40, 0.20}, {0.30, 0.30, 0.60}};
  const auto& s = sizes[rng->integer(8)];
  Cuboid c;
  for (int i = 0; i < 3; ++i) c.size[i] = s[i] * rng->uniform(0.88, 1.12);
  c.material = rng->chance(0.8) ? Material::kCardboard : Material::kPaintedBox;
  c.seed = rng->next();
  return c;
}

bool FreeSpace::isFree(const Eigen::Vector2d& center, double reach) const {
  if ((center - start).norm() < start_radius + reach) return false;
  for (std::size_t i = 0; i < lane.size(); i += 5)
    if ((center - lane[i]).norm() < lane_half_width + reach) return false;
  return true;
}

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

namespace {

// Pallets, boxes and debris of clusters, each on free floor or on what carries it.
class ClusterBuilder {
 public:
  ClusterBuilder(const FreeSpace& free, double texel, Rng* rng, World* world)
      : free_(free), texel_(texel), rng_(rng), world_(world) {}

  void add(const ClusterConfig& c) {
    carriers_.clear();
    Footprint f;
    for (int i = 0; i < c.pallets; ++i)
      if (tryPlace(c, 0.6, 0.4, 0.03, &f)) addLoadedPallet(f);
    for (int i = 0; i < c.boxes; ++i) addBox(c);
    ClusterConfig wide = c;
    wide.radius *= 1.5;
    for (int i = 0; i < c.debris; ++i)
      if (tryPlace(wide, 0.2, 0.15, -0.05, &f)) addDebris(f.center, f.yaw, texel_, rng_, world_);
  }

 private:
  bool tryPlace(const ClusterConfig& c, double hx, double hy, double gap, Footprint* placed) {
    for (int attempt = 0; attempt < 60; ++attempt) {
      Footprint f;
      const double r = c.radius * std::sqrt(rng_->uniform()), a = rng_->uniform(-M_PI, M_PI);
      f.center = c.center + r * Eigen::Vector2d(std::cos(a), std::sin(a));
      f.yaw = rng_->uniform(-M_PI, M_PI);
      f.hx = hx;
      f.hy = hy;
      if (!free_.isFree(f.center, std::hypot(hx, hy))) continue;
      if (std::any_of(base_.begin(), base_.end(), [&](const Footprint& o) { return overlap(f, o, gap); })) continue;
      *placed = f;
      return true;
    }
    return false;
  }

  // Two or three boxes side by side on the pallet, each of which may carry more.
  void addLoadedPallet(Footprint f) {
    addPallet(f, texel_, rng_->next(), world_);
    f.top = 0.144;
    base_.push_back(f);
    const int n = 2 + rng_->integer(2);
    for (int k = 0; k < n; ++k) {
      Cuboid box = randomBox(rng_);
      box.size.x() = std::min(box.size.x(), 0.78);
      box.size.y() = std::min(box.size.y(), 1.16 / n);
      Footprint b;
      const double along = 1.2 * ((k + 0.5) / n - 0.5);
      b.yaw = f.yaw + M_PI / 2 + rng_->uniform(-0.04, 0.04);
      b.center = f.center + along * Eigen::Vector2d(std::cos(f.yaw), std::sin(f.yaw));
      stand(b, f.top, &box);
    }
  }

  // On a carrier with room for it, or on the floor.
  void addBox(const ClusterConfig& c) {
    Cuboid box = randomBox(rng_);
    std::vector<std::size_t> options;
    for (std::size_t k = 0; k < carriers_.size(); ++k)
      if (carriers_[k].can_carry && carriers_[k].top + box.size.z() <= c.max_height &&
          0.5 * box.size.x() < 1.15 * carriers_[k].hx && 0.5 * box.size.y() < 1.15 * carriers_[k].hy)
        options.push_back(k);
    Footprint f;
    if (!options.empty() && rng_->chance(0.45)) {
      Footprint& below = carriers_[options[rng_->integer(static_cast<int>(options.size()))]];
      Footprint b = below;
      b.yaw += rng_->uniform(-0.35, 0.35);
      b.center += Eigen::Vector2d(rng_->uniform(-0.03, 0.03), rng_->uniform(-0.03, 0.03));
      below.can_carry = false;
      stand(b, below.top, &box);
    } else if (tryPlace(c, 0.5 * box.size.x(), 0.5 * box.size.y(), 0.02, &f)) {
      base_.push_back(f);
      stand(f, 0, &box);
    }
  }

  // The box as it stands on something of this height: one more carrier.
  void stand(Footprint b, double height, Cuboid* box) {
    b.hx = 0.5 * box->size.x();
    b.hy = 0.5 * box->size.y();
    b.top = height + box->size.z();
    box->T_world_base = standing(b, height);
    addCuboid(*box, texel_, world_);
    carriers_.push_back(b);
  }

  const FreeSpace& free_;
  const double texel_;
  Rng* rng_;
  World* world_;
  std::vector<Footprint> base_;      // everything that stands on the floor
  std::vector<Footprint> carriers_;  // of the cluster: what a box may stand on
};

}  // namespace

void addClusters(const std::vector<ClusterConfig>& clusters, const FreeSpace& free, double texel, Rng* rng,
                 World* world) {
  ClusterBuilder builder(free, texel, rng, world);
  for (const ClusterConfig& c : clusters) builder.add(c);
}

void addWall(const WallConfig& wall, double texel, std::uint64_t seed, World* world) {
  const Eigen::Vector2d d = wall.to - wall.from, mid = 0.5 * (wall.from + wall.to);
  Cuboid c;
  c.T_world_base = yawPose(std::atan2(d.y(), d.x()), {mid.x(), mid.y(), 0});
  c.size = {d.norm(), 0.12, wall.height};
  c.material = Material::kPlaster;
  c.seed = seed;
  addCuboid(c, texel, world);
}

void addGrid(const WorldConfig& config, World* world) {
  for (int r = 0; r < config.grid_rows; ++r)
    for (int k = 0; k < config.grid_columns; ++k) {
      Cuboid c;
      c.T_world_base.translation() = Eigen::Vector3d((k - 0.5 * (config.grid_columns - 1)) * config.grid_spacing,
                                                     (r - 0.5 * (config.grid_rows - 1)) * config.grid_spacing, 0);
      c.size.setConstant(config.grid_box);
      c.seed = 12345;  // one texture for all
      addCuboid(c, config.texel, world);
    }
}

namespace {

// Noise and mounds away from the lane, level on it.
class Terrain {
 public:
  Terrain(const WorldConfig& config, const FreeSpace& free, Rng* rng)
      : free_(free), relief_(config.relief), seed_(static_cast<std::uint32_t>(rng->next())) {
    for (int i = 0; i < 5; ++i)
      mounds_.push_back(
          {{rng->uniform(-1.8, 1.8), rng->uniform(-1.8, 1.8)}, rng->uniform(0.5, 0.9), rng->uniform(0.25, 0.7)});
  }

  double height(const Eigen::Vector2d& p) const {
    const auto q = p.cast<float>().eval();
    double z = relief_ * fractalNoise(0.9f * q.x(), 0.9f * q.y(), seed_, 5, 0.5f);
    for (const auto& m : mounds_)
      z += m.height * std::exp(-(p - m.center).squaredNorm() / (m.radius * m.radius)) *
           (1 + 0.35 * fractalNoise(3 * q.x(), 3 * q.y(), seed_ + 9, 4));
    return z * openness(p);
  }

  void addTile(const Eigen::Vector2d& low, const Eigen::Vector2d& high, double cell, double texel, World* world) const {
    const Eigen::Vector2d size = high - low;
    if (size.minCoeff() < 0.01) return;
    Patch p;
    p.columns = std::max(1, static_cast<int>(std::lround(size.x() / cell)));
    p.rows = std::max(1, static_cast<int>(std::lround(size.y() / cell)));
    p.width = static_cast<float>(size.x());
    p.height = static_cast<float>(size.y());
    p.material = Material::kGravel;
    p.texel = static_cast<float>(texel);
    p.seed = p.object = seed_;
    for (int r = 0; r <= p.rows; ++r)
      for (int c = 0; c <= p.columns; ++c) {
        const Eigen::Vector2d q(low.x() + size.x() * c / p.columns, low.y() + size.y() * r / p.rows);
        p.vertices.emplace_back(static_cast<float>(q.x()), static_cast<float>(q.y()), static_cast<float>(height(q)));
      }
    world->patches.push_back(p);
  }

 private:
  struct Mound {
    Eigen::Vector2d center;
    double radius, height;
  };

  double openness(const Eigen::Vector2d& p) const {  // 0 on the lane and at the start, 1 away from them
    double d = (p - free_.start).norm() - free_.start_radius;
    for (std::size_t i = 0; i < free_.lane.size(); i += 4)
      d = std::min(d, (p - free_.lane[i]).norm() - free_.lane_half_width);
    const double x = std::clamp(d / 0.6, 0.0, 1.0);
    return x * x * (3 - 2 * x);
  }

  const FreeSpace& free_;
  const double relief_;
  const std::uint32_t seed_;
  std::vector<Mound> mounds_;
};

void addSlab(const Terrain& terrain, const FreeSpace& free, double texel, Rng* rng, World* world) {
  Cuboid c;
  const bool beam = rng->chance(0.4);
  c.size = beam ? Eigen::Vector3d(rng->uniform(0.8, 1.5), 0.12, 0.12)
                : Eigen::Vector3d(rng->uniform(0.4, 0.9), rng->uniform(0.3, 0.7), rng->uniform(0.06, 0.12));
  c.material = beam ? Material::kWood : Material::kConcrete;
  c.printed = false;
  c.seed = rng->next();
  const Eigen::Vector2d p(rng->uniform(-2.2, 2.2), rng->uniform(-2.2, 2.2));
  const double tilt = rng->uniform(0.1, 0.5), yaw = rng->uniform(-M_PI, M_PI);
  if (!free.isFree(p, 0.5 * std::hypot(c.size.x(), c.size.y()))) return;
  c.T_world_base = yawPose(yaw, {p.x(), p.y(), terrain.height(p) + 0.4 * c.size.x() * std::sin(tilt)}) *
                   Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitY());
  addCuboid(c, texel, world);
}

}  // namespace

void addRubble(const WorldConfig& config, const FreeSpace& free, Rng* rng, World* world) {
  const Terrain terrain(config, free, rng);
  // The height field: a fine centre and coarse surroundings, as tiles so that texture resolution can differ.
  const double half = 0.5 * config.floor_size, inner = std::min(half, 4.2);
  const double edges[4] = {-half, -inner, inner, half};  // tiles of one row or column share their vertices: no cracks
  for (int r = 0; r < 3; ++r)
    for (int k = 0; k < 3; ++k)
      terrain.addTile({edges[k], edges[r]}, {edges[k + 1], edges[r + 1]}, 0.035,
                      r == 1 && k == 1 ? config.texel : 3 * config.texel, world);

  for (int i = 0; i < config.rocks; ++i) {
    const double r = 0.07 + 0.33 * std::pow(rng->uniform(), 2.5);
    const Eigen::Vector2d p(rng->uniform(-2.9, 2.9), rng->uniform(-2.9, 2.9));
    if (!free.isFree(p, 1.25 * r)) continue;
    addRock({p.x(), p.y(), terrain.height(p) + 0.25 * r}, r, config.texel, rng, world);
  }
  for (int i = 0; i < 9; ++i) addSlab(terrain, free, config.texel, rng, world);
}

}  // namespace air_ground_sim
