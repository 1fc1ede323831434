// ~save_map, and what autosave leaves when the node is stopped.
#pragma once

#include <air_ground/SaveMap.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include <string>
#include <utility>

#include "air_ground_common/ros/file_services.h"
#include "refine_worker.h"

namespace icp_refine {

/// Writing a large map takes seconds, in which tf must go on: a thread of its own. `worker` must live longer.
class MapFile {
 public:
  /// Throws std::runtime_error where the folder cannot be written to; "": none.
  MapFile(const std::string& autosave_folder, RefineWorker& worker);
  ~MapFile();

 private:
  bool onSave(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response);
  /// Number of points; whether the aerial ones are among them.
  std::pair<std::size_t, bool> write(const std::string& path);

  const air_ground_common::ros_utils::Autosave autosave_;
  RefineWorker& worker_;
  ros::CallbackQueue queue_;
  ros::NodeHandle handle_{"~"};
  ros::ServiceServer service_;
  ros::AsyncSpinner spinner_{1, &queue_};
};

}  // namespace icp_refine
