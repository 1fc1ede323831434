// Renders what a downward camera sees of a textured floor with plates floating above it: exact geometry, plain noise
// texture.
#pragma once

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "synthetic_flight.h"

namespace synthetic {

class PlateWorld {
 public:
  explicit PlateWorld(unsigned seed, bool plates = true) {
    cv::RNG random(seed);
    planes_.push_back(makePlane(random, -5.0, -5.0, 10.0, 10.0, 0.0));
    for (int i = 0; plates && i < 25; ++i)
      planes_.push_back(makePlane(random, random.uniform(-3.0, 3.0), random.uniform(-3.0, 4.0),
                                  random.uniform(0.3, 0.8), random.uniform(0.3, 0.8), random.uniform(0.1, 0.6)));
    std::sort(planes_.begin(), planes_.end(), [](const Plane& a, const Plane& b) { return a.z < b.z; });
  }

  /// 8-bit image of a camera of any model above all plates: a ray a pixel, the floor repeated without end, textures
  /// from the level that fits the pixel. `rays` of the camera, once for a flight: see raysOf.
  cv::Mat renderByRays(const air_ground_common::CameraModel& camera, const std::vector<Eigen::Vector3d>& rays,
                       const Pose& T_world_camera, cv::RNG* noise = nullptr) const {
    cv::Mat image(camera.height, camera.width, CV_8UC1, cv::Scalar(0));
    const Eigen::Vector3d c = T_world_camera.translation();
    for (int y = 0; y < camera.height; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        const Eigen::Vector3d& ray = rays[static_cast<std::size_t>(y) * camera.width + x];
        if (!ray.allFinite()) continue;
        const Eigen::Vector3d d = T_world_camera.linear() * ray;
        if (!(d.z() < -0.05)) continue;
        for (auto plane = planes_.rbegin(); plane != planes_.rend(); ++plane) {
          const double range = (plane->z - c.z()) / d.z();
          Eigen::Vector2d p = kPixelsPerMetre * ((c + range * d).head<2>() - Eigen::Vector2d(plane->x, plane->y));
          const bool floor = std::next(plane) == planes_.rend();
          const Eigen::Vector2d size(plane->texture.cols, plane->texture.rows);
          if (floor) p -= size.cwiseProduct(p.cwiseQuotient(size).array().floor().matrix());
          if (p.x() < 0 || p.y() < 0 || p.x() >= size.x() || p.y() >= size.y()) continue;
          const double texels = kPixelsPerMetre * range / (camera.fx * std::sqrt(-d.z()));
          const int level = std::clamp(cvRound(std::log2(texels)), 0, static_cast<int>(plane->levels.size()) - 1);
          image.at<std::uint8_t>(y, x) = bilinear(plane->levels[level], p / (1 << level));
          break;
        }
      }
    }
    if (noise) addGrain(noise, &image);
    return image;
  }

  static std::vector<Eigen::Vector3d> raysOf(const air_ground_common::CameraModel& camera) {
    std::vector<Eigen::Vector3d> rays;
    for (int y = 0; y < camera.height; ++y)
      for (int x = 0; x < camera.width; ++x) rays.push_back(camera.ray({x, y}));
    return rays;
  }

  /// 8-bit image of a pinhole without distortion above all plates that looks down within 60 degrees.
  cv::Mat render(const air_ground_common::CameraModel& camera, const Pose& T_world_camera, double gain = 1.0,
                 cv::RNG* noise = nullptr) const {
    cv::Mat image(camera.height, camera.width, CV_8UC1, cv::Scalar(0));
    const Pose T = T_world_camera.inverse();
    for (const Plane& plane : planes_) {
      // Texture pixel (u, v, 1) -> point on the plane -> image.
      Eigen::Matrix3d M;
      M.col(0) = T.linear().col(0) / kPixelsPerMetre;
      M.col(1) = T.linear().col(1) / kPixelsPerMetre;
      M.col(2) = T * Eigen::Vector3d(plane.x, plane.y, plane.z);
      Eigen::Matrix3d H = camera.K() * M;
      // Only the part of the image that the plate covers is warped.
      cv::Rect2d box;
      for (const auto& corner :
           {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(plane.texture.cols, 0, 1),
            Eigen::Vector3d(0, plane.texture.rows, 1), Eigen::Vector3d(plane.texture.cols, plane.texture.rows, 1)}) {
        const Eigen::Vector2d p = (H * corner).hnormalized();
        const cv::Rect2d around(p.x() - 1, p.y() - 1, 2, 2);
        box = box.area() > 0 ? box | around : around;
      }
      const cv::Rect2d whole(0, 0, camera.width, camera.height), seen = box & whole;
      if (seen.area() < 1) continue;
      const cv::Rect area =
          cv::Rect(cv::Point(cvFloor(seen.x), cvFloor(seen.y)), cv::Point(cvCeil(seen.br().x), cvCeil(seen.br().y)));
      Eigen::Matrix3d shift = Eigen::Matrix3d::Identity();
      shift(0, 2) = -area.x;
      shift(1, 2) = -area.y;
      H = (shift * H).eval();
      cv::Mat warp(3, 3, CV_64F);
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) warp.at<double>(r, c) = H(r, c);
      cv::Mat part = image(area);
      cv::warpPerspective(plane.texture, part, warp, part.size(), cv::INTER_AREA, cv::BORDER_TRANSPARENT);
    }
    image.convertTo(image, CV_8U, gain);
    if (noise) addGrain(noise, &image);
    return image;
  }

 private:
  static constexpr double kPixelsPerMetre = 200;
  struct Plane {
    double x, y, z;
    cv::Mat texture;
    std::vector<cv::Mat> levels;
  };

  static void addGrain(cv::RNG* noise, cv::Mat* image) {
    cv::Mat grain(image->size(), CV_16S), sum;
    noise->fill(grain, cv::RNG::NORMAL, 0, 2);
    cv::add(*image, grain, sum, cv::noArray(), CV_16S);
    sum.convertTo(*image, CV_8U);
  }

  // At a texel's corner coordinates, as cv::resize keeps them from level to level.
  static std::uint8_t bilinear(const cv::Mat& m, const Eigen::Vector2d& p) {
    const double x = std::clamp(p.x() - 0.5, 0.0, m.cols - 1.001), y = std::clamp(p.y() - 0.5, 0.0, m.rows - 1.001);
    const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
    const double a = x - x0, b = y - y0;
    const std::uint8_t* row = m.ptr(y0) + x0;
    const std::uint8_t* below = m.ptr(std::min(y0 + 1, m.rows - 1)) + x0;
    return static_cast<std::uint8_t>((1 - b) * ((1 - a) * row[0] + a * row[1]) +
                                     b * ((1 - a) * below[0] + a * below[1]) + 0.5);
  }

  static Plane makePlane(cv::RNG& random, double x, double y, double width, double height, double z) {
    const cv::Size size(cvRound(width * kPixelsPerMetre), cvRound(height * kPixelsPerMetre));
    cv::Mat texture(size, CV_8UC1, cv::Scalar(110));
    // Blobs and rectangles of many sizes give corners at every height.
    const int count = static_cast<int>(size.area() / 350);
    for (int i = 0; i < count; ++i) {
      const cv::Point p(random.uniform(0, size.width), random.uniform(0, size.height));
      const int extent = static_cast<int>(3 + 30 * std::pow(random.uniform(0.0, 1.0), 4));
      const cv::Scalar grey(random.uniform(30, 220));
      if (i % 2)
        cv::rectangle(texture, cv::Rect(p.x, p.y, extent, random.uniform(3, 3 + extent)), grey, -1);
      else
        cv::circle(texture, p, extent / 2 + 1, grey, -1, cv::LINE_AA);
    }
    cv::GaussianBlur(texture, texture, cv::Size(3, 3), 0.7);
    Plane plane{x, y, z, texture, {texture}};
    while (plane.levels.size() < 7 && plane.levels.back().cols > 8 && plane.levels.back().rows > 8) {
      cv::Mat next;
      cv::resize(plane.levels.back(), next, cv::Size(), 0.5, 0.5, cv::INTER_AREA);
      plane.levels.push_back(next);
    }
    return plane;
  }

  std::vector<Plane> planes_;
};

}  // namespace synthetic
