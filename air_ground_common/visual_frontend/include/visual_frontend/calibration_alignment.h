// A camera's radial distortion, and where nothing else tells it the readout time of its shutter, as adjustments of a
// map find them; what the map was made of is put right.
#pragma once

#include <functional>
#include <optional>

#include "visual_frontend/bundle_job.h"
#include "visual_frontend/rolling_shutter.h"

namespace visual_frontend {

/// Motion of the camera at an image [s], where it is known.
using VelocityAt = std::function<std::optional<CameraVelocity>(double stamp)>;

class CalibrationAlignment {
 public:
  /// Standard deviations of the first radial coefficient [1] and the readout time [s]; 0: exact, not estimated.
  CalibrationAlignment(const CameraModel& camera, double readout_time, double radial_stddev,
                       double readout_time_stddev);

  bool estimates() const { return estimates_; }
  /// Lets a job of `map` estimate the calibration besides.
  void open(const VelocityAt& velocity, const Map& map, BundleJob* job) const;
  /// Takes over what a job has found.
  void follow(const CalibrationEstimate& estimate);
  /// Takes over a readout time [s] that something else has told.
  void followReadout(double readout_time);
  /// Moves the rays of the map's keyframes from the calibration before the last of these two to the one now.
  void recalibrate(const VelocityAt& velocity, Map* map) const;

  const CameraModel& camera() const { return camera_; }  ///< as it is known now
  double readoutTime() const { return readout_time_; }   ///< likewise [s]

 private:
  CameraModel camera_, camera_before_;  // the last follow()
  bool estimates_;
  double readout_time_, readout_change_ = 0;
  CalibrationVector sigma_;  ///< before the first image
  CalibrationVector mean_;   ///< of what is left, by what was known before the first image
};

}  // namespace visual_frontend
