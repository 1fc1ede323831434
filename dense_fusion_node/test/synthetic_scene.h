// Analytic scene for tests: a textured floor z = 0 with boxes on it, rendered with exact depth.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"

namespace dense_fusion::testing {

struct Box {
  Eigen::Vector3d lower, upper;
};

/// Value noise in [-1, 1], continuous, without repetition.
inline double noise3(const Eigen::Vector3d& p, std::uint32_t seed) {
  const auto hash = [seed](int x, int y, int z) {
    std::uint32_t h = seed * 0x9e3779b9u + std::uint32_t(x) * 0x85ebca6bu + std::uint32_t(y) * 0xc2b2ae35u +
                      std::uint32_t(z) * 0x27d4eb2fu;
    h ^= h >> 15;
    h *= 0x2c1b3c6du;
    h ^= h >> 12;
    h *= 0x297a2d39u;
    h ^= h >> 15;
    return h / 2147483648.0 - 1.0;
  };
  const Eigen::Vector3d f = p.array().floor();
  const Eigen::Vector3d w0 = p - f;
  const Eigen::Vector3d w = w0.array().square() * (3 - 2 * w0.array());
  const int x = int(f.x()), y = int(f.y()), z = int(f.z());
  double value = 0;
  for (int i = 0; i < 8; ++i)
    value += (i & 1 ? w.x() : 1 - w.x()) * (i & 2 ? w.y() : 1 - w.y()) * (i & 4 ? w.z() : 1 - w.z()) *
             hash(x + (i & 1), y + (i >> 1 & 1), z + (i >> 2 & 1));
  return value;
}

struct Scene {
  std::vector<Box> boxes;
  std::uint32_t seed = 1;
  double contrast = 1;  ///< 0: no texture anywhere

  /// Distance along `direction` (any length, in its units) to the first surface; -1 for none.
  double hit(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
    double best = direction.z() < 0 ? -origin.z() / direction.z() : -1;
    for (const Box& box : boxes) {
      const Eigen::Array3d a = (box.lower - origin).array() / direction.array(),
                           b = (box.upper - origin).array() / direction.array();
      const double in = a.min(b).maxCoeff(), out = a.max(b).minCoeff();
      if (in > 1e-6 && in <= out && (best < 0 || in < best)) best = in;
    }
    return best;
  }

  double brightness(const Eigen::Vector3d& p) const {
    return 120 + contrast * (45 * noise3(p * 9, seed) + 35 * noise3(p * 27, seed + 1) + 25 * noise3(p * 70, seed + 2));
  }

  /// Signed height error is simple here: the true surface height at (x, y).
  double heightAt(double x, double y) const {
    double z = 0;
    for (const Box& b : boxes)
      if (x >= b.lower.x() && x <= b.upper.x() && y >= b.lower.y() && y <= b.upper.y()) z = std::max(z, b.upper.z());
    return z;
  }

  /// Image with 2x2 samples a pixel, gain and offset, and the exact depth of pixel centres.
  cv::Mat render(const air_ground_common::CameraModel& camera, const Eigen::Isometry3d& T, double gain, double offset,
                 cv::Mat* depth = nullptr) const {
    cv::Mat image(camera.height, camera.width, CV_8U);
    if (depth) *depth = cv::Mat(camera.height, camera.width, CV_32F);
#pragma omp parallel for schedule(dynamic, 8) num_threads(2)
    for (int v = 0; v < camera.height; ++v)
      for (int u = 0; u < camera.width; ++u) {
        const auto at = [&](double du, double dv) -> Eigen::Vector3d {
          return T.linear() * camera.unproject({u + du, v + dv}).homogeneous();
        };
        double sum = 0;
        for (int i = 0; i < 2; ++i)
          for (int j = 0; j < 2; ++j) {
            const Eigen::Vector3d ray = at(i / 2.0 - 0.25, j / 2.0 - 0.25);
            const double t = hit(T.translation(), ray);
            if (t > 0) sum += brightness(T.translation() + t * ray);
          }
        image.at<std::uint8_t>(v, u) = cv::saturate_cast<std::uint8_t>(gain * sum / 4 + offset);
        if (depth) depth->at<float>(v, u) = static_cast<float>(hit(T.translation(), at(0, 0)));
      }
    return image;
  }
};

/// Camera looking straight down as on the MAV: optical x = -y, y = -x, z = -z of the level base.
inline Eigen::Isometry3d lookDown(const Eigen::Vector3d& position, double roll = 0, double pitch = 0, double yaw = 0) {
  Eigen::Matrix3d R_base_camera;
  R_base_camera << 0, -1, 0, -1, 0, 0, 0, 0, -1;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
                Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
                   .toRotationMatrix() *
               R_base_camera;
  T.translation() = position;
  return T;
}

/// What a rolling shutter records: each row by the pose that the camera has then. `motion`: a RowMotion.
template <typename Motion>
inline cv::Mat renderRows(const Scene& scene, const air_ground_common::CameraModel& camera, const Eigen::Isometry3d& T,
                          const Motion& motion) {
  cv::Mat image(camera.height, camera.width, CV_8U);
  for (int v = 0; v < camera.height; ++v) {
    const double t = ((v + 0.5) / camera.height - 0.5) * motion.readout_time;
    Eigen::Isometry3d T_map_row = T;
    T_map_row.translation() += T.linear() * (t * motion.velocity);
    T_map_row.linear() = T.linear() * air_ground_common::expSO3(t * motion.angular_rate);
    air_ground_common::CameraModel row = camera;
    row.height = 1;
    row.cy -= v;
    scene.render(row, T_map_row, 1, 0).copyTo(image.row(v));
  }
  return image;
}

inline air_ground_common::CameraModel wideCamera() {
  air_ground_common::CameraModel c;
  c.width = 752;
  c.height = 480;
  c.fx = c.fy = 420;
  c.cx = 371.3;
  c.cy = 243.1;
  c.k1 = -0.22;
  c.k2 = 0.05;
  c.p1 = 3e-4;
  c.p2 = -2e-4;
  return c;
}

/// Three boxes of different heights around the origin.
inline Scene boxScene() {
  Scene scene;
  scene.boxes = {
      {{-0.6, -0.5, 0}, {-0.1, 0.2, 0.5}}, {{0.3, 0.1, 0}, {0.9, 0.6, 0.3}}, {{0.4, -0.8, 0}, {0.8, -0.4, 0.8}}};
  return scene;
}

}  // namespace dense_fusion::testing
