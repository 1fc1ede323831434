// Services that write files: the same formats and the same answers in every node.
#pragma once

#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "air_ground_common/ros/conversions.h"

namespace air_ground_common::ros_utils {

/// The path from the root, as a shell would take it: `~/` is the home of the node's user, a relative path is below the
/// node's working directory (~/.ros under roslaunch). Throws std::runtime_error where it is empty or there is no home.
std::string absolutePath(const std::string& path);

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

/// Meaning of the parameter autosave.
constexpr const char* kAutosave =
    "folder, made when missing: what the node's save services write goes there when it is stopped, under names of this "
    "start; \"\" = nowhere";

/// What a node leaves behind when it is stopped: files in a folder of the user's (parameter autosave; empty: none),
/// under names of this start, `<node>_<date and time, UTC>_<what>`, so that no file that is there already is written
/// over.
class Autosave {
 public:
  /// Makes the folder. Throws std::runtime_error when it cannot be written to: better now than at the end.
  explicit Autosave(const std::string& folder);

  /// There is a folder.
  bool on() const { return !begin_.empty(); }

  /// `save` writes the file whose path it gets, or throws when there is nothing to save. What became of it goes to
  /// stderr: roscpp's console has ended by then. Never throws.
  void save(const std::string& what, const std::function<void(const std::string&)>& save) const;

 private:
  std::string begin_;  ///< of all paths
};

}  // namespace air_ground_common::ros_utils
