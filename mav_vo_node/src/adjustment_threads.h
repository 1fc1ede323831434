// Bundle adjustments beside the tracking: one of the last keyframes and one of the whole map at a time.
#pragma once

#include <future>
#include <optional>

#include "visual_frontend/bundle_job.h"

namespace mav_vo {

using visual_frontend::BundleJob;

class AdjustmentThreads {
 public:
  /// `reproducible`: see OdometrySettings.
  explicit AdjustmentThreads(bool reproducible) : reproducible_(reproducible) {}

  /// Waits for what runs; nothing comes of it.
  void discard();
  bool localRuns() const { return local_.result.valid(); }
  bool fullRuns() const { return full_.result.valid(); }

  /// Solves the job on a thread of its own, one of the whole map on one of lowest priority. `stamp`: of the image [s].
  /// None of its kind may be running.
  void start(BundleJob job, double stamp);

  /// The image that takes a result over is known when the adjustment begins, not by when its thread has finished: what
  /// a recording gives does not depend on how busy the machine is. Called once an image.
  bool localDue();
  /// Adjustments of the whole map may take seconds: asked for once a second of the recording; or due, and waited for,
  /// at an image that their size decides.
  bool fullDue(double stamp);

  BundleJob awaitLocal() { return local_.result.get(); }  ///< waits
  BundleJob awaitFull() { return full_.result.get(); }    ///< waits

 private:
  struct Running {
    std::future<BundleJob> result;
    double stamp = 0;  ///< begun, or last asked for, at this image [s]
    int images = 0;    ///< since
    std::size_t keyframes = 0;
  };
  bool reproducible_;
  Running local_, full_;
};

}  // namespace mav_vo
