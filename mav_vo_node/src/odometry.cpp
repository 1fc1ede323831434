#include "mav_vo/odometry.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>

#include "odometry_impl.h"

namespace mav_vo {

namespace {

constexpr double kImuRestBiasSigma = 0.01;  // of one that the IMU alone calls a rest [rad/s]
constexpr double kMetricTilt = 0.01;        // of the metric map's z axis against gravity [rad]
constexpr std::size_t kRecentImages = 800;  // whose inertial motion is kept for the scale filter
constexpr std::size_t kMaxRecords = 40000;  // half an hour at 20 Hz; older images are thinned

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
      scale(settings_.scale, settings_.imu_noise, 0.1),
      gyro_alignment(settings_.gyro_alignment, settings_.imu_noise, T_camera_imu.linear(), sigma(), camera_.height),
      standstill(settings_.standstill) {
  settings.validate();
  imu.setOffset(settings.gyro_alignment.time_offset);
  gyro_alignment.setReadoutTime(settings.readout_time);
  if (settings.readout_time_stddev > 0) {
    GyroAlignmentSettings with_readout = settings.gyro_alignment;
    with_readout.readout_time = settings.readout_time;
    with_readout.readout_time_stddev = settings.readout_time_stddev;
    shutter_alignment.emplace(with_readout, settings.imu_noise, T_camera_imu.linear(), sigma(), camera.height);
  }
  if (!air_ground_common::isValid(T_base_camera) || !air_ground_common::isValid(T_base_imu))
    throw std::invalid_argument("Odometry: T_base_camera and T_base_imu must be rigid transforms");
}

void Odometry::Impl::startMap() {
  for (RunningJob* job : {&running_local, &running_full}) {
    if (job->result.valid()) job->result.wait();
    *job = {};
  }
  tracker.reset();
  bootstrap.reset();
  keepMapsBias();
  map.clear();
  revision.restart();
  inertial = {};
  track_landmark.clear();
  track_views.clear();
  keyframe_covariance.clear();
  bias.gyro = gyro_alignment.bias();  // the old map's may have been why it was lost
  relocalized = hovering = false;
  records.clear();
  scale.reset(map_tilt);
  ++map_id;
  metric = false;
  state = OdometryState::kInitializing;
  reason = "new map";
  located_stamp = -1;
  velocity.setZero();
  T_map_camera.setIdentity();
  inliers = keyframe_landmarks = 0;
  scene_distance = 1;
  depth_min = depth_max = 0;
}

void Odometry::Impl::reset() {
  startMap();
  imu.clear();
  attitude.reset();
  bias = {};
  rested = false;
  gyro_alignment.reset();
  gyro_alignment.setReadoutTime(settings.readout_time);
  if (shutter_alignment) shutter_alignment->reset();
  standstill.reset();
  imu.setOffset(settings.gyro_alignment.time_offset);
  shutter.setReadoutTime(settings.readout_time);
  up_imu.reset();
  up_sigma = 0.1;
  last_stamp = -1;
  state = OdometryState::kWaiting;
  reason = "no image yet";
}

std::optional<LandmarkId> Odometry::Impl::landmarkOf(TrackId track) const {
  const auto it = track_landmark.find(track);
  if (it == track_landmark.end() || !map.hasLandmark(it->second)) return std::nullopt;
  return it->second;
}

void Odometry::Impl::followShutter(double stamp, const Pose& predicted) {
  if (!shutter.active()) return;
  const double half = 0.5 * std::abs(shutter.readoutTime());
  const auto turn = cameraTurn(stamp - half, stamp + half);
  shutter.setMotion(
      turn ? Eigen::Vector3d(air_ground_common::logSO3(turn->R_a_b) / (2 * half)) : Eigen::Vector3d::Zero(),
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
  carryUp(stamp);
  if (const auto rest = standstill.add(stamp, tracker.features(), imu.buffer(), imu.stamp(stamp))) useStandstill(*rest);
  alignGyro(stamp);
}

// What the image does in the present state, and to which state that leads.
void Odometry::Impl::advance(const cv::Mat& gray) {
  if (state == OdometryState::kWaiting) {
    // The IMU seemed to rest before the images began: a hint, no more.
    if (settings.use_imu && attitude.biasKnown()) gyro_alignment.setBias(attitude.gyroBias(), kImuRestBiasSigma);
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
  const bool known_before = continuous && located_stamp >= 0 && !records.empty();
  if (known_before) {
    const Pose T_map_previous = poseOfRecord(records.size() - 1);
    const double dt = last_stamp - located_stamp;
    velocity = (T_map_camera.translation() - T_map_previous.translation()) / dt;
    increment = incrementSince(T_map_previous);
  } else {
    velocity.setZero();
  }
  std::optional<Preintegration> motion;
  if (known_before && settings.use_imu)
    motion = imu.motion(located_stamp, last_stamp, settings.imu_noise, ImuBias{bias.gyro, Eigen::Vector3d::Zero()});
  if (metric && settings.use_imu) {
    up_imu = (T_map_camera.linear() * T_camera_imu.linear()).transpose() * Eigen::Vector3d::UnitZ();
    up_sigma = kMetricTilt;
  }
  previous_covariance = last_pose.covariance;
  located_stamp = last_stamp;
  const KeyframeId reference = map.lastKeyframe();
  records.push_back({last_stamp, reference, map.keyframe(reference).T_map_camera.inverse() * T_map_camera,
                     scene_distance, last_pose.covariance.topLeftCorner<3, 3>(),
                     motion ? std::make_unique<const Preintegration>(*motion) : nullptr});
  if (settings.use_imu) scale.add(scaleMeasurement(records.size() - 1), motion);
  if (records.size() > kRecentImages) records[records.size() - 1 - kRecentImages].motion.reset();
  if (records.size() > kMaxRecords) thinRecords();

  const bool keyframe = needsKeyframe();
  if (settings.reobserve_matches > 0 && (keyframe || !continuous || records.size() % 2 == 0)) {
    auto how = settings.reobservation;
    how.max_matches = settings.reobserve_matches;
    lookForOldLandmarks(how);
  }
  if (keyframe) addKeyframe();
  // A scale that most images since its start speak against was wrong from the start.
  if (!metric && scale.updates() >= kScaleTrial && scale.rejectedShare() > 0.5) scale.reset(map_tilt);
  if (!metric && settings.use_imu && imu_problem.empty() && scale.certain(neededScaleStddev()) &&
      map.keyframeCount() >= settings.min_metric_keyframes)
    makeMetric();
  if (metric && last_stamp >= next_full && made_keyframe) adjustFully();
  T_map_camera = poseOfRecord(records.size() - 1);
  state = metric ? OdometryState::kTracking : OdometryState::kScaling;
  reason = metric ? "" : scaleReason();
}

// Of the older half every second one goes.
void Odometry::Impl::thinRecords() {
  std::size_t kept = 0;
  const std::size_t half = records.size() / 2;
  for (std::size_t i = 0; i < records.size(); ++i)
    if (i >= half || i % 2 == 0) records[kept++] = std::move(records[i]);
  records.resize(kept);
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
  result->scale = scale.initialized() ? scale.scale() : 1.0;
  result->scale_stddev = scale.scaleStddev();
  if (metric && settings.use_imu) result->tilt_stddev = kMapTilt;
  result->imu_bias = bias;
  result->gyro_bias_stddev = gyro_alignment.biasStddev();
  result->time_offset = imu.offset();
  result->time_offset_stddev = settings.gyro_alignment.time_offset_stddev > 0 ? gyro_alignment.timeOffsetStddev() : 0;
  result->readout_time = shutter.readoutTime();
  result->readout_time_stddev = shutter_alignment ? shutter_alignment->readoutTimeStddev() : 0;
  result->pose_valid = located_stamp >= 0 && located_stamp == result->stamp && last_pose.success;
  if (!result->pose_valid) return;
  result->inliers = inliers;
  result->depth_min = depth_min;
  result->depth_max = depth_max;
  result->T_map_camera = T_map_camera;
  result->camera_covariance = mapCovariance(last_pose.covariance);
  // In the visual unit the lever arm between camera and base_link is not known: the base is put at the camera.
  Pose T_camera_base = T_base_camera.inverse();
  if (!metric) T_camera_base.translation() *= scale.initialized() ? 1.0 / scale.scale() : 0.0;
  result->T_map_base = T_map_camera * T_camera_base;
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() = -air_ground_common::skew(T_map_camera.linear() * T_camera_base.translation());
  result->covariance = J * result->camera_covariance * J.transpose();
  if (metric && scale.initialized()) result->velocity = scale.state().v;
}

Odometry::Odometry(const CameraModel& camera, const Pose& T_base_camera, const Pose& T_base_imu,
                   const OdometrySettings& settings)
    : impl_(std::make_unique<Impl>(camera, T_base_camera, T_base_imu, settings)) {}

Odometry::~Odometry() = default;

bool Odometry::addImu(const ImuSample& sample) {
  if (!impl_->imu.add(sample)) return false;
  impl_->attitude.add(sample);
  return true;
}

double Odometry::imuNeededAt(double image_stamp) const {
  return impl_->imu.stamp(image_stamp) + 0.5 * std::abs(impl_->shutter.readoutTime());
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

air_ground_common::Trajectory Odometry::trajectory() const {
  air_ground_common::Trajectory trajectory;
  for (std::size_t i = 0; i < impl_->records.size(); ++i)
    trajectory.push_back({impl_->records[i].stamp, impl_->poseOfRecord(i)});
  return trajectory;
}

}  // namespace mav_vo
