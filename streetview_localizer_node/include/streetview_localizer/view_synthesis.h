// The city as the database's photographs colour it (paper B, figure 5): a synthesised view from any pose, and the model
// as coloured points for display.
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/database.h"

namespace streetview_localizer {

struct ColouredPoint {
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  ///< [m]
  cv::Vec3b bgr;
};

/// Keeps references to both arguments; the views must have their images. Methods are thread-safe.
class ViewSynthesizer {
 public:
  ViewSynthesizer(const StreetviewDatabase& database, const BackProjector& projector);

  /// What a camera sees of the textured model, BGR, of the camera's size: each pixel takes its colour from that one of
  /// about `views_used` views of the nearest panoramas which sees the place unoccluded, most squarely and from nearest.
  /// Facades that none of them sees are grey, shaded by their slope; sky is pale blue.
  cv::Mat render(const air_ground_common::CameraModel& camera, const air_ground_common::Pose& T_world_camera,
                 int views_used = 32) const;

  /// Points over the buildings, one in about `spacing` x `spacing` [m], coloured by the best view of the nearest
  /// panoramas. The spacing grows until about `max_points` do.
  std::vector<ColouredPoint> sampleModel(double spacing, std::size_t max_points) const;

 private:
  bool colour(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, const std::vector<int>& views,
              cv::Vec3b* bgr) const;
  std::vector<int> viewsNear(const Eigen::Vector3d& position, int count) const;

  const StreetviewDatabase& database_;
  const BackProjector& projector_;
  std::vector<cv::Mat> depth_;  // of each view, reduced by kReduction
  std::vector<air_ground_common::CameraModel> depth_camera_;
};

}  // namespace streetview_localizer
