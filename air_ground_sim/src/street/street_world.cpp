#include <algorithm>
#include <cmath>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "air_ground_sim/noise.h"
#include "air_ground_sim/street/street.h"
#include "air_ground_sim/street/street_paint.h"

namespace air_ground_sim {
namespace {

using air_ground_common::Pose;
using cv::Vec3f;
using Eigen::Vector3d;

using Picture = std::function<cv::Mat(const Patch&)>;  // row 0 at the top

// Adds surfaces in the frame of a building, a car, a tree.
class Builder {
 public:
  Builder(World* world, const Pose& T_world_frame, std::uint64_t seed, double coarse)
      : world_(*world), T_(T_world_frame), seed_(seed), coarse_(coarse) {}

  Patch* rectangle(const Vector3d& origin, const Vector3d& u, const Vector3d& v, double texel, Picture picture) {
    return quad(origin, origin + u, origin + v, origin + u + v, texel, std::move(picture));
  }

  Patch* quad(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d, double texel,
              Picture picture) {
    Patch p;
    for (const Vector3d& x : {a, b, c, d}) p.vertices.push_back((T_ * x).cast<float>());
    p.width = static_cast<float>(std::max((b - a).norm(), (d - c).norm()));
    p.height = static_cast<float>(std::max((c - a).norm(), (d - b).norm()));
    return add(std::move(p), texel, std::move(picture));
  }

  Patch* add(Patch p, double texel, Picture picture) {
    p.texel = static_cast<float>(texel);
    p.seed = p.object = mix(seed_, ++count_);
    p.light_step = 6;
    p.painter = [picture = std::move(picture)](const Patch& patch) {
      cv::Mat image = picture(patch);
      cv::flip(image, image, 0);
      return image;
    };
    world_.patches.push_back(std::move(p));
    return &world_.patches.back();
  }

  Picture plain(const Vec3f& color) const {
    return [color](const Patch& p) { return paintPlain(color, p.width, p.height, p.texel, p.seed); };
  }

  // Front (-y), left (-x), right (+x), back, top, bottom; `front` and `side` may carry pictures.
  void box(const Vector3d& lo, const Vector3d& hi, const Vec3f& color, double texel, const Picture& front = nullptr,
           const Picture& side = nullptr, bool back = false) {
    const Vector3d e = hi - lo, x(e.x(), 0, 0), y(0, e.y(), 0), z(0, 0, e.z());
    const double t = front ? texel : coarse_;
    rectangle(lo, x, z, t, front ? front : plain(color));
    rectangle(lo + y, -y, z, side ? texel : coarse_, side ? side : plain(color));
    rectangle(lo + x, y, z, side ? texel : coarse_, side ? side : plain(color));
    if (back) rectangle(lo + x + y, -x, z, t, front ? front : plain(color));
    rectangle(lo + z, x, y, coarse_, plain(color * 1.05f));
    rectangle(lo + y, x, -y, coarse_, plain(color * 0.9f));
  }

 private:
  World& world_;
  Pose T_;
  std::uint64_t seed_, count_ = 0;
  double coarse_;
};

double recessOf(OpeningKind kind) {
  return kind == OpeningKind::kWindow ? 0.16 : kind == OpeningKind::kDoor ? 0.28 : 0.2;
}

// The wall with its openings cut out: one picture over a grid whose lines run along the openings' edges.
Patch wallWithHoles(const Building& b) {
  std::vector<float> xs = {0, 1}, zs = {0, 1};
  for (const auto& o : b.openings) {
    for (const double x : {o.x, o.x + o.width}) xs.push_back(static_cast<float>(x / b.width));
    for (const double z : {o.z, o.z + o.height}) zs.push_back(static_cast<float>(z / b.eaves));
  }
  for (auto* v : {&xs, &zs}) {
    std::sort(v->begin(), v->end());
    v->erase(std::unique(v->begin(), v->end(), [](float a, float b) { return b - a < 1e-5f; }), v->end());
  }
  Patch p;
  p.columns = static_cast<int>(xs.size()) - 1;
  p.rows = static_cast<int>(zs.size()) - 1;
  p.width = static_cast<float>(b.width);
  p.height = static_cast<float>(b.eaves);
  for (const float z : zs)
    for (const float x : xs) p.vertices.push_back(b.point(x * b.width, 0, z * b.eaves).cast<float>());
  for (int r = 0; r < p.rows; ++r)
    for (int c = 0; c < p.columns; ++c) {
      const double x = 0.5 * (xs[c] + xs[c + 1]) * b.width, z = 0.5 * (zs[r] + zs[r + 1]) * b.eaves;
      p.holes.push_back(std::any_of(b.openings.begin(), b.openings.end(), [&](const Opening& o) {
        return x > o.x && x < o.x + o.width && z > o.z && z < o.z + o.height;
      }));
    }
  p.column_at = std::move(xs);
  p.row_at = std::move(zs);
  return p;
}

void addRoof(const Building& b, const Vec3f& wall, double coarse, Builder* add) {
  const double w = b.width, d = b.depth, e = b.eaves, over = 0.25;
  const Picture tiles = [&b](const Patch& p) { return paintRoof(b, p.width, p.height, p.texel); };
  const double fine = 0.6 * coarse;
  if (b.roof == RoofKind::kFlat) {
    add->rectangle({0, 0, e}, {w, 0, 0}, {0, d, 0}, coarse, tiles);
    return;
  }
  const double slope = b.roof_rise / (0.5 * d), low = e - over * slope, ridge = e + b.roof_rise, middle = 0.5 * d;
  const double inset = b.hipInset();
  add->quad({0, -over, low}, {w, -over, low}, {inset, middle, ridge}, {w - inset, middle, ridge}, fine, tiles);
  add->quad({w, d + over, low}, {0, d + over, low}, {w - inset, middle, ridge}, {inset, middle, ridge}, coarse, tiles);
  const Picture gable = b.roof == RoofKind::kHip ? tiles : add->plain(wall);
  add->quad({0, d, e}, {0, 0, e}, {inset, middle, ridge}, {inset, middle, ridge}, fine, gable);
  add->quad({w, 0, e}, {w, d, e}, {w - inset, middle, ridge}, {w - inset, middle, ridge}, fine, gable);
}

void addWindows(const Building& b, double texel, double coarse, Season season, Builder* builder) {
  Builder& add = *builder;
  const Vec3f wall = wallColor(b), trim = trimColor(b);
  for (std::size_t i = 0; i < b.openings.size(); ++i) {
    const Opening& o = b.openings[i];
    const double r = recessOf(o.kind), x0 = o.x, x1 = o.x + o.width, z0 = o.z, z1 = o.z + o.height;
    const int index = static_cast<int>(i);
    add.rectangle({x0, r, z0}, {o.width, 0, 0}, {0, 0, o.height}, texel,
                  [&b, index, season](const Patch& p) { return paintPane(b, index, season, p.texel); });
    add.rectangle({x0, 0, z0}, {0, r, 0}, {0, 0, o.height}, coarse, add.plain(wall * 0.9f));
    add.rectangle({x1, r, z0}, {0, -r, 0}, {0, 0, o.height}, coarse, add.plain(wall * 0.9f));
    add.rectangle({x0, 0, z0}, {o.width, 0, 0}, {0, r, 0}, coarse, add.plain(trim));
    add.rectangle({x0, r, z1}, {o.width, 0, 0}, {0, -r, 0}, coarse, add.plain(wall * 0.85f));
    if (o.kind == OpeningKind::kWindow) add.box({x0 - 0.1, -0.1, z0 - 0.07}, {x1 + 0.1, 0, z0}, trim, coarse);
  }
}

void addBalconies(const Building& b, double texel, double coarse, Season season, Builder* builder) {
  Builder& add = *builder;
  const Vec3f trim = trimColor(b);
  for (std::size_t i = 0; i < b.balconies.size(); ++i) {
    const Opening& o = b.balconies[i];
    const int index = static_cast<int>(i);
    const Picture railing = [&b, index, season](const Patch& p) {
      return paintRailing(b, index, season, p.width, p.height, p.texel);
    };
    add.box({o.x, -1.05, o.z - 0.14}, {o.x + o.width, 0, o.z}, trim, coarse);
    add.box({o.x, -1.05, o.z}, {o.x + o.width, -1.0, o.z + 1.0}, trim, texel, railing, nullptr, true);
    add.box({o.x, -1.0, o.z}, {o.x + 0.05, 0, o.z + 1.0}, trim, texel, nullptr, railing);
    add.box({o.x + o.width - 0.05, -1.0, o.z}, {o.x + o.width, 0, o.z + 1.0}, trim, texel, nullptr, railing);
  }
}

// Signs over the windows, signs that stand out, awnings.
void addShopFronts(const Building& b, double texel, Season season, Builder* builder) {
  Builder& add = *builder;
  const Vec3f trim = trimColor(b);
  for (const auto& o : b.openings) {
    if (o.kind != OpeningKind::kShopWindow) continue;
    const int shop = o.column;
    const double z = b.street_level + b.shop_height - 0.82;
    add.box({o.x, -0.12, z}, {std::min(b.width - 0.1, o.x + o.width), 0, z + 0.5}, trim, texel,
            [&b, shop](const Patch& p) { return paintSign(b, shop, false, p.width, p.height, p.texel); });
    Rng own(mix(mix(b.seed, 8), shop));
    if (own.chance(0.7)) {
      const double x = own.chance(0.5) ? o.x - 0.25 : std::min(b.width - 0.2, o.x + o.width + 0.1),
                   zb = b.street_level + b.shop_height + own.uniform(-0.3, 0.4);
      add.box({x, -0.85, zb}, {x + 0.1, -0.1, zb + own.uniform(0.6, 0.9)}, trim, texel, nullptr,
              [&b, shop](const Patch& p) { return paintSign(b, shop, true, p.width, p.height, p.texel); });
    }
    const double out = own.uniform();
    if (out < (season == Season::kPanoramas ? 0.5 : 0.25)) {
      const double top = z - 0.02, reach = own.uniform(0.9, 1.3);
      add.rectangle({o.x, -reach, top - 0.45}, {o.width, 0, 0}, {0, reach, 0.45}, texel,
                    [&b, shop](const Patch& p) { return paintAwning(b, shop, p.width, p.height, p.texel); });
    }
  }
}

void addBuilding(const Building& b, const StreetConfig& c, Season season, World* world) {
  const double texel = c.texel, coarse = 4 * texel;
  Builder add(world, b.T_world_front, b.seed, coarse);
  const Vec3f wall = wallColor(b), trim = trimColor(b);
  const double w = b.width, d = b.depth, e = b.eaves;
  if (c.facade_images.empty()) {
    add.add(wallWithHoles(b), texel, [&b, season](const Patch& p) { return paintFacade(b, season, p.texel); });
  } else {
    const std::string file = b.photograph;
    add.rectangle({0, 0, 0}, {w, 0, 0}, {0, 0, e}, texel, [file](const Patch& p) {
      cv::Mat photo = cv::imread(file, cv::IMREAD_COLOR), rgb;
      if (photo.empty()) throw std::runtime_error("cannot read the facade photograph '" + file + "'");
      cv::resize(photo, photo,
                 {std::max(4, static_cast<int>(p.width / p.texel)), std::max(4, static_cast<int>(p.height / p.texel))},
                 0, 0, cv::INTER_AREA);
      cv::cvtColor(photo, rgb, cv::COLOR_BGR2RGB);
      return rgb;
    });
  }
  add.rectangle({0, d, 0}, {0, -d, 0}, {0, 0, e}, 2 * coarse, add.plain(wall * 0.95f));
  add.rectangle({w, 0, 0}, {0, d, 0}, {0, 0, e}, 2 * coarse, add.plain(wall * 0.95f));
  add.rectangle({w, d, 0}, {-w, 0, 0}, {0, 0, e}, 4 * coarse, add.plain(wall * 0.95f));
  addRoof(b, wall, coarse, &add);
  add.box({0, -0.22, e - 0.26}, {w, 0, e - 0.04}, trim, coarse);  // cornice
  Rng rng(mix(b.seed, 7));
  for (int i = 0; i < 2; ++i) {
    const double x = rng.uniform(0.15, 0.8) * w, y = rng.uniform(0.35, 0.6) * d;
    add.box({x, y, e}, {x + 0.7, y + 0.55, e + b.roof_rise + rng.uniform(0.6, 1.4)}, {126, 84, 70}, coarse, nullptr,
            nullptr, true);
  }
  if (!c.facade_images.empty()) return;
  addWindows(b, texel, coarse, season, &add);
  addBalconies(b, texel, coarse, season, &add);
  if (b.shop) addShopFronts(b, texel, season, &add);
}

Pose standPose(const Stand& s) { return air_ground_common::yawPose(s.yaw, s.position); }

Picture thing(Thing kind, std::uint64_t seed, Season season) {
  return [kind, seed, season](const Patch& p) { return paintThing(kind, seed, season, p.width, p.height, p.texel); };
}

void addCar(const Stand& s, Season season, World* world) {
  Rng rng(s.seed);
  Builder add(world, standPose(s), s.seed, 0.05);
  const double length = rng.uniform(3.9, 4.7), width = rng.uniform(1.68, 1.8), waist = rng.uniform(0.82, 1.0),
               top = waist + rng.uniform(0.48, 0.75);
  const Picture body = thing(Thing::kCarBody, s.seed, season), glass = thing(Thing::kCarGlass, s.seed, season);
  const Vec3f roof = paintThing(Thing::kCarGlass, s.seed, season, 0.04, 0.04, 0.01).at<cv::Vec3b>(0, 0);
  add.box({-0.5 * length, -0.5 * width, 0.18}, {0.5 * length, 0.5 * width, waist}, roof, 0.015, body, body, true);
  add.box({-0.32 * length, -0.44 * width, waist}, {0.2 * length, 0.44 * width, top}, roof, 0.015, glass, glass, true);
}

void addPerson(const Stand& s, Season season, World* world) {
  Rng rng(s.seed);
  Builder add(world, standPose(s), s.seed, 0.03);
  const double k = rng.uniform(0.92, 1.06);
  const auto part = [&](double wx, double wy, double z0, double z1, Thing kind, int index) {
    const Picture picture = thing(kind, mix(s.seed, index), season);
    add.box({-0.5 * wx, -0.5 * wy, k * z0}, {0.5 * wx, 0.5 * wy, k * z1}, {90, 80, 76}, 0.015, picture, picture, true);
  };
  part(0.32, 0.24, 0.0, 0.85, Thing::kClothes, 1);
  part(0.46, 0.27, 0.85, 1.45, Thing::kClothes, 2);
  part(0.18, 0.2, 1.49, 1.75, Thing::kSkin, 3);
}

void addTree(const Stand& s, Season season, World* world) {
  Rng rng(s.seed);
  Builder add(world, standPose(s), s.seed, 0.03);
  const double height = rng.uniform(3.2, 3.9),
               radius = rng.uniform(1.0, 1.35) * (season == Season::kPanoramas ? 1.0 : 0.8);
  const Picture bark = thing(Thing::kBark, s.seed, season);
  add.box({-0.12, -0.12, 0}, {0.12, 0.12, height}, {84, 72, 60}, 0.02, bark, bark, true);
  Patch p;
  p.columns = 28;
  p.rows = 16;
  p.width = static_cast<float>(2 * M_PI * radius);
  p.height = static_cast<float>(M_PI * radius * 1.2);
  const Pose T = standPose(s);
  for (int r = 0; r <= p.rows; ++r)
    for (int c = 0; c <= p.columns; ++c) {
      const double azimuth = 2 * M_PI * (c % p.columns) / p.columns,
                   elevation = M_PI * (static_cast<double>(r) / p.rows - 0.5);
      const Vector3d n(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                       std::sin(elevation));
      const double bump =
          1 + 0.28 * fractalNoise(static_cast<float>(2.5 * n.x()), static_cast<float>(2.5 * n.y()),
                                  static_cast<float>(2.5 * n.z()), static_cast<std::uint32_t>(s.seed), 3);
      p.vertices.push_back(
          (T * Vector3d(radius * bump * n.x(), radius * bump * n.y(), height + radius * (0.7 + 1.2 * bump * n.z())))
              .cast<float>());
    }
  add.add(std::move(p), 0.02, thing(Thing::kLeaves, s.seed, season));
}

void addGround(const std::shared_ptr<const Street>& street, Season season, World* world) {
  const StreetConfig& c = street->config;
  const double tile = 8;
  Eigen::Vector2d low(1e9, 1e9), high(-1e9, -1e9);
  for (const auto& line : c.lines)
    for (const auto& p : {line.from, line.to}) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
  Builder add(world, Pose::Identity(), mix(street->seed, 9), 0.2);
  const auto index = [&](double v) { return static_cast<int>(std::floor(v / tile)); };
  for (int iy = index(low.y() - 60); iy <= index(high.y() + 60); ++iy)
    for (int ix = index(low.x() - 60); ix <= index(high.x() + 60); ++ix) {
      const Eigen::Vector2d corner(ix * tile, iy * tile);
      const double distance = street->distanceToLine(corner + Eigen::Vector2d::Constant(0.5 * tile));
      if (distance > 60) continue;
      Patch p;
      p.columns = p.rows = 4;
      p.width = p.height = static_cast<float>(tile);
      for (int r = 0; r <= 4; ++r)
        for (int k = 0; k <= 4; ++k) {
          const Eigen::Vector2d at = corner + tile / 4 * Eigen::Vector2d(k, r);
          p.vertices.emplace_back(static_cast<float>(at.x()), static_cast<float>(at.y()),
                                  static_cast<float>(street->ground(at)));
        }
      add.add(std::move(p), distance < 0.5 * c.width + 6 ? 2 * c.texel : 0.2,
              [street, season](const Patch& patch) { return paintGround(*street, patch, season); });
    }
}

}  // namespace

World buildStreetWorld(const Street& plan, Season season) {
  World world;
  const auto street = std::make_shared<const Street>(plan);
  world.keep_alive = street;
  addGround(street, season, &world);
  for (const auto& b : street->buildings) addBuilding(b, street->config, season, &world);
  for (const auto& s : street->trees) addTree(s, season, &world);
  const int day = season == Season::kFlight ? 1 : 0;
  for (const auto& s : street->cars[day]) addCar(s, season, &world);
  for (const auto& s : street->people[day]) addPerson(s, season, &world);

  // Summer at noon, and a hazy autumn afternoon with the sun elsewhere.
  Rng rng(mix(plan.seed, 45));
  const double summer = rng.uniform(0, 2 * M_PI), autumn = summer + (rng.chance(0.5) ? 1 : -1) * rng.uniform(1.6, 2.8);
  const bool panoramas = season == Season::kPanoramas;
  const double azimuth = panoramas ? summer : autumn, elevation = panoramas ? 0.95 : 0.55;
  world.sun = Eigen::Vector3d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                              std::sin(elevation))
                  .cast<float>();
  world.ambient = panoramas ? 0.5f : 0.68f;
  world.tint = panoramas ? Eigen::Vector3f(1.06f, 1.0f, 0.9f) : Eigen::Vector3f(0.92f, 0.97f, 1.08f);
  world.sun_reach = 300;
  world.ambient_reach = 25;
  world.sky = 0.85f;
  world.sky_map = paintSky(season, plan.seed);
  return world;
}

}  // namespace air_ground_sim
