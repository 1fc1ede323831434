// Which way is up in the map: from rest at the start, then from the motion that camera and IMU agree on.
#pragma once

#include <optional>
#include <utility>

#include "camera_motion.h"
#include "rgbd_slam/slam.h"

namespace rgbd_slam {

class MapLevel {
 public:
  explicit MapLevel(const SlamSettings& settings) : settings_(settings) {}

  void clear() { known_ = settled_ = by_surfaces_ = false; }
  /// A new map, level as far as the accelerometer tells; null: nothing tells.
  void begin(const visual_frontend::AttitudeFilter* attitude);
  /// The gyro contradicts the images: which way is up comes from it, too, whenever the robot moves, and by the same
  /// mounting. From now on the base counts as level as it stood at first, in a map that may lean against that.
  void distrust(const Pose& T_map_first_base);

  struct Correction {
    Eigen::Matrix3d R;      ///< levels the map, turned about its origin
    bool directions_false;  ///< up in the keyframes was of an accelerometer in motion
  };
  /// When the map leans for certain, T_map_camera being the pose at `stamp`. T_map_first_base: whose yaw stays.
  std::optional<Correction> update(double stamp, const CameraMotion& motion, const Pose& T_map_camera,
                                   const Pose& T_map_first_base);

  /// By what lies flat (surface_vertical.h), in a map that no accelerometer levels; `up` in the map.
  std::optional<Correction> takeSurfaces(const Eigen::Vector3d& up, const Pose& T_map_first_base);

  /// Up in a camera and its standard deviation [rad], to hold a keyframe by.
  std::optional<std::pair<Eigen::Vector3d, double>> upInCamera(double stamp, const Eigen::Matrix3d& R_map_camera,
                                                               const CameraMotion& motion) const;
  bool known() const { return known_; }  ///< the map was levelled by the accelerometer
  bool bySurfaces() const { return by_surfaces_; }
  bool settled() const { return settled_; }  ///< for good, or there is nothing to level with
  double sigma() const { return sigma_; }    ///< of the map's z axis, what it is known to lean included [rad]
  const Vertical& vertical() const { return vertical_; }

 private:
  static constexpr double kNoGravity = 0.05;  // how far a robot may lean that nothing levels [rad]

  SlamSettings settings_;
  static Eigen::Matrix3d levelling(const Eigen::Vector3d& up, const Pose& T_map_first_base);

  bool known_ = false, settled_ = false, by_surfaces_ = false;
  double sigma_ = kNoGravity;
  Vertical vertical_{Eigen::Vector3d::UnitZ(), kNoGravity};
};

}  // namespace rgbd_slam
