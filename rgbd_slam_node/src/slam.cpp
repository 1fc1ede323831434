#include "rgbd_slam/slam.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "air_ground_common/covariance.h"
#include "displacement.h"
#include "slam_impl.h"
#include "visual_frontend/image_noise.h"

namespace rgbd_slam {

using visual_frontend::Feature;

namespace {

constexpr double kPlaceRadius = 10;   // of the search for landmarks about where a recognised place puts them [px]
constexpr double kUpsideDown = -0.7;  // cosine of a base's lean that no robot begins with: signs are wrong
constexpr double kSameTime = 1e-3;    // of colour and depth: nothing moves much in less [s]
constexpr double kSecond = 1.01;      // for which adjustments are not asked whether they have finished, and more [s]
constexpr double kRestFelt = 0.4;     // before it is called one, a rest has lasted for that and some more [s]
constexpr double kRestShown = 5;      // of a rest, by its poses [s]
constexpr double kRestRange = 1;      // at which they are compared: turns count, too [m]
constexpr double kRestSlip = 0.02, kRestSpeed = 0.03;  // by which they may differ at rest [m], [m/s]

}  // namespace

const char* toString(State state) {
  switch (state) {
    case State::kWaiting:
      return "waiting";
    case State::kInitializing:
      return "initializing";
    case State::kTracking:
      return "tracking";
    case State::kLost:
      return "lost";
  }
  return "unknown";
}

SlamSettings::SlamSettings() {
  tracker.max_features = 250;
  tracker.min_shi_tomasi = 4e-5;  // with depth, a faint corner is better than none
  bundle.max_iterations = 6;
  bundle.max_seconds = 0.5;
}

Slam::Impl::Impl(const CameraModel& camera_model, const Mounting& mounted, const SlamSettings& slam_settings)
    : given_camera(camera_model),
      mounting(mounted),
      settings(slam_settings),
      level(slam_settings),
      loops(camera_model, slam_settings),
      dense(camera_model, slam_settings),
      surfaces(camera_model, slam_settings),
      reference(slam_settings),
      whole(slam_settings.reproducible),
      camera(camera_model),
      calibration(camera_model, slam_settings.readout_time, slam_settings.radial_stddev, 0),
      motion(camera_model, mounted, slam_settings),
      carrier(camera_model),
      tracking(camera_model, slam_settings, map, frames, tracks, surfaces, motion),
      shutter(camera_model, slam_settings),
      search(slam_settings) {
  settings.validate();
  if (!air_ground_common::isValid(mounting.T_base_camera))
    throw std::invalid_argument("Mounting::T_base_camera is not a rigid transform");
  T_camera_base = mounting.T_base_camera.inverse();
}

void Slam::Impl::clear() {
  whole.discard();
  tracking.reset();
  tracking.postponeReobservation();
  map.clear();
  frames.clear();
  covariances.clear();
  level.clear();
  loops.clear();
  dense.clear();
  surfaces.clear();
  reference.reset();
  motion.endMap();
  shutter.interrupt();
  search.clear();
  next_calibration = kCalibrationKeyframes;
  next_levelling = 1;
  state = State::kWaiting;
  first_stamp = -1;
}

SlamResult Slam::Impl::initialize(const RgbdImages& images) {
  SlamResult result;
  const double stamp = images.stamp;
  result.state = state = State::kInitializing;
  if (first_stamp < 0) first_stamp = stamp;
  motion.setRowMotion(stamp, Pose::Identity());
  tracking.restart(images.gray);
  tracking.tracker().replenish();
  const int with_depth = featuresWithDepth(images);
  result.tracked = static_cast<int>(tracking.tracker().features().size());
  if (with_depth < settings.min_start_features) {
    result.reason = "only " + std::to_string(with_depth) + " of " + std::to_string(result.tracked) +
                    " features have depth, " + std::to_string(settings.min_start_features) + " are needed to start";
    return result;
  }
  if (visual_frontend::isNoise(images.gray)) {
    result.reason = "the images show nothing but noise: uncover the lens, or give it light";
    return result;
  }
  const bool up_known = motion.upKnownAt(stamp);
  const bool awaited = motion.gyroTrusted() && motion.coverageProblem().empty();
  if (awaited && !up_known && stamp - first_stamp < settings.gravity_timeout) {
    result.reason = "waiting for the IMU to show which way is up";
    return result;
  }
  upside_down = up_known && motion.upInBase().z() < kUpsideDown;
  const bool levelled = up_known && motion.gyroTrusted() && !upside_down;
  level.begin(levelled ? &motion.attitude() : nullptr);
  result.T_map_camera = Pose(firstAttitude(levelled)) * mounting.T_base_camera;
  loops.moveTo(result.T_map_camera.translation());
  ++map_id;
  ++counters.maps;
  TrackedPose first;
  first.pose.T_map_camera = result.T_map_camera;
  first.pose.covariance = Matrix6d::Identity() * 1e-10;
  const KeyframeId id = addKeyframe(images, first);
  if (up_known) motion.startMap();
  frames.add(stamp, result.T_map_camera, id, map);
  result.state = state = State::kTracking;
  result.keyframe = result.new_map = true;
  result.T_map_base = result.T_map_camera * T_camera_base;
  motion.addPose(stamp, result.T_map_camera, Matrix6d::Zero());
  result.covariance = covariances.at(id, result.T_map_camera.translation(), map) +
                      air_ground_common::tiltCovariance(level.sigma(), result.T_map_base.translation());
  result.covariance.diagonal().array() += 1e-10;
  result.inliers = tracks.count();
  return result;
}

Eigen::Matrix3d Slam::Impl::firstAttitude(bool levelled) const {
  if (!levelled) return Eigen::Matrix3d::Identity();
  const Eigen::Matrix3d R = air_ground_common::levelingRotation(motion.upInBase());
  return Eigen::AngleAxisd(-air_ground_common::yawOf(R), Eigen::Vector3d::UnitZ()) * R;
}

std::string Slam::Impl::imuProblem() const {
  if (!motion.coverageProblem().empty()) return motion.coverageProblem();
  if (!turns.problem().empty() || !upside_down) return turns.problem();
  return "the accelerometer's up points down in the base: at rest it must read +9.81 m/s^2 along the axis that points "
         "up (specific force): check its signs and its transform to base_link";
}

void Slam::Impl::check(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth) const {
  const auto check = [&](const cv::Mat& image, bool type_ok, const char* what) {
    if (!type_ok || image.cols != camera.width || image.rows != camera.height) {
      throw std::invalid_argument(std::string("Slam::process: ") + what + " has " + std::to_string(image.cols) + "x" +
                                  std::to_string(image.rows) + " pixels of OpenCV type " +
                                  std::to_string(image.type()) + ", the camera " + std::to_string(camera.width) + "x" +
                                  std::to_string(camera.height));
    }
  };
  check(gray, gray.type() == CV_8UC1, "the grey image (CV_8UC1)");
  check(depth, depth.type() == CV_32F, "the depth image (CV_32F, registered)");
  if (!bgr.empty()) check(bgr, bgr.type() == CV_8UC3, "the colour image (CV_8UC3)");
  if (!std::isfinite(stamp) || stamp <= last_stamp)
    throw std::invalid_argument("Slam::process: the stamp is not newer than the last");
}

cv::Mat Slam::Impl::carriedTo(double stamp, const cv::Mat& depth, double depth_delay) {
  if (!(std::abs(depth_delay) > kSameTime && std::abs(depth_delay) < kLongestDepthDelay)) return depth;
  const double last = frames.empty() ? -std::numeric_limits<double>::infinity() : frames.lastStamp();
  const Pose T_image_depth = motion.movedBy(last, frames.empty() ? Pose::Identity() : lastPose(), stamp, depth_delay);
  cv::Mat carried = carrier.carry(depth, T_image_depth);
  counters.depth_carried += carried.data != depth.data;
  return carried;
}

SlamResult Slam::Impl::process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth,
                               double depth_delay) {
  check(stamp, gray, bgr, depth);
  ++counters.frames;
  if (last_stamp >= 0) motion.checkCoverage(last_stamp, stamp);
  last_stamp = stamp;
  const bool adjusted = adoptWhole(stamp);
  if (adjusted) dense.forgetFrames();
  const cv::Mat depth_now = carriedTo(stamp, depth, depth_delay);
  const RgbdImages images{stamp, gray, bgr.empty() ? gray : bgr, depth_now};
  const bool begun = state != State::kWaiting && state != State::kInitializing;
  SlamResult result = begun ? follow(images) : initialize(images);
  result.map_corrected = result.map_corrected || adjusted;
  result.imu_problem = imuProblem();
  return result;
}

SlamResult Slam::Impl::follow(const RgbdImages& images) {
  const double stamp = images.stamp;
  SlamResult result;
  const bool was_lost = state == State::kLost;
  TrackedPose tracked;
  if (!was_lost) tracked = tracking.track(images, reference);
  if (!tracked.success) {
    result.reason = tracked.reason;
    tracked = relocalize(images);
    result.relocalized = tracked.success;
    if (result.reason.empty()) result.reason = tracked.reason;
  }
  result.tracked = static_cast<int>(tracking.tracker().features().size());
  if (!tracked.success) {
    result.state = State::kLost;
    beLost(&result);
    return result;
  }
  result.state = state = State::kTracking;
  result.reason.clear();
  result.inliers = tracked.pose.inlier_count;
  result.rms = tracked.pose.rms;
  result.by_depth = tracked.by_depth;
  counters.by_depth += tracked.by_depth;
  if (was_lost) ++counters.relocalizations;
  search.found();

  const Pose T_tracked = tracked.pose.T_map_camera;
  compareTurns(stamp, T_tracked);
  result.T_previous_current_base = step(stamp, T_tracked, result.relocalized);
  // Uncertainty of the map here, then of the camera in the map.
  const auto uncertainty = [&]() -> Matrix6d {
    return covariances.at(reference.id(), T_tracked.translation(), map) + tracked.pose.covariance;
  };
  Matrix6d covariance = uncertainty();
  addToMap(images, tracked, &result);
  if (result.relocalized) covariance = uncertainty();  // by now the reference is there, not where it was lost
  motion.addPose(stamp, lastPose(), tracked.pose.covariance);
  const bool calibrated = result.keyframe && alignCalibration();
  result.recalibrated = alignShutter(images) || calibrated;
  if (levelMap() || result.recalibrated) result.map_corrected = true;
  if (result.map_corrected) {
    shutter.interrupt();
    dense.forgetFrames();
  } else {
    dense.remember(stamp, images.depth, lastPose(), motion.rows());
  }
  concludePose(covariance, tracked.pose.covariance, &result);
  return result;
}

void Slam::Impl::compareTurns(double stamp, const Pose& T_map_camera) {
  const double last = frames.lastStamp();
  const auto felt = motion.feltTurn(last, stamp);
  if (!felt) return;
  const Eigen::Matrix3d R_previous_current = lastPose().linear().transpose() * T_map_camera.linear();
  turns.add(mounting.T_base_camera.linear() * air_ground_common::logSO3(R_previous_current), *felt, stamp - last);
  motion.trustGyro(turns.problem().empty());
  if (motion.gyroTrusted() || !level.known()) return;
  level.distrust(firstBase());
  next_levelling = 1;
}

bool Slam::Impl::hasStoodSinceLost(double stamp) const {
  const double last = frames.lastStamp();
  if (!motion.restedBetween(last, stamp)) return false;
  // An even motion feels like rest: the poses of that rest tell the two apart, though somebody may push them a little.
  const double begin = std::max(motion.lastUnrest() - kRestFelt, last - kRestShown);
  std::size_t first = frames.size() - 1;
  while (first > 0 && frames.stamp(first - 1) > begin) --first;
  const double shown = last - frames.stamp(first),
               moved = displacement(frames.pose(first, map), lastPose(), kRestRange);
  return shown >= 0.5 * kRestFelt && moved < kRestSlip + kRestSpeed * shown;
}

void Slam::Impl::beLost(SlamResult* result) {
  state = State::kLost;
  ++counters.lost_frames;
  // A map that has hardly begun is not worth the wait.
  constexpr std::size_t kYoung = 20;  // poses
  const bool young = map.keyframeCount() < 2 && frames.size() < kYoung && settings.restart_after > 0;
  if (!search.givesUp() && !young) return;
  result->ended = std::make_shared<const EndedMap>(asEnded());
  clear();
}

TrackedPose Slam::Impl::relocalize(const RgbdImages& images) {
  TrackedPose tracked = relocalizeByImages(images);
  // While tracking, the surfaces have been asked already.
  if (tracked.success || state != State::kLost) return tracked;
  TrackedPose by_depth = tracking.findByDepth(images, reference.id());
  return by_depth.success ? by_depth : tracked;
}

TrackedPose Slam::Impl::relocalizeByImages(const RgbdImages& images) {
  TrackedPose tracked;
  tracking.reset();
  if (state == State::kLost && !search.due(images.stamp)) {
    tracked.reason = search.reason();
    return tracked;
  }
  search.begin(images.stamp);
  ++counters.relocalization_attempts;
  motion.setRowMotion(images.stamp, lastPose());
  tracking.restart(images.gray);
  tracked = tracking.findNearLast(images);
  if (tracked.success) return tracked;
  Keyframe query;
  const visual_frontend::PlaceMatch match = recognize(images, &query);
  if (match.success) {
    const Pose around = map.keyframe(match.keyframe).T_map_camera * match.T_place_query;
    tracked = tracking.findAround(around, kPlaceRadius, images);
    if (!tracked.success) {
      const TrackedPose by_features = tracking.findByFeatures(query, match, around, images);
      if (by_features.success) tracked = by_features;
    }
  } else {
    tracked.reason = "lost: " + match.reason;
  }
  search.conclude(match, tracked.reason);
  return tracked;
}

visual_frontend::PlaceMatch Slam::Impl::recognize(const RgbdImages& images, Keyframe* query) {
  describe(images, *query);
  const auto with_depth =
      std::count_if(query->orb_depth.begin(), query->orb_depth.end(), [](double z) { return z > 0; });
  if (with_depth >= settings.min_start_features && !visual_frontend::isNoise(images.gray) &&
      !hasStoodSinceLost(images.stamp))
    search.sawAPlace();
  visual_frontend::RelocalizationGate gate;
  gate.T_map_last = lastPose();
  gate.max_distance = settings.relocalization_slack + settings.max_speed * (images.stamp - frames.lastStamp());
  if (level.known() && motion.upKnownAt(images.stamp)) {
    gate.up_camera = motion.upInCamera();
    gate.max_tilt = std::max(gate.max_tilt, 3 * motion.attitude().upSigma());
  }
  bool from_gyro = false;
  const Pose predicted = motion.predict(frames.lastStamp(), gate.T_map_last, images.stamp, &from_gyro);
  const double lost_for = images.stamp - frames.lastStamp();
  if (from_gyro) gate.setTurn(predicted.linear(), motion.rotationSigma(lost_for), lost_for);
  return visual_frontend::relocalize(map, camera, *query, gate, settings.place);
}

Pose Slam::Impl::step(double stamp, const Pose& T_map_camera, bool relocalized) {
  const Pose T_before = lastPose();
  const double dt = stamp - frames.lastStamp();
  loops.moveTo(T_map_camera.translation());
  if (relocalized || dt > 1.0) {
    motion.interrupt();
  } else {
    motion.update(dt, T_before, T_map_camera);
  }
  reference.countFrame();
  return mounting.T_base_camera * T_before.inverse() * T_map_camera * T_camera_base;
}

void Slam::Impl::concludePose(const Matrix6d& camera_covariance, const Matrix6d& frame_covariance,
                              SlamResult* result) const {
  result->T_map_camera = lastPose();
  result->T_map_base = result->T_map_camera * T_camera_base;
  const Eigen::Vector3d lever = result->T_map_base.translation() - result->T_map_camera.translation();
  result->covariance = air_ground_common::covarianceAt(camera_covariance, lever) +
                       air_ground_common::tiltCovariance(level.sigma(), result->T_map_base.translation());
  result->covariance.diagonal().array() += 1e-10;
  if (result->relocalized) return;
  const Pose T_map_previous = result->T_map_base * result->T_previous_current_base.inverse();
  result->increment_covariance =
      2 * air_ground_common::aboutAxes(T_map_previous.linear().transpose(),
                                       air_ground_common::covarianceAt(frame_covariance, lever));
}

// ---- Public interface

Slam::Slam(const CameraModel& camera, const Mounting& mounting, const SlamSettings& settings)
    : impl_(new Impl(camera, mounting, settings)) {}
Slam::~Slam() = default;

bool Slam::addImu(const visual_frontend::ImuSample& sample) { return impl_->motion.addImu(sample); }

SlamResult Slam::process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth,
                         double depth_delay) {
  return impl_->process(stamp, gray, bgr, depth, depth_delay);
}

bool Slam::finish() { return impl_->whole.runs() && impl_->takeWhole(); }
bool Slam::adoptFinished() { return impl_->adoptWhole(impl_->last_stamp + kSecond); }
bool Slam::adjusting() const { return impl_->whole.runs(); }

air_ground_common::Trajectory Slam::trajectory() const { return impl_->frames.poses(impl_->map); }

std::vector<PosedPoints> Slam::posedPoints() const { return impl_->dense.posed(impl_->map); }
EndedMap Slam::asEnded() const { return impl_->asEnded(); }
const CameraModel& Slam::camera() const { return impl_->camera; }
const visual_frontend::Map& Slam::map() const { return impl_->map; }
const std::vector<Feature>& Slam::features() const { return impl_->tracking.tracker().features(); }
const SlamCounters& Slam::counters() const { return impl_->counters; }
Eigen::Vector3d Slam::gyroBias() const { return impl_->motion.gyroBias(); }
bool Slam::gravityKnown() const { return impl_->level.known(); }

bool Slam::levelBySurfaces() const { return impl_->level.bySurfaces(); }
double Slam::readoutTime() const { return impl_->motion.rows().readoutTime(); }
double Slam::readoutTimeStddev() const { return impl_->shutter.stddev(); }
Vertical Slam::vertical() const { return impl_->level.vertical(); }
std::optional<visual_frontend::InertialEstimate> Slam::inertialEstimate() const { return impl_->motion.estimate(); }
int Slam::mapId() const { return impl_->map_id; }

std::vector<bool> Slam::mapped() const {
  std::vector<bool> result;
  for (const Feature& f : impl_->tracking.tracker().features()) result.push_back(impl_->tracks.has(f.id));
  return result;
}

void Slam::reset() {
  impl_->clear();
  impl_->calibration = {impl_->given_camera, impl_->settings.readout_time, impl_->settings.radial_stddev, 0};
  impl_->setCamera(impl_->given_camera);
  impl_->motion.reset();
  impl_->turns.reset();
  impl_->upside_down = false;
  impl_->shutter.reset();
  impl_->last_stamp = -1;
}

}  // namespace rgbd_slam
