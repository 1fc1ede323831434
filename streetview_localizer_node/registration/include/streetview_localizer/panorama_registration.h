// Corrects the pose of an equirectangular panorama against the city model, after Taneja, Ballan, Pollefeys,
// "Registration of spherical panoramic images with cadastral 3D models", 3DIMPVT 2012. Method:
// docs/panorama_registration.md.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "streetview_localizer/city_model.h"

namespace streetview_localizer {

struct RegistrationSettings {
  // Search around the geotag. The defaults are of Street View; telephones and action cameras are far worse.
  double search_radius = 9.0;          ///< in the horizontal plane [m]
  double search_yaw = 0.12;            ///< to either side, pi: the full circle [rad]
  double geotag_stddev = 3.0;          ///< horizontal, one axis [m]; 2.95 is a mean error of 3.7 m
  double heading_stddev = 0.035;       ///< of the geotag's yaw [rad]
  double tilt_stddev = 0.03;           ///< of the geotag's roll and pitch [rad]
  double height_stddev = 3.0;          ///< of the geotag's height [m]
  double camera_height = 2.5;          ///< above the model's ground [m]; 0 = not known
  double camera_height_stddev = 0.15;  ///< of camera_height together with the ground's own error [m]
  double model_radius = 120.0;         ///< buildings farther away are not looked at [m]

  // Errors of the model, one axis, the same for all of a building.
  double model_lateral_stddev = 0.1;  ///< [m]
  double model_height_stddev = 0.5;   ///< of roof lines [m]

  // Eaves, gutters and cornices stand out from the walls; with 0 and a small deviation for models that contain them.
  double roof_overhang = 0.15;         ///< [m]
  double roof_overhang_stddev = 0.15;  ///< of the mean over a panorama's buildings [m]

  // When a correction is believed.
  double max_position_stddev = 0.4;        ///< horizontal, the larger axis [m]
  double max_orientation_stddev = 0.0175;  ///< the largest axis [rad]

  int threads = 1;  ///< of registerPanoramas; one panorama is always one thread's work
};

struct RegistrationResult {
  /// The corrected pose if accepted, else the geotag. Body frame: x towards the image's centre, y left, z up.
  air_ground_common::Pose T_world_panorama = air_ground_common::Pose::Identity();
  bool accepted = false;
  std::string reason;             ///< why not; empty when accepted
  double position_stddev = 0;     ///< root mean square over the three axes [m]
  double orientation_stddev = 0;  ///< the same of the rotation vector [rad]
  double cost = 0;                ///< mean robust cost of an outline sample, 0 (perfect) to 1
  double inlier_ratio = 0;        ///< of the model's visible sky line, the part found in the image
  /// Order x y z rotX rotY rotZ, about the panorama's centre in world axes: R = exp(rot) R_estimated. Rejected: of the
  /// geotag.
  air_ground_common::Matrix6d covariance = air_ground_common::Matrix6d::Zero();
};

/// One image of a drive.
struct RegistrationInput {
  std::function<cv::Mat()> load;                         ///< 8-bit BGR; called once
  std::optional<air_ground_common::CameraModel> camera;  ///< of a perspective photograph; none: equirectangular
  air_ground_common::Pose T_world_geotag = air_ground_common::Pose::Identity();
  bool heading_known = true;  ///< false: the geotag's yaw means nothing, the full circle is searched
};

/// What is left of the geotag where it is not corrected: its covariance, in the order of RegistrationResult's.
/// `heading_known`: false for a yaw that means nothing.
air_ground_common::Matrix6d geotagCovariance(const RegistrationSettings& settings, bool heading_known = true);

class PanoramaRegistrar {
 public:
  /// Uses the model's mesh, surface and building, and keeps what it needs of them. Throws std::invalid_argument for a
  /// model without buildings, lists of unequal length or a setting out of range.
  explicit PanoramaRegistrar(const CityModel& model, const RegistrationSettings& settings = {});
  ~PanoramaRegistrar();
  PanoramaRegistrar(const PanoramaRegistrar&) = delete;
  PanoramaRegistrar& operator=(const PanoramaRegistrar&) = delete;

  /// `equirect_bgr`: 8-bit BGR, width = 2 height, column 0 looks backwards (azimuth +pi), azimuth falls to the right.
  /// Throws std::invalid_argument for another kind of image; what cannot be corrected is a result with a reason.
  /// `heading_known`: as in RegistrationInput.
  RegistrationResult registerPanorama(const cv::Mat& equirect_bgr, const air_ground_common::Pose& T_world_geotag,
                                      bool heading_known = true) const;

  /// The same for a wide perspective photograph, which must fit better to be believed. Body frame: x along the optical
  /// axis, y left, z up. Throws std::invalid_argument for an image of another size than the camera's.
  RegistrationResult registerPhotograph(const cv::Mat& bgr, const air_ground_common::CameraModel& camera,
                                        const air_ground_common::Pose& T_world_geotag, bool heading_known = true) const;

  /// Height of the ground at a place in world [m]: the model's terrain, or where it has none as the feet of the walls
  /// within 80 m tell; empty where there are none either.
  std::optional<double> groundHeight(const Eigen::Vector3d& position) const;

  /// Registers each image on its own, several at once. `progress`, if given, is called with the number done. An image
  /// whose load() throws or returns an empty image is reported as rejected.
  std::vector<RegistrationResult> registerPanoramas(const std::vector<RegistrationInput>& panoramas,
                                                    const std::function<void(std::size_t)>& progress = {}) const;

  /// The image with the model's outline from a pose drawn over it: skyline red, corners and gaps yellow, foot of the
  /// walls green.
  cv::Mat drawOutline(const cv::Mat& equirect_bgr, const air_ground_common::Pose& T_world_panorama) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace streetview_localizer
