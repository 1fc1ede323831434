// A bar on stderr that says how far the frames are.
#pragma once

#include <chrono>
#include <cstdio>
#include <string>

namespace air_ground_sim {

class Progress {
 public:
  Progress(std::size_t total, bool quiet) : total_(total), quiet_(quiet), begin_(std::chrono::steady_clock::now()) {}

  void step() {
    ++done_;
    if (quiet_ || (done_ % 10 && done_ != total_)) return;
    const double elapsed = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
    const double share = static_cast<double>(done_) / static_cast<double>(total_);
    std::string bar(static_cast<std::size_t>(40 * share), '#');
    bar.resize(40, '.');
    std::fprintf(stderr, "\r[%s] %3.0f %%  %zu of %zu frames  %.0f s, %.0f s to go   %s", bar.c_str(), 100 * share,
                 done_, total_, elapsed, elapsed * (1 / share - 1), done_ == total_ ? "\n" : "");
  }

 private:
  std::size_t total_, done_ = 0;
  bool quiet_;
  std::chrono::steady_clock::time_point begin_;
};

}  // namespace air_ground_sim
