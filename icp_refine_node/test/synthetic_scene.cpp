#include "synthetic_scene.h"

#include <cmath>

namespace icp_refine::synthetic {
namespace {

using air_ground_common::TriangleMesh;
using Rng = std::mt19937;

double uniform(Rng& rng, double a, double b) { return a + (b - a) * (rng() / 4294967296.0); }

double gauss(Rng& rng) {
  const double u = (rng() + 1.0) / 4294967297.0, v = rng() / 4294967296.0;
  return std::sqrt(-2 * std::log(u)) * std::cos(2 * M_PI * v);
}

void addBox(TriangleMesh& mesh, const Eigen::Vector3d& centre, const Eigen::Vector3d& size, double yaw) {
  const int first = static_cast<int>(mesh.vertices.size());
  const Eigen::Matrix3d R = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  for (int k = 0; k < 8; ++k) {
    const Eigen::Vector3d corner((k & 1) ? 0.5 : -0.5, (k & 2) ? 0.5 : -0.5, (k & 4) ? 0.5 : -0.5);
    mesh.vertices.push_back((centre + R * corner.cwiseProduct(size)).cast<float>());
  }
  static const int kFaces[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& f : kFaces) {
    mesh.triangles.emplace_back(first + f[0], first + f[1], first + f[2]);
    mesh.triangles.emplace_back(first + f[0], first + f[2], first + f[3]);
  }
}

TriangleMesh makeMesh(Rng& rng, const SceneSettings& s) {
  TriangleMesh mesh;
  mesh.vertices = {{-6, -6, 0}, {6, -6, 0}, {6, 6, 0}, {-6, 6, 0}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  if (s.world == World::kCorridor) {
    addBox(mesh, {0, 1.6, 0.6}, {12, 0.3, 1.2}, 0);
    addBox(mesh, {0, -1.6, 0.6}, {12, 0.3, 1.2}, 0);
  }
  if (s.world != World::kBoxes) return mesh;
  std::vector<Eigen::Vector3d> placed;
  for (int tries = 0; static_cast<int>(placed.size()) < s.boxes && tries < 1000; ++tries) {
    const Eigen::Vector3d p(uniform(rng, -2, 2), uniform(rng, -1.7, 1.7), 0);
    const Eigen::Vector3d size(uniform(rng, 0.3, 0.9), uniform(rng, 0.3, 0.7), uniform(rng, 0.15, 1.2));
    bool free = true;
    for (const auto& q : placed) free &= (p - q).norm() > 0.75;
    if (!free) continue;
    placed.push_back(p);
    addBox(mesh, {p.x(), p.y(), size.z() / 2}, size, uniform(rng, 0, M_PI));
  }
  return mesh;
}

// R_world_camera of an optical frame that looks along `forward`.
Eigen::Matrix3d lookAlong(const Eigen::Vector3d& forward) {
  Eigen::Matrix3d R;
  Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ());
  if (right.norm() < 1e-3) right = -Eigen::Vector3d::UnitY();
  R.col(2) = forward.normalized();
  R.col(0) = right.normalized();
  R.col(1) = R.col(2).cross(R.col(0));
  return R;
}

struct DepthImage {
  int width, height;
  double f;
  std::vector<double> z;       // 0 = none
  std::vector<double> cosine;  // of the angle of incidence
  Eigen::Vector3d ray(int u, int v) const { return {(u - (width - 1) / 2.0) / f, (v - (height - 1) / 2.0) / f, 1}; }
};

DepthImage render(const air_ground_common::MeshScene& scene, const Eigen::Matrix3d& R, const Eigen::Vector3d& t,
                  int width, int height, double f) {
  DepthImage out{width, height, f, std::vector<double>(width * height, 0), std::vector<double>(width * height, 0)};
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      const Eigen::Vector3d ray = out.ray(u, v);
      const Eigen::Vector3f direction = (R * ray).normalized().cast<float>();
      const auto hit = scene.cast(t.cast<float>(), direction, 20);
      if (!hit) continue;
      out.z[v * width + u] = hit->distance / ray.norm();
      out.cosine[v * width + u] = std::abs(hit->normal.dot(direction));
    }
  }
  return out;
}

// Smooth random field of unit variance: few random waves of about 0.3 m.
struct Bumps {
  explicit Bumps(Rng& rng) {
    for (auto& w : waves) w << 4.0 * gauss(rng), 4.0 * gauss(rng), 4.0 * gauss(rng), uniform(rng, 0, 2 * M_PI);
  }
  double operator()(const Eigen::Vector3d& p) const {
    double sum = 0;
    for (const auto& w : waves) sum += std::cos(w.head<3>().dot(p) * 2 + w[3]);
    return sum / std::sqrt(waves.size() / 2.0);
  }
  std::array<Eigen::Vector4d, 16> waves;
};

Cloud groundCloud(const air_ground_common::MeshScene& scene, const Pose& T_map_world, const SceneSettings& s,
                  Rng& rng) {
  // Half an ellipse around the boxes, 8 m or so.
  Cloud out;
  const double start = uniform(rng, 0, 2 * M_PI);
  const Eigen::Vector3d drift_direction = Eigen::Vector3d(gauss(rng), gauss(rng), 0.2 * gauss(rng)).normalized();
  constexpr int kPoses = 20;
  for (int k = 0; k < kPoses; ++k) {
    double a = start + 1.15 * M_PI * k / (kPoses - 1);
    Eigen::Vector3d position(3.2 * std::cos(a), 2.9 * std::sin(a), 0.5);
    Eigen::Vector3d forward(-position.x(), -position.y(), -0.18 * position.norm());
    if (s.world == World::kCorridor) {
      position = {-3 + 6.0 * k / (kPoses - 1), 0.1, 0.5};
      forward = {k % 2 ? 1.0 : -1.0, 0.6 * ((k / 2) % 2 ? 1.0 : -1.0), -0.35};
    }
    const Eigen::Matrix3d R = lookAlong(forward);
    const Eigen::Vector3d drift = s.ground_drift * 8.0 * k / kPoses * drift_direction;
    const DepthImage depth = render(scene, R, position, 160, 120, 131);
    for (int i = 0; i < 160 * 120; ++i) {
      double z = depth.z[i];
      if (z < 0.5 || z > 4.5 || depth.cosine[i] < 0.12) continue;
      z += gauss(rng) * (0.0012 + 0.0019 * (z - 0.4) * (z - 0.4));
      const Eigen::Vector3d world = R * (depth.ray(i % 160, i / 160) * z) + position + drift;
      out.points.push_back((T_map_world * world).cast<float>());
    }
  }
  return out;
}

Cloud aerialCloud(const air_ground_common::MeshScene& scene, const Pose& T_map_world, const SceneSettings& s, Rng& rng,
                  double* scale) {
  Cloud out;
  const Bumps bumps(rng);
  *scale = 1 + s.scale_offset + s.scale_error * gauss(rng);
  constexpr int kWidth = 94, kHeight = 60;
  for (double x : {-1.2, 0.0, 1.2}) {
    for (double y : {-1.0, 0.0, 1.0}) {
      const Eigen::Vector3d position(x + 0.2 * gauss(rng), y + 0.2 * gauss(rng), 2.3 + 0.2 * gauss(rng));
      const Eigen::Matrix3d R = lookAlong({0.05 * gauss(rng), 0.05 * gauss(rng), -1});
      const DepthImage depth = render(scene, R, position, kWidth, kHeight, 50);
      for (int v = 1; v + 1 < kHeight; ++v) {
        for (int u = 1; u + 1 < kWidth; ++u) {
          double z = 0;
          int n = 0;
          const int reach = s.smooth_edges ? 1 : 0;
          for (int dv = -reach; dv <= reach; ++dv) {
            for (int du = -reach; du <= reach; ++du) {
              const double d = depth.z[(v + dv) * kWidth + u + du];
              if (d > 0) z += d, ++n;
            }
          }
          if (!n) continue;
          z /= n;
          const Eigen::Vector3d at = R * (depth.ray(u, v) * z) + position;
          // Missing patches: where another smooth field of the surface is low (its quantile by the normal
          // distribution).
          if (bumps(at + Eigen::Vector3d(31, 17, 5)) < -1.2 + 2.1 * s.missing) continue;
          z += s.aerial_noise * gauss(rng) + s.aerial_bumps * bumps(at);
          const Eigen::Vector3d world = R * (depth.ray(u, v) * z) + position;
          out.points.push_back((T_map_world * world * *scale).cast<float>());
        }
      }
    }
  }
  return out;
}

}  // namespace

Scene makeScene(unsigned seed, const SceneSettings& settings) {
  Rng rng(seed * 7919u + 13u);
  Scene out;
  out.mesh = makeMesh(rng, settings);
  const air_ground_common::MeshScene scene(out.mesh);
  out.T_world_ground_map =
      air_ground_common::yawPose(uniform(rng, -M_PI, M_PI), {uniform(rng, -3, 3), uniform(rng, -3, 3), 0.1});
  out.T_world_mav_map =
      air_ground_common::yawPose(uniform(rng, -M_PI, M_PI), {uniform(rng, -1.5, 1.5), uniform(rng, -1, 1), 0.1});
  // Both maps hang from gravity, to a fraction of a degree.
  const auto tilt = [&rng] { return air_ground_common::expSO3({0.006 * gauss(rng), 0.006 * gauss(rng), 0}); };
  out.T_world_ground_map.linear() = out.T_world_ground_map.linear() * tilt();
  out.T_world_mav_map.linear() = out.T_world_mav_map.linear() * tilt();
  out.ground = groundCloud(scene, out.T_world_ground_map.inverse(), settings, rng);
  double scale = 1;
  out.aerial = aerialCloud(scene, out.T_world_mav_map.inverse(), settings, rng, &scale);
  out.truth = similarity(out.T_world_ground_map.inverse() * out.T_world_mav_map, 1 / scale);
  out.T_ground_map_mav_map = rigidAt(out.truth, centroid(out.aerial));
  return out;
}

Pose perturbed(const Pose& T, const Eigen::Vector3d& centre, double sigma_translation, double sigma_angle,
               bool yaw_only, std::mt19937& rng) {
  Eigen::Vector3d axis(gauss(rng), gauss(rng), gauss(rng));
  if (yaw_only) axis = Eigen::Vector3d::UnitZ();
  const Eigen::Matrix3d R = air_ground_common::expSO3(sigma_angle * gauss(rng) * axis.normalized());
  const Eigen::Vector3d middle = T * centre;
  const Eigen::Vector3d shift = sigma_translation * Eigen::Vector3d(gauss(rng), gauss(rng), gauss(rng));
  Pose delta = Pose::Identity();
  delta.linear() = R;
  delta.translation() = middle + shift - R * middle;
  return delta * T;
}

Eigen::Vector3d centroid(const Cloud& cloud) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const auto& p : cloud.points) sum += p.cast<double>();
  return cloud.empty() ? sum : Eigen::Vector3d(sum / static_cast<double>(cloud.size()));
}

}  // namespace icp_refine::synthetic
