#include "map_scale.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/text.h"
#include "imu_alignment.h"

namespace mav_vo {

namespace {

constexpr std::size_t kImages = 800;         // whose inertial motion is kept
constexpr int kTrial = 40;                   // images after which a scale that most of them reject is given up
constexpr int kLongTrial = 100;              // ... that neither holds nor fails
constexpr double kPatience = 5;              // of a map for a scale as certain as asked for [s]
constexpr double kYoung = 8;                 // until then the first keyframes may bend the map more than noise says [s]
constexpr double kMostStddev = 2.5;          // of what was asked for, that serves in the end [1]
constexpr double kAdjustedTilt = 0.005;      // of the map's z axis after an inertial adjustment [rad]
constexpr double kRestartScaleStddev = 0.1;  // the filter judges the adjusted map afresh [1]
constexpr int kBrokenWindows = 3;            // by gaps of the IMU: then these are the reason
constexpr double kHistory = 3.0;             // images from so long before the map became metric are judged too [s]

}  // namespace

MapScale::MapScale(const OdometrySettings& settings, const Pose& T_camera_imu)
    : T_camera_imu_(T_camera_imu),
      metric_stddev_(settings.metric_stddev),
      accel_scale_stddev_(settings.accel_scale_stddev),
      filter_(settings.scale, settings.imu_noise, tilt_stddev_) {}

void MapScale::begin(double tilt_stddev) {
  tilt_stddev_ = tilt_stddev;
  images_.clear();
  filter_.reset(tilt_stddev);
}

void MapScale::add(const FrameTrajectory& frames, const visual_frontend::Map& map, double scene_distance,
                   const Eigen::Matrix3d& position_covariance, const std::optional<Preintegration>& motion) {
  images_.push_back({scene_distance, position_covariance, motion});
  if (images_.size() > kImages + 1) images_.pop_front();
  if (images_.size() > kImages) images_.front().motion.reset();
  filter_.add(measurement(images_.size() - 1, frames, map), motion);
}

void MapScale::dropRefuted(const FrameTrajectory& frames, const visual_frontend::Map& map) {
  const auto hopeless = [this] {
    const bool refuted = filter_.updates() >= kTrial && filter_.rejectedShare() > 0.5;
    // What a scale was started on stays in its count of rejections: a new window judges the map as it is by now.
    return refuted || (filter_.updates() >= kLongTrial && !filter_.certain(1.0));
  };
  if (!hopeless()) return;
  estimateAnew(frames, map);
  if (hopeless()) filter_.reset(tilt_stddev_);
}

void MapScale::transform(const air_ground_common::Similarity& S) {
  for (Image& image : images_) {
    image.scene_distance *= S.scale;
    image.position_covariance = (S.scale * S.scale * S.R * image.position_covariance * S.R.transpose()).eval();
  }
  filter_.transform(S);
}

ScaleMeasurement MapScale::measurement(std::size_t image, const FrameTrajectory& frames,
                                       const visual_frontend::Map& map) const {
  const Pose T = frames.pose(frameOf(image, frames), map);
  ScaleMeasurement measurement;
  measurement.p_map_camera = T.translation();
  measurement.R_map_imu = T.linear() * T_camera_imu_.linear();
  measurement.p_imu_camera = T_camera_imu_.inverse().translation();
  measurement.covariance = images_[image].position_covariance;
  measurement.scene_distance = images_[image].scene_distance;
  measurement.stamp = frames.stamp(frameOf(image, frames));
  return measurement;
}

// The filter saw the images before the map was adjusted: what it says about the scale holds for the map as it is now
// only when it sees them again.
void MapScale::judgeAnew(const FrameTrajectory& frames, const visual_frontend::Map& map,
                         const visual_frontend::InertialMap& inertial, double metric_since) {
  std::size_t i = 0;
  const auto startsHere = [&] {
    const std::size_t frame = frameOf(i, frames);
    return i + 1 < images_.size() && images_[i + 1].motion && frames.isKeyframe(frame) &&
           !(frames.stamp(frame) < metric_since - kHistory);
  };
  while (i < images_.size() && !startsHere()) ++i;
  if (i >= images_.size()) return;
  filter_.reset(kAdjustedTilt);
  const visual_frontend::InertialState& start = inertial.states.at(frames.reference(frameOf(i, frames)));
  filter_.startAt(measurement(i, frames, map), start.velocity, start.bias.accel, kRestartScaleStddev);
  for (++i; i < images_.size(); ++i) filter_.add(measurement(i, frames, map), images_[i].motion);
}

void MapScale::dropMotionSince(double stamp, const FrameTrajectory& frames) {
  for (std::size_t i = images_.size(); i > 0 && frames.stamp(frameOf(i - 1, frames)) > stamp; --i)
    images_[i - 1].motion.reset();
}

void MapScale::estimateAnew(const FrameTrajectory& frames, const visual_frontend::Map& map) {
  filter_.reset(tilt_stddev_);
  for (std::size_t i = 0; i < images_.size(); ++i) filter_.add(measurement(i, frames, map), images_[i].motion);
}

// Motion that tells little of the scale: a rough one that the map's adjustment goes on refining serves better than
// none.
double MapScale::neededStddev(double age) const {
  return metric_stddev_ * std::clamp(age / kPatience, 1.0, kMostStddev);
}

std::string MapScale::reason(double age) const {
  if (filter_.inverted()) {
    return "metric scale is not known: the accelerations point the wrong way; at rest the IMU must read +9.81 m/s^2 "
           "along the axis that points up (specific force): check its signs and the static transform of its frame";
  }
  if (filter_.contradicted() || (filter_.updates() >= kTrial && !filter_.certain(1.0))) {
    if (age < kYoung) return "metric scale is not known yet: IMU and images do not agree in the first seconds";
    return "metric scale is not known: IMU and images tell of different motions; check the static transforms of IMU "
           "and camera, the accelerometer's unit (m/s^2, with gravity) and noise densities, time stamps";
  }
  if (!filter_.initialized() && filter_.brokenWindows() >= kBrokenWindows) {
    return air_ground_common::formatted(
        "metric scale is not known yet: the IMU's samples have gaps of more than %.2f s, so that no motion is known "
        "long enough; see to its driver, rate and link",
        ImuAlignment::kLongestGap);
  }
  const double stddev = filter_.initialized() ? filter_.relativeStddev() : filter_.startStddev();
  if (!std::isfinite(stddev)) return "metric scale is not known yet: it needs a second of motion";
  return air_ground_common::formatted(
      "metric scale is not known yet (+- %.0f %%, %.0f %% needed): change speed and direction", 100 * stddev,
      100 * neededStddev(age));
}

}  // namespace mav_vo
