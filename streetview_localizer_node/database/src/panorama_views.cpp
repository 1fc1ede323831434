#include "streetview_localizer/panorama_views.h"

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string>

namespace streetview_localizer {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

Eigen::Vector3d panoramaRay(const cv::Size& size, const Eigen::Vector2d& pixel) {
  const double azimuth = ((pixel.x() + 0.5) / size.width - 0.5) * 2 * M_PI;
  const double elevation = (0.5 - (pixel.y() + 0.5) / size.height) * M_PI;
  return {std::cos(elevation) * std::cos(azimuth), -std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
}

Eigen::Vector2d panoramaPixel(const cv::Size& size, const Eigen::Vector3d& d) {
  const double azimuth = std::atan2(-d.y(), d.x()), elevation = std::atan2(d.z(), std::hypot(d.x(), d.y()));
  double u = (azimuth / (2 * M_PI) + 0.5) * size.width - 0.5;
  if (u >= size.width - 0.5) u -= size.width;
  return {u, (0.5 - elevation / M_PI) * size.height - 0.5};
}

std::vector<View> cutPanorama(const cv::Mat& image, const Pose& T_world_panorama, const PanoramaViewSettings& s) {
  if (image.empty()) throw std::invalid_argument("the panorama is empty");
  if (std::abs(image.cols - 2.0 * image.rows) > 0.02 * image.cols)
    throw std::invalid_argument("an equirectangular panorama is twice as wide as high, this image has " +
                                std::to_string(image.cols) + "x" + std::to_string(image.rows) + " pixels");
  if (!(s.horizontal_fov > 0.1) || !(s.horizontal_fov < 2.8) || !(s.yaw_step > 0.05) || s.width < 16 || s.height < 16 ||
      s.pitches.empty())
    throw std::invalid_argument(
        "panorama views need a field of view of 6 to 160 degrees, a yaw step above 3 degrees and 16 pixels");
  CameraModel camera;
  camera.width = s.width;
  camera.height = s.height;
  camera.fx = camera.fy = 0.5 * s.width / std::tan(0.5 * s.horizontal_fov);
  camera.cx = 0.5 * (s.width - 1);
  camera.cy = 0.5 * (s.height - 1);

  // Where the panorama has more pixels a radian than a view has at its centre, it is averaged to the view's resolution.
  cv::Mat source = image;
  const double finer = image.cols / (2 * M_PI) / camera.fx;
  if (finer > 1.3) {
    const int width = 2 * static_cast<int>(std::lround(image.cols / finer / 2));
    cv::resize(image, source, cv::Size(width, width / 2), 0, 0, cv::INTER_AREA);
  }
  // A border of wrapped columns, and of rows, lets the interpolation cross the seam.
  constexpr int kBorder = 4;
  cv::Mat padded;
  cv::copyMakeBorder(source, padded, kBorder, kBorder, 0, 0, cv::BORDER_REPLICATE);
  cv::copyMakeBorder(padded, padded, 0, 0, kBorder, kBorder, cv::BORDER_WRAP);

  const int count = std::max(1, static_cast<int>(std::lround(2 * M_PI / s.yaw_step)));
  std::vector<View> views;
  for (const double pitch : s.pitches) {
    for (int i = 0; i < count; ++i) {
      View view;
      view.id = static_cast<int>(views.size());
      view.camera = camera;
      Pose T_panorama_camera = Pose::Identity();
      T_panorama_camera.linear() = (Eigen::AngleAxisd(-2 * M_PI * i / count, Eigen::Vector3d::UnitZ()) *
                                    Eigen::AngleAxisd(-pitch, Eigen::Vector3d::UnitY()))
                                       .toRotationMatrix() *
                                   air_ground_common::opticalFromForwardBody().transpose();
      view.T_world_camera = T_world_panorama * T_panorama_camera;
      cv::Mat map(s.height, s.width, CV_32FC2);
      for (int y = 0; y < s.height; ++y)
        for (int x = 0; x < s.width; ++x) {
          const Eigen::Vector2d p =
              panoramaPixel(source.size(), T_panorama_camera.linear() * camera.ray({double(x), double(y)}));
          map.at<cv::Vec2f>(y, x) = {float(p.x() + kBorder), float(p.y() + kBorder)};
        }
      cv::remap(padded, view.image, map, cv::noArray(), cv::INTER_CUBIC, cv::BORDER_REPLICATE);
      views.push_back(std::move(view));
    }
  }
  return views;
}

}  // namespace streetview_localizer
