// A thread's work that may fail without ending the process.
#pragma once

#include <exception>
#include <string>

namespace dense_fusion {

/// Runs `job`; whatever it throws goes to `report` as a text. False when it threw. A worker's loop around it goes on:
/// memory that ran out for one scene, say, is there again for the next.
template <typename Job, typename Report>
bool runGuarded(const Job& job, const Report& report) {
  try {
    job();
    return true;
  } catch (const std::exception& e) {
    report(std::string(e.what()));
  } catch (...) {
    report(std::string("for an unknown reason"));
  }
  return false;
}

}  // namespace dense_fusion
