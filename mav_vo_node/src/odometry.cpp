#include "mav_vo/odometry.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>

#include "odometry_impl.h"

namespace mav_vo {

namespace {

constexpr double kUnknownTilt = 0.1;       // of a map that has not begun [rad]
constexpr std::size_t kMaxFrames = 40000;  // half an hour at 20 Hz; older ones are thinned

}  // namespace

const char* toString(OdometryState state) {
  switch (state) {
    case OdometryState::kWaiting:
      return "waiting";
    case OdometryState::kInitializing:
      return "initializing";
    case OdometryState::kScaling:
      return "scaling";
    case OdometryState::kTracking:
      return "tracking";
    case OdometryState::kLost:
      return "lost";
  }
  return "unknown";
}

Odometry::Impl::Impl(const CameraModel& camera_, const Pose& T_base_camera_, const Pose& T_base_imu,
                     const OdometrySettings& settings_)
    : camera(camera_),
      T_base_camera(T_base_camera_),
      T_camera_imu(T_base_camera_.inverse() * T_base_imu),
      settings(settings_),
      tracker(camera_, settings_.tracker),
      shutter(camera_, settings_.readout_time),
      bootstrap(camera_, settings_.bootstrap),
      scale(settings_, T_camera_imu),
      imu(settings_, T_camera_imu.linear(), sigma(), camera_.height) {
  settings.validate();
  inertial.T_camera_imu = T_camera_imu;
  if (!air_ground_common::isValid(T_base_camera) || !air_ground_common::isValid(T_base_imu))
    throw std::invalid_argument("Odometry: T_base_camera and T_base_imu must be rigid transforms");
}

void Odometry::Impl::startMap() {
  adjustments.discard();
  tracker.reset();
  bootstrap.reset();
  keepMapsBias();
  map.clear();
  revision.restart();
  inertial = {{}, {}, T_camera_imu, false};
  tracks.clear();
  covariances.clear();
  bias.gyro = imu.gyroBias();  // the old map's may have been why it was lost
  relocalized = hovering = false;
  frames.clear();
  scale.begin(kUnknownTilt);
  ++map_id;
  metric = false;
  state = OdometryState::kInitializing;
  reason = "new map";
  located_stamp = -1;
  velocity.setZero();
  turn_rate.setZero();
  T_map_camera.setIdentity();
  inliers = keyframe_landmarks = 0;
  scene_distance = 1;
  depth_min = depth_max = 0;
}

void Odometry::Impl::reset() {
  startMap();
  imu.reset();
  bias = {};
  shutter.setReadoutTime(settings.readout_time);
  last_stamp = -1;
  state = OdometryState::kWaiting;
  reason = "no image yet";
}

std::optional<LandmarkId> Odometry::Impl::landmarkOf(TrackId track) const {
  const LandmarkId landmark = tracks.landmarkOf(track);
  if (!map.hasLandmark(landmark)) return std::nullopt;
  return landmark;
}

void Odometry::Impl::followShutter(double stamp, const Pose& predicted) {
  if (!shutter.active()) return;
  const double half = 0.5 * std::abs(shutter.readoutTime());
  const auto turn = cameraTurn(stamp - half, stamp + half);
  shutter.setMotion(turn ? Eigen::Vector3d(air_ground_common::logSO3(turn->R_a_b) / (2 * half)) : turn_rate,
                    predicted.linear().transpose() * velocity);
}

Eigen::Vector2d Odometry::Impl::rayOf(const Feature& feature) const {
  if (!shutter.active()) return feature.normalized;
  double inverse_depth = 0;
  if (map.keyframeCount() > 0) {
    const auto id = landmarkOf(feature.id);
    const double depth = id ? (T_map_camera.inverse() * map.landmark(*id).position).z() : scene_distance;
    if (depth > 0.1 * scene_distance) inverse_depth = 1 / depth;
  }
  return shutter.toMiddleRow(feature.pixel, feature.normalized, inverse_depth);
}

std::vector<Feature> Odometry::Impl::currentFeatures() const {
  std::vector<Feature> features = tracker.features();
  if (shutter.active())
    for (Feature& f : features) f.normalized = rayOf(f);
  return features;
}

// A map that is not metric yet has little to lose: it is waited for no longer than it lived.
double Odometry::Impl::patience() const {
  if (metric || map.keyframeCount() == 0) return settings.lost_timeout;
  return std::min(settings.lost_timeout, lost_since - map.keyframes().begin()->second.stamp);
}

bool Odometry::Impl::tracking() const { return state == OdometryState::kScaling || state == OdometryState::kTracking; }

// Where the camera should be at this image, and where its features.
Pose Odometry::Impl::predict(double stamp, visual_frontend::TrackPrediction* prediction) {
  Pose predicted = T_map_camera;
  if (R_previous_current) prediction->R_current_previous = R_previous_current->transpose();
  const bool predictable = tracking() && located_stamp == last_stamp;
  if (predictable) {
    predicted.translation() += velocity * (stamp - located_stamp);
    if (R_previous_current) predicted.linear() = T_map_camera.linear() * *R_previous_current;
  }
  followShutter(stamp, predicted);
  if (!predictable) return predicted;
  const Pose T_camera_map = predicted.inverse();
  for (const Feature& f : tracker.features()) {
    const auto id = landmarkOf(f.id);
    if (!id) continue;
    const Eigen::Vector3d p_camera = T_camera_map * map.landmark(*id).position;
    if (const auto pixel = camera.project(p_camera)) prediction->pixels[f.id] = shutter.toItsRow(*pixel, p_camera);
  }
  return predicted;
}

void Odometry::Impl::useImu(double stamp) {
  imu.carryUp(R_previous_current, stamp - last_stamp);
  if (imu.detectStandstill(stamp, tracker.features(), metric)) bias.gyro = imu.gyroBias();
  alignImu(stamp);
}

// What the image does in the present state, and to which state that leads.
void Odometry::Impl::advance(const cv::Mat& gray) {
  if (state == OdometryState::kWaiting) {
    if (settings.use_imu) imu.takeRestOfImuAlone();
    state = OdometryState::kInitializing;
    reason = "first image";
  }
  if (state == OdometryState::kInitializing) {
    initialize();
  } else if (tracking()) {
    if (locate(R_previous_current.has_value())) {
      localized(true);
    } else {
      state = OdometryState::kLost;
      reason = "lost: " + last_pose.reason;
      lost_since = last_stamp;
      frames_lost = 0;
    }
  }
  if (state == OdometryState::kLost) {
    if (relocalize(gray, R_previous_current.has_value())) {
      state = metric ? OdometryState::kTracking : OdometryState::kScaling;
      relocalized = true;
      localized(false);
    } else if (last_stamp - lost_since > patience()) {
      startMap();
      reason = "lost for too long: a new map starts";
    }
  }
}

FrameResult Odometry::Impl::process(double stamp, const cv::Mat& gray) {
  const auto begin = std::chrono::steady_clock::now();
  FrameResult result;
  result.stamp = stamp;
  increment.reset();
  made_keyframe = false;
  if (!std::isfinite(stamp) || stamp <= last_stamp) {
    fillResult(&result);
    result.reason = "the image's stamp is not later than the last one's";
    return result;
  }
  adoptDue();
  image = &gray;
  R_previous_current.reset();
  if (last_stamp >= 0)
    if (const auto turn = cameraTurn(last_stamp, stamp)) R_previous_current = turn->R_a_b;
  visual_frontend::TrackPrediction prediction;
  const Pose predicted = predict(stamp, &prediction);
  tracker.track(gray, prediction);
  result.tracked = static_cast<int>(tracker.features().size());
  if (settings.use_imu) useImu(stamp);
  if (tracking()) T_map_camera = predicted;
  last_stamp = stamp;
  advance(gray);
  fillResult(&result);
  image = nullptr;
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return result;
}

void Odometry::Impl::localized(bool continuous) {
  const bool known_before = continuous && located_stamp >= 0 && !frames.empty();
  if (known_before) {
    const Pose T_map_previous = frames.lastPose(map);
    const double dt = last_stamp - located_stamp;
    velocity = (T_map_camera.translation() - T_map_previous.translation()) / dt;
    turn_rate = air_ground_common::logSO3(T_map_previous.linear().transpose() * T_map_camera.linear()) / dt;
    increment = incrementSince(T_map_previous);
  } else {
    velocity.setZero();
    turn_rate.setZero();
  }
  std::optional<Preintegration> motion;
  if (known_before && settings.use_imu)
    motion = imu.motion(located_stamp, last_stamp, ImuBias{bias.gyro, Eigen::Vector3d::Zero()});
  if (metric && settings.use_imu)
    imu.setUp((T_map_camera.linear() * T_camera_imu.linear()).transpose() * Eigen::Vector3d::UnitZ());
  previous_covariance = last_pose.covariance;
  located_stamp = last_stamp;
  const KeyframeId reference = map.lastKeyframe();
  frames.add(last_stamp, T_map_camera, reference, map);
  frames.thin(kMaxFrames);
  if (settings.use_imu) scale.add(frames, map, scene_distance, last_pose.covariance.topLeftCorner<3, 3>(), motion);

  const bool keyframe = needsKeyframe();
  if (settings.reobserve_matches > 0 && (keyframe || !continuous || frames.size() % 2 == 0)) {
    auto how = settings.reobservation;
    how.max_matches = settings.reobserve_matches;
    lookForOldLandmarks(how);
  }
  if (keyframe) addKeyframe();
  if (!metric) scale.dropRefuted();
  if (!metric && settings.use_imu && imu_problem.empty() && scale.known(mapAge()) &&
      map.keyframeCount() >= settings.min_metric_keyframes)
    makeMetric();
  if (metric && last_stamp >= next_full && made_keyframe) adjustFully();
  T_map_camera = frames.lastPose(map);
  state = metric ? OdometryState::kTracking : OdometryState::kScaling;
  reason = metric ? "" : scaleReason();
}

void Odometry::Impl::fillResult(FrameResult* result) const {
  result->state = state;
  result->reason = reason;
  result->metric = metric;
  result->map_id = map_id;
  result->map_revision = revision.count();
  result->keyframe = made_keyframe;
  result->keyframes = map.keyframeCount();
  result->landmarks = map.landmarkCount();
  result->increment = increment;
  const ScaleFilter& estimate = scale.filter();
  result->scale = estimate.initialized() ? estimate.scale() : 1.0;
  result->scale_stddev = estimate.scaleStddev();
  if (metric && settings.use_imu) result->tilt_stddev = kMapTilt;
  result->imu_bias = bias;
  result->gyro_bias_stddev = imu.gyroBiasStddev();
  result->time_offset = imu.timeOffset();
  result->time_offset_stddev = imu.timeOffsetStddev();
  result->readout_time = shutter.readoutTime();
  result->readout_time_stddev = imu.readoutTimeStddev();
  result->pose_valid = located_stamp >= 0 && located_stamp == result->stamp && last_pose.success;
  if (!result->pose_valid) return;
  result->inliers = inliers;
  result->depth_min = depth_min;
  result->depth_max = depth_max;
  result->T_map_camera = T_map_camera;
  result->camera_covariance = mapCovariance(last_pose.covariance);
  // In the visual unit the lever arm between camera and base_link is not known: the base is put at the camera.
  Pose T_camera_base = T_base_camera.inverse();
  if (!metric) T_camera_base.translation() *= estimate.initialized() ? 1.0 / estimate.scale() : 0.0;
  result->T_map_base = T_map_camera * T_camera_base;
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() = -air_ground_common::skew(T_map_camera.linear() * T_camera_base.translation());
  result->covariance = J * result->camera_covariance * J.transpose();
  if (metric && estimate.initialized()) result->velocity = estimate.state().v;
}

Odometry::Odometry(const CameraModel& camera, const Pose& T_base_camera, const Pose& T_base_imu,
                   const OdometrySettings& settings)
    : impl_(std::make_unique<Impl>(camera, T_base_camera, T_base_imu, settings)) {}

Odometry::~Odometry() = default;

bool Odometry::addImu(const ImuSample& sample) { return impl_->imu.add(sample); }

double Odometry::imuNeededAt(double image_stamp) const {
  return impl_->imu.imuStamp(image_stamp) + 0.5 * std::abs(impl_->shutter.readoutTime());
}

void Odometry::setImuProblem(const std::string& problem) { impl_->imu_problem = problem; }
FrameResult Odometry::process(double stamp, const cv::Mat& gray) { return impl_->process(stamp, gray); }
void Odometry::reset() { impl_->reset(); }
const visual_frontend::Map& Odometry::map() const { return impl_->map; }
const std::vector<Feature>& Odometry::features() const { return impl_->tracker.features(); }
bool Odometry::metric() const { return impl_->metric; }
std::uint32_t Odometry::mapId() const { return impl_->map_id; }
void Odometry::finish() { impl_->adoptAll(); }

std::vector<bool> Odometry::mappedFeatures() const {
  std::vector<bool> mapped;
  for (const Feature& f : impl_->tracker.features()) mapped.push_back(impl_->landmarkOf(f.id).has_value());
  return mapped;
}

air_ground_common::Trajectory Odometry::trajectory() const { return impl_->frames.poses(impl_->map); }

}  // namespace mav_vo
