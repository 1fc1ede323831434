// The odometry before it is sure of itself: gyro bias and gravity, the first views, and why it is not metric yet.
#include <algorithm>
#include <cmath>

#include "odometry_impl.h"

namespace mav_vo {

namespace {

constexpr double kMovingTilt = 0.3;     // of gravity as a moving accelerometer shows it [rad]
constexpr double kTrustedTilt = 0.05;   // better known gravity levels the bundle adjustment [rad]
constexpr double kMapTurnError = 8e-3;  // of the turn from a map's first keyframe to its newest [rad]
constexpr double kMapBiasSigma = 2e-3;  // of a gyro bias from a map, at the best [rad/s]

}  // namespace

// What a map that is not metric yet has seen with another readout time is not worth keeping.
void Odometry::Impl::alignImu(double stamp) {
  if (const auto readout = imu.alignShutter(stamp, tracker.features(), shutter.readoutTime())) {
    shutter.setReadoutTime(readout->readout_time);
    if (!metric && map.keyframeCount() > 0 && readout->large) startMap();
  }
  if (!imu.alignGyro(stamp, tracker.features())) return;
  // A map knows the bias better: its adjustment sees all of its keyframes.
  if (map.keyframeCount() == 0) bias.gyro = imu.gyroBias();
  imu.followBias(bias.gyro);
  if (imu.adoptTimeOffset()) retime();
}

// A map measures turns against landmarks it has triangulated: turn and translation, which image pairs confuse, are
// apart.
void Odometry::Impl::keepMapsBias() {
  if (!settings.use_imu || inertial.links.empty() || map.keyframeCount() < 2) return;
  const double lived = map.keyframe(map.lastKeyframe()).stamp - map.keyframes().begin()->second.stamp;
  const double sigma = std::max(kMapBiasSigma, kMapTurnError / std::max(lived, 0.1));
  imu.keepBias(inertial.states.rbegin()->second.bias.gyro, sigma);
}

std::optional<GyroRotation> Odometry::Impl::cameraTurn(double stamp_a, double stamp_b) const {
  if (!settings.use_imu) return std::nullopt;
  return imu.cameraTurn(stamp_a, stamp_b, bias.gyro);
}

// Levels the map with what is known of gravity, heading 0 at the first view's base_link.
void Odometry::Impl::levelFirstViews(const BootstrapResult& start, Pose* T_map_first, double* tilt) const {
  std::optional<Eigen::Vector3d> up;
  *tilt = kMovingTilt;
  if (imu.up() && imu.up()->sigma < kMovingTilt) {
    up = imu.up()->up_imu;
    *tilt = imu.up()->sigma;
  } else if (settings.use_imu && imu.attitude().initialized()) {
    up = imu.attitude().up();
  }
  // Without gravity the vehicle is taken to be level.
  Eigen::Matrix3d R_map_first = T_base_camera.linear();
  if (up)
    R_map_first =
        air_ground_common::levelingRotation(start.views.back().T_first_camera.linear() * (T_camera_imu.linear() * *up));
  const double yaw = air_ground_common::yawOf(R_map_first * T_base_camera.linear().transpose());
  T_map_first->setIdentity();
  T_map_first->linear() = Eigen::AngleAxisd(-yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix() * R_map_first;
}

void Odometry::Impl::initialize() {
  if (tracker.lastSurvival() < 0.7 || tracker.features().size() < 0.7 * settings.tracker.max_features)
    tracker.replenish();
  auto start = bootstrap.add(last_stamp, currentFeatures(), tracker.pyramid(),
                             [this](double a, double b) { return cameraTurn(a, b); });
  if (!start) {
    const std::string problem = settings.use_imu ? imu.problem() : "";
    reason = "initialising: " + (problem.empty() ? bootstrap.reason() : problem);
    return;
  }
  const BootstrapView &first = start->views.front(), &last = start->views.back();
  Pose T_map_first;
  double map_tilt = 0;
  levelFirstViews(*start, &T_map_first, &map_tilt);

  for (const auto& point : start->points) tracks.assign(point.track, map.addLandmark(T_map_first * point.position));
  for (BootstrapView& view : start->views) {
    Keyframe keyframe;
    keyframe.stamp = view.stamp;
    keyframe.T_map_camera = T_map_first * view.T_first_camera;
    for (const Feature& f : view.features) {
      visual_frontend::Observation o;
      o.landmark = tracks.landmarkOf(f.id);
      o.track = f.id;
      o.pixel = f.pixel;
      o.normalized = f.normalized;
      keyframe.observations.push_back(o);
    }
    keyframe.pyramid = std::move(view.pyramid);
    if (map_tilt < kTrustedTilt) {
      keyframe.up_camera = keyframe.T_map_camera.linear().transpose() * Eigen::Vector3d::UnitZ();
      keyframe.up_sigma = std::max(0.01, map_tilt);
    }
    insertKeyframe(std::move(keyframe));
  }
  bootstrap.reset();
  scale.begin(map_tilt);
  scene_distance = 1;
  velocity = (map.keyframe(map.lastKeyframe()).T_map_camera.translation() - T_map_first.translation()) /
             (last.stamp - first.stamp);
  T_map_camera = map.keyframe(map.lastKeyframe()).T_map_camera;
  located_stamp = -1;
  state = OdometryState::kScaling;
  reason = scaleReason();
  if (locate(false)) {
    localized(false);
    triangulateTracks(map.lastKeyframe());
  } else {
    startMap();
    reason = "initialising: the first map did not hold in the next image; another is tried";
  }
}

double Odometry::Impl::mapAge() const {
  return map.keyframeCount() == 0 ? 0 : last_stamp - map.keyframes().begin()->second.stamp;
}

std::string Odometry::Impl::scaleReason() const {
  if (!settings.use_imu) return "no IMU: lengths are in the map's own unit until the alignment tells it";
  if (!imu_problem.empty()) return imu_problem;
  if (const std::string problem = imu.problem(); !problem.empty()) return problem;
  return scale.reason(mapAge());
}

}  // namespace mav_vo
