// Runs a function that may block for long on a thread of its own.
#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>

namespace heightmap_mcl {

/// Calls to the ROS master do not return while the master is away: neither a callback nor the holder of a lock may wait
/// for one.
class BackgroundTask {
 public:
  explicit BackgroundTask(std::function<void()> task) : task_(std::move(task)), thread_([this] { run(); }) {}
  /// Waits for a run that has begun.
  ~BackgroundTask() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    thread_.join();
  }
  BackgroundTask(const BackgroundTask&) = delete;
  BackgroundTask& operator=(const BackgroundTask&) = delete;

  /// Returns at once. Requests that come while the task has yet to begin are one.
  void request() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      requested_ = true;
    }
    wake_.notify_all();
  }

 private:
  void run() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      wake_.wait(lock, [this] { return requested_ || stop_; });
      if (stop_) return;
      requested_ = false;
      lock.unlock();
      task_();
      lock.lock();
    }
  }

  std::function<void()> task_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool requested_ = false, stop_ = false;
  std::thread thread_;
};

}  // namespace heightmap_mcl
