#include <algorithm>

#include "odometry_impl.h"

namespace mav_vo {

namespace {

constexpr double kRestBiasPrior = 1e-3;                   // of a gyro bias, at the best [rad/s]
constexpr double kMaxGyroBiasPrior = 0.05;                // [rad/s]
constexpr double kMaxSeconds = 10, kMaxFullSeconds = 20;  // of an adjustment, wall clock [s]
constexpr double kParameterTolerance = 1e-8;              // relative step at which its iterations end
constexpr int kMinShared = 8;                             // landmarks that make an older keyframe hold the window

}  // namespace

void Odometry::Impl::adjustLocally() {
  std::vector<KeyframeId> free, fixed;
  for (auto it = map.keyframes().rbegin(); it != map.keyframes().rend(); ++it) {
    if (static_cast<int>(free.size()) < settings.window) {
      free.push_back(it->first);
    } else {
      fixed.push_back(it->first);  // where the window's inertial chain begins
      break;
    }
  }
  std::sort(free.begin(), free.end());
  for (const auto& other : map.observers(map.landmarksOf(free), kMinShared)) {
    if (static_cast<int>(fixed.size()) > settings.window_fixed) break;
    if (other.keyframe < free.front() && (fixed.empty() || other.keyframe != fixed.front()))
      fixed.push_back(other.keyframe);
  }
  run(extractBundle(map, camera, free, fixed, bundleSettings(settings.local_iterations, kMaxSeconds), &inertial));
}

void Odometry::Impl::adjustFully() {
  std::vector<KeyframeId> free, fixed;
  for (const auto& entry : map.keyframes()) free.push_back(entry.first);
  if (static_cast<int>(free.size()) > settings.full_max_keyframes) {
    const auto first = free.end() - settings.full_max_keyframes;
    fixed.assign(free.begin(), first);
    free.erase(free.begin(), first);
  }
  BundleJob job =
      extractBundle(map, camera, free, fixed, bundleSettings(settings.full_iterations, kMaxFullSeconds), &inertial);
  job.full = true;
  next_full = last_stamp + full_interval;
  full_interval = std::min(2 * full_interval, 4 * settings.full_interval);
  run(std::move(job));
}

void Odometry::Impl::run(BundleJob job) {
  if (settings.synchronous) {
    job.solve();
    adopt(job);
    return;
  }
  // At most one of each kind. Keyframes closer together than the lag wait for the one before.
  if (job.full && adjustments.fullRuns()) {
    next_full = last_stamp;
    return;
  }
  if (!job.full) adoptLocal();
  adjustments.start(std::move(job), last_stamp);
}

void Odometry::Impl::adoptDue() {
  if (adjustments.localDue()) adoptLocal();
  if (adjustments.fullDue(last_stamp)) adoptAll();
}

// A local result begun before the whole map moved must be in before that.
void Odometry::Impl::adoptAll() {
  adoptLocal();
  if (!adjustments.fullRuns()) return;
  adopt(adjustments.takeFull());
  if (!frames.empty()) T_map_camera = frames.lastPose(map);
}

void Odometry::Impl::adoptLocal() {
  if (!adjustments.localRuns()) return;
  adopt(adjustments.takeLocal());
  if (!frames.empty()) T_map_camera = frames.lastPose(map);
}

void Odometry::Impl::adopt(const BundleJob& job) {
  if (!job.result.usable || job.problem.metric != metric) return;
  applyBundle(job, map, &inertial);
  revision.follow(map, scene_distance);
  const auto newest = inertial.states.rbegin();
  if (newest != inertial.states.rend() && settings.use_imu) bias.gyro = newest->second.bias.gyro;
  if (!metric) return;
  bias.accel = newest->second.bias.accel;
  if (job.full) scale.judgeAnew(frames, map, inertial, metric_since);
}

visual_frontend::BundleSettings Odometry::Impl::bundleSettings(int iterations, double max_seconds) const {
  visual_frontend::BundleSettings bundle;
  bundle.pixel_sigma = settings.pixel_sigma;
  bundle.max_iterations = iterations;
  bundle.max_seconds = max_seconds;
  bundle.threads = settings.bundle_threads;
  bundle.parameter_tolerance = kParameterTolerance;
  bundle.gyro_bias_prior = std::clamp(imu.gyroBiasStddev(), kRestBiasPrior, kMaxGyroBiasPrior);
  // A map that is not metric yet may have begun with a bias that the tracks have long known better.
  if (!metric) bundle.gyro_bias_mean = imu.gyroBias();
  return bundle;
}

// Links whose samples are gone keep the offset of their time.
void Odometry::Impl::retime() {
  for (auto& link : inertial.links) {
    const auto here = map.keyframes().find(link.first);
    if (here == map.keyframes().end() || here == map.keyframes().begin()) continue;
    const auto motion = imu.motion(std::prev(here)->second.stamp, here->second.stamp, link.second.bias());
    if (motion) link.second = *motion;
  }
  scale.integrateAnew(frames, [this](double from, double to, const ImuBias& of) { return imu.motion(from, to, of); });
  if (!metric) scale.estimateAnew(frames, map);
}

}  // namespace mav_vo
