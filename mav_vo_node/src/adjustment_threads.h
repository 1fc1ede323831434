// Bundle adjustments beside the tracking: one of the last keyframes and one of the whole map at a time.
#pragma once

#include <future>

#include "visual_frontend/bundle_job.h"
#include "visual_frontend/whole_map_thread.h"

namespace mav_vo {

using visual_frontend::BundleJob;

class AdjustmentThreads {
 public:
  /// `reproducible`: see OdometrySettings.
  explicit AdjustmentThreads(bool reproducible) : full_(reproducible) {}

  /// Waits for a local one that runs, and for an iteration of one of the whole map; nothing comes of either.
  void discard();
  bool localRuns() const { return local_.valid(); }
  bool fullRuns() const { return full_.runs(); }

  /// Solves the job on a thread of its own. `stamp`: of the image [s]. None of its kind may be running.
  void start(BundleJob job, double stamp);

  /// The image that takes a local result over is known when the adjustment begins, not by when its thread has finished:
  /// what a recording gives does not depend on how busy the machine is. Called once an image.
  bool localDue() { return localRuns() && ++images_ >= kAdoptAfterImages; }
  bool fullDue(double stamp) { return full_.due(stamp); }  ///< see WholeMapThread

  BundleJob awaitLocal() { return local_.get(); }  ///< waits, so that no image is tracked on a map older than due
  BundleJob awaitFull() { return full_.await(); }  ///< waits

 private:
  static constexpr int kAdoptAfterImages = 2;

  std::future<BundleJob> local_;
  int images_ = 0;  // since it began
  visual_frontend::WholeMapThread full_;
};

}  // namespace mav_vo
