// Makes a node known to a ROS master that has been started again. roscpp registers topics and services once: with a new
// master the node would go on, but nobody could find it any more.
#pragma once

#include <memory>

namespace air_ground_common::ros_utils {

/// While it lives, looks once a second, on a thread of its own, whether the master is another one. If so, that one is
/// told the topics, services and private parameters that the node has. Connections that stand are kept, and nothing
/// that was estimated is lost: a node that ended for a respawn would begin its map anew.
class MasterWatch {
 public:
  MasterWatch();
  ~MasterWatch();
  MasterWatch(const MasterWatch&) = delete;
  MasterWatch& operator=(const MasterWatch&) = delete;

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;  ///< shared with the thread: a call to a master that is gone may outlive this
};

}  // namespace air_ground_common::ros_utils
