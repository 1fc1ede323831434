#include "map_file.h"

namespace icp_refine {

namespace ros_utils = air_ground_common::ros_utils;

MapFile::MapFile(const std::string& autosave_folder, RefineWorker& worker)
    : autosave_(autosave_folder), worker_(worker) {
  handle_.setCallbackQueue(&queue_);
  service_ = handle_.advertiseService("save_map", &MapFile::onSave, this);
  spinner_.start();
}

MapFile::~MapFile() {
  spinner_.stop();
  autosave_.save("augmented_map.ply", [this](const std::string& path) { write(path); });
}

bool MapFile::onSave(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
  return ros_utils::answer(response, [&]() -> std::string {
    const auto [points, aligned] = write(ros_utils::absolutePath(request.path));
    response.points = points;
    return aligned ? "wrote ground and aerial points" : "wrote the ground points alone: no alignment yet";
  });
}

std::pair<std::size_t, bool> MapFile::write(const std::string& path) {
  const auto [points, aligned] = worker_.map();
  if (points.empty()) throw std::runtime_error("no map yet: neither a ground map nor an aligned aerial map has come");
  ros_utils::writeCloud(path, points, ros_utils::CloudFields::kXyzRgbSource);
  return {points.size(), aligned};
}

}  // namespace icp_refine
