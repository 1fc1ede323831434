#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "relative_pose.h"
#include "streetview_localizer/pairwise.h"

namespace streetview_localizer {
namespace {

using air_ground_common::CameraModel;

/// Adds a view's features, `keep` by their pixel, to those of the whole image.
template <typename Keep>
void append(const cv::Mat& image, const CameraModel& camera, const Eigen::Matrix3d& R_body_camera,
            const FeatureSettings& settings, const Keep& keep, BearingFeatures* all) {
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  const Features found = extractFeatures(grey, settings);
  // Of the sphere's picture as fine as the view in its middle.
  const cv::Size sphere(static_cast<int>(2 * M_PI * camera.fx), static_cast<int>(M_PI * camera.fx));
  cv::Mat kept(0, found.descriptors.cols, found.descriptors.type());
  for (std::size_t i = 0; i < found.size(); ++i) {
    cv::KeyPoint keypoint = found.keypoints[i];
    const Eigen::Vector3d ray = camera.ray({keypoint.pt.x, keypoint.pt.y});
    if (!keep(ray)) continue;
    const Eigen::Vector3d bearing = (R_body_camera * ray).normalized();
    const Eigen::Vector2d pixel = panoramaPixel(sphere, bearing);
    keypoint.pt = cv::Point2f(static_cast<float>(pixel.x()), static_cast<float>(pixel.y()));
    all->features.keypoints.push_back(keypoint);
    all->bearings.push_back(bearing);
    kept.push_back(found.descriptors.row(static_cast<int>(i)));
  }
  if (kept.rows > 0) all->features.descriptors.push_back(kept);
}

}  // namespace

BearingFeatures bearingFeaturesOf(const cv::Mat& panorama, const PanoramaViewSettings& settings,
                                  const FeatureSettings& feature_settings) {
  BearingFeatures all;
  const std::vector<View> views = cutPanorama(panorama, air_ground_common::Pose::Identity(), settings);
  const std::size_t ring = views.size() / settings.pitches.size();
  for (const View& view : views) {
    const Eigen::Matrix3d R = view.T_world_camera.linear();
    const auto nearest = [&](const Eigen::Vector3d& ray) {
      const Eigen::Vector3d bearing = R * ray, axis = R.col(2);
      const double off =
          air_ground_common::wrapAngle(std::atan2(bearing.y(), bearing.x()) - std::atan2(axis.y(), axis.x()));
      return std::abs(off) <= M_PI / static_cast<double>(ring);
    };
    append(view.image, view.camera, R, feature_settings, nearest, &all);
  }
  return all;
}

BearingFeatures bearingFeaturesOf(const cv::Mat& photograph, const CameraModel& full, const PanoramaViewSettings& views,
                                  const FeatureSettings& settings) {
  BearingFeatures all;
  const double focal = 0.5 * views.width / std::tan(0.5 * views.horizontal_fov);
  cv::Mat image = photograph;
  CameraModel camera = full;
  if (focal < full.fx) {
    cv::resize(photograph, image, {}, focal / full.fx, focal / full.fx, cv::INTER_AREA);
    camera = full.scaled(focal / full.fx);
  }
  append(
      image, camera, air_ground_common::opticalFromForwardBody().transpose(), settings,
      [](const Eigen::Vector3d&) { return true; }, &all);
  return all;
}

std::size_t bytesOf(const BearingFeatures& f) {
  return f.features.descriptors.total() + f.bearings.size() * (sizeof(Eigen::Vector3d) + sizeof(cv::KeyPoint));
}

std::vector<Match> matchBearings(const BearingFeatures& a, const BearingFeatures& b) {
  return matchPairwise(a.features, b.features);
}

}  // namespace streetview_localizer
