// Neighbouring panoramas show the same facades: how two of them stand to each other is measured from their images, and
// contradicts a pose that fits the model's outline at a wrong place.
#pragma once

#include <functional>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/features.h"
#include "streetview_localizer/panorama_registration.h"
#include "streetview_localizer/panorama_views.h"

namespace streetview_localizer {

struct NeighbourSettings {
  int count = 4;                                      ///< of neighbours of an image, the nearest
  double max_distance = 25.0;                         ///< of them [m]
  double position = 0.5;                              ///< in plan; what is wrong by less is not looked for [m]
  double angle = 0.0087;                              ///< the same [rad]
  double sigmas = 3.0;                                ///< by which each of several neighbours must contradict a pose
  double sigmas_alone = 4.0;                          ///< the same of one alone
  double position_floor = 0.1, angle_floor = 0.0026;  ///< no registration is believed to be better [m], [rad]
  double measured_position = 0.05, measured_angle = 0.001;  ///< added to a measured relative pose [m], [rad]
  double search_radius = 1.0, search_yaw = 0.02;  ///< of a new registration around what neighbours say [m], [rad]

  /// What is matched: narrower views than the database's, which overlap little.
  PanoramaViewSettings views = {384, 640, 0.925, 0.7854, {0.2618}};
  FeatureSettings features = {0, 0.03, 10, false};
};

/// An image and its pose as the registration has it.
struct NeighbourImage {
  std::string name;                                      ///< in messages
  std::function<cv::Mat()> load;                         ///< 8-bit BGR; an empty one has no neighbours
  std::optional<air_ground_common::CameraModel> camera;  ///< of a photograph; none: equirectangular
  air_ground_common::Pose T_world_image =
      air_ground_common::Pose::Identity();  ///< body frame; the geotag if not registered
  bool registered = true;
  bool fixed = false;                                  ///< its pose cannot be changed any more
  double position_stddev = 0, orientation_stddev = 0;  ///< one axis [m], [rad]
};

/// The measured relative pose of two images.
struct NeighbourEdge {
  int a = 0, b = 0;                                                     ///< of the images
  air_ground_common::Pose T_a_b = air_ground_common::Pose::Identity();  ///< body frame of b to that of a
  /// Order x y z rotX rotY rotZ in a's axes, R_true = exp(rot) R.
  air_ground_common::Matrix6d covariance = air_ground_common::Matrix6d::Zero();
};

/// What the neighbours say of an image.
struct NeighbourVerdict {
  enum class Kind {
    kUnopposed,     ///< agrees with its neighbours, or has none that say anything
    kDoubtful,      ///< more contradict than agree, too few to decide
    kContradicted,  ///< at least two place it elsewhere, more than agree with it
    kPlaced         ///< not registered; at least two place it
  };
  Kind kind = Kind::kUnopposed;
  std::vector<int> witnesses;  ///< the neighbours that place it elsewhere
  air_ground_common::Pose T_world_image = air_ground_common::Pose::Identity();  ///< where they do, their mean
};

/// Measures each pair of neighbours of which one is not fixed. Runs in `threads` threads; the result does not depend on
/// their number. `progress` is called with images done and images in all, from one thread at a time.
std::vector<NeighbourEdge> measureNeighbours(const std::vector<NeighbourImage>& images, const BackProjector& projector,
                                             const NeighbourSettings& settings, int threads,
                                             const std::function<void(int, int)>& progress = {});

/// Judges each image by its edges. The one that is contradicted most is judged first, and has no say in the others.
std::vector<NeighbourVerdict> judgeNeighbours(const std::vector<NeighbourImage>& images,
                                              const std::vector<NeighbourEdge>& edges,
                                              const NeighbourSettings& settings);

/// What becomes of an image.
struct NeighbourOutcome {
  enum class Kind {
    kKept,      ///< as it was
    kDoubtful,  ///< kept, with larger standard deviations and a remark
    kAnew,      ///< was contradicted; registered anew where its neighbours place it
    kGained,    ///< was not registered; is now, where its neighbours place it
    kRefused    ///< is contradicted, and the outline does not fit where its neighbours place it
  };
  Kind kind = Kind::kKept;
  air_ground_common::Pose T_world_image = air_ground_common::Pose::Identity();  ///< of an image that is not refused
  double position_stddev = 0, orientation_stddev = 0;                           ///< its, one axis [m], [rad]
  std::string remark;  ///< one line: what the neighbours say; empty for what is kept
};

/// Registers anew what is contradicted or placed, and draws the conclusions. `registration`: settings of the build,
/// whose threads are used.
std::vector<NeighbourOutcome> settleNeighbours(const std::vector<NeighbourImage>& images,
                                               const std::vector<NeighbourVerdict>& verdicts, const CityModel& model,
                                               const RegistrationSettings& registration,
                                               const NeighbourSettings& settings,
                                               const std::function<void(int, int)>& progress = {});

/// True when a pose is within settings.position and settings.angle of another.
bool agrees(const air_ground_common::Pose& T_world_a, const air_ground_common::Pose& T_world_b,
            const NeighbourSettings& settings);

/// The registration around a place that neighbours tell: a search of decimetres with a prior as good.
RegistrationSettings aroundNeighbours(RegistrationSettings registration, const NeighbourSettings& settings);

}  // namespace streetview_localizer
