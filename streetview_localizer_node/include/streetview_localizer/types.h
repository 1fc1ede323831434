// What the stages of street-level localization hand to each other. Frame `world`: local east-north-up
// (air_ground_common/geodesy.h).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"

namespace streetview_localizer {

/// Keypoints (pixel, size, angle of OpenCV) and their RootSIFT descriptors: n x 128, CV_8U, so that the Euclidean
/// distance of two rows is the Hellinger distance of the SIFT histograms times 512 * sqrt(2), up to rounding.
struct Features {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  std::size_t size() const { return keypoints.size(); }
};

/// A panorama, or a photograph, and what is known of its place. Body frame: x towards the image's centre, y left, z up.
struct Panorama {
  std::string id;               ///< unique; the file as its list names it, with folders
  bool equirectangular = true;  ///< false: one perspective photograph
  air_ground_common::Pose T_world_geotag = air_ground_common::Pose::Identity();  ///< as recorded
  air_ground_common::Pose T_world_panorama =
      air_ground_common::Pose::Identity();  ///< after registration to the city model
  bool registered = false;                  ///< false: T_world_panorama is the geotag, `remark` says why
  double position_stddev = 3.7;             ///< of T_world_panorama, one axis [m]
  double orientation_stddev = 0.033;        ///< one axis [rad]
  std::string remark;                       ///< one line for a person; empty when all is well
};

/// A perspective image of the database: a cut of a panorama, or the photograph itself.
struct View {
  int id = 0;
  int panorama = 0;  ///< index of its Panorama
  air_ground_common::CameraModel camera;
  air_ground_common::Pose T_world_camera = air_ground_common::Pose::Identity();  ///< optical frame
  cv::Mat image;                                                                 ///< 8-bit, grey or BGR
  Features features;                     ///< only those whose ray meets a building
  std::vector<Eigen::Vector3f> points;   ///< of each feature, in world [m]
  std::vector<Eigen::Vector3f> normals;  ///< outward unit normal of the facade there
};

/// A match of two feature lists.
struct Match {
  int query = 0, view = 0;  ///< indices of keypoints
  float distance = 0;       ///< of the descriptors, as in Features
  float ratio = 0;          ///< distance over that to the nearest descriptor of another place, in [0, 1]
};

/// What the pose is computed from.
struct Correspondence {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();       ///< in the query, as recorded (distorted) [px]
  Eigen::Vector2d view_pixel = Eigen::Vector2d::Zero();  ///< in the database view [px]
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();     ///< [m]
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();      ///< outward unit normal in world; zero if unknown
  /// Of the database view that the point was cast from, in world [m]; not finite: that of the PointSource.
  Eigen::Vector3d view_centre = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  double quality = 1;  ///< larger is better, for guided sampling
};

}  // namespace streetview_localizer
