// Step 1 of the matching for the query: SIFT fails beyond some 40 degrees between two views of a facade, so the query
// is also warped to what cameras beside, below and above it would see, and features are taken from every view (Majdik,
// Albers-Schoenberg and Scaramuzza, IROS 2013; after Morel and Yu, ASIFT, 2009). In the paper of 2014 this is step (1)
// of figure 4.
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "streetview_localizer/features.h"
#include "streetview_localizer/types.h"

namespace streetview_localizer {

/// Where the virtual camera stands on a sphere around the point that the query's optical axis meets, on a facade that
/// faces the query's camera. Both zero: the query itself.
struct VirtualView {
  double azimuth = 0;    ///< positive: from the right [rad]
  double elevation = 0;  ///< positive: from above [rad]
};

/// From the ground below, from above, from both sides and obliquely.
std::vector<VirtualView> airToGroundViews();

struct VirtualViewSettings {
  FeatureSettings original;                             ///< of the query as recorded
  FeatureSettings warped = {0, 0.04, 10, false};        ///< of the virtual views
  std::vector<VirtualView> views = airToGroundViews();  ///< none: the original only
  double distance = 4;  ///< of the virtual camera from the facade over that of the query's, at least 1: large is affine
  double border = 2.5;  ///< keypoints nearer to the warped image's border than this many keypoint sizes are dropped
  double merge_pixels = 1.5;    ///< features at most this far apart, of the same size and angle, ... [px]
  double merge_distance = 150;  ///< ... and with descriptors at most this far apart are one: the first is kept
};

/// The exact map between the query's pixels (as recorded, distorted) and those of one virtual view.
class VirtualViewWarp {
 public:
  /// Throws std::invalid_argument when the view is turned by 80 degrees or more, the distance is below 1, or the camera
  /// invalid.
  VirtualViewWarp(const air_ground_common::CameraModel& camera, const VirtualView& view, double distance = 4);

  Eigen::Vector2d toOriginal(const Eigen::Vector2d& warped) const;
  Eigen::Vector2d toWarped(const Eigen::Vector2d& original) const;
  /// d original / d warped, 2x2.
  Eigen::Matrix2d jacobian(const Eigen::Vector2d& warped) const;
  cv::Size size() const { return size_; }

  /// The virtual view, at full or half resolution, low-passed against aliasing. Pixels that the query does not see
  /// repeat its border. Half resolution: pixel x is at 2 x + 0.5 of the full one.
  cv::Mat render(const cv::Mat& grey, bool half) const;

 private:
  air_ground_common::CameraModel camera_;
  Eigen::Matrix3d warped_from_plane_;  // plane: the query's normalised coordinates
  Eigen::Matrix3d plane_from_warped_;
  cv::Size size_;
};

/// Features of the query and its virtual views, in pixels of the query. `class_id` of a keypoint is 0 for the query
/// itself and i + 1 for settings.views[i]. Sizes and angles are mapped as well (square root of the Jacobian's
/// determinant; image of the direction). Deterministic; runs in OpenCV's threads. Throws std::invalid_argument when
/// image and camera differ in size.
Features extractWithVirtualViews(const cv::Mat& image, const air_ground_common::CameraModel& camera,
                                 const VirtualViewSettings& settings = {});

/// The same with the image's own features given, class_id 0: what extractFeatures finds with settings.original.
Features addVirtualViews(const Features& original, const cv::Mat& image, const air_ground_common::CameraModel& camera,
                         const VirtualViewSettings& settings = {});

}  // namespace streetview_localizer
