#include <algorithm>
#include <chrono>
#include <cmath>

#include "odometry_impl.h"
#include "visual_frontend/local_landmarks.h"

namespace mav_vo {

namespace {

constexpr double kMovingShare = 0.01;       // of the scene's distance; below, the vehicle hovers
constexpr double kHoverInterval = 3.0;      // a keyframe once the vehicle hovers, so that inertial links stay short [s]
constexpr double kLongHoverInterval = 9.0;  // and while it goes on hovering; the IMU's samples reach back 12 s [s]
constexpr double kTrustedTilt = 0.05;       // better known gravity levels the bundle adjustment [rad]
constexpr double kLeastParallax = 10;       // of a new landmark, in standard deviations of a ray
constexpr double kLinkGate = 30.7;          // chi-squared, three degrees of freedom, one in a million
constexpr double kVelocityStddev = 0.05;    // of a keyframe's adjusted velocity [m/s]
constexpr double kTurnStddev = 0.005;       // of the turn between two keyframes by their landmarks [rad]

}  // namespace

bool Odometry::Impl::needsKeyframe() const {
  const Keyframe& last = map.keyframe(map.lastKeyframe());
  const double elapsed = last_stamp - last.stamp;
  if (visual_frontend::changeOfView(last.T_map_camera, T_map_camera, scene_distance,
                                    {settings.keyframe_distance, settings.keyframe_angle}) > 1)
    return true;
  if (keyframe_landmarks > 0 && inliers < settings.keyframe_overlap * keyframe_landmarks) return true;
  const double distance = (T_map_camera.translation() - last.T_map_camera.translation()).norm();
  if (elapsed > settings.keyframe_max_interval && distance > kMovingShare * scene_distance) return true;
  return elapsed > (hovering && !moved(last) ? kLongHoverInterval : kHoverInterval);
}

bool Odometry::Impl::moved(const Keyframe& since) const {
  return visual_frontend::changeOfView(since.T_map_camera, T_map_camera, scene_distance,
                                       {kMovingShare, 0.25 * settings.keyframe_angle}) > 1;
}

// Where the camera saw nothing the vehicle may have been carried off, or the IMU's stamps hide a hole: such a link
// would tear the map.
bool Odometry::Impl::contradicts(const Preintegration& motion, KeyframeId previous, const Keyframe& keyframe) const {
  const double dt = motion.duration();
  const visual_frontend::InertialState& before = inertial.states.at(previous);
  const Pose T_before = map.keyframe(previous).T_map_camera * T_camera_imu,
             T_after = keyframe.T_map_camera * T_camera_imu;
  const double turn =
      air_ground_common::rotationAngle(T_before.linear() * motion.rotation(before.bias), T_after.linear());
  const double turn_sigma = std::hypot(kTurnStddev, imu.gyroBiasStddev() * dt);
  if (turn * turn > kLinkGate * turn_sigma * turn_sigma) return true;
  if (!metric) return false;
  const Eigen::Vector3d p = T_before.translation() + before.velocity * dt -
                            0.5 * dt * dt * kGravity * Eigen::Vector3d::UnitZ() +
                            T_before.linear() * motion.position(before.bias);
  const double sigma = std::hypot(kVelocityStddev * dt, 0.5 * dt * dt * settings.scale.accel_bias_stddev,
                                  settings.scale.position_stddev * scene_distance);
  return (T_after.translation() - p).squaredNorm() > kLinkGate * sigma * sigma;
}

void Odometry::Impl::insertKeyframe(Keyframe keyframe) {
  const double stamp = keyframe.stamp;
  const KeyframeId previous = map.lastKeyframe();
  std::optional<Preintegration> motion;
  if (settings.use_imu && previous != visual_frontend::kNoKeyframe)
    motion = imu.motion(map.keyframe(previous).stamp, stamp, bias);
  if (motion && relocalized && contradicts(*motion, previous, keyframe)) motion.reset();
  relocalized = false;
  const KeyframeId id = map.addKeyframe(std::move(keyframe));
  tracks.addViews(map.keyframe(id));
  visual_frontend::InertialState state_here;
  state_here.bias = bias;
  if (motion) {
    inertial.links.emplace(id, *motion);
    if (metric) {
      const visual_frontend::InertialState& before = inertial.states.at(previous);
      const Eigen::Matrix3d R = map.keyframe(previous).T_map_camera.linear() * T_camera_imu.linear();
      state_here.velocity =
          before.velocity + Eigen::Vector3d(0, 0, -kGravity) * motion->duration() + R * motion->velocity(before.bias);
      state_here.bias = before.bias;
    }
  } else if (metric && scale.filter().initialized()) {
    state_here.velocity = scale.filter().state().v;
  }
  inertial.states[id] = state_here;
}

void Odometry::Impl::addKeyframe() {
  Keyframe keyframe;
  keyframe.stamp = last_stamp;
  keyframe.T_map_camera = T_map_camera;
  int landmarks = 0;
  for (const Feature& f : currentFeatures()) {
    visual_frontend::Observation o;
    if (const auto id = landmarkOf(f.id)) {
      o.landmark = *id;
      ++landmarks;
    }
    o.track = f.id;
    o.pixel = f.pixel;
    o.normalized = f.normalized;
    keyframe.observations.push_back(o);
  }
  hovering = !moved(map.keyframe(map.lastKeyframe()));
  // What a hovering camera sees is in earlier images already.
  if (!hovering)
    for (const cv::Mat& level : tracker.pyramid()) keyframe.pyramid.push_back(level.clone());
  visual_frontend::describeKeyframe(*image, camera, settings.place, keyframe);
  if (const auto& up = imu.up(); !metric && up && up->sigma < kTrustedTilt) {
    keyframe.up_camera = T_camera_imu.linear() * up->up_imu;
    keyframe.up_sigma = std::max(0.02, up->sigma);
  }
  insertKeyframe(std::move(keyframe));
  const KeyframeId id = map.lastKeyframe();
  frames.lastIsKeyframe(id);
  triangulateTracks(id);
  tracker.replenish();
  covariances.add(id, last_pose.covariance, map);
  map.dropFarImages(T_map_camera, settings.max_image_keyframes, scene_distance);
  thinKeyframes();
  adjustLocally();
  keyframe_landmarks = 0;
  for (const auto& o : map.keyframe(id).observations) keyframe_landmarks += o.landmark != visual_frontend::kNoLandmark;
  made_keyframe = true;
}

// Only keyframes that no adjustment moves any more: what they tell is in their landmarks.
void Odometry::Impl::thinKeyframes() {
  const int newest = std::max(settings.full_max_keyframes, settings.window + 1);
  if (static_cast<int>(map.keyframeCount()) <= newest) return;
  // The IMU's samples between keyframes that stay where they are serve nothing.
  const KeyframeId oldest_free = std::prev(map.keyframes().end(), newest)->first;
  inertial.links.erase(inertial.links.begin(), inertial.links.lower_bound(oldest_free));
  const KeyframeId id = map.redundantKeyframe(newest, {settings.keyframe_distance, settings.keyframe_angle});
  if (id == visual_frontend::kNoKeyframe) return;
  const auto here = map.keyframes().find(id), after = std::next(here);
  frames.rebase(id, std::prev(here)->first, map);
  tracks.forgetKeyframe(id);
  inertial.links.erase(id);
  inertial.links.erase(after->first);  // it began here
  inertial.states.erase(id);
  covariances.forget(id);
  std::vector<LandmarkId> seen;
  for (const auto& o : here->second.observations)
    if (o.landmark != visual_frontend::kNoLandmark) seen.push_back(o.landmark);
  map.removeKeyframe(id);
  for (const LandmarkId landmark : seen)
    if (map.hasLandmark(landmark) && map.landmark(landmark).observations.size() < 2) map.removeLandmark(landmark);
}

void Odometry::Impl::triangulateTracks(KeyframeId id) {
  visual_frontend::TriangulationSettings how;
  // Where few tracks have a landmark the next one is needed at once, with 10 % of its depth open.
  const auto& seen_here = map.keyframe(id).observations;
  const auto mapped_here = std::count_if(seen_here.begin(), seen_here.end(), [](const visual_frontend::Observation& o) {
    return o.landmark != visual_frontend::kNoLandmark;
  });
  const bool few = 2 * static_cast<std::size_t>(mapped_here) < seen_here.size();
  how.min_parallax =
      few ? std::min(settings.triangulation_parallax, kLeastParallax * sigma()) : settings.triangulation_parallax;
  how.min_depth = 0.1 * scene_distance;
  how.max_depth = 20 * scene_distance;
  for (const auto& unplaced : visual_frontend::createLandmarks(id, camera, settings.pixel_sigma, how, map, tracks)) {
    if (unplaced.status != visual_frontend::TriangulationStatus::kLargeResidual &&
        unplaced.status != visual_frontend::TriangulationStatus::kBehindCamera)
      continue;
    tracker.remove({unplaced.track});
    tracks.forgetViews(unplaced.track);
  }
  tracks.forgetMissing(map);
  tracks.keep(tracker.features());
}

void Odometry::Impl::scaleIncrement(double factor) {
  // Camera moves by the scaled step; the base's lever arm is metric already once the map is.
  const Pose step = T_base_camera.inverse() * increment->T_previous_current * T_base_camera;
  Pose scaled = step;
  scaled.translation() *= factor;
  increment->T_previous_current = T_base_camera * scaled * T_base_camera.inverse();
  for (auto* covariance : {&increment->covariance, &increment->pose_covariance}) {
    covariance->topLeftCorner<3, 3>() *= factor * factor;
    covariance->block<3, 1>(0, 3) *= factor;
    covariance->block<1, 3>(3, 0) *= factor;
  }
}

void Odometry::Impl::transformMap(const air_ground_common::Similarity& S) {
  map.transform(S);
  frames.rescale(S.scale);
  scale.transform(S);
  velocity = S.scale * (S.R * velocity);
  scene_distance *= S.scale;
  depth_min *= S.scale;
  depth_max *= S.scale;
  covariances.transform(S);
  for (Matrix6d* covariance : {&last_pose.covariance, &previous_covariance})
    *covariance = visual_frontend::transformed(*covariance, S);
  if (increment) scaleIncrement(S.scale);
}

// From the positions and the inertial motion between them.
void Odometry::Impl::startVelocities() {
  for (auto it = map.keyframes().begin(); it != map.keyframes().end(); ++it) {
    visual_frontend::InertialState& here = inertial.states[it->first];
    here.bias.accel = bias.accel;
    const auto next = std::next(it);
    const auto link = next == map.keyframes().end() ? inertial.links.end() : inertial.links.find(next->first);
    const Eigen::Vector3d g(0, 0, -kGravity);
    if (link != inertial.links.end()) {
      const Preintegration& motion = link->second;
      const double dt = motion.duration();
      const Pose T_a = it->second.T_map_camera * T_camera_imu, T_b = next->second.T_map_camera * T_camera_imu;
      here.velocity =
          (T_b.translation() - T_a.translation() - 0.5 * dt * dt * g - T_a.linear() * motion.position(here.bias)) / dt;
    } else if (it != map.keyframes().begin() && inertial.links.count(it->first)) {
      const auto previous = std::prev(it);
      const Preintegration& motion = inertial.links.at(it->first);
      here.velocity = inertial.states[previous->first].velocity + g * motion.duration() +
                      previous->second.T_map_camera.linear() * T_camera_imu.linear() * motion.velocity(here.bias);
    }
  }
}

void Odometry::Impl::makeMetric() {
  adoptAll();
  const auto& estimate = scale.filter().state();
  const Eigen::Vector3d up = -estimate.gravity();
  air_ground_common::Similarity S;
  S.scale = estimate.scale;
  S.R = air_ground_common::levelingRotation(up);
  const Pose& first = map.keyframes().begin()->second.T_map_camera;
  // Origin and heading 0 at the base_link of the first keyframe.
  const double yaw = air_ground_common::yawOf(S.R * first.linear() * T_base_camera.linear().transpose());
  S.R = (Eigen::AngleAxisd(-yaw, Eigen::Vector3d::UnitZ()) * S.R).eval();
  const Eigen::Vector3d p_first_base = T_base_camera.inverse().translation();
  S.t = -(S.scale * (S.R * first.translation()) + S.R * first.linear() * p_first_base);
  const Eigen::Vector3d accel_bias = estimate.accel_bias;
  transformMap(S);
  metric = inertial.metric = true;
  revision.restart();
  metric_since = last_stamp;
  bias.accel = accel_bias;

  startVelocities();
  for (const auto& entry : map.keyframes()) map.keyframe(entry.first).up_camera.reset();
  full_interval = settings.full_interval / 2;
  adjustFully();
  adoptAll();
  full_interval = settings.full_interval / 2;
  next_full = last_stamp + full_interval;
}

}  // namespace mav_vo
