// The odometry's map: how it begins, grows, is adjusted and becomes metric.
#include <algorithm>
#include <iterator>
#include <utility>

#include "increment.h"
#include "metric_map.h"
#include "odometry_impl.h"
#include "visual_frontend/image_memory.h"
#include "visual_frontend/local_landmarks.h"

namespace mav_vo {

using visual_frontend::kNoKeyframe;
using visual_frontend::kNoLandmark;

namespace {

constexpr double kUnknownTilt = 0.1;        // of a map that has not begun [rad]
constexpr double kMovingTilt = 0.3;         // of gravity as a moving accelerometer shows it [rad]
constexpr double kTrustedTilt = 0.05;       // better known gravity levels the bundle adjustment [rad]
constexpr double kMapTurnError = 8e-3;      // of the turn from a map's first keyframe to its newest [rad]
constexpr double kMapBiasSigma = 2e-3;      // of a gyro bias from a map, at the best [rad/s]
constexpr double kOtherBias = 6;            // standard deviations between the map's bias and the tracks'
constexpr double kRestBiasPrior = 1e-3;     // of a gyro bias, at the best [rad/s]
constexpr double kMaxGyroBiasPrior = 0.05;  // [rad/s]
constexpr double kLeastParallax = 10;       // of a new landmark, in standard deviations of a ray

int mappedObservations(const Keyframe& keyframe) {
  return static_cast<int>(
      std::count_if(keyframe.observations.begin(), keyframe.observations.end(),
                    [](const visual_frontend::Observation& o) { return o.landmark != kNoLandmark; }));
}

/// Up in the IMU's axes as it is known at the first views; until gravity is known the vehicle is taken to be level.
std::optional<UpDirection> upAtStart(const ImuAlignment& imu, double stamp, bool use_imu) {
  if (imu.up() && imu.up()->sigma < kMovingTilt) return imu.up();
  if (const auto up = imu.attitude(stamp); up && use_imu) return UpDirection{up->up_imu, kMovingTilt};
  return std::nullopt;
}

/// A view of the start as a keyframe.
Keyframe keyframeOf(BootstrapView& view, const Pose& T_map_first, const visual_frontend::LandmarkTracks& tracks) {
  Keyframe keyframe;
  keyframe.stamp = view.stamp;
  keyframe.T_map_camera = T_map_first * view.T_first_camera;
  for (const visual_frontend::Feature& f : view.features)
    keyframe.observations.push_back({tracks.landmarkOf(f.id), f.id, f.pixel, f.normalized});
  keyframe.pyramid = std::move(view.pyramid);
  return keyframe;
}

}  // namespace

void Odometry::Impl::startMap() {
  adjuster.discard();
  bootstrap.reset();
  keepMapsBias();
  map.clear();
  revision.restart();
  inertial.clear();
  tracks.clear();
  covariances.clear();
  frames.clear();
  bias.gyro = imu.gyroBias();  // the old map's may have been why it was lost
  pose.reset();
  relocalizer.reset();
  policy.reset();
  scale.begin(kUnknownTilt);
  relocalized = false;
  contradicted_links = agreeing_links = 0;
  ++map_id;
  state = OdometryState::kInitializing;
  reason = "new map";
}

// A map measures turns against landmarks it has triangulated: turn and translation, which image pairs confuse, are
// apart.
double Odometry::Impl::mapBiasSigma() const {
  const double lived = map.keyframe(map.lastKeyframe()).stamp - map.keyframes().begin()->second.stamp;
  return std::max(kMapBiasSigma, kMapTurnError / std::max(lived, 0.1));
}

bool Odometry::Impl::mapHasBias() const { return settings.use_imu && inertial.linked() && map.keyframeCount() >= 2; }

void Odometry::Impl::keepMapsBias() {
  if (metric() && mapHasBias() && !mapBiasRefuted()) imu.keepBias(inertial.newestBias()->gyro, mapBiasSigma());
}

bool Odometry::Impl::mapBiasRefuted() const {
  return mapHasBias() && (inertial.newestBias()->gyro - imu.gyroBias()).norm() >
                             kOtherBias * std::hypot(mapBiasSigma(), imu.gyroBiasStddev());
}

// Keyframes that have left the window hold the newest ones to the bias of their time. Where it does not help to adjust
// them, too, the landmarks of a false start bend the turns of the gyro towards themselves.
void Odometry::Impl::leaveRefutedBias() {
  adopt(adjuster.finish());
  if (mapBiasRefuted()) adjustAnew();
  if (mapBiasRefuted()) startMap();
}

void Odometry::Impl::initialize(const cv::Mat& gray) {
  visual_frontend::FeatureTracker& tracker = pose.tracker();
  if (tracker.lastSurvival() < 0.7 || tracker.features().size() < 0.7 * settings.tracker.max_features)
    tracker.replenish();
  auto start = bootstrap.add(last_stamp, pose.currentFeatures(), tracker.pyramid(),
                             [this](double a, double b) { return cameraTurn(a, b); });
  if (!start) {
    const std::string problem = settings.use_imu ? imu.problem() : "";
    reason = "initialising: " + (problem.empty() ? bootstrap.reason() : problem);
    return;
  }
  const auto up = upAtStart(imu, last_stamp, settings.use_imu);
  const double tilt = up ? up->sigma : kMovingTilt;
  Pose T_map_first(T_base_camera.linear());
  if (up)
    T_map_first = levelRotation(start->views.back().T_first_camera.linear() * (R_camera_imu() * up->up_imu),
                                Eigen::Matrix3d::Identity(), T_base_camera);

  for (const auto& point : start->points) tracks.assign(point.track, map.addLandmark(T_map_first * point.position));
  for (BootstrapView& view : start->views) {
    Keyframe keyframe = keyframeOf(view, T_map_first, tracks);
    if (tilt < kTrustedTilt) {
      keyframe.up_camera = keyframe.T_map_camera.linear().transpose() * Eigen::Vector3d::UnitZ();
      keyframe.up_sigma = std::max(0.01, tilt);
    }
    insertKeyframe(std::move(keyframe));
  }
  bootstrap.reset();
  adjuster.schedule(last_stamp, map.keyframeCount());
  scale.begin(tilt);
  levelled = up.has_value() || !settings.use_imu;
  const Pose& T_map_last = map.keyframe(map.lastKeyframe()).T_map_camera;
  pose.beginMap(T_map_last, (T_map_last.translation() - T_map_first.translation()) /
                                (start->views.back().stamp - start->views.front().stamp));
  state = OdometryState::kScaling;
  reason = scaleReason();
  if (pose.locate(std::nullopt)) {
    localized(gray, false);
    // The first landmarks are poor, and so is a pose by them; the keyframe is adjusted.
    if (!made_keyframe) frames.lastIsKeyframe(map.lastKeyframe());
    createLandmarks(map.lastKeyframe());
  } else {
    startMap();
    reason = "initialising: the first map did not hold in the next image; another is tried";
  }
}

// A vehicle that was taken to be level may have leaned by any angle, and base_link's z axis need not point up.
void Odometry::Impl::level() {
  const auto up = imu.attitude(last_stamp);
  if (!up) return;
  adopt(adjuster.finish());
  air_ground_common::Similarity S;
  S.R = levelRotation(frames.lastPose(map).linear() * (R_camera_imu() * up->up_imu),
                      map.keyframes().begin()->second.T_map_camera.linear(), T_base_camera);
  transformMap(S);
  revision.restart();
  scale.estimateAnew(frames, map);
  levelled = true;
}

KeyframeId Odometry::Impl::insertKeyframe(Keyframe keyframe) {
  const KeyframeId before = map.lastKeyframe();
  const Keyframe* previous = before == kNoKeyframe ? nullptr : &map.keyframe(before);
  std::optional<Preintegration> motion;
  if (settings.use_imu && previous) motion = imu.motion(previous->stamp, keyframe.stamp, bias);
  if (motion && (relocalized || metric()) && !agrees(*motion, *previous, keyframe)) motion.reset();
  relocalized = false;
  const KeyframeId id = map.addKeyframe(std::move(keyframe));
  tracks.addViews(map.keyframe(id));
  inertial.add(id, previous, motion, bias, imuVelocity(map.keyframe(id), motion.has_value()));
  return id;
}

// In a metric map nothing but its scale, which no image holds, could give way to an IMU that has gone wrong. One that
// has contradicted is believed again when it agrees closely for some keyframes in a row.
bool Odometry::Impl::agrees(const Preintegration& motion, const Keyframe& previous, const Keyframe& keyframe) {
  constexpr int kBelieved = 4;
  const bool doubted = contradicted_links > 0 && !relocalized;
  if (inertial.contradicts(motion, previous, keyframe, imu.gyroBiasStddev(), pose.sceneDistance(), doubted)) {
    contradicted_links += !relocalized;
    agreeing_links = 0;
    return false;
  }
  if (doubted && ++agreeing_links < kBelieved) return false;
  contradicted_links = agreeing_links = 0;
  return true;
}

// Where no motion leads to the keyframe, the filter has no velocity either; by the images' the next one is judged.
Eigen::Vector3d Odometry::Impl::imuVelocity(const Keyframe& keyframe, bool linked) const {
  if (!metric()) return Eigen::Vector3d::Zero();
  if (const auto seen = linked ? std::nullopt : frames.velocityAt(keyframe.stamp, map))
    return keyframe.T_map_camera.linear() *
           (seen->linear + seen->angular.cross(inertial.data().T_camera_imu.translation()));
  return scale.filter().initialized() ? scale.filter().state().velocity() : Eigen::Vector3d::Zero();
}

void Odometry::Impl::addKeyframe(const cv::Mat& gray) {
  adopt(adjuster.finishNewest());  // keyframes closer together than its lag wait for the one before
  Keyframe keyframe;
  keyframe.stamp = last_stamp;
  keyframe.T_map_camera = pose.pose();
  keyframe.observations = pose.observations();
  policy.follow(map.keyframe(map.lastKeyframe()), pose.pose(), pose.sceneDistance());
  // What a hovering camera sees is in earlier images already.
  if (!policy.hovering())
    for (const cv::Mat& level : pose.tracker().pyramid()) keyframe.pyramid.push_back(level.clone());
  visual_frontend::describeKeyframe(gray, camera, settings.place, keyframe);
  if (const auto& up = imu.up(); !metric() && up && up->sigma < kTrustedTilt) {
    keyframe.up_camera = R_camera_imu() * up->up_imu;
    keyframe.up_sigma = std::max(0.02, up->sigma);
  }
  const bool trusted = contradicted_links == 0;
  const KeyframeId id = insertKeyframe(std::move(keyframe));
  frames.lastIsKeyframe(id);
  createLandmarks(id);
  pose.tracker().replenish();
  covariances.add(id, pose.result().covariance, map);
  map.dropFarImages(pose.pose(), visual_frontend::imagesKept(pose.tracker().pyramid(), settings.max_image_keyframes),
                    pose.sceneDistance());
  thinKeyframes();
  adopt(adjuster.adjustNewest(map, inertial.data(), bundleSettings(), last_stamp));
  policy.setLandmarks(mappedObservations(map.keyframe(id)));
  if (trusted && contradicted_links > 0) {
    scale.dropMotionSince(std::prev(map.keyframes().find(id))->second.stamp, frames);
    scale.judgeAnew(frames, map, inertial.data(), metric_since);
  }
  made_keyframe = true;
}

void Odometry::Impl::createLandmarks(KeyframeId id) {
  visual_frontend::TriangulationSettings how;
  // Where few tracks have a landmark the next one is needed at once, with 10 % of its depth open.
  const Keyframe& keyframe = map.keyframe(id);
  const bool few = 2 * static_cast<std::size_t>(mappedObservations(keyframe)) < keyframe.observations.size();
  how.min_parallax =
      few ? std::min(settings.triangulation_parallax, kLeastParallax * sigma()) : settings.triangulation_parallax;
  how.min_depth = 0.1 * pose.sceneDistance();
  how.max_depth = 20 * pose.sceneDistance();
  for (const auto& unplaced : visual_frontend::createLandmarks(id, camera, settings.pixel_sigma, how, map, tracks)) {
    if (unplaced.status != visual_frontend::TriangulationStatus::kLargeResidual &&
        unplaced.status != visual_frontend::TriangulationStatus::kBehindCamera)
      continue;
    pose.tracker().remove({unplaced.track});
    tracks.forgetViews(unplaced.track);
  }
  tracks.forgetMissing(map);
  tracks.keep(pose.tracker().features());
}

// Only keyframes that no adjustment moves any more: what they tell is in their landmarks.
void Odometry::Impl::thinKeyframes() {
  const int newest = std::max(settings.full_max_keyframes, mostInWindow(settings) + 1);
  if (static_cast<int>(map.keyframeCount()) <= newest) return;
  inertial.forgetLinksBefore(std::prev(map.keyframes().end(), newest)->first);
  const KeyframeId id = map.redundantKeyframe(newest, {settings.keyframe_distance, settings.keyframe_angle});
  if (id == kNoKeyframe) return;
  frames.rebase(id, std::prev(map.keyframes().find(id))->first, map);
  tracks.forgetKeyframe(id);
  inertial.remove(id, map);
  covariances.forget(id);
  std::vector<visual_frontend::LandmarkId> seen;
  for (const auto& o : map.keyframe(id).observations)
    if (o.landmark != kNoLandmark) seen.push_back(o.landmark);
  map.removeKeyframe(id);
  for (const auto landmark : seen)
    if (map.hasLandmark(landmark) && map.landmark(landmark).observations.size() < 2) map.removeLandmark(landmark);
}

void Odometry::Impl::transformMap(const air_ground_common::Similarity& S) {
  map.transform(S);
  frames.rescale(S.scale);
  scale.transform(S);
  pose.transform(S);
  covariances.transform(S);
  if (increment) scaleIncrement(S.scale, T_base_camera, &*increment);
}

void Odometry::Impl::makeMetric() {
  adopt(adjuster.finish());
  const ScaleFilter::State estimate = scale.filter().state();
  transformMap(
      metricMap(estimate.scale, -estimate.gravity(), map.keyframes().begin()->second.T_map_camera, T_base_camera));
  revision.restart();
  metric_since = last_stamp;
  bias.accel = estimate.accel_bias;
  inertial.makeMetric(map, bias.accel);
  for (const auto& entry : map.keyframes()) map.keyframe(entry.first).up_camera.reset();
  adjustWholeMap();
  adopt(adjuster.finish());
}

// Links whose samples are gone keep the offset of their time.
void Odometry::Impl::retime() {
  const auto between = [this](double from, double to, const ImuBias& of) { return imu.motion(from, to, of); };
  inertial.integrateAnew(map, between);
  scale.integrateAnew(frames, between);
  if (!metric()) scale.estimateAnew(frames, map);
}

// The IMU's axes have become others.
void Odometry::Impl::turnImu(const Eigen::Matrix3d& R_new_old) {
  bias.gyro = R_new_old * bias.gyro;
  if (map.keyframeCount() == 0) return;
  adopt(adjuster.finish());
  inertial.turn(R_new_old, map);
  scale.turn(R_new_old);
  if (!metric()) return adjustAnew();
  bias.accel = inertial.newestBias()->accel;
  scale.judgeAnew(frames, map, inertial.data(), metric_since);
  adjustWholeMap();
}

visual_frontend::BundleSettings Odometry::Impl::bundleSettings() const {
  visual_frontend::BundleSettings bundle;
  bundle.pixel_sigma = settings.pixel_sigma;
  bundle.threads = settings.bundle_threads;
  bundle.gyro_bias_prior = std::clamp(imu.gyroBiasStddev(), kRestBiasPrior, kMaxGyroBiasPrior);
  // A map that is not metric yet may have begun with a bias that the tracks have long known better.
  if (!metric()) bundle.gyro_bias_mean = imu.gyroBias();
  return bundle;
}

void Odometry::Impl::adjustWholeMap() {
  BundleJob whole = adjuster.wholeMap(map, inertial.data(), bundleSettings());
  if (calibration.estimates()) calibration.open(velocityAt(), map, &whole);
  // A vibration that is folded down turns the gyro, too.
  if (settings.imu_rotation_stddev > 0 && metric() && !imu.vibrates()) whole.problem.mounting = inertial.openMounting();
  adopt(adjuster.adjustWhole(std::move(whole), last_stamp));
}

// With an IMU, ImuAlignment tells the readout time.
visual_frontend::CalibrationAlignment Odometry::Impl::givenCalibration() const {
  return {given_camera, settings.readout_time, settings.radial_stddev,
          settings.use_imu ? 0 : settings.readout_time_stddev};
}

visual_frontend::VelocityAt Odometry::Impl::velocityAt() const {
  return [this](double stamp) { return frames.velocityAt(stamp, map); };
}

void Odometry::Impl::setCamera(const CameraModel& better_known) {
  camera = better_known;
  pose.setCamera(camera);
  bootstrap.setCamera(camera);
  relocalizer.setCamera(camera);
  adjuster.setCamera(camera);
}

void Odometry::Impl::setReadoutTime(double readout_time) {
  next_readout.reset();
  adopt(adjuster.finish());
  pose.setReadoutTime(readout_time);
  calibration.followReadout(readout_time);
  if (map.keyframeCount() == 0) return;
  calibration.recalibrate(velocityAt(), &map);
  metric() ? adjustWholeMap() : adjustAnew();
}

// What was taken for known has turned out to be wrong, and so is what old keyframes have of it: the gyro's bias, too.
void Odometry::Impl::adjustAnew() {
  adopt(adjuster.adjustWhole(adjuster.wholeMap(map, inertial.data(), bundleSettings()), last_stamp));
  adopt(adjuster.finish());
}

void Odometry::Impl::recalibrate(const visual_frontend::CalibrationEstimate& estimate) {
  calibration.follow(estimate);
  setCamera(calibration.camera());
  if (!settings.use_imu) pose.setReadoutTime(calibration.readoutTime());
  calibration.recalibrate(velocityAt(), &map);
  adjuster.schedule(last_stamp, map.keyframeCount());
  revision.next();
}

void Odometry::Impl::adopt(const MapAdjuster::Jobs& jobs) {
  if (jobs.empty()) return;
  // An image may be under way, whose pose is predicted from the last one's.
  const Pose T_last_now = frames.empty() ? Pose::Identity() : frames.lastPose(map).inverse() * pose.pose();
  for (const BundleJob& job : jobs) {
    if (!job.result.usable || job.problem.metric != metric()) continue;
    applyBundle(job, map, &inertial.data());
    if (job.problem.mounting) inertial.mount(job.problem.mounting->turn);
    revision.follow(map, pose.sceneDistance());
    if (job.problem.calibration) recalibrate(*job.problem.calibration);
    const ImuBias* newest = inertial.newestBias();
    if (newest && settings.use_imu) bias.gyro = newest->gyro;
    if (metric()) bias.accel = newest->accel;
    if (job.full && metric()) scale.judgeAnew(frames, map, inertial.data(), metric_since);
    if (job.full && !metric() && settings.use_imu) scale.estimateAnew(frames, map);
  }
  if (!frames.empty()) pose.setPose(frames.lastPose(map) * T_last_now);
}

}  // namespace mav_vo
