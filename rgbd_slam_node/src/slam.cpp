#include "rgbd_slam/slam.h"

#include <cmath>
#include <stdexcept>

#include "slam_impl.h"

namespace rgbd_slam {

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
  bundle.pixel_sigma = 1.0;
}

Slam::Impl::Impl(const CameraModel& camera_model, const Mounting& mounted, const SlamSettings& slam_settings)
    : camera(camera_model),
      mounting(mounted),
      settings(slam_settings),
      tracker(camera_model, slam_settings.tracker),
      motion(camera_model, mounted, slam_settings) {
  settings.validate();
  if (!air_ground_common::isValid(mounting.T_base_camera))
    throw std::invalid_argument("Mounting::T_base_camera is not a rigid transform");
  focal = 0.5 * (camera.fx + camera.fy);
  T_camera_base = mounting.T_base_camera.inverse();
  if (settings.readout_time_stddev > 0)
    shutter.emplace(settings.readout_time, settings.readout_time_stddev, settings.pixel_sigma / focal);
}

void Slam::Impl::clear() {
  tracker.reset();
  map.clear();
  tracks.clear();
  covariances.clear();
  keyframe_path.clear();
  keyframe_points.clear();
  active_depth.reset();
  motion.endMap();
  if (shutter) shutter->interrupt();
  gravity_known = leveled = false;
  frames.clear();
  state = State::kWaiting;
  first_stamp = last_attempt = -1;
  strange_for = 0;
  nearly_found = false;
  path = 0;
  since_keyframe = since_reobservation = 0;
  reference = kNoKeyframe;
}

FrameResult Slam::Impl::initialize(const Images& images) {
  FrameResult result;
  const double stamp = images.stamp;
  result.state = state = State::kInitializing;
  if (first_stamp < 0) first_stamp = stamp;
  motion.setRowMotion(stamp, Pose::Identity());
  tracker.reset();
  tracker.track(images.gray);
  tracker.replenish();
  int with_depth = 0;
  for (const Feature& f : tracker.features())
    with_depth += sampleDepth(images.depth, f.pixel, settings.depth).has_value();
  result.tracked = static_cast<int>(tracker.features().size());
  if (with_depth < settings.min_start_features) {
    result.reason = "only " + std::to_string(with_depth) + " of " + std::to_string(result.tracked) +
                    " features have depth, " + std::to_string(settings.min_start_features) + " are needed to start";
    return result;
  }
  const visual_frontend::AttitudeFilter& attitude = motion.attitude();
  const bool imu_ready = motion.hasImu() && attitude.initialized();
  if (motion.hasImu() && !imu_ready && stamp - first_stamp < settings.gravity_timeout) {
    result.reason = "waiting for the IMU to show which way is up";
    return result;
  }
  // Level, yaw 0, origin at the base.
  Eigen::Matrix3d R_map_base = Eigen::Matrix3d::Identity();
  if (imu_ready) {
    R_map_base = air_ground_common::levelingRotation(*mounting.R_base_imu * attitude.up());
    R_map_base = Eigen::AngleAxisd(-air_ground_common::yawOf(R_map_base), Eigen::Vector3d::UnitZ()) * R_map_base;
  }
  gravity_known = imu_ready;
  // Begun in motion, the first direction is coarse: levelMap looks again when more is known.
  leveled = !imu_ready || attitude.atRest();
  result.T_map_camera = Pose(R_map_base) * mounting.T_base_camera;
  ++map_id;
  ++counters.maps;
  addKeyframe(images, result.T_map_camera, Matrix6d::Identity() * 1e-10);
  if (imu_ready) motion.startMap();
  tilt_sigma = imu_ready ? attitude.upSigma() : 0.05;
  vertical = {Eigen::Vector3d::UnitZ(), tilt_sigma};
  frames.add(stamp, result.T_map_camera, reference, map);
  result.state = state = State::kTracking;
  result.keyframe = result.new_map = true;
  result.T_map_base = result.T_map_camera * T_camera_base;
  motion.addPose(stamp, result.T_map_camera, Matrix6d::Zero());
  result.covariance = covariances.at(reference, result.T_map_camera.translation(), map) +
                      visual_frontend::tiltCovariance(tilt_sigma, result.T_map_base.translation());
  result.covariance.diagonal().array() += 1e-10;
  result.inliers = tracks.count();
  return result;
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

FrameResult Slam::Impl::process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth) {
  check(stamp, gray, bgr, depth);
  ++counters.frames;
  last_stamp = stamp;
  const Images images{stamp, gray, bgr.empty() ? gray : bgr, depth};
  if (state == State::kWaiting || state == State::kInitializing) return initialize(images);

  FrameResult result;
  const bool was_lost = state == State::kLost;
  Tracked tracked;
  if (!was_lost) tracked = track(images);
  if (!tracked.success) {
    result.reason = tracked.reason;
    tracked = relocalize(images);
    result.relocalized = tracked.success;
    if (result.reason.empty()) result.reason = tracked.reason;
  }
  result.tracked = static_cast<int>(tracker.features().size());
  if (!tracked.success) {
    result.state = State::kLost;
    beLost();
    return result;
  }
  result.state = state = State::kTracking;
  result.reason.clear();
  result.inliers = tracked.pose.inlier_count;
  result.rms = tracked.pose.rms;
  if (was_lost) ++counters.relocalizations;
  strange_for = 0;

  const Pose T_tracked = tracked.pose.T_map_camera;
  compareTurns(stamp, T_tracked);
  result.imu_problem = turns.problem();
  result.T_previous_current_base = step(stamp, T_tracked, result.relocalized);
  // Uncertainty of the map here, then of the camera in the map.
  const Matrix6d covariance = covariances.at(reference, T_tracked.translation(), map) + tracked.pose.covariance;
  addToMap(images, tracked, &result);
  motion.addPose(stamp, lastPose(), tracked.pose.covariance);
  if (alignShutter(images) || levelMap()) result.map_corrected = true;
  if (shutter && result.map_corrected) shutter->interrupt();
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
  // Which way is up comes from the gyro, too, whenever the robot moves.
  if (!motion.gyroTrusted()) gravity_known = false;
}

void Slam::Impl::beLost() {
  state = State::kLost;
  ++counters.lost_frames;
  const bool restart = settings.restart_after > 0 && strange_for >= settings.restart_after - 1e-6;
  // A map this small is no loss; nor can much be recognised by it.
  if (restart || map.keyframeCount() < 2) clear();
}

Pose Slam::Impl::step(double stamp, const Pose& T_map_camera, bool relocalized) {
  const Pose T_before = lastPose();
  const double dt = stamp - frames.lastStamp();
  path += (T_map_camera.translation() - T_before.translation()).norm();
  if (relocalized || dt > 1.0) {
    motion.interrupt();
  } else {
    motion.update(dt, T_before, T_map_camera);
  }
  ++since_keyframe;
  return mounting.T_base_camera * T_before.inverse() * T_map_camera * T_camera_base;
}

void Slam::Impl::addToMap(const Images& images, const Tracked& tracked, FrameResult* result) {
  const Pose& T_map_camera = tracked.pose.T_map_camera;
  const bool due = result->relocalized || keyframeDue(T_map_camera, tracked.landmarks);
  const KeyframeId known = due ? keyframeOfView(T_map_camera, tracked.landmarks) : reference;
  if (known == kNoKeyframe) {
    const KeyframeId id = addKeyframe(images, T_map_camera, tracked.pose.covariance);
    result->keyframe = true;
    frames.add(images.stamp, map.keyframe(id).T_map_camera, id, map);
    if (settings.loop_closure) result->map_corrected = closeLoop(id);
    removeReplacedBy(id);
    if (result->map_corrected) motion.moveMap(lastPose() * T_map_camera.inverse());
    return;
  }
  if (known != reference) setReference(known);
  frames.add(images.stamp, T_map_camera, reference, map);
  if (active_depth && active_depth->frames() <= settings.max_fused_frames) {
    const Pose T_reference_camera = map.keyframe(reference).T_map_camera.inverse() * T_map_camera;
    active_depth->fuse(camera, images.depth, T_reference_camera.inverse(), settings.depth, settings.cloud,
                       &motion.rows());
  }
}

void Slam::Impl::concludePose(const Matrix6d& camera_covariance, const Matrix6d& frame_covariance,
                              FrameResult* result) const {
  result->T_map_camera = lastPose();
  result->T_map_base = result->T_map_camera * T_camera_base;
  const Eigen::Vector3d lever = result->T_map_base.translation() - result->T_map_camera.translation();
  result->covariance = visual_frontend::covarianceAt(camera_covariance, lever) +
                       visual_frontend::tiltCovariance(tilt_sigma, result->T_map_base.translation());
  result->covariance.diagonal().array() += 1e-10;
  if (result->relocalized) return;
  Matrix6d base_map = Matrix6d::Zero();
  base_map.topLeftCorner<3, 3>() = base_map.bottomRightCorner<3, 3>() = result->T_map_base.linear().transpose();
  result->increment_covariance =
      2 * base_map * visual_frontend::covarianceAt(frame_covariance, lever) * base_map.transpose();
}

// ---- Public interface

Slam::Slam(const CameraModel& camera, const Mounting& mounting, const SlamSettings& settings)
    : impl_(new Impl(camera, mounting, settings)) {}
Slam::~Slam() = default;

bool Slam::addImu(const visual_frontend::ImuSample& sample) { return impl_->motion.addImu(sample); }

FrameResult Slam::process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth) {
  return impl_->process(stamp, gray, bgr, depth);
}

air_ground_common::Trajectory Slam::trajectory() const { return impl_->frames.poses(impl_->map); }

std::vector<PosedPoints> Slam::posedPoints() const {
  std::vector<PosedPoints> result;
  for (const auto& [id, points] : impl_->keyframe_points)
    result.push_back({impl_->map.keyframe(id).T_map_camera, points, id});
  if (impl_->active_depth && impl_->map.keyframeCount() > 0) {
    auto points = std::make_shared<std::vector<KeyframeDepth::Point>>(
        impl_->active_depth->points(impl_->settings.depth, impl_->settings.cloud));
    result.push_back({impl_->map.keyframe(impl_->reference).T_map_camera, points, impl_->reference});
  }
  return result;
}

const visual_frontend::Map& Slam::map() const { return impl_->map; }
const std::vector<Feature>& Slam::features() const { return impl_->tracker.features(); }
const SlamCounters& Slam::counters() const { return impl_->counters; }
Eigen::Vector3d Slam::gyroBias() const { return impl_->motion.gyroBias(); }
bool Slam::gravityKnown() const { return impl_->gravity_known; }
double Slam::readoutTime() const { return impl_->motion.rows().readoutTime(); }
double Slam::readoutTimeStddev() const { return impl_->shutter ? impl_->shutter->stddev() : 0; }
Vertical Slam::vertical() const { return impl_->vertical; }
std::optional<visual_frontend::InertialEstimate> Slam::inertialEstimate() const { return impl_->motion.estimate(); }
int Slam::mapId() const { return impl_->map_id; }

std::vector<bool> Slam::mapped() const {
  std::vector<bool> result;
  for (const Feature& f : impl_->tracker.features()) result.push_back(impl_->tracks.has(f.id));
  return result;
}

void Slam::reset() {
  impl_->clear();
  impl_->motion.reset();
  impl_->turns.reset();
  if (impl_->shutter) impl_->shutter->reset();
  impl_->last_stamp = -1;
}

}  // namespace rgbd_slam
