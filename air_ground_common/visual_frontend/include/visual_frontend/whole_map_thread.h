// The bundle adjustment of a whole map beside the tracking: it may take seconds.
#pragma once

#include <atomic>
#include <future>
#include <memory>

#include "visual_frontend/bundle_job.h"

namespace visual_frontend {

class WholeMapThread {
 public:
  /// `reproducible`: the image that takes a result over is known when the adjustment begins, not by when its thread has
  /// finished: what a recording gives does not depend on how busy the machine is.
  explicit WholeMapThread(bool reproducible) : reproducible_(reproducible) {}
  /// Waits for an iteration, as discard() does.
  ~WholeMapThread() { discard(); }
  WholeMapThread(const WholeMapThread&) = delete;
  WholeMapThread& operator=(const WholeMapThread&) = delete;

  /// Solves the job on a thread of the lowest priority, which delays neither tracking nor local adjustments. `stamp`:
  /// of the image [s]. Throws std::logic_error while one runs.
  void start(BundleJob job, double stamp);
  bool runs() const { return result_.valid(); }
  /// At this image the result is to be taken over: it is ready, as asked once a second of the recording; or, where
  /// results are reproducible, the image has come that the size of the job decides, ready or not.
  bool due(double stamp);
  /// The solved job; waits for it. Throws std::future_error where none runs.
  BundleJob await() { return result_.get(); }
  /// What runs ends with its present iteration: its result, which await() still gives, is of no use.
  void cancel();
  bool cancelled() const { return runs() && *cancelled_; }
  /// The same, and waits for the end of that iteration; nothing comes of it.
  void discard();

 private:
  bool reproducible_;
  std::future<BundleJob> result_;
  std::shared_ptr<std::atomic<bool>> cancelled_;
  double stamp_ = 0;           // begun, or last asked for, at this image [s]
  std::size_t keyframes_ = 0;  // of the job
};

}  // namespace visual_frontend
