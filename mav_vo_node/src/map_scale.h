// The metric scale of a map by the images and the IMU so far: they are kept, for the map that they were seen in is
// adjusted again and again.
#pragma once

#include <cmath>
#include <deque>
#include <optional>
#include <string>

#include "mav_vo/imu_preintegration.h"
#include "mav_vo/odometry.h"
#include "visual_frontend/bundle_job.h"
#include "visual_frontend/keyframe_trajectory.h"

namespace mav_vo {

using FrameTrajectory = visual_frontend::KeyframeTrajectory<Pose>;

class MapScale {
 public:
  MapScale(const OdometrySettings& settings, const Pose& T_camera_imu);

  /// Another map, its z axis known to `tilt_stddev` [rad]; the images are forgotten.
  void begin(double tilt_stddev);
  /// The last of `frames`; `motion`: since the frame before it. Covariance of its position by the image noise.
  void add(const FrameTrajectory& frames, const visual_frontend::Map& map, double scene_distance,
           const Eigen::Matrix3d& position_covariance, const std::optional<Preintegration>& motion);
  /// A scale that most images since its start speak against was wrong from the start: all images are judged anew,
  /// by the map as it is now; where that does not help the next ones begin.
  void dropRefuted(const FrameTrajectory& frames, const visual_frontend::Map& map);
  /// With Map::transform.
  void transform(const air_ground_common::Similarity& S_new_old);
  /// After the adjustment of a metric map: judges it by the images since a keyframe not long before `metric_since` [s].
  void judgeAnew(const FrameTrajectory& frames, const visual_frontend::Map& map,
                 const visual_frontend::InertialMap& inertial, double metric_since);
  /// Forgets the inertial motion since a stamp [s]: it has turned out to be wrong.
  void dropMotionSince(double stamp, const FrameTrajectory& frames);
  /// Of a map that is not metric: all images again.
  void estimateAnew(const FrameTrajectory& frames, const visual_frontend::Map& map);
  /// Inertial motion integrated anew by `between` (two stamps, and the motion's bias), where it gives one.
  template <class Between>
  void integrateAnew(const FrameTrajectory& frames, const Between& between) {
    for (std::size_t i = 1; i < images_.size(); ++i) {
      if (!images_[i].motion) continue;
      const std::size_t frame = frameOf(i, frames);
      if (auto motion = between(frames.stamp(frame - 1), frames.stamp(frame), images_[i].motion->bias()))
        images_[i].motion = std::move(motion);
    }
  }

  /// The IMU's axes have become others.
  void turn(const Eigen::Matrix3d& R_new_old) {
    for (Image& image : images_)
      if (image.motion) image.motion = image.motion->turned(R_new_old);
  }

  const ScaleFilter& filter() const { return filter_; }
  /// Of the scale, relative, with the accelerometer's own error, which the filter cannot see; infinite while unknown.
  double relativeStddev() const { return std::hypot(filter_.relativeStddev(), accel_scale_stddev_); }
  /// Enough to make a map metric that is `age` [s] old.
  bool known(double age) const { return filter_.certain(neededStddev(age)); }
  std::string reason(double age) const;  ///< why it is not

 private:
  /// What an image told beside its pose; one for each of the last frames.
  struct Image {
    double scene_distance;
    Eigen::Matrix3d position_covariance;
    std::optional<Preintegration> motion;
  };
  std::size_t frameOf(std::size_t image, const FrameTrajectory& frames) const {
    return frames.size() - images_.size() + image;
  }
  double neededStddev(double age) const;
  ScaleMeasurement measurement(std::size_t image, const FrameTrajectory& frames, const visual_frontend::Map& map) const;

  Pose T_camera_imu_;
  double metric_stddev_, accel_scale_stddev_;
  double tilt_stddev_ = 0.1;
  ScaleFilter filter_;
  std::deque<Image> images_;
};

}  // namespace mav_vo
