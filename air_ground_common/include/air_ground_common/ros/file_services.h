// Services that write files: the same formats and the same answers in every node.
#pragma once

#include <stdexcept>
#include <string>
#include <vector>

#include "air_ground_common/ros/conversions.h"

namespace air_ground_common::ros_utils {

/// By the path's ending: .ply (with colour and `source`) or .pcd (binary, with `fields`). Written through a temporary
/// file. Throws std::runtime_error, also when there is no point.
void writeCloud(const std::string& path, const std::vector<CloudPoint>& points,
                CloudFields fields = CloudFields::kXyzRgb);

/// Answers a service with `success` and `message`: `save` returns the message, its exception becomes the refusal.
template <typename Response, typename Save>
bool answer(Response& response, const Save& save) {
  try {
    response.message = save();
    response.success = true;
  } catch (const std::exception& e) {
    response.success = false;
    response.message = e.what();
  }
  return true;
}

}  // namespace air_ground_common::ros_utils
