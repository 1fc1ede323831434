// One camera's frames, rendered ahead on a thread of its own.
#pragma once

#include <omp.h>

#include <condition_variable>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>

namespace air_ground_sim {

/// The two cameras run side by side: on two cores that beats sharing each image between them, above all when other
/// programs want the cores too.
template <class Frame>
class FrameStream {
 public:
  FrameStream(int count, int threads, std::function<void(int, Frame*)> render) {
    worker_ = std::thread([this, count, threads, render = std::move(render)] {
      omp_set_num_threads(threads);
      try {
        for (int i = 0; i < count; ++i) {
          Frame frame;
          render(i, &frame);
          std::unique_lock<std::mutex> lock(mutex_);
          changed_.wait(lock, [this] { return stop_ || ready_.size() < kAhead; });
          if (stop_) return;
          ready_.push_back(std::move(frame));
          changed_.notify_all();
        }
      } catch (...) {
        std::lock_guard<std::mutex> lock(mutex_);
        error_ = std::current_exception();
        changed_.notify_all();
      }
    });
  }
  ~FrameStream() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
      changed_.notify_all();
    }
    worker_.join();
  }
  Frame next() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return error_ || !ready_.empty(); });
    if (error_) std::rethrow_exception(error_);
    Frame frame = std::move(ready_.front());
    ready_.pop_front();
    changed_.notify_all();
    return frame;
  }

 private:
  static constexpr std::size_t kAhead = 24;
  std::deque<Frame> ready_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::exception_ptr error_;
  bool stop_ = false;
  std::thread worker_;
};

}  // namespace air_ground_sim
