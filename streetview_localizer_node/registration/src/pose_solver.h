// Fits the model's outline to a panorama's: coarse search over the ground plane and the heading, then all six degrees
// of freedom together with the errors of the buildings.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"
#include "model_outline.h"
#include "panorama_image.h"
#include "sky.h"
#include "streetview_localizer/panorama_registration.h"

namespace streetview_localizer::registration {

constexpr int kLargestWidth = 2048;  ///< finer panoramas are reduced: the model is not as fine [px]

/// A panorama turned level, and what was found in it. Frame `level`: z up as the image's vertical lines tell.
struct ImageCues {
  cv::Mat image, mask;  ///< level, BGR; mask empty or 255 where the image is
  Eigen::Matrix3d R_body_level = Eigen::Matrix3d::Identity();
  double tilt_stddev = 0;  ///< [rad]
  SkyLine sky;
  std::vector<Segment> segments;
  std::vector<float> tangent;  ///< of the sky line's elevation, per bin of the profile; NaN where unknown
  std::optional<VerticalEvidence> evidence;
};

/// `R_world_geotag` gives the first guess of what is up.
ImageCues findCues(const cv::Mat& bgr, const cv::Mat& mask, const Eigen::Matrix3d& R_world_geotag,
                   const RegistrationSettings& settings);

/// Headings at one place that differ by more are places of their own; wider than the default search's window [rad].
constexpr double kOtherHeading = 0.26;

struct Candidate {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  double yaw = 0;   ///< of level in world [rad]
  double cost = 0;  ///< mean of the sky line's truncated difference [rad]
};

/// Places and headings where the model's sky line is like the image's, best first, none near a better one.
std::vector<Candidate> searchCandidates(const ModelOutline& model, const std::vector<ModelEdge>& edges,
                                        const ImageCues& cues, const air_ground_common::Pose& T_world_geotag,
                                        const RegistrationSettings& settings);

struct Fit {
  air_ground_common::Pose T_world_level = air_ground_common::Pose::Identity();
  air_ground_common::Matrix6d covariance = air_ground_common::Matrix6d::Zero();  ///< x y z rotX rotY rotZ, world axes
  double cost = 1;                                                               ///< mean robust cost, in [0, 1]
  double sky_ratio = 0;     ///< share of the model's sky line that the image's confirms
  double sky_angle = 0;     ///< length of the model's sky line [rad]
  int verticals = 0;        ///< corners and gaps found
  int verticals_seen = 0;   ///< that should be seen
  double facade_ratio = 0;  ///< share of the segments on facades that run level
  bool valid = false;
};

Fit refinePose(const ModelOutline& model, const std::vector<ModelEdge>& edges, const ImageCues& cues,
               const Candidate& start, const air_ground_common::Pose& T_world_geotag,
               const RegistrationSettings& settings);

struct Selection {
  Fit fit;                 ///< the best; not valid if there is none
  double second_cost = 1;  ///< of the best fit at another place
  bool accepted = false;
  std::string reason;  ///< why not
};

/// Search, refinement of every candidate, and the decision whether the best is to be believed.
Selection selectPose(const ModelOutline& model, const ImageCues& cues, const air_ground_common::Pose& T_world_geotag,
                     const RegistrationSettings& settings);

}  // namespace streetview_localizer::registration
