#include "rgbd_slam/depth_registration.h"

#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string>

namespace rgbd_slam {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

namespace {

constexpr double kNearest = 0.05;  // what is closer to the colour camera than this is not seen by it [m]

int pixelsCovered(double focal_length, double focal_length_depth) {
  return std::max(1, static_cast<int>(std::ceil(focal_length / focal_length_depth - 1e-6)));
}

}  // namespace

std::optional<cv::Mat> depthAtSize(const cv::Mat& depth, int width, int height) {
  constexpr double kSameProportions = 0.01;
  const double across = static_cast<double>(width) / depth.cols, down = static_cast<double>(height) / depth.rows;
  if (std::abs(across / down - 1) > kSameProportions) return std::nullopt;
  cv::Mat result;
  cv::resize(depth, result, cv::Size(width, height), 0, 0, cv::INTER_NEAREST_EXACT);  // no depths between two surfaces
  return result;
}

bool seesAlike(const CameraModel& depth, const CameraModel& colour) {
  constexpr double kFocal = 0.03, kCentre = 0.02;
  const double sx = static_cast<double>(colour.width) / depth.width;
  const double sy = static_cast<double>(colour.height) / depth.height;
  const auto centre = [](double c, double scale) { return (c + 0.5) * scale - 0.5; };
  return std::abs(depth.fx * sx - colour.fx) < kFocal * colour.fx &&
         std::abs(depth.fy * sy - colour.fy) < kFocal * colour.fy &&
         std::abs(centre(depth.cx, sx) - colour.cx) < kCentre * colour.width &&
         std::abs(centre(depth.cy, sy) - colour.cy) < kCentre * colour.height;
}

DepthRegistration::DepthRegistration(const CameraModel& depth_camera, const CameraModel& colour_camera,
                                     const Pose& T_colour_depth)
    : depth_camera_(depth_camera),
      colour_camera_(colour_camera),
      p_colour_depth_(T_colour_depth.translation().cast<float>()),
      width_(pixelsCovered(colour_camera.fx, depth_camera.fx)),
      height_(pixelsCovered(colour_camera.fy, depth_camera.fy)) {
  depth_camera.validate();
  colour_camera.validate();
  rays_.reserve(static_cast<std::size_t>(depth_camera.width) * static_cast<std::size_t>(depth_camera.height));
  for (int v = 0; v < depth_camera.height; ++v)
    for (int u = 0; u < depth_camera.width; ++u)
      rays_.emplace_back((T_colour_depth.linear() * depth_camera.unproject({u, v}).homogeneous()).cast<float>());
}

cv::Mat DepthRegistration::operator()(const cv::Mat& depth) const {
  if (depth.type() != CV_32F || depth.cols != depth_camera_.width || depth.rows != depth_camera_.height)
    throw std::invalid_argument("the depth image is " + std::to_string(depth.cols) + "x" + std::to_string(depth.rows) +
                                ", its calibration is for " + std::to_string(depth_camera_.width) + "x" +
                                std::to_string(depth_camera_.height));
  cv::Mat registered(colour_camera_.height, colour_camera_.width, CV_32F,
                     cv::Scalar(std::numeric_limits<float>::quiet_NaN()));
  for (int v = 0; v < depth.rows; ++v) {
    const float* row = depth.ptr<float>(v);
    const Eigen::Vector3f* rays = rays_.data() + static_cast<std::size_t>(v) * static_cast<std::size_t>(depth.cols);
    for (int u = 0; u < depth.cols; ++u) {
      if (!(row[u] > 0)) continue;
      const Eigen::Vector3f p = row[u] * rays[u] + p_colour_depth_;
      if (!(p.z() > kNearest)) continue;  // also where the depth camera sees nothing
      const auto pixel = colour_camera_.project(p.cast<double>());
      if (!pixel || !pixel->allFinite() || pixel->cwiseAbs().maxCoeff() > 1e6) continue;
      // The pixels whose centres lie within the footprint, which is centred on the point.
      const int x = static_cast<int>(std::lround(pixel->x() - 0.5 * (width_ - 1)));
      const int y = static_cast<int>(std::lround(pixel->y() - 0.5 * (height_ - 1)));
      for (int j = std::max(y, 0); j < std::min(y + height_, registered.rows); ++j) {
        float* out = registered.ptr<float>(j);
        for (int i = std::max(x, 0); i < std::min(x + width_, registered.cols); ++i)
          if (!(out[i] <= p.z())) out[i] = p.z();
      }
    }
  }
  return registered;
}

}  // namespace rgbd_slam
