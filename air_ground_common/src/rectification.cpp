#include "air_ground_common/rectification.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace air_ground_common {
namespace {

// Left, right, up and down, as lengths on the normalised plane.
struct Extent {
  double side[4];

  // Corners and points between them, in order round the rectangle.
  bool isSeenBy(const CameraModel& camera) const {
    constexpr int kPoints = 16;
    for (int i = 0; i <= kPoints; ++i) {
      const double s = static_cast<double>(i) / kPoints;
      const double x = -side[0] + s * (side[0] + side[1]), y = -side[2] + s * (side[2] + side[3]);
      for (const Eigen::Vector3d& ray : {Eigen::Vector3d(x, -side[2], 1), Eigen::Vector3d(x, side[3], 1),
                                         Eigen::Vector3d(-side[0], y, 1), Eigen::Vector3d(side[1], y, 1)}) {
        const auto pixel = camera.project(ray);
        if (!pixel || !camera.contains(*pixel)) return false;
      }
    }
    return true;
  }
};

}  // namespace

CameraModel centralPinhole(const CameraModel& camera, double max_field) {
  camera.validate();
  if (!(max_field > 0 && max_field < M_PI))
    throw std::invalid_argument("pinhole view: the field of view must lie in (0, pi) rad");
  const double limit = std::tan(0.5 * max_field);
  // What a pinhole of this size and focal length sees, or the limit; a fisheye sees more within its image.
  Extent extent;
  const Eigen::Vector2d edges[4] = {
      {0, camera.cy}, {camera.width - 1.0, camera.cy}, {camera.cx, 0}, {camera.cx, camera.height - 1.0}};
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector2d n = camera.unproject(edges[i]);
    const double reach = (i % 2 == 0 ? -1 : 1) * n[i / 2];
    extent.side[i] = std::isfinite(reach) ? std::min(limit, reach) : limit;
  }
  for (int i = 0; i < 200 && !extent.isSeenBy(camera); ++i)
    for (double& side : extent.side) side *= 0.98;
  CameraModel view = camera.undistorted();
  const auto whole = [](double pixels, int recorded) {
    if (pixels > 4.0 * recorded)
      throw std::invalid_argument(
          "pinhole view: by its calibration the camera sees much on few pixels; calibrate anew");
    return static_cast<int>(pixels / 8) * 8;
  };
  view.width = whole(camera.fx * (extent.side[0] + extent.side[1]), camera.width);
  view.height = whole(camera.fy * (extent.side[2] + extent.side[3]), camera.height);
  if (view.width < 32 || view.height < 32)
    throw std::invalid_argument("pinhole view: the camera sees next to nothing about its optical axis");
  // What rounding left over is shared between the sides.
  view.cx = 0.5 * (view.width - 1) + 0.5 * camera.fx * (extent.side[0] - extent.side[1]);
  view.cy = 0.5 * (view.height - 1) + 0.5 * camera.fy * (extent.side[2] - extent.side[3]);
  return view;
}

cv::Mat rectificationMap(const CameraModel& camera, const CameraModel& view) {
  cv::Mat map(view.height, view.width, CV_32FC2);
  for (int y = 0; y < view.height; ++y) {
    cv::Vec2f* row = map.ptr<cv::Vec2f>(y);
    for (int x = 0; x < view.width; ++x) {
      const Eigen::Vector3d ray = view.unproject({x, y}).homogeneous();
      const auto pixel = ray.allFinite() ? camera.project(ray) : std::nullopt;
      row[x] = pixel ? cv::Vec2f(static_cast<float>(pixel->x()), static_cast<float>(pixel->y())) : cv::Vec2f(-1, -1);
    }
  }
  return map;
}

}  // namespace air_ground_common
