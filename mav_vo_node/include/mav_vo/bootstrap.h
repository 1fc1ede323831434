// Start of a monocular map: three views with enough parallax, the rotation from the gyro and the direction of
// translation from two points (Kneip 2011), or all of it from five points (Nister 2004, OpenGV) without gyro; refined
// by a small bundle adjustment.
#pragma once

#include <deque>
#include <functional>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>
#include <vector>

#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/types.h"

namespace mav_vo {

struct BootstrapSettings {
  double min_parallax = 0.06;     ///< median angle between the rays of the first and last view [rad]
  int min_common = 60;            ///< tracks that both views share
  double min_common_share = 0.5;  ///< in weak texture: at least this share of the most that any recent image had
  int min_inliers = 45;           ///< of them, consistent with the motion and triangulated; fewer in weak texture
  double min_inlier_share = 0.5;  ///< of the common tracks: the most, where a mirror shows a second motion
  double max_age = 5.0;           ///< between first and last view [s]
  double frame_interval = 0.1;    ///< between views that are kept as candidates for the first [s]
  double pixel_sigma = 0.6;       ///< of a tracked feature [px]
  double gyro_sigma = 0.004;      ///< of the integrated rotation between the views, with the bias known [rad]
  double max_gyro_sigma = 0.02;   ///< a rotation that is less certain is not used, and waited for [rad]
  double max_rms = 2.0;           ///< reprojection error after bundle adjustment, in sigmas
  unsigned seed = 1;
};

/// Rotation of the camera between two images from the gyro.
struct GyroRotation {
  Eigen::Matrix3d R_a_b = Eigen::Matrix3d::Identity();
  double sigma = 0;  ///< what the bias leaves open [rad]
};
/// Of two stamps, the earlier one first; empty where the IMU has no samples.
using GyroRotations = std::function<std::optional<GyroRotation>(double stamp_a, double stamp_b)>;

struct BootstrapView {
  double stamp = 0;  ///< [s]
  std::vector<visual_frontend::Feature> features;
  std::vector<cv::Mat> pyramid;
  visual_frontend::Pose T_first_camera =
      visual_frontend::Pose::Identity();  ///< of a result: pose in the first view's camera
};

struct BootstrapResult {
  std::vector<BootstrapView> views;  ///< two or three, in order of time
  struct Point {
    visual_frontend::TrackId track = visual_frontend::kNoTrack;
    Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< in the first view's camera; unit: the median depth there
  };
  std::vector<Point> points;
  double rms = 0;              ///< reprojection error, in sigmas
  double median_parallax = 0;  ///< [rad]
  bool rotation_from_gyro = false;
};

/// Five-point RANSAC (OpenGV) between normalised coordinates of the same points: T_a_b with unit translation. Empty
/// below 8 inliers.
std::optional<visual_frontend::Pose> fivePointPose(const std::vector<Eigen::Vector2d>& a,
                                                   const std::vector<Eigen::Vector2d>& b, double sigma,
                                                   std::vector<unsigned char>* inliers);

class Bootstrap {
 public:
  Bootstrap(const visual_frontend::CameraModel& camera, const BootstrapSettings& settings);

  /// Next image's features and pyramid. `gyro` is asked anew at each attempt, because what is known of the bias
  /// changes; where it has no answer, five points are used. A result when a map can start.
  std::optional<BootstrapResult> add(double stamp, const std::vector<visual_frontend::Feature>& features,
                                     const visual_frontend::ImagePyramid& pyramid, const GyroRotations& gyro);
  void reset();
  void setCamera(const visual_frontend::CameraModel& camera) { camera_ = camera; }  ///< when no views are kept

  const std::string& reason() const { return reason_; }  ///< why there is no result yet

 private:
  struct Attempt;
  bool findMotion(Attempt* attempt);  ///< of the last view against the first; false: reason_ says why
  bool findPoints(Attempt* attempt);  ///< that both see; likewise
  void addMiddleView(const GyroRotations& gyro, Attempt* attempt) const;
  std::optional<BootstrapResult> adjust(Attempt* attempt);  ///< all views and points; likewise
  std::size_t leastPoints(const Attempt& attempt) const;
  std::optional<BootstrapResult> attempt(const BootstrapView& first, const BootstrapView& last,
                                         const GyroRotations& gyro, const std::optional<GyroRotation>& turn);

  visual_frontend::CameraModel camera_;
  BootstrapSettings settings_;
  std::deque<BootstrapView> views_;
  int needed_ = 0;  ///< tracks that both views must share, by the texture of the recent images
  std::string reason_ = "no image yet";
};

}  // namespace mav_vo
