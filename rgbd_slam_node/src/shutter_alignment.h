// The readout time of a rolling shutter: found from the frames, and what a map was made of is put right.
#pragma once

#include <optional>
#include <vector>

#include "dense_keyframes.h"
#include "frame_tracker.h"
#include "rgbd_slam/readout_estimator.h"

namespace rgbd_slam {

class ShutterAlignment {
 public:
  ShutterAlignment(const CameraModel& camera, const SlamSettings& settings);

  /// What the features show of the next frame, which is at T_map_camera. Returns a readout time [s] that is sure enough
  /// to replace the one `in_use`.
  std::optional<double> add(const RgbdImages& images, const Pose& T_map_camera,
                            const std::vector<visual_frontend::Feature>& features, double in_use);
  void distrust() {  ///< what was seen was seen with another calibration
    if (estimator_) estimator_->distrust();
  }
  void interrupt();  ///< the next pose does not go on from the last one
  void reset();
  double stddev() const { return estimator_ ? estimator_->stddev() : 0; }  ///< [s]; 0: given, not estimated

 private:
  DepthModel depth_;
  int height_;
  std::optional<ReadoutEstimator> estimator_;
};

/// Moves what the keyframes saw, their dense points and surfaces, as if their readout time were longer by `change` [s].
void moveRows(double change, const CameraModel& camera, const Frames& frames, visual_frontend::Map& map,
              DenseKeyframes& dense, KeyframeSurfaces& surfaces);

}  // namespace rgbd_slam
