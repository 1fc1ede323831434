#include "map_adjuster.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace mav_vo {

using visual_frontend::BundleSettings;
using visual_frontend::InertialMap;
using visual_frontend::KeyframeId;
using visual_frontend::Map;

namespace {

constexpr double kMaxSeconds = 10, kMaxWholeSeconds = 20;  // of an adjustment, wall clock [s]
constexpr double kNoLimit = 600;                           // where a slow machine shall give the same [s]
constexpr double kIntervalPerKeyframe = 0.16;              // of the whole map [s]
constexpr int kYoungWindows = 3;                           // that move in a map which is not metric yet
constexpr double kParameterTolerance = 1e-8;               // relative step at which its iterations end
constexpr int kMinShared = 8;                              // landmarks that make an older keyframe hold the window

}  // namespace

MapAdjuster::Jobs MapAdjuster::adjustNewest(const Map& map, const InertialMap& inertial, BundleSettings settings,
                                            double stamp) {
  if (threads_.localRuns()) throw std::logic_error("MapAdjuster: the adjustment before is not in the map yet");
  std::vector<KeyframeId> free, fixed;
  // What begins the window's inertial chain holds its gyro bias, which the first seconds do not know yet.
  const bool bias_open = !inertial.metric && !inertial.links.empty();
  const int least = bias_open ? kYoungWindows * settings_.window : settings_.window;
  const int most = inertial.metric ? mostInWindow(settings_) : least;
  const double begin = map.keyframe(map.lastKeyframe()).stamp - settings_.window_duration;
  for (auto it = map.keyframes().rbegin(); it != map.keyframes().rend(); ++it) {
    const int count = static_cast<int>(free.size());
    if (count >= (it->second.stamp < begin ? least : most)) {
      fixed.push_back(it->first);  // where the window's inertial chain begins
      break;
    }
    free.push_back(it->first);
  }
  std::sort(free.begin(), free.end());
  for (const auto& other : map.observers(map.landmarksOf(free), kMinShared)) {
    if (static_cast<int>(fixed.size()) > settings_.window_fixed) break;
    if (other.keyframe < free.front() && (fixed.empty() || other.keyframe != fixed.front()))
      fixed.push_back(other.keyframe);
  }
  settings.max_iterations = settings_.local_iterations;
  settings.max_seconds = settings_.reproducible ? kNoLimit : kMaxSeconds;
  settings.parameter_tolerance = kParameterTolerance;
  return run(extractBundle(map, camera_, free, fixed, settings, &inertial), stamp);
}

BundleJob MapAdjuster::wholeMap(const Map& map, const InertialMap& inertial, BundleSettings settings) const {
  std::vector<KeyframeId> free, fixed;
  for (const auto& entry : map.keyframes()) free.push_back(entry.first);
  if (static_cast<int>(free.size()) > settings_.full_max_keyframes) {
    const auto first = free.end() - settings_.full_max_keyframes;
    fixed.assign(free.begin(), first);
    free.erase(free.begin(), first);
  }
  settings.max_iterations = settings_.full_iterations;
  settings.max_seconds = settings_.reproducible ? kNoLimit : kMaxWholeSeconds;
  settings.parameter_tolerance = kParameterTolerance;
  BundleJob job = extractBundle(map, camera_, free, fixed, settings, &inertial);
  job.full = true;
  return job;
}

MapAdjuster::Jobs MapAdjuster::adjustWhole(BundleJob whole, double stamp) {
  schedule(stamp, whole.keyframes.size());
  return run(std::move(whole), stamp);
}

void MapAdjuster::schedule(double stamp, std::size_t keyframes) {
  const double moved = static_cast<double>(std::min(keyframes, static_cast<std::size_t>(settings_.full_max_keyframes)));
  // Without IMU nothing but the views holds the turns against a calibration that is estimated, too.
  const double least = settings_.use_imu ? settings_.full_interval : 2 * settings_.full_interval;
  next_whole_ = stamp + std::max(least, kIntervalPerKeyframe * moved);
}

MapAdjuster::Jobs MapAdjuster::run(BundleJob job, double stamp) {
  Jobs done;
  if (settings_.synchronous) {
    job.solve();
    done.push_back(std::move(job));
    return done;
  }
  // At most one of each kind.
  if (job.full && threads_.fullRuns()) {
    next_whole_ = stamp;
    return done;
  }
  threads_.start(std::move(job), stamp);
  return done;
}

MapAdjuster::Jobs MapAdjuster::finishNewest() {
  Jobs done;
  if (threads_.localRuns()) done.push_back(threads_.awaitLocal());
  return done;
}

MapAdjuster::Jobs MapAdjuster::due(double stamp) {
  Jobs done;
  if (threads_.localDue()) done = finishNewest();
  if (threads_.fullDue(stamp)) {
    // A local result begun before the whole map moved must be in before that.
    if (done.empty()) done = finishNewest();
    done.push_back(threads_.awaitFull());
  }
  return done;
}

MapAdjuster::Jobs MapAdjuster::finish() {
  Jobs done = finishNewest();
  if (threads_.fullRuns()) done.push_back(threads_.awaitFull());
  return done;
}

}  // namespace mav_vo
