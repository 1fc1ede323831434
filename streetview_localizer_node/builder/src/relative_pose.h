// How two images of one street stand to each other, by what both show of the facades.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/features.h"
#include "streetview_localizer/panorama_views.h"
#include "streetview_localizer/types.h"

namespace streetview_localizer {

/// What of an image can be found in another, whatever its direction.
struct BearingFeatures {
  Features features;                      ///< keypoints in pixels of the whole sphere's picture: which are at one place
  std::vector<Eigen::Vector3d> bearings;  ///< of each, unit, in the body frame (x to the image's centre, y left, z up)
};

/// Of a panorama (BGR or grey). Where views overlap, each direction is taken from the one that it is nearest to.
BearingFeatures bearingFeaturesOf(const cv::Mat& panorama, const PanoramaViewSettings& views,
                                  const FeatureSettings& settings);
/// Of a photograph, reduced to the views' focal length where it is finer.
BearingFeatures bearingFeaturesOf(const cv::Mat& photograph, const air_ground_common::CameraModel& camera,
                                  const PanoramaViewSettings& views, const FeatureSettings& settings);

/// Memory that they take [bytes].
std::size_t bytesOf(const BearingFeatures& features);

struct RelativePoseSettings {
  double bearing_stddev = 0.003;  ///< of a match, one axis [rad]: a pixel of the views
  double relief_stddev = 0.05;    ///< of a facade's parts along its normal [m]
  double wall_stddev = 0.2;       ///< of a whole wall, seen from a registered panorama [m]
  double max_error = 0.009;       ///< of a match that agrees [rad]
  int min_inliers = 30;
  int min_on_wall = 6;          ///< a facade counts with so many of them ...
  double max_share = 0.8;       ///< ... and no facade holds more than this share of all
  double max_rival = 0.6;       ///< so many times the matches may agree with another pose: rows of equal windows
  int max_iterations = 2000;    ///< of RANSAC
  double max_distance = 50.0;   ///< of facades [m]
  double max_incidence = 1.31;  ///< on them [rad]
};

/// A measured relative pose.
struct RelativePose {
  air_ground_common::Pose T_a_b = air_ground_common::Pose::Identity();  ///< body frame of b to that of a
  /// Order x y z rotX rotY rotZ in a's axes, R_true = exp(rot) R: image noise, and walls that are not where the model
  /// has them.
  air_ground_common::Matrix6d covariance = air_ground_common::Matrix6d::Zero();
  int inliers = 0;
};

/// Casts what is matched onto the model from `T_world_a`, and finds b from these points. An error of a along a facade
/// takes the points with it and leaves T_a_b as it is; one across to a facade is among the walls' unknown offsets.
/// Empty where too little agrees, all of it lies on one facade, or another pose fits nearly as well.
std::optional<RelativePose> measureRelativePose(const BearingFeatures& a, const air_ground_common::Pose& T_world_a,
                                                const BearingFeatures& b, const std::vector<Match>& matches,
                                                const BackProjector& projector,
                                                const RelativePoseSettings& settings = {});

/// The same of a seen from b.
RelativePose inverted(const RelativePose& relative);

/// Matches of `a` (query) with `b` (view).
std::vector<Match> matchBearings(const BearingFeatures& a, const BearingFeatures& b);

}  // namespace streetview_localizer
