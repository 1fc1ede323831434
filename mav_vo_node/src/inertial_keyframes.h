// What the IMU tells of a map's keyframes: their velocities and biases, and the motion from one to the next.
#pragma once

#include <optional>

#include "mav_vo/odometry.h"
#include "visual_frontend/bundle_job.h"

namespace mav_vo {

class InertialKeyframes {
 public:
  InertialKeyframes(const OdometrySettings& settings, const Pose& T_camera_imu);

  /// Another map, which is not metric.
  void clear();
  bool metric() const { return data_.metric; }
  /// The map has become metric: velocities from its positions and the motion between them, biases of the
  /// accelerometer as given [m/s^2].
  void makeMetric(const visual_frontend::Map& map, const Eigen::Vector3d& accel_bias);

  /// Whether a keyframe cannot have come about by this motion from the one before it. Where the camera saw nothing the
  /// vehicle may have been carried off, or the IMU's stamps hide a hole: such a link would tear the map.
  /// `gyro_bias_stddev` [rad/s]. `strictly`: where the IMU has contradicted before.
  bool contradicts(const Preintegration& motion, const visual_frontend::Keyframe& previous,
                   const visual_frontend::Keyframe& keyframe, double gyro_bias_stddev, double scene_distance,
                   bool strictly = false) const;
  /// A keyframe that follows `previous` by `motion`; none: not linked, and so fast as given [m/s].
  void add(visual_frontend::KeyframeId id, const visual_frontend::Keyframe* previous,
           const std::optional<Preintegration>& motion, const ImuBias& bias, const Eigen::Vector3d& velocity);
  /// Before keyframe `id`, which is not the first or last, leaves the map.
  void remove(visual_frontend::KeyframeId id, const visual_frontend::Map& map);
  /// The IMU's samples between keyframes that stay where they are serve nothing.
  void forgetLinksBefore(visual_frontend::KeyframeId id);
  /// Links integrated anew by `between` (two stamps, and the link's bias), where it gives one.
  template <class Between>
  void integrateAnew(const visual_frontend::Map& map, const Between& between) {
    for (auto& link : data_.links) {
      const auto here = map.keyframes().find(link.first);
      if (here == map.keyframes().end() || here == map.keyframes().begin()) continue;
      const auto motion = between(std::prev(here)->second.stamp, here->second.stamp, link.second.bias());
      if (motion) link.second = *motion;
    }
  }

  /// The IMU's axes have become others, and what adjustments have found of them is void; what its accelerometer reads
  /// stays, so its bias takes up the difference.
  void turn(const Eigen::Matrix3d& R_new_old, const visual_frontend::Map& map);

  /// How far the IMU may be turned yet against its mounting as given, for an adjustment of the whole map.
  visual_frontend::BundleProblem::Mounting openMounting() const;
  /// As such an adjustment, whose poses and states are in the map, has found it [rad].
  void mount(const Eigen::Vector3d& turn);
  void mountAsGiven() { data_.T_camera_imu.linear() = R_camera_imu_; }
  /// From the IMU's axes to those that it was given to have, as adjustments have found them.
  Eigen::Matrix3d mounting() const { return R_camera_imu_.transpose() * data_.T_camera_imu.linear(); }

  bool linked() const { return !data_.links.empty(); }
  /// Of the newest keyframe; null: there is none.
  const ImuBias* newestBias() const { return data_.states.empty() ? nullptr : &data_.states.rbegin()->second.bias; }
  const visual_frontend::InertialMap& data() const { return data_; }
  visual_frontend::InertialMap& data() { return data_; }  ///< for applyBundle

 private:
  double accel_bias_stddev_, position_stddev_, mounting_stddev_;
  Eigen::Matrix3d R_camera_imu_;  // as given
  visual_frontend::InertialMap data_;
};

}  // namespace mav_vo
