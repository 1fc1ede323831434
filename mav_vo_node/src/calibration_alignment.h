// The camera's radial distortion, and without IMU its readout time, as adjustments of the whole map find them; what the
// map was made of is put right.
#pragma once

#include "map_scale.h"
#include "mav_vo/odometry.h"
#include "visual_frontend/bundle_job.h"

namespace mav_vo {

class CalibrationAlignment {
 public:
  CalibrationAlignment(const CameraModel& camera, const OdometrySettings& settings);

  bool estimates() const { return estimates_; }
  /// Lets the job estimate the calibration besides.
  void open(const FrameTrajectory& frames, const visual_frontend::Map& map, visual_frontend::BundleJob* job) const;
  /// Takes over what a job has found.
  void follow(const visual_frontend::CalibrationEstimate& estimate);

  const CameraModel& camera() const { return camera_; }  ///< as it is known now
  double readoutTime() const { return readout_time_; }   ///< likewise, without IMU [s]

  /// Rays of the map's keyframes by the camera as it is known now, and a readout time [s].
  void recalibrate(const FrameTrajectory& frames, double readout_time, visual_frontend::Map* map) const;

 private:
  CameraModel camera_;
  bool estimates_;
  double readout_time_;
  visual_frontend::CalibrationVector sigma_;  ///< before the first image
  visual_frontend::CalibrationVector mean_;   ///< of what is left, by what was known before the first image
};

}  // namespace mav_vo
