#include "dense_fusion/rectifier.h"

#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string>

#include "air_ground_common/rectification.h"
#include "visual_frontend/rolling_shutter.h"

namespace dense_fusion {

cv::Mat normalizeContrast(const cv::Mat& intensity, const RectifierSettings& settings) {
  cv::Mat image, mean, mean_of_square;
  intensity.convertTo(image, CV_32F);
  const int side = 2 * settings.normalization_radius + 1;
  cv::boxFilter(image, mean, CV_32F, {side, side});
  cv::sqrBoxFilter(image, mean_of_square, CV_32F, {side, side});
  cv::Mat normalized(intensity.size(), CV_8U);
  const float floor = static_cast<float>(settings.contrast_floor), gain = static_cast<float>(settings.contrast_gain);
  for (int y = 0; y < image.rows; ++y) {
    const float* value = image.ptr<float>(y);
    const float* m = mean.ptr<float>(y);
    const float* s = mean_of_square.ptr<float>(y);
    std::uint8_t* out = normalized.ptr<std::uint8_t>(y);
    for (int x = 0; x < image.cols; ++x) {
      const float deviation = std::sqrt(std::max(0.f, s[x] - m[x] * m[x]));
      const float v = 128.5f + gain * (value[x] - m[x]) / (deviation + floor);
      out[x] = static_cast<std::uint8_t>(std::min(255.f, std::max(0.f, v)));
    }
  }
  return normalized;
}

Rectifier::Rectifier(const air_ground_common::CameraModel& camera, const RectifierSettings& settings)
    : input_(camera), settings_(settings) {
  camera.validate();
  if (!(settings.scale > 0 && settings.scale <= 1))
    throw std::invalid_argument("rectifier: scale must lie in (0, 1], not " + std::to_string(settings.scale));
  if (settings.normalization_radius < 1 || !(settings.contrast_floor > 0) || !(settings.contrast_gain > 0))
    throw std::invalid_argument("rectifier: normalization_radius, contrast_floor and contrast_gain must be positive");
  if (!(settings.max_field >= 0.2 && settings.max_field <= 2.6))
    throw std::invalid_argument("rectifier: max_field must lie in [0.2, 2.6] rad");
  air_ground_common::CameraModel& full = full_ = camera.undistorted();
  if (camera.model != air_ground_common::DistortionModel::kPlumbBob) {
    full = air_ground_common::centralPinhole(camera, settings.max_field);
    exact_map_ = air_ground_common::rectificationMap(camera, full);
    cv::convertMaps(exact_map_, cv::noArray(), map1_, map2_, CV_16SC2);
  } else if (camera.hasDistortion()) {
    const cv::Mat K =
        cv::getOptimalNewCameraMatrix(camera.cvK(), camera.cvDistortion(), {camera.width, camera.height}, 0);
    full.fx = K.at<double>(0, 0);
    full.fy = K.at<double>(1, 1);
    full.cx = K.at<double>(0, 2);
    full.cy = K.at<double>(1, 2);
    cv::initUndistortRectifyMap(camera.cvK(), camera.cvDistortion(), cv::noArray(), K, {camera.width, camera.height},
                                CV_16SC2, map1_, map2_);
  }
  if (exact_map_.empty()) exact_map_ = air_ground_common::rectificationMap(camera, full);
  output_ = full.scaled(settings.scale);
}

// The rows' shifts are smooth: they are computed on a coarse grid.
cv::Mat Rectifier::rowMap(const RowMotion& rows) const {
  visual_frontend::RollingShutter shutter(input_, rows.readout_time);
  // Far away only the turn shows: any depth serves, without velocity.
  shutter.setMotion(rows.angular_rate, rows.depth > 0 ? rows.velocity : Eigen::Vector3d(Eigen::Vector3d::Zero()));
  const double depth = rows.depth > 0 ? rows.depth : 1.0;
  constexpr int kStep = 16;
  cv::Mat shifts((full_.height + kStep - 1) / kStep, (full_.width + kStep - 1) / kStep, CV_32FC2);
  for (int i = 0; i < shifts.rows; ++i)
    for (int j = 0; j < shifts.cols; ++j) {
      // Where cv::resize puts the centre of a grid's cell.
      const double u = (j + 0.5) * full_.width / shifts.cols - 0.5, v = (i + 0.5) * full_.height / shifts.rows - 0.5;
      const Eigen::Vector3d p((u - full_.cx) / full_.fx * depth, (v - full_.cy) / full_.fy * depth, depth);
      const auto pixel = input_.project(p);
      const Eigen::Vector2d shift =
          pixel ? Eigen::Vector2d(shutter.toItsRow(*pixel, p) - *pixel) : Eigen::Vector2d(0, 0);
      shifts.at<cv::Vec2f>(i, j) = {static_cast<float>(shift.x()), static_cast<float>(shift.y())};
    }
  cv::Mat map;
  cv::resize(shifts, map, exact_map_.size(), 0, 0, cv::INTER_LINEAR);
  map += exact_map_;
  return map;
}

Frame Rectifier::rectify(const cv::Mat& image, std::int64_t stamp, const Eigen::Isometry3d& T_map_camera,
                         const RowMotion& rows) const {
  if (image.cols != input_.width || image.rows != input_.height)
    throw std::invalid_argument("rectifier: image of " + std::to_string(image.cols) + "x" + std::to_string(image.rows) +
                                " but calibration for " + std::to_string(input_.width) + "x" +
                                std::to_string(input_.height));
  cv::Mat gray;
  if (image.type() == CV_8UC1)
    gray = image;
  else if (image.type() == CV_8UC3)
    cv::cvtColor(image, gray, cv::COLOR_BGR2GRAY);
  else
    throw std::invalid_argument("rectifier: image must have 8 bits and 1 or 3 channels");
  cv::Mat undistorted;  // never the caller's pixels
  if (rows.readout_time != 0)
    cv::remap(gray, undistorted, rowMap(rows), cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  else if (!map1_.empty())
    cv::remap(gray, undistorted, map1_, map2_, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  else
    undistorted = gray;
  Frame frame;
  frame.stamp = stamp;
  frame.T_map_camera = T_map_camera;
  if (output_.width == undistorted.cols && output_.height == undistorted.rows)
    frame.intensity = undistorted.clone();
  else
    // Averages whole blocks, which matches the pixel centres of CameraModel::scaled.
    cv::resize(undistorted, frame.intensity, {output_.width, output_.height}, 0, 0, cv::INTER_AREA);
  frame.normalized = normalizeContrast(frame.intensity, settings_);
  return frame;
}

}  // namespace dense_fusion
