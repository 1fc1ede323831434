// A street of textured houses with exact truth, its erroneous cadastral model, and panoramas taken in it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "air_ground_common/mesh.h"
#include "streetview_localizer/city_model.h"

namespace streetview_localizer {

struct SyntheticStreetSettings {
  std::uint64_t seed = 1;
  double length = 120;                ///< [m]
  double heading = 0.4;               ///< of the street, from x towards y [rad]
  double slope = 0.03;                ///< of the ground along the street
  double model_lateral_stddev = 0.1;  ///< of each house, one axis [m]
  double model_height_stddev = 0.5;   ///< of each house's roof [m]
  bool occluders = true;              ///< parked cars and people
  int image_width = 1024;             ///< of the panoramas [px]
};

class SyntheticStreet {
 public:
  explicit SyntheticStreet(const SyntheticStreetSettings& settings);
  const CityModel& model() const { return model_; }

  /// Pose of a panorama `along` metres down the street, with the car's small tilt.
  air_ground_common::Pose panoramaPose(double along, std::mt19937_64* random) const;
  cv::Mat render(const air_ground_common::Pose& T_world_panorama) const;
  /// The same seen by a perspective camera; body frame: x along the optical axis, y left, z up.
  cv::Mat photograph(const air_ground_common::CameraModel& camera, const air_ground_common::Pose& T_world_body) const;

 private:
  enum class Kind : std::uint8_t { kWall, kRoof, kGround, kBox };
  struct Patch {  // one planar quad or triangle fan; texture coordinates in metres from its first corner
    Kind kind = Kind::kWall;
    int house = -1;
    Eigen::Vector3f origin, along, up, normal;
    float length = 0;
    Eigen::Vector3f colour;
  };
  struct House {
    Eigen::Vector3f wall, trim, window;
    float pitch_x, pitch_y, fill_x, fill_y, offset, phase;
  };
  Eigen::Vector3d place(double along, double across, double height) const;
  void addPolygon(const std::vector<Eigen::Vector3d>& corners, Kind kind, int house, const Eigen::Vector3f& colour);
  void addBox(double s0, double s1, double q0, double q1, double height, const Eigen::Vector3f& colour);
  void addHouse(double s0, double s1, double q0, double q1, double height, double ridge, std::mt19937_64* random);
  Eigen::Vector3f shade(const Patch& patch, const Eigen::Vector3f& point) const;
  Eigen::Vector3f sky(const Eigen::Vector3f& direction) const;
  /// Colour of the pixel with this running number, the mean along four rays (unit, world).
  cv::Vec3b pixel(const Eigen::Vector3f& origin, const std::array<Eigen::Vector3f, 4>& rays, int number) const;

  SyntheticStreetSettings settings_;
  air_ground_common::TriangleMesh mesh_;
  std::vector<int> patch_of_triangle_;
  std::vector<Patch> patches_;
  std::vector<House> houses_;
  CityModel model_;
  std::unique_ptr<air_ground_common::MeshScene> scene_;
  Eigen::Vector3f sun_, light_;
};

/// A geotag as recorded: 3.7 m and 1.9 degrees from the truth on average.
air_ground_common::Pose drawGeotag(const air_ground_common::Pose& T_world_panorama, std::mt19937_64* random);

}  // namespace streetview_localizer
