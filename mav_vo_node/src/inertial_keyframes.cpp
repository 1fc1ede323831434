#include "inertial_keyframes.h"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace mav_vo {

using visual_frontend::InertialState;
using visual_frontend::Keyframe;
using visual_frontend::KeyframeId;

namespace {

constexpr double kLinkGate = 30.7;        // chi-squared, three degrees of freedom, one in a million
constexpr double kStrictGate = 7.8;       // likewise, one in twenty
constexpr double kVelocityStddev = 0.05;  // of a keyframe's adjusted velocity [m/s]
constexpr double kFineMounting = 0.009;   // of a mounting that the tracks do not find to be another [rad]
constexpr double kTurnStddev = 0.005;     // of the turn between two keyframes by their landmarks [rad]

}  // namespace

InertialKeyframes::InertialKeyframes(const OdometrySettings& settings, const Pose& T_camera_imu)
    : accel_bias_stddev_(settings.scale.accel_bias_stddev),
      position_stddev_(settings.scale.position_stddev),
      mounting_stddev_(std::min(kFineMounting, settings.imu_rotation_stddev)),
      R_camera_imu_(T_camera_imu.linear()) {
  data_.T_camera_imu = T_camera_imu;
}

void InertialKeyframes::clear() {
  data_.states.clear();
  data_.links.clear();
  data_.metric = false;
}

bool InertialKeyframes::contradicts(const Preintegration& motion, const Keyframe& previous, const Keyframe& keyframe,
                                    double gyro_bias_stddev, double scene_distance, bool strictly) const {
  const double gate = strictly ? kStrictGate : kLinkGate;
  const double dt = motion.duration();
  const InertialState& before = data_.states.at(previous.id);
  const Pose T_before = previous.T_map_camera * data_.T_camera_imu,
             T_after = keyframe.T_map_camera * data_.T_camera_imu;
  const double turn =
      air_ground_common::rotationAngle(T_before.linear() * motion.rotation(before.bias), T_after.linear());
  const double turn_sigma = std::hypot(kTurnStddev, gyro_bias_stddev * dt);
  if (turn * turn > gate * turn_sigma * turn_sigma) return true;
  if (!metric()) return false;
  const Eigen::Vector3d p = T_before.translation() + before.velocity * dt -
                            0.5 * dt * dt * kGravity * Eigen::Vector3d::UnitZ() +
                            T_before.linear() * motion.position(before.bias);
  const double sigma =
      std::hypot(kVelocityStddev * dt, 0.5 * dt * dt * accel_bias_stddev_, position_stddev_ * scene_distance);
  return (T_after.translation() - p).squaredNorm() > gate * sigma * sigma;
}

void InertialKeyframes::add(KeyframeId id, const Keyframe* previous, const std::optional<Preintegration>& motion,
                            const ImuBias& bias, const Eigen::Vector3d& velocity) {
  InertialState state{velocity, bias};
  if (motion) {
    data_.links.emplace(id, *motion);
    if (metric()) {
      const InertialState& before = data_.states.at(previous->id);
      const Eigen::Matrix3d R = previous->T_map_camera.linear() * data_.T_camera_imu.linear();
      state.velocity =
          before.velocity + Eigen::Vector3d(0, 0, -kGravity) * motion->duration() + R * motion->velocity(before.bias);
      state.bias = before.bias;
    }
  }
  data_.states[id] = state;
}

void InertialKeyframes::remove(KeyframeId id, const visual_frontend::Map& map) {
  data_.links.erase(id);
  data_.links.erase(std::next(map.keyframes().find(id))->first);  // it began here
  data_.states.erase(id);
}

void InertialKeyframes::forgetLinksBefore(KeyframeId id) {
  data_.links.erase(data_.links.begin(), data_.links.lower_bound(id));
}

visual_frontend::BundleProblem::Mounting InertialKeyframes::openMounting() const {
  visual_frontend::BundleProblem::Mounting open;
  open.mean = -air_ground_common::logSO3(mounting());
  open.sigma = mounting_stddev_;
  return open;
}

void InertialKeyframes::mount(const Eigen::Vector3d& turn) {
  data_.T_camera_imu.linear() *= air_ground_common::expSO3(turn);
}

void InertialKeyframes::turn(const Eigen::Matrix3d& R_new_old, const visual_frontend::Map& map) {
  mountAsGiven();
  for (auto& link : data_.links) link.second = link.second.turned(R_new_old);
  for (auto& [id, state] : data_.states) {
    const Eigen::Vector3d up =
        (map.keyframe(id).T_map_camera.linear() * data_.T_camera_imu.linear()).transpose().col(2);
    const Eigen::Vector3d reads = kGravity * up + state.bias.accel;
    state.bias.accel += R_new_old * reads - reads;
    state.bias.gyro = (R_new_old * state.bias.gyro).eval();
  }
}

void InertialKeyframes::makeMetric(const visual_frontend::Map& map, const Eigen::Vector3d& accel_bias) {
  data_.metric = true;
  const Eigen::Vector3d g(0, 0, -kGravity);
  for (auto it = map.keyframes().begin(); it != map.keyframes().end(); ++it) {
    InertialState& here = data_.states[it->first];
    here.bias.accel = accel_bias;
    const auto next = std::next(it);
    const auto link = next == map.keyframes().end() ? data_.links.end() : data_.links.find(next->first);
    if (link != data_.links.end()) {
      const Preintegration& motion = link->second;
      const double dt = motion.duration();
      const Pose T_a = it->second.T_map_camera * data_.T_camera_imu,
                 T_b = next->second.T_map_camera * data_.T_camera_imu;
      here.velocity =
          (T_b.translation() - T_a.translation() - 0.5 * dt * dt * g - T_a.linear() * motion.position(here.bias)) / dt;
    } else if (it != map.keyframes().begin() && data_.links.count(it->first)) {
      const auto previous = std::prev(it);
      const Preintegration& motion = data_.links.at(it->first);
      here.velocity = data_.states[previous->first].velocity + g * motion.duration() +
                      previous->second.T_map_camera.linear() * data_.T_camera_imu.linear() * motion.velocity(here.bias);
    }
  }
}

}  // namespace mav_vo
