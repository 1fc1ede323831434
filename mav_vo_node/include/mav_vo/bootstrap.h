// Start of a monocular map: three views with enough parallax, the rotation from the gyro and the direction of
// translation from two points (Kneip 2011), or all of it from five points (Nister 2004, OpenGV) without gyro; refined
// by a small bundle adjustment.
#pragma once

#include <deque>
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
  int min_inliers = 45;           ///< of them, consistent with the motion and triangulated
  double min_inlier_share = 0.6;  ///< of the common tracks
  double max_age = 5.0;           ///< between first and last view [s]
  double frame_interval = 0.1;    ///< between views that are kept as candidates for the first [s]
  double pixel_sigma = 0.6;       ///< of a tracked feature [px]
  double gyro_sigma = 0.004;      ///< of the integrated rotation between the views [rad]
  double max_rms = 2.0;           ///< reprojection error after bundle adjustment, in sigmas
  unsigned seed = 1;
};

struct BootstrapView {
  double stamp = 0;  ///< [s]
  std::vector<visual_frontend::Feature> features;
  std::vector<cv::Mat> pyramid;
  Eigen::Matrix3d R_start_camera = Eigen::Matrix3d::Identity();  ///< integrated gyro rotation, to the oldest view
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

  /// Next image's features and pyramid; `R_previous_current` is the gyro's rotation since the last call (empty: not
  /// known, then and until the views from before it are gone five points are used). A result when a map can start.
  std::optional<BootstrapResult> add(double stamp, const std::vector<visual_frontend::Feature>& features,
                                     const visual_frontend::ImagePyramid& pyramid,
                                     const std::optional<Eigen::Matrix3d>& R_previous_current);
  void reset();

  const std::string& reason() const { return reason_; }  ///< why there is no result yet

 private:
  std::optional<BootstrapResult> attempt(const BootstrapView& first, const BootstrapView& last, bool gyro);

  visual_frontend::CameraModel camera_;
  BootstrapSettings settings_;
  std::deque<BootstrapView> views_;
  Eigen::Matrix3d R_start_camera_ = Eigen::Matrix3d::Identity();
  double gyro_since_ = 0;  ///< views from this stamp on have rotations that can be compared [s]
  std::string reason_ = "no image yet";
};

}  // namespace mav_vo
