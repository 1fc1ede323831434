#include "mav_vo/odometry.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>

#include "air_ground_common/covariance.h"
#include "air_ground_common/text.h"
#include "flown_level.h"
#include "increment.h"
#include "odometry_impl.h"

namespace mav_vo {

using visual_frontend::Feature;

namespace {

constexpr double kMapTilt = 0.002;         // of the adjusted map as a whole, against gravity [rad]
constexpr double kMeanAccel = 0.006;       // to which images tell an acceleration that lasts [m/s^2]
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

namespace {

BootstrapSettings startOf(const OdometrySettings& settings) {
  BootstrapSettings start = settings.bootstrap;
  start.pixel_sigma = settings.pixel_sigma;
  start.seed = settings.seed;
  return start;
}

}  // namespace

Odometry::Impl::Impl(const CameraModel& camera_, const Pose& T_base_camera_, const Pose& T_base_imu,
                     const OdometrySettings& settings_)
    : given_camera(camera_),
      T_base_camera(T_base_camera_),
      settings(settings_),
      inertial(settings_, T_base_camera_.inverse() * T_base_imu),
      adjuster(camera_, settings_),
      scale(settings_, inertial.data().T_camera_imu),
      camera(camera_),
      calibration(givenCalibration()),
      imu(settings_, R_camera_imu(), sigma(), camera_.height),
      pose(camera_, settings_, map, tracks, [this](double a, double b) { return cameraTurn(a, b); }),
      bootstrap(camera_, startOf(settings_)),
      policy(settings_),
      relocalizer(camera_, settings_) {
  settings.validate();
  if (!air_ground_common::isValid(T_base_camera) || !air_ground_common::isValid(T_base_imu))
    throw std::invalid_argument("Odometry: T_base_camera and T_base_imu must be rigid transforms");
}

void Odometry::Impl::reset() {
  startMap();
  inertial.mountAsGiven();
  imu.reset();
  bias = {};
  calibration = givenCalibration();
  setCamera(given_camera);
  pose.setReadoutTime(settings.readout_time);
  next_readout.reset();
  last_stamp = -1;
  state = OdometryState::kWaiting;
  reason = "no image yet";
}

bool Odometry::Impl::tracking() const { return state == OdometryState::kScaling || state == OdometryState::kTracking; }

double Odometry::Impl::mapAge() const {
  return map.keyframeCount() == 0 ? 0 : last_stamp - map.keyframes().begin()->second.stamp;
}

// A map that is waited for its scale has little to lose: no longer than it lived, whatever the images show.
bool Odometry::Impl::givesUp() const {
  const double lost = last_stamp - relocalizer.lostSince();
  if (map.keyframeCount() == 0) return lost > settings.lost_timeout;
  if (metric()) return relocalizer.strangeFor() > settings.lost_timeout;
  const double lived = relocalizer.lostSince() - map.keyframes().begin()->second.stamp;
  return (settings.use_imu ? lost : relocalizer.strangeFor()) > std::min(settings.lost_timeout, lived);
}

std::string Odometry::Impl::scaleReason() const {
  if (!settings.use_imu)
    return "no IMU: lengths are in the map's own unit until the alignment tells it (in a city the tracker finds the "
           "scale)";
  if (!imu_problem.empty()) return imu_problem;
  if (!imu.coverageProblem().empty()) return "metric scale is not known: " + imu.coverageProblem();
  if (const std::string problem = imu.problem(); !problem.empty()) return problem;
  if (!scale.known(mapAge())) return scale.reason(mapAge());
  const std::string clock = imu.clockProblem();
  return clock.empty() ? scale.reason(mapAge()) : clock;
}

std::optional<double> Odometry::Impl::turnSigma() const {
  if (!pose.turnSincePrevious()) return std::nullopt;
  return std::hypot(settings.gyro_prior_sigma, imu.gyroBiasStddev() * (last_stamp - pose.locatedStamp()));
}

std::optional<GyroRotation> Odometry::Impl::cameraTurn(double stamp_a, double stamp_b) const {
  if (!settings.use_imu) return std::nullopt;
  return imu.cameraTurn(stamp_a, stamp_b, bias.gyro);
}

// What the IMU and the tracks tell of each other, with or without a map.
void Odometry::Impl::useImu(double stamp) {
  const std::vector<Feature>& features = pose.tracker().features();
  if (last_stamp >= 0) imu.checkCoverage(last_stamp, stamp);
  imu.carryUp(pose.turnSincePrevious(), stamp - last_stamp);
  if (imu.findClock(stamp, metric())) startMap();  // whose turns and gravity were those of another time
  if (imu.detectStandstill(stamp, features, metric())) bias.gyro = imu.gyroBias();
  next_readout = imu.alignShutter(stamp, features, pose.readoutTime());
  if (const auto turn = imu.alignMounting(stamp, features)) turnImu(*turn);
  if (!imu.alignGyro(stamp, features, metric())) return;
  if (!metric() && mapBiasRefuted()) leaveRefutedBias();
  // A map knows the bias better: its adjustment sees all of its keyframes.
  if (map.keyframeCount() == 0) bias.gyro = imu.gyroBias();
  imu.followBias(bias.gyro);
  if (imu.adoptTimeOffset()) retime();
}

// What the image does in the present state, and to which state that leads.
void Odometry::Impl::advance(const cv::Mat& gray) {
  if (state == OdometryState::kWaiting) {
    if (settings.use_imu) imu.useBiasAtRest();
    state = OdometryState::kInitializing;
    reason = "first image";
  }
  if (state == OdometryState::kInitializing) {
    initialize(gray);
  } else if (tracking()) {
    pose.realign();
    if (pose.locate(turnSigma())) {
      localized(gray, true);
    } else {
      state = OdometryState::kLost;
      reason = "lost: " + pose.result().reason;
      relocalizer.begin(last_stamp);
    }
  }
  if (state == OdometryState::kLost) {
    if (relocalize(gray)) {
      state = metric() ? OdometryState::kTracking : OdometryState::kScaling;
      relocalized = true;
      localized(gray, false);
    } else if (givesUp()) {
      startMap();
      reason = "lost for too long: a new map starts";
    }
  }
}

bool Odometry::Impl::relocalize(const cv::Mat& gray) {
  if (map.keyframeCount() == 0 || frames.empty()) return false;
  visual_frontend::RelocalizationGate gate;
  gate.T_map_last = frames.lastPose(map);
  if (metric())
    gate.max_distance = settings.relocalization_slack +
                        std::max(settings.max_speed, 1.5 * pose.speed()) * (last_stamp - frames.lastStamp());
  if (const auto up = imu.attitude(last_stamp); up && metric() && settings.use_imu) {
    gate.up_camera = R_camera_imu() * up->up_imu;
    gate.max_tilt = std::max(gate.max_tilt, 3 * up->sigma);
  }
  if (const auto turn = cameraTurn(frames.lastStamp(), last_stamp); turn && metric() && imu.problem().empty())
    gate.setTurn(gate.T_map_last.linear() * turn->R_a_b, turn->sigma, last_stamp - frames.lastStamp());
  const bool found = relocalizer.find(last_stamp, gray, map, gate, turnSigma(), pose);
  if (!found && !relocalizer.reason().empty()) reason = relocalizer.reason();
  return found;
}

VoResult Odometry::Impl::process(double stamp, const cv::Mat& gray) {
  const auto begin = std::chrono::steady_clock::now();
  VoResult result;
  result.stamp = stamp;
  increment.reset();
  made_keyframe = false;
  if (!std::isfinite(stamp) || stamp <= last_stamp) {
    fillResult(&result);
    result.pose_valid = false;  // a repeated stamp is that of the last pose
    result.reason = "the image's stamp is not later than the last one's";
    return result;
  }
  adopt(adjuster.due(last_stamp));
  if (next_readout) setReadoutTime(*next_readout);
  pose.track(last_stamp, stamp, gray, tracking());
  result.tracked = static_cast<int>(pose.tracker().features().size());
  if (settings.use_imu) useImu(stamp);
  last_stamp = stamp;
  advance(gray);
  fillResult(&result);
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return result;
}

void Odometry::Impl::localized(const cv::Mat& gray, bool continuous) {
  std::optional<Pose> T_map_previous;
  std::optional<Preintegration> motion;
  if (continuous && pose.locatedStamp() >= 0 && !frames.empty()) {
    T_map_previous = frames.lastPose(map);
    increment = incrementSince(*T_map_previous);
    if (settings.use_imu)
      motion = imu.motion(pose.locatedStamp(), last_stamp, ImuBias{bias.gyro, Eigen::Vector3d::Zero()});
  }
  if (metric() && settings.use_imu)
    imu.setUp((pose.pose().linear() * R_camera_imu()).transpose() * Eigen::Vector3d::UnitZ());
  pose.settle(last_stamp, T_map_previous);
  frames.add(last_stamp, pose.pose(), map.lastKeyframe(), map);
  frames.thin(kMaxFrames);
  if (settings.use_imu)
    scale.add(frames, map, pose.sceneDistance(), pose.result().covariance.topLeftCorner<3, 3>(),
              contradicted_links == 0 ? motion : std::optional<Preintegration>());

  const bool keyframe = policy.due(map.keyframe(map.lastKeyframe()), last_stamp, pose.pose(), pose.sceneDistance(),
                                   pose.result().inlier_count);
  if (settings.reobserve_matches > 0 && (keyframe || !continuous || frames.size() % 2 == 0)) {
    auto how = settings.reobservation;
    how.max_matches = settings.reobserve_matches;
    pose.reobserve(how);
  }
  if (keyframe) addKeyframe(gray);
  if (!levelled && !metric()) level();
  if (!metric()) scale.dropRefuted(frames, map);
  if (!metric() && settings.use_imu && imu_problem.empty() && scale.known(mapAge()) && imu.clockProblem().empty() &&
      map.keyframeCount() >= settings.min_metric_keyframes)
    makeMetric();
  if (made_keyframe && adjuster.wholeDue(last_stamp)) adjustWholeMap();
  pose.setPose(frames.lastPose(map));
  state = metric() ? OdometryState::kTracking : OdometryState::kScaling;
  reason = metric() ? imuReason() : scaleReason();
}

std::string Odometry::Impl::imuReason() const {
  constexpr int kInARow = 3;
  if (!settings.use_imu) return "";
  if (!imu.coverageProblem().empty() || contradicted_links < kInARow) return imu.coverageProblem();
  return air_ground_common::formatted(
      "the IMU and the images tell of different motions between keyframes, %d times by now, and nothing but the map "
      "holds its "
      "scale: see whether the IMU repeats its samples, or its clock was set",
      contradicted_links);
}

Increment Odometry::Impl::incrementSince(const Pose& T_map_previous) const {
  Increment step = incrementBetween(pose.locatedStamp(), {T_map_previous, pose.previousCovariance()},
                                    {pose.pose(), pose.result().covariance}, T_base_camera);
  if (settings.increment_covariance != IncrementCovariance::kMonteCarlo) return step;
  std::vector<RayPair> pairs;
  for (const Feature& f : pose.tracker().features()) {
    if (f.age < 1 || tracks.landmarkIn(map, f.id) == visual_frontend::kNoLandmark) continue;
    const Eigen::Vector2d previous = camera.unproject(f.previous_pixel);
    if (previous.allFinite()) pairs.push_back({previous, f.normalized});
  }
  MonteCarloSettings how;
  how.samples = settings.increment_samples;
  how.seed = settings.seed;
  scatterCovariance(pairs, (T_map_previous * T_base_camera.inverse()).linear(), T_base_camera, sigma(), how, &step);
  return step;
}

// While the IMU keeps its attitude, a bias of its accelerometer is as good as a tilt of the map. With R_mean the mean
// of its rotations, (3 - |R_mean|^2) / 2 is the variance of the angle by which they differ.
double Odometry::Impl::mapTilt() const {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (const auto& [id, keyframe] : map.keyframes()) sum += keyframe.T_map_camera.linear();
  const double count = static_cast<double>(std::max<std::size_t>(1, map.keyframeCount()));
  const double turned = std::sqrt(std::max(0.0, 0.5 * (3 - (sum / count).squaredNorm())));
  const double bias_stddev = settings.scale.accel_bias_stddev;
  return std::hypot(kMapTilt, std::min(bias_stddev, kMeanAccel / std::max(turned, 1e-6)) / kGravity);
}

air_ground_common::Vertical Odometry::Impl::flownVertical() const {
  const auto across = [this](const Eigen::Vector3d& lateral_in_camera) {
    std::vector<FlownAttitude> attitudes;
    for (const auto& [id, keyframe] : map.keyframes()) {
      const Eigen::Matrix3d& R_map_camera = keyframe.T_map_camera.linear();
      attitudes.push_back({keyframe.stamp, R_map_camera * lateral_in_camera, R_map_camera * Eigen::Vector3d(0, 1, 1)});
    }
    return verticalOfFlight(attitudes);
  };
  const air_ground_common::Vertical vertical = across(T_base_camera.linear().transpose() * Eigen::Vector3d::UnitY());
  // A mounting that nobody gave, or one whose axes are those of the images.
  return vertical.stddev > 0 ? vertical : across(Eigen::Vector3d::UnitX());
}

double Odometry::Impl::scaleDeviation() const {
  if (!metric() || !scale.filter().initialized()) return 0;
  return std::hypot(scale.relativeStddev(), scale.filter().scale() - 1);
}

// Error of the pose in the map: image noise, that of the keyframe it was made from, and what scale and tilt of the map
// leave open, which grows from its origin.
Matrix6d Odometry::Impl::mapCovariance(double tilt_stddev) const {
  Matrix6d C = pose.result().covariance;
  const double relative = scaleDeviation();
  const Eigen::Vector3d p = pose.pose().translation();
  C.topLeftCorner<3, 3>() += relative * relative * p * p.transpose();
  if (!frames.empty()) C += covariances.at(frames.lastReference(), p, map);
  C += air_ground_common::tiltCovariance(tilt_stddev, p);
  C.diagonal().array() += 1e-10;
  return C;
}

void Odometry::Impl::fillResult(VoResult* result) const {
  const ScaleFilter& estimate = scale.filter();
  result->state = state;
  result->reason = reason;
  const bool uncovered = state == OdometryState::kScaling && !imu.coverageProblem().empty();
  result->imu_at_fault = settings.use_imu && (state == OdometryState::kTracking ? !imuReason().empty()
                                                                                : uncovered || !imu.problem().empty());
  result->metric = metric();
  result->map_id = map_id;
  result->map_revision = revision.count();
  result->map_corrections = revision.corrections();
  result->keyframe = made_keyframe;
  result->keyframes = map.keyframeCount();
  result->landmarks = map.landmarkCount();
  result->increment = increment;
  result->scale = estimate.initialized() ? estimate.scale() : 1.0;
  result->scale_stddev = result->scale * scale.relativeStddev();
  result->scale_deviation = scaleDeviation();
  if (!settings.use_imu)
    result->vertical = flownVertical();
  else if (metric())
    result->vertical.stddev = mapTilt();
  result->imu_bias = bias;
  result->gyro_bias_stddev = imu.gyroBiasStddev();
  result->time_offset = imu.timeOffset();
  result->time_offset_stddev = imu.timeOffsetStddev();
  result->readout_time = pose.readoutTime();
  result->readout_time_stddev = imu.readoutTimeStddev();
  result->R_given_imu = inertial.mounting() * imu.mounting();
  result->imu_rotation_stddev = imu.mountingStddev();
  if (settings.use_imu) result->accel_noise = imu.noise().accel_density;
  result->pose_valid = pose.locatedStamp() >= 0 && pose.locatedStamp() == result->stamp && pose.result().success;
  if (!result->pose_valid) return;
  result->inliers = pose.result().inlier_count;
  result->depth_min = pose.depthMin();
  result->depth_max = pose.depthMax();
  result->T_map_camera = pose.pose();
  result->camera_covariance = mapCovariance(settings.use_imu ? result->vertical.stddev : 0);
  // In the visual unit the lever arm between camera and base_link is not known: the base is put at the camera.
  Pose T_camera_base = T_base_camera.inverse();
  if (!metric()) T_camera_base.translation() *= estimate.initialized() ? 1.0 / estimate.scale() : 0.0;
  result->T_map_base = pose.pose() * T_camera_base;
  result->covariance =
      air_ground_common::covarianceAt(result->camera_covariance, pose.pose().linear() * T_camera_base.translation());
  if (metric() && estimate.initialized()) result->velocity = estimate.state().velocity();
}

Odometry::Odometry(const CameraModel& camera, const Pose& T_base_camera, const Pose& T_base_imu,
                   const OdometrySettings& settings)
    : impl_(std::make_unique<Impl>(camera, T_base_camera, T_base_imu, settings)) {}

Odometry::~Odometry() = default;

bool Odometry::addImu(const ImuSample& sample) { return impl_->imu.add(sample); }

double Odometry::imuNeededAt(double image_stamp) const {
  return impl_->imu.imuStamp(image_stamp) + 0.5 * std::abs(impl_->pose.readoutTime());
}

void Odometry::setImuProblem(const std::string& problem) { impl_->imu_problem = problem; }
VoResult Odometry::process(double stamp, const cv::Mat& gray) { return impl_->process(stamp, gray); }
void Odometry::reset() { impl_->reset(); }
const CameraModel& Odometry::camera() const { return impl_->camera; }
const visual_frontend::Map& Odometry::map() const { return impl_->map; }
const std::vector<Feature>& Odometry::features() const { return impl_->pose.tracker().features(); }
bool Odometry::metric() const { return impl_->metric(); }
std::uint32_t Odometry::mapId() const { return impl_->map_id; }
void Odometry::finish() { impl_->adopt(impl_->adjuster.finish()); }

std::vector<bool> Odometry::mappedFeatures() const {
  std::vector<bool> mapped;
  for (const Feature& f : impl_->pose.tracker().features())
    mapped.push_back(impl_->tracks.landmarkIn(impl_->map, f.id) != visual_frontend::kNoLandmark);
  return mapped;
}

air_ground_common::Trajectory Odometry::trajectory() const { return impl_->frames.poses(impl_->map); }

}  // namespace mav_vo
