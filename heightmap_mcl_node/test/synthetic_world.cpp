#include "synthetic_world.h"

#include <algorithm>
#include <cmath>
#include <random>

namespace heightmap_mcl::synthetic {
namespace {

using air_ground_common::MeshScene;
using air_ground_common::Pose;
using air_ground_common::TriangleMesh;
using air_ground_common::wrapAngle;
using air_ground_common::yawPose;
using Random = std::mt19937_64;

double uniform(Random& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}
double normal(Random& random, double sigma) { return sigma * std::normal_distribution<double>(0, 1)(random); }

/// Walls of 2.5 m about the origin, one with a door of 2 m, furniture along them and in the middle, lamp, ceiling.
TriangleMesh makeRoom(const Options& options, Random& random) {
  TriangleMesh mesh;
  addBox(mesh, 0, 0, -0.1, 0, {14, 14, 0.1});
  if (options.ceiling) addBox(mesh, 0, 0, 2.5, 0, {14, 14, 0.1});
  const double w = uniform(random, 4.4, 6.2), d = uniform(random, 3.8, 5.2), t = 0.12;
  const int door_wall = static_cast<int>(uniform(random, 0, 4));
  const double door = uniform(random, -0.3, 0.3);
  for (int k = 0; k < 4; ++k) {
    const bool along_x = k < 2;
    const double length = (along_x ? w : d) + t, side = k % 2 ? 1 : -1;
    const auto piece = [&](double from, double to, double bottom, double height) {
      const double middle = 0.5 * (from + to), offset = side * 0.5 * ((along_x ? d : w) + t);
      addBox(mesh, along_x ? middle : offset, along_x ? offset : middle, bottom, along_x ? 0 : M_PI / 2,
             {to - from, t, height});
    };
    if (k != door_wall) {
      piece(-length / 2, length / 2, 0, 2.5);
      continue;
    }
    const double at = door * length;
    piece(-length / 2, at - 0.45, 0, 2.5);
    piece(at + 0.45, length / 2, 0, 2.5);
    piece(at - 0.45, at + 0.45, 2.0, 0.5);
  }
  // Cupboards, shelves and sideboards with their backs to the walls.
  const int along = 4 + static_cast<int>(uniform(random, 0, 3));
  for (int i = 0; i < along; ++i) {
    const int k = i % 4;
    const double depth = uniform(random, 0.3, 0.6), width = uniform(random, 0.5, 1.5);
    const double height = uniform(random, 0, 1) < 0.4 ? uniform(random, 1.5, 2.1) : uniform(random, 0.4, 1.0);
    const double free = 0.5 * ((k < 2 ? w : d) - width) - 0.1, at = uniform(random, -free, free);
    const double off = (k % 2 ? 1 : -1) * (0.5 * (k < 2 ? d : w) - 0.5 * depth);
    addBox(mesh, k < 2 ? at : off, k < 2 ? off : at, 0, k < 2 ? 0 : M_PI / 2, {width, depth, height});
  }
  // Tables on legs, with chairs.
  const int tables = 1 + static_cast<int>(uniform(random, 0, 2.5));
  for (int i = 0; i < tables; ++i) {
    const double x = uniform(random, -0.3, 0.3) * w, y = uniform(random, -0.3, 0.3) * d, yaw = uniform(random, 0, M_PI);
    const Eigen::Vector2d size(uniform(random, 1.0, 1.6), uniform(random, 0.6, 0.9));
    const Pose T = yawPose(yaw, {x, y, 0});
    addBox(mesh, x, y, 0.70, yaw, {size.x(), size.y(), 0.04});
    for (int leg = 0; leg < 4; ++leg) {
      const Eigen::Vector3d p =
          T * Eigen::Vector3d((leg & 1 ? 0.45 : -0.45) * size.x(), (leg & 2 ? 0.45 : -0.45) * size.y(), 0);
      addBox(mesh, p.x(), p.y(), 0, yaw, {0.06, 0.06, 0.7});
    }
    const Eigen::Vector3d chair = T * Eigen::Vector3d(uniform(random, -0.4, 0.4), 0.5 * size.y() + 0.35, 0);
    addBox(mesh, chair.x(), chair.y(), 0, yaw, {0.42, 0.42, 0.45});
    if (i == 0 && options.ceiling) addBox(mesh, x, y, 2.1, yaw, {0.5, 0.5, 0.2});  // the lamp over the first
  }
  for (int i = 0; i < 5; ++i) {
    addBox(mesh, uniform(random, -0.4, 0.4) * w, uniform(random, -0.4, 0.4) * d, 0, uniform(random, 0, M_PI),
           {uniform(random, 0.2, 0.5), uniform(random, 0.2, 0.5), uniform(random, 0.1, 0.5)});
  }
  return mesh;
}

TriangleMesh makeMesh(const Options& options, Random& random) {
  const World world = options.world;
  if (world == World::kRoom) return makeRoom(options, random);
  TriangleMesh mesh;
  addBox(mesh, 0, 0, -0.1, 0, {12, 12, 0.1});
  if (world == World::kBoxes || world == World::kFewBoxes) {
    struct Placed {
      double x, y, radius;
    };
    std::vector<Placed> placed;
    const bool few = world == World::kFewBoxes;
    const int boxes = few ? 3 + static_cast<int>(uniform(random, 0, 4)) : 11 + static_cast<int>(uniform(random, 0, 5));
    for (int attempt = 0; attempt < 400 && static_cast<int>(placed.size()) < boxes; ++attempt) {
      Eigen::Vector3d size(uniform(random, 0.25, 0.8), uniform(random, 0.25, 0.8),
                           uniform(random, 0, 1) < 0.6 ? uniform(random, 0.15, 0.6) : uniform(random, 0.6, 1.4));
      if (few) size = uniform(random, 0, 1) < 0.5 ? Eigen::Vector3d(0.6, 0.4, 0.4) : Eigen::Vector3d(0.4, 0.4, 0.3);
      const double x = uniform(random, -2.2, 2.2), y = uniform(random, -2.7, 2.7);
      const double radius = 0.5 * size.head<2>().norm();
      if (std::any_of(placed.begin(), placed.end(),
                      [&](const Placed& p) { return std::hypot(x - p.x, y - p.y) < 0.8 * (radius + p.radius); })) {
        continue;
      }
      placed.push_back({x, y, radius});
      const double yaw = uniform(random, 0, M_PI);
      addBox(mesh, x, y, 0, yaw, size);
      if (!few && uniform(random, 0, 1) < 0.3) {
        addBox(mesh, x + 0.05, y, size.z(), yaw + 0.4, {0.6 * size.x(), 0.6 * size.y(), uniform(random, 0.1, 0.3)});
      }
    }
    for (int i = 0; i < 25 && !few; ++i) {
      addBox(mesh, uniform(random, -2.4, 2.4), uniform(random, -2.9, 2.9), 0, uniform(random, 0, M_PI),
             {uniform(random, 0.08, 0.5), uniform(random, 0.05, 0.15), uniform(random, 0.03, 0.12)});
    }
  } else if (world == World::kIdenticalBoxes) {
    for (int i = -3; i <= 3; ++i) {
      for (int j = -3; j <= 3; ++j) addBox(mesh, 1.0 * i, 1.0 * j, 0, 0, {0.4, 0.4, 0.4});
    }
  } else if (world == World::kRidge) {
    addBox(mesh, 0, 0, 0, 0, {0.5, 12, 0.4});
    addBox(mesh, 1.3, 0, 0, 0, {0.3, 12, 0.25});
  }
  return mesh;
}

/// Depth camera at `T_world_base`, looking along +x, tilted down by `tilt`; points in the world frame.
void seeFromGround(const MeshScene& scene, const Pose& T_world_base, double tilt, double noise, Random& random,
                   std::vector<Eigen::Vector3f>& points) {
  const Eigen::Vector3d origin = T_world_base * Eigen::Vector3d(0, 0, 0.5);
  const Eigen::Matrix3d R =
      T_world_base.rotation() * Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitY()).toRotationMatrix();
  const double half_width = std::tan(0.5), half_height = std::tan(0.38);  // 57 x 44 degrees
  constexpr int kColumns = 160, kRows = 120;
  for (int v = 0; v < kRows; ++v) {
    for (int u = 0; u < kColumns; ++u) {
      const Eigen::Vector3d d(1, half_width * (1 - 2 * (u + 0.5) / kColumns),
                              half_height * (1 - 2 * (v + 0.5) / kRows));
      const double length = d.norm();
      const auto hit = scene.cast(origin.cast<float>(), (R * d / length).cast<float>(), 6.f);
      if (!hit) continue;
      double depth = hit->distance / length;
      if (depth < 0.5 || depth > 4.5) continue;
      // Noise of a Kinect (Nguyen 2012).
      depth += normal(random, noise * (0.0012 + 0.0019 * (depth - 0.4) * (depth - 0.4)));
      points.push_back((origin + R * d * depth).cast<float>());
    }
  }
}

/// Camera looking down; points in the body frame (x forward, z up), noisy and with holes.
std::vector<Eigen::Vector3d> seeFromAir(const MeshScene& scene, const Pose& T_world_base, const Options& options,
                                        Random& random) {
  constexpr int kColumns = 260, kRows = 170;
  const double half_width = 0.78, half_height = 0.50;
  std::vector<float> depth(kColumns * kRows, -1.f);
  const auto directionOf = [&](int u, int v) {
    // Image x points to -y of the body, image y to -x.
    return Eigen::Vector3d(-half_height * (2 * (v + 0.5) / kRows - 1), -half_width * (2 * (u + 0.5) / kColumns - 1),
                           -1);
  };
  for (int v = 0; v < kRows; ++v) {
    for (int u = 0; u < kColumns; ++u) {
      const Eigen::Vector3d d = directionOf(u, v);
      const double length = d.norm();
      const auto hit = scene.cast(T_world_base.translation().cast<float>(),
                                  (T_world_base.rotation() * d / length).cast<float>(), 8.f);
      if (hit) depth[v * kColumns + u] = static_cast<float>(hit->distance / length);
    }
  }
  struct Wave {
    double a, b, phase, amplitude;
  };
  std::vector<Wave> waves;
  for (int i = 0; i < 6; ++i) {
    waves.push_back({uniform(random, -0.06, 0.06), uniform(random, -0.06, 0.06), uniform(random, 0, 2 * M_PI),
                     options.smooth_noise * std::sqrt(2.0 / 6)});
  }
  struct Blob {
    double u, v, radius;
  };
  std::vector<Blob> blobs;
  double covered = 0;
  while (covered < options.hole_share * kColumns * kRows) {
    blobs.push_back({uniform(random, 0, kColumns), uniform(random, 0, kRows), uniform(random, 3, 16)});
    covered += M_PI * blobs.back().radius * blobs.back().radius;
  }
  std::vector<Eigen::Vector3d> points;
  for (int v = 1; v + 1 < kRows; ++v) {
    for (int u = 1; u + 1 < kColumns; ++u) {
      double z = depth[v * kColumns + u];
      if (z < 0) continue;
      if (std::any_of(blobs.begin(), blobs.end(),
                      [&](const Blob& b) { return std::hypot(u - b.u, v - b.v) < b.radius; }))
        continue;
      // Regularised depth maps smear their edges.
      const double neighbour = depth[(v + static_cast<int>(uniform(random, -1, 2))) * kColumns + u +
                                     static_cast<int>(uniform(random, -1, 2))];
      if (neighbour > 0 && std::abs(neighbour - z) > 0.1) z += uniform(random, 0, 1) * (neighbour - z);
      for (const Wave& w : waves) z += w.amplitude * std::sin(w.a * u + w.b * v + w.phase);
      z += normal(random, options.cloud_noise);
      points.push_back(directionOf(u, v) * z);
    }
  }
  return points;
}

}  // namespace

void addBox(TriangleMesh& mesh, double x, double y, double bottom, double yaw, const Eigen::Vector3d& size) {
  const int base = static_cast<int>(mesh.vertices.size());
  const Pose T = yawPose(yaw, {x, y, bottom});
  for (int k = 0; k < 8; ++k) {
    const Eigen::Vector3d corner((k & 1 ? 0.5 : -0.5) * size.x(), (k & 2 ? 0.5 : -0.5) * size.y(),
                                 k & 4 ? size.z() : 0.0);
    mesh.vertices.push_back((T * corner).cast<float>());
  }
  for (const auto& t : {Eigen::Vector3i(0, 2, 1),
                        {1, 2, 3},
                        {4, 5, 6},
                        {5, 7, 6},
                        {0, 1, 4},
                        {1, 5, 4},
                        {2, 6, 3},
                        {3, 6, 7},
                        {0, 4, 2},
                        {2, 4, 6},
                        {1, 3, 5},
                        {3, 7, 5}}) {
    mesh.triangles.push_back(t + Eigen::Vector3i::Constant(base));
  }
}

Run makeRun(const Options& options) {
  Random random(options.seed * 7919 + 17);
  const bool room = options.world == World::kRoom;
  Run run;
  run.mesh = makeMesh(options, random);
  const MeshScene scene(run.mesh);
  Random elsewhere(options.seed * 104729 + 5);
  const MeshScene aerial_scene(options.other_world ? makeMesh(options, elsewhere) : run.mesh);

  // The ground robot drives an arc around the scene and looks at points near its middle.
  // In a room it drives an arc within, looks along the walls and, now and then, up.
  const double radius = room ? uniform(random, 1.0, 1.4) : uniform(random, 2.9, 3.3),
               begin = uniform(random, 0, 2 * M_PI);
  const double turn = options.ground_path / radius * (uniform(random, 0, 1) < 0.5 ? 1 : -1);
  Pose T_world_groundmap;
  std::vector<Eigen::Vector3f> seen;
  constexpr int kGroundFrames = 40;
  for (int i = 0; i < kGroundFrames; ++i) {
    const double a = begin + turn * i / (kGroundFrames - 1);
    const Eigen::Vector3d position(0.9 * radius * std::cos(a), 1.1 * radius * std::sin(a), 0);
    const double inwards = std::atan2(-position.y(), -position.x());
    const double yaw = inwards + (room ? 1.2 * std::sin(0.9 * i) : 0.45 * std::sin(1.3 * i));
    const Pose T_world_base = yawPose(yaw, position);
    if (i == 0) T_world_groundmap = T_world_base;
    run.T_ground_robot = T_world_groundmap.inverse() * T_world_base;
    seeFromGround(scene, T_world_base, room ? (i % 4 == 3 ? -0.35 : 0.1) : 0.25, options.ground_noise, random, seen);
  }
  const Pose T_groundmap_world = T_world_groundmap.inverse();
  for (const auto& p : seen) run.ground.push_back((T_groundmap_world * p.cast<double>()).cast<float>());

  // The MAV flies a loop; its map starts at its first pose.
  const double phase = uniform(random, 0, 2 * M_PI), heading0 = uniform(random, -M_PI, M_PI);
  const double rx = uniform(random, 0.6, 1.1), ry = uniform(random, 0.8, 1.4),
               altitude = room ? uniform(random, 1.5, 1.75) : uniform(random, 2.2, 2.9);
  const double scale = 1 + options.scale_error * (uniform(random, 0, 1) < 0.5 ? 1 : -1);
  const double drift_heading = uniform(random, 0, 2 * M_PI), yaw_drift_sign = uniform(random, 0, 1) < 0.5 ? 1 : -1;
  const double tilt_axis = options.tilt > 0 ? uniform(random, 0, 2 * M_PI) : 0;
  const Pose tilt(Eigen::AngleAxisd(options.tilt, Eigen::Vector3d(std::cos(tilt_axis), std::sin(tilt_axis), 0)));
  Pose T_world_mavmap;
  Eigen::Vector3d last = Eigen::Vector3d::Zero();
  double path = 0;
  for (int i = 0; i < options.aerial_clouds; ++i) {
    const double a = phase + 0.75 * i;
    const Eigen::Vector3d position(rx * std::cos(a), ry * std::sin(a), altitude + 0.3 * std::sin(0.7 * i));
    const Pose T_world_base = yawPose(heading0 + 0.25 * std::sin(0.9 * i), position);
    if (i == 0) {
      T_world_mavmap = T_world_base;
    } else {
      path += (position - last).norm();
    }
    last = position;
    // What the MAV believes: scaled, drifted.
    const Pose T_true = T_world_mavmap.inverse() * T_world_base;
    const Eigen::Vector3d drift =
        options.drift_per_metre * path * Eigen::Vector3d(std::cos(drift_heading), std::sin(drift_heading), 0.3);
    const double yaw_drift = yaw_drift_sign * options.yaw_drift_per_metre * path;
    Pose T_believed =
        yawPose(air_ground_common::yawOf(T_true.rotation()) + yaw_drift, scale * T_true.translation() + drift);

    AerialCloud cloud;
    cloud.reference = tilt * T_believed.translation();
    for (const auto& p : seeFromAir(aerial_scene, T_world_base, options, random))
      cloud.points.push_back((tilt * (T_believed * (scale * p))).cast<float>());
    run.aerial.push_back(std::move(cloud));
    run.T_ground_mav.push_back(T_groundmap_world * T_world_base * T_believed.inverse() * tilt.inverse());
  }
  return run;
}

std::vector<Eigen::Vector3f> drifted(std::vector<Eigen::Vector3f> ground) {
  Eigen::Vector2f centre = Eigen::Vector2f::Zero();
  for (const auto& p : ground) centre += p.head<2>() / static_cast<float>(ground.size());
  const Eigen::Rotation2Df turn(0.17f);
  for (std::size_t i = ground.size() / 2; i < ground.size(); ++i)
    ground[i].head<2>() = centre + turn * (ground[i].head<2>() - centre) + Eigen::Vector2f(0.35f, 0.35f);
  return ground;
}

AerialCloud OwnUnit::raw(const AerialCloud& cloud) const {
  AerialCloud out = cloud;
  const Eigen::Matrix3f S = (R_raw_level / unit).cast<float>();
  for (auto& p : out.points) p = S * p;
  out.reference = R_raw_level * cloud.reference / unit;
  return out;
}

Error errorOf(const Pose& estimate, const Pose& truth, const Eigen::Vector3d& reference) {
  const Eigen::Vector3d d = estimate * reference - truth * reference;
  return {
      d.head<2>().norm(),
      std::abs(wrapAngle(air_ground_common::yawOf(estimate.rotation()) - air_ground_common::yawOf(truth.rotation()))),
      std::abs(d.z())};
}

}  // namespace heightmap_mcl::synthetic
