// Exceptions of parallel loops.
#pragma once

#include <exception>

namespace air_ground_common {

/// Around each piece of a parallel loop, out of which nothing may be thrown: one exception is kept for after the loop.
class FirstException {
 public:
  template <typename Job>
  void guard(const Job& job) {
    try {
      job();
    } catch (...) {
#pragma omp critical(air_ground_first_exception)
      if (!exception_) exception_ = std::current_exception();
    }
  }
  void rethrow() const {
    if (exception_) std::rethrow_exception(exception_);
  }

 private:
  std::exception_ptr exception_;
};

}  // namespace air_ground_common
