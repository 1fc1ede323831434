// What a user asks of an estimator's node, what it leaves behind, and what it leaves out.
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "air_ground_common/ros/estimator_shell.h"
#include "air_ground_common/ros/file_services.h"

namespace air_ground_common::ros_utils {

// By a thread of their own: one that writes a file, or waits for an image that is worked on, holds no input up.
void EstimatorShell::advertiseServices() {
  private_handle_.setCallbackQueue(&service_queue_);
  services_ = {private_handle_.advertiseService("save_map", &EstimatorShell::saveMap, this),
               private_handle_.advertiseService("save_trajectory", &EstimatorShell::saveTrajectory, this),
               private_handle_.advertiseService("reset", &EstimatorShell::reset, this)};
}

void EstimatorShell::start() {
  worker_ = std::thread(&EstimatorShell::work, this);
  service_spinner_.start();
}

void EstimatorShell::stop() {
  service_spinner_.stop();
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    stop_ = true;
  }
  queue_changed_.notify_all();
  if (!worker_.joinable()) return;
  worker_.join();
  autosave_.save("trajectory.txt", [this](const std::string& path) {
    std::uint64_t poses = 0;
    saveTrajectoryTo(path, false, &poses);
  });
  autosave_.save("map.ply", [this](const std::string& path) { saveMapTo(path); });
}

std::size_t EstimatorShell::saveMapTo(const std::string& path) {
  std::function<std::vector<CloudPoint>()> map;
  {
    const std::lock_guard<std::mutex> lock(estimator_mutex_);
    if (!estimator_.exists()) throw std::runtime_error("there is no map yet");
    map = estimator_.mapForFile();
  }
  const std::vector<CloudPoint> points = map();
  writeCloud(path, points);
  return points.size();
}

/// Returns what was written. `overwrite` false: maps other than the first whose file is there already were saved
/// before.
std::string EstimatorShell::saveTrajectoryTo(const std::string& path, bool overwrite, std::uint64_t* poses) {
  std::vector<MapTrajectory> maps;
  {
    const std::lock_guard<std::mutex> lock(estimator_mutex_);
    if (!estimator_.exists()) throw std::runtime_error("there is no trajectory yet");
    maps = estimator_.trajectories();
  }
  std::string written;
  for (std::size_t i = 0; i < maps.size(); ++i) {
    std::filesystem::path file = path;
    const std::size_t number = maps[i].id > 0 ? maps[i].id : i;
    if (i > 0)
      file.replace_filename(file.stem().string() + "_map" + std::to_string(number) + file.extension().string());
    if (i > 0 && !overwrite && std::filesystem::exists(file)) continue;
    writeTum(file, maps[i].poses, maps[i].unit);
    written += (i > 0 ? "; of another map " : "") + std::to_string(maps[i].poses.size()) + " camera poses" +
               (!maps[i].unit.empty() ? ", unit: " + maps[i].unit + ","
                : i == 0              ? " in " + settings_.map_frame
                                      : " in its own frame") +
               " written to " + file.string();
  }
  *poses = maps.front().poses.size();
  return written;
}

bool EstimatorShell::saveMap(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
  return answer(response, [&] {
    const std::string path = absolutePath(request.path);
    response.points = saveMapTo(path);
    return std::to_string(response.points) + " points in " + settings_.map_frame + " written to " + path;
  });
}

bool EstimatorShell::saveTrajectory(air_ground::SaveTrajectory::Request& request,
                                    air_ground::SaveTrajectory::Response& response) {
  return answer(response, [&] {
    const std::string path = absolutePath(request.path);
    return saveTrajectoryTo(path, true, &response.poses);
  });
}

/// The next one goes on with the maps' numbers; this one knows its own until it is gone.
void EstimatorShell::dropEstimator() {
  const std::uint32_t maps = estimator_.mapId();
  keepMap();
  estimator_.drop();
  map_id_offset_ += maps;
}

/// The map that comes does not wait for what fails with this one's.
void EstimatorShell::keepMap() {
  try {
    estimator_.keep();
  } catch (const std::exception& e) {
    health_.count(std::string("a map that ended is not kept: ") + e.what());
  }
}

// To the estimator these are images that did not come: what it knows of the motion since is the IMU's.
void EstimatorShell::leaveOut(const EstimatorFrame& frame) {
  health_.count("images left out: their pixels are those of the image before, and the robot moves");
  estimator_.idle();
  constexpr double kHangs = 1.0;  // [s]: some drivers and converters send an image twice now and then
  const double seconds = frame.stamp.toSec() - frozen_images_.since();
  if (seconds < kHangs) return;
  using Status = air_ground::VoStatus;
  Status status = told_;
  status.header.stamp = frame.stamp;
  status.header.frame_id = settings_.map_frame;
  status.map_id = mapId();
  if (status.state == Status::STATE_TRACKING || status.state == Status::STATE_SCALING)
    status.state = Status::STATE_LOST;
  status.inliers = 0;
  status.reason = "the images have been the same, pixel by pixel, for " + std::to_string(std::lround(seconds)) +
                  " s, though the robot moves";
  health_.withheld(status.reason, "see whether the camera's driver hangs; a simulator's camera needs noise");
  tell(status);
}

void EstimatorShell::forgetImages() {
  frozen_images_ = {};
  told_ = {};
}

/// `all`: calibration and mountings are read again, too.
void EstimatorShell::resetEstimator(bool all) {
  const std::lock_guard<std::mutex> lock(estimator_mutex_);
  if (estimator_.exists() && all) dropEstimator();
  if (estimator_.exists()) {
    keepMap();
    estimator_.reset();
  }
  imu_input_.reset();
  if (all) imu_seen_ = false;
  estimator_.forgetMap();
  estimator_.forgetOdometry();
  last_stamp_ = ros::Time();
  forgetImages();
  health_.state(health_.kWarn, "started afresh: waiting for images");
}

bool EstimatorShell::reset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    clearQueues();
  }
  resetEstimator(true);
  response.success = true;
  response.message = names_.subject + " starts afresh";
  return true;
}

}  // namespace air_ground_common::ros_utils
