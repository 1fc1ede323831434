// Work that can wait leaves the processor to work that cannot.
#pragma once

#include <sys/resource.h>
#include <unistd.h>

#include <fstream>

namespace air_ground_common {

constexpr const char* kNiceness =
    "nice value of the node's work: where the processor is short, odometry and SLAM go first; 0: as they do";

/// Sets the nice value of this thread and of those that it starts from now on, and of the process's scheduling group
/// where it has one of its own: kernels that group by sessions (sched_autogroup) weigh groups, not threads, and
/// roslaunch gives each node a session. `niceness` 0 to 19; 0 changes nothing. Where the system does not let it,
/// nothing happens.
inline void giveWay(int niceness) {
  if (niceness <= 0) return;
  setpriority(PRIO_PROCESS, 0, niceness);
  if (getsid(0) != getpid()) return;
  std::ofstream("/proc/self/autogroup") << niceness;
}

/// Sets the nice value of this thread alone, against the process's others, which make poses. Where the system does not
/// let it, nothing happens.
inline void giveWayWithin(int niceness = 10) { setpriority(PRIO_PROCESS, 0, niceness); }

}  // namespace air_ground_common
