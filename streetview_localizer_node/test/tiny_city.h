// A courtyard of three painted walls with exact geometry: what the camera sees, what the model says and where both
// stand is known.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <vector>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/database.h"
#include "streetview_localizer/features.h"
#include "streetview_localizer/panorama_views.h"

namespace streetview_localizer::test {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

class TinyCity {
 public:
  /// `tile` > 0: every wall repeats one piece of this width [m], as a row of equal windows does.
  explicit TinyCity(unsigned seed, double tile = 0) {
    // Origin, direction along the wall, length; the normal is along x z.
    addWall({-12, 8, 0}, {1, 0, 0}, 24, seed, tile);
    addWall({12, 8, 0}, {0, -1, 0}, 16, seed + 100, tile);
    addWall({12, -8, 0}, {-1, 0, 0}, 24, seed + 200, tile);
    const int base = static_cast<int>(model_.mesh.vertices.size());
    for (const auto& v : {Eigen::Vector3f(-30, -30, 0), Eigen::Vector3f(30, -30, 0), Eigen::Vector3f(30, 30, 0),
                          Eigen::Vector3f(-30, 30, 0)})
      model_.mesh.vertices.push_back(v);
    for (const auto& t : {Eigen::Vector3i(base, base + 1, base + 2), Eigen::Vector3i(base, base + 2, base + 3)}) {
      model_.mesh.triangles.push_back(t);
      model_.surface.push_back(Surface::kGround);
      model_.building.push_back(-1);
    }
  }

  const CityModel& model() const { return model_; }

  static CameraModel camera() {
    CameraModel c;
    c.width = 640;
    c.height = 480;
    c.fx = c.fy = 420;
    c.cx = 319.5;
    c.cy = 239.5;
    return c;
  }

  /// Pose of a camera at a place that looks along a heading (counter-clockwise from x), up by a pitch, turned by a
  /// roll.
  static Pose look(const Eigen::Vector3d& position, double heading, double pitch, double roll = 0) {
    Pose T = Pose::Identity();
    const Eigen::Matrix3d body =
        (Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(-pitch, Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
            .toRotationMatrix();
    T.linear() = body * air_ground_common::opticalFromForwardBody().transpose();
    T.translation() = position;
    return T;
  }

  cv::Mat photograph(const CameraModel& c, const Pose& T_world_camera) const {
    cv::Mat image(c.height, c.width, CV_8UC3);
    for (int row = 0; row < c.height; ++row)
      for (int col = 0; col < c.width; ++col)
        image.at<cv::Vec3b>(row, col) =
            colour(T_world_camera.translation(), T_world_camera.linear() * c.ray({col, row}));
    return image;
  }

  cv::Mat panorama(const Pose& T_world_panorama, int width = 2048) const {
    cv::Mat image(width / 2, width, CV_8UC3);
    for (int row = 0; row < image.rows; ++row)
      for (int col = 0; col < image.cols; ++col)
        image.at<cv::Vec3b>(row, col) =
            colour(T_world_panorama.translation(), T_world_panorama.linear() * panoramaRay(image.size(), {col, row}));
    return image;
  }

  /// Panoramas at x = -6, 0, 6 on the courtyard's axis, 2.5 m high, with headings of their own.
  std::vector<Panorama> panoramas() const {
    std::vector<Panorama> all;
    for (int i = 0; i < 3; ++i) {
      Panorama p;
      p.id = "pano_" + std::to_string(i) + ".jpg";
      p.T_world_panorama = air_ground_common::yawPose(0.3 + i, {-6.0 + 6 * i, 0.5, 2.5});
      p.T_world_geotag = p.T_world_panorama;
      p.registered = true;
      p.position_stddev = 0.05;
      p.orientation_stddev = 0.004;
      all.push_back(p);
    }
    return all;
  }

  std::vector<View> viewsOf(const Panorama& place, const BackProjector& projector) const {
    PanoramaViewSettings settings;
    settings.width = settings.height = 480;
    std::vector<View> views = cutPanorama(panorama(place.T_world_panorama), place.T_world_panorama, settings);
    for (View& view : views) {
      view.features = extractFeatures(view.image);
      projector.apply(&view);
    }
    return views;
  }

  std::shared_ptr<StreetviewDatabase> database() const {
    auto db = std::make_shared<StreetviewDatabase>();
    db->model = model_;
    const BackProjector projector(model_);
    for (const Panorama& place : panoramas()) {
      for (View& view : viewsOf(place, projector)) {
        view.id = static_cast<int>(db->views.size());
        view.panorama = static_cast<int>(db->panoramas.size());
        db->views.push_back(std::move(view));
      }
      db->panoramas.push_back(place);
    }
    db->buildIndex();
    return db;
  }

 private:
  struct Wall {
    Eigen::Vector3d origin, along, normal;
    double length;
    cv::Mat paint;  // kPixels to the metre, top row first
  };
  static constexpr double kPixels = 50, kHeight = 9;

  // Rectangles and ellipses of all sizes and shades.
  static cv::Mat paint(double length, unsigned seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> unit(0, 1);
    cv::Mat image(static_cast<int>(kHeight * kPixels), std::max(8, static_cast<int>(length * kPixels)), CV_8UC3,
                  cv::Scalar::all(150));
    const int shapes = static_cast<int>(length * kHeight * 6);
    for (int i = 0; i < shapes; ++i) {
      const double size = kPixels * 1.5 * std::pow(unit(rng), 2) + 3;
      const cv::Point centre(static_cast<int>(unit(rng) * image.cols), static_cast<int>(unit(rng) * image.rows));
      const cv::Size half(static_cast<int>(size * (0.4 + unit(rng))), static_cast<int>(size * (0.4 + unit(rng))));
      const cv::Scalar shade(255 * unit(rng), 255 * unit(rng), 255 * unit(rng));
      if (i % 2)
        cv::rectangle(image, cv::Rect(centre, half), shade, cv::FILLED);
      else
        cv::ellipse(image, centre, half, 180 * unit(rng), 0, 360, shade, cv::FILLED);
    }
    cv::GaussianBlur(image, image, {}, 0.8);
    return image;
  }

  void addWall(const Eigen::Vector3d& origin, const Eigen::Vector3d& along, double length, unsigned seed, double tile) {
    Wall w{origin, along, along.cross(Eigen::Vector3d::UnitZ()), length, {}};
    if (tile > 0) {
      const cv::Mat piece = paint(tile, seed);
      cv::repeat(piece, 1, static_cast<int>(std::ceil(length / tile)) + 1, w.paint);
    } else {
      w.paint = paint(length, seed);
    }
    walls_.push_back(w);
    const int base = static_cast<int>(model_.mesh.vertices.size());
    const Eigen::Vector3d up(0, 0, kHeight), side = length * along;
    for (const Eigen::Vector3d& v :
         {origin, Eigen::Vector3d(origin + side), Eigen::Vector3d(origin + side + up), Eigen::Vector3d(origin + up)})
      model_.mesh.vertices.push_back(v.cast<float>());
    for (const auto& t : {Eigen::Vector3i(base, base + 1, base + 2), Eigen::Vector3i(base, base + 2, base + 3)}) {
      model_.mesh.triangles.push_back(t);
      model_.surface.push_back(Surface::kWall);
      model_.building.push_back(static_cast<int>(model_.building_ids.size()));
    }
    model_.building_ids.push_back("wall_" + std::to_string(walls_.size()));
  }

  cv::Vec3b colour(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const {
    double nearest = 1e9;
    cv::Vec3b out = ray.z() > 0 ? cv::Vec3b(230, 225, 220) : cv::Vec3b(90, 90, 90);
    for (const Wall& w : walls_) {
      const double speed = w.normal.dot(ray);
      if (std::abs(speed) < 1e-9) continue;
      const double t = w.normal.dot(w.origin - from) / speed;
      if (t <= 0 || t >= nearest) continue;
      const Eigen::Vector3d p = from + t * ray - w.origin;
      const double u = p.dot(w.along), v = p.z();
      if (u < 0 || u > w.length || v < 0 || v > kHeight) continue;
      nearest = t;
      const double x = std::clamp(u * kPixels - 0.5, 0.0, w.paint.cols - 1.001),
                   y = std::clamp((kHeight - v) * kPixels - 0.5, 0.0, w.paint.rows - 1.001);
      const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
      cv::Vec3d sum;
      for (int dy = 0; dy < 2; ++dy)
        for (int dx = 0; dx < 2; ++dx)
          sum += std::abs(1 - dx - (x - x0)) * std::abs(1 - dy - (y - y0)) *
                 cv::Vec3d(w.paint.at<cv::Vec3b>(y0 + dy, x0 + dx));
      out = cv::Vec3b(cv::saturate_cast<uchar>(sum[0]), cv::saturate_cast<uchar>(sum[1]),
                      cv::saturate_cast<uchar>(sum[2]));
    }
    return out;
  }

  CityModel model_;
  std::vector<Wall> walls_;
};

}  // namespace streetview_localizer::test
