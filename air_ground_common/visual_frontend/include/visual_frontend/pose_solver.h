// Camera pose from 3D-2D correspondences: minimal solvers, RANSAC, and motion-only refinement with covariance.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "visual_frontend/types.h"

namespace visual_frontend {

struct PoseCorrespondence {
  Eigen::Vector3d p_map = Eigen::Vector3d::Zero();       ///< [m]
  Eigen::Vector2d normalized = Eigen::Vector2d::Zero();  ///< undistorted x/z, y/z
  double sigma = 1.0 / 500;                              ///< of each normalised coordinate (pixel sigma / focal length)
  double depth = 0;                                      ///< measured z in the camera [m]; 0 = none
  double depth_sigma = 0;                                ///< [m]
  double elongation = 1;                                 ///< of the noise (NormalizedNoise)
};

struct RansacSettings {
  double threshold = 2.5;     ///< inlier: reprojection error below this many sigmas
  double confidence = 0.995;  ///< probability of having drawn one clean sample
  int max_iterations = 300;
  int min_inliers = 12;
  unsigned seed = 1;
};

enum class RobustLoss { kNone, kHuber, kCauchy };

/// What something else than points tells of a pose.
struct PosePrior {
  Pose T_map_camera = Pose::Identity();
  /// Of (translation, rotation) of a perturbation d in T_map_camera * exp(d); singular where nothing is told.
  Matrix6d information = Matrix6d::Zero();
};

struct RefineSettings {
  RobustLoss loss = RobustLoss::kHuber;
  double loss_width = 1.5;  ///< in sigmas
  int max_iterations = 15;
  double inlier_threshold = 2.8;  ///< sigmas (2 DoF, about 98 %); of the final inlier flags and of the covariance
  double min_step = 1e-6;         ///< norm of the step (m, rad) at which iterations end
  bool use_depth = true;
  /// Prior on the rotation: R_map_camera with a standard deviation [rad] about each map axis.
  std::optional<Eigen::Matrix3d> R_map_camera_prior;
  double rotation_prior_sigma = 0.01;
  /// Prior on roll and pitch: the direction up (+z of the map) in the camera frame.
  std::optional<Eigen::Vector3d> up_camera;
  double up_sigma = 0.02;          ///< [rad]
  std::optional<PosePrior> prior;  ///< with it no number of points is asked for, but that all together fix the pose
};

struct PoseResult {
  bool success = false;
  std::string reason;  ///< why not, empty on success
  Pose T_map_camera = Pose::Identity();
  /// Of (x, y, z, rotX, rotY, rotZ): camera position in the map and rotation about the map's axes [m, rad].
  Matrix6d covariance = Matrix6d::Zero();
  std::vector<unsigned char> inliers;  ///< one flag a correspondence
  int inlier_count = 0;
  double rms = 0;  ///< reprojection error of the inliers, root mean square per coordinate, in sigmas
  int iterations = 0;
};

/// Translation from two points with known rotation (P2P; Kneip, Chli, Siegwart, BMVC 2011): the camera centre c that
/// minimises the squared distances of both rays to their points. Empty when the rays are parallel or a point would lie
/// behind the camera. `ray` in the camera frame, any length, z > 0.
std::optional<Eigen::Vector3d> solveP2P(const Eigen::Matrix3d& R_map_camera, const Eigen::Vector3d& p_map_0,
                                        const Eigen::Vector3d& ray_0, const Eigen::Vector3d& p_map_1,
                                        const Eigen::Vector3d& ray_1);

/// Up to four poses, without memory from the heap: for loops over many samples.
struct P3PSolutions {
  int size = 0;
  Eigen::Matrix3d R_map_camera[4];
  Eigen::Vector3d t_map_camera[4];
};

/// Up to four poses from three points (Kneip, Scaramuzza, Siegwart, CVPR 2011); rays in the camera frame, any length.
/// None for points on a line or rays in a plane.
P3PSolutions solveP3PFixed(const Eigen::Matrix3d& p_map_columns, const Eigen::Matrix3d& ray_columns);
std::vector<Pose> solveP3P(const Eigen::Matrix3d& p_map_columns, const Eigen::Matrix3d& ray_columns);

/// RANSAC with P2P: rotation known (gyro), two points a sample. The result keeps that rotation; refine afterwards.
PoseResult ransacKnownRotation(const std::vector<PoseCorrespondence>& correspondences,
                               const Eigen::Matrix3d& R_map_camera, const RansacSettings& settings);

/// RANSAC with P3P and one more point to choose among its solutions.
PoseResult ransacPose(const std::vector<PoseCorrespondence>& correspondences, const RansacSettings& settings);

/// Levenberg-Marquardt on the pose alone, from `initial`; analytic Jacobians, robust loss, covariance from the inliers'
/// information scaled by max(1, chi^2 per degree of freedom). Fails (success false, with the reason) when fewer than 4
/// inliers remain (3 with depth) or the information is singular. `chosen`, one flag a correspondence: the first
/// iterations go by these alone, e.g. RANSAC's inliers; empty: by all in front of the camera. What agrees with the
/// pose they give decides in the end.
PoseResult refinePose(const std::vector<PoseCorrespondence>& correspondences, const Pose& initial,
                      const RefineSettings& settings, const std::vector<unsigned char>& chosen = {});

/// Relative rotation known, two views of unknown points: direction of translation from two correspondences (epipolar
/// constraint is linear in t): RANSAC, then all inliers. For monocular initialisation.
struct TranslationDirection {
  bool success = false;
  std::string reason;
  Eigen::Vector3d t_a_b = Eigen::Vector3d::UnitZ();  ///< unit: camera b in camera a; points in front of both
  std::vector<unsigned char> inliers;
  int inlier_count = 0;
  double median_parallax = 0;  ///< angle between the rays after derotation, over the inliers [rad]
};
/// `a`, `b`: normalised coordinates of the same points; r_a = R_a_b * r_b. `sigma` of a normalised coordinate near the
/// optical axis; `noise_a`, `noise_b` of each point, for wide-angle lenses (empty: sigma everywhere).
TranslationDirection translationFromKnownRotation(const std::vector<Eigen::Vector2d>& a,
                                                  const std::vector<Eigen::Vector2d>& b, const Eigen::Matrix3d& R_a_b,
                                                  double sigma, const RansacSettings& settings,
                                                  const std::vector<NormalizedNoise>& noise_a = {},
                                                  const std::vector<NormalizedNoise>& noise_b = {});

}  // namespace visual_frontend
