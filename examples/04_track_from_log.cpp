// Position and heading from odometry that drifts and fixes that come late and are sometimes wrong: paper B, section
// III.
//
//   04_track_from_log LOG.txt      lines in any order of time:
//     odometry BEGIN END DX DY DZ DYAW    motion in the levelled body frame at BEGIN [s, m, rad]
//     fix STAMP X Y Z YAW                 pose in the world [s, m, rad], 0.3 m and 0.02 rad
#include <cstdio>
#include <exception>
#include <fstream>
#include <sstream>
#include <string>

#include "ekf_tracker/tracker.h"

int main(int argc, char** argv) try {
  if (argc != 2) {
    std::fprintf(stderr, "usage: %s LOG.txt\n", argv[0]);
    return 2;
  }
  std::ifstream log(argv[1]);
  if (!log) {
    std::fprintf(stderr, "%s cannot be read\n", argv[1]);
    return 1;
  }
  ekf_tracker::Tracker tracker;
  int refused = 0;
  for (std::string line; std::getline(log, line);) {
    std::istringstream words(line);
    std::string kind;
    words >> kind;
    if (kind == "odometry") {
      ekf_tracker::Increment step;
      auto& v = step.motion;
      words >> step.previous_stamp >> step.stamp >> v[0] >> v[1] >> v[2] >> v[3];
      step.covariance = Eigen::Vector4d(1e-4, 1e-4, 1e-4, 1e-6).asDiagonal();
      tracker.addIncrement(step);
    } else if (kind == "fix") {
      ekf_tracker::Measurement fix;
      auto& v = fix.value;
      words >> fix.stamp >> v[0] >> v[1] >> v[2] >> v[3];
      fix.covariance = Eigen::Vector4d(0.09, 0.09, 0.09, 4e-4).asDiagonal();
      tracker.addMeasurement(fix);
    }
    for (const auto& outcome : tracker.popOutcomes())
      refused += outcome.result == ekf_tracker::Result::kRefusedByGate ? 1 : 0;
  }
  const auto now = tracker.latest();
  if (!now) {
    std::fprintf(stderr, "no two fixes agree: there is no position yet\n");
    return 1;
  }
  std::printf("%.3f %.4f %.4f %.4f %.5f refused %d\n", now->stamp, now->pose[0], now->pose[1], now->pose[2],
              now->pose[3], refused);
  return 0;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
