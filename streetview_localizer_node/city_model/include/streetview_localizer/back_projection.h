// Casts the pixels of posed images onto the city model: which features of an image lie on which facade, and where.
#pragma once

#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "streetview_localizer/city_model.h"
#include "streetview_localizer/types.h"

namespace streetview_localizer {

struct BackProjectionSettings {
  double max_incidence = 1.31;  ///< between ray and facade normal; beyond, a pixel smears over the wall [rad]
  double min_depth = 1.0;       ///< along the ray [m]
  double max_depth = 50.0;      ///< along the ray [m]
  double edge_distance = 3.0;   ///< features nearer than this to a depth discontinuity of the model are dropped [px]
  double discontinuity = 0.3;   ///< a neighbouring ray this far off the feature's own plane is one [m]
  bool walls_only = false;      ///< true: roofs and attached parts are dropped too
};

/// Where a pixel's ray meets the model.
struct SurfacePoint {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();   ///< in world [m]
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< unit, towards the viewer
  double distance = 0;                               ///< along the ray [m]
  int triangle = -1;
};

/// Why features were dropped.
struct BackProjectionCounts {
  int kept = 0, sky = 0, ground = 0, range = 0, grazing = 0, edge = 0;
};

/// The model as a camera sees it. Misses (sky): depth 0, triangle -1.
struct ModelImage {
  cv::Mat depth;     ///< CV_32F, z of the optical frame [m]
  cv::Mat triangle;  ///< CV_32S, index into the mesh
};

/// Copies nothing of the model but its mesh into Embree; keeps a reference. Methods are thread-safe.
class BackProjector {
 public:
  /// Throws std::invalid_argument for a model without triangles.
  explicit BackProjector(const CityModel& model, const BackProjectionSettings& settings = {});
  ~BackProjector();
  BackProjector(BackProjector&&) noexcept;

  /// Nearest surface on the ray from `origin` (world) along `direction` (world, any length).
  std::optional<SurfacePoint> cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;

  /// Keeps those of view.features whose ray meets a building under the settings; fills view.points and view.normals.
  BackProjectionCounts apply(View* view) const;

  /// Depth and triangle of every pixel (packets of eight rays).
  ModelImage render(const air_ground_common::CameraModel& camera, const air_ground_common::Pose& T_world_camera) const;

  const CityModel& model() const;
  const air_ground_common::MeshScene& scene() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace streetview_localizer
