#include "recording_files.h"

#include <ros/package.h>

#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/camera_file.h"
#include "air_ground_common/text.h"

namespace air_ground_sim {

namespace fs = std::filesystem;

std::string worldFile(const std::string& world) {
  if (world.size() > 5 && world.substr(world.size() - 5) == ".yaml") {
    if (!fs::exists(world)) throw std::invalid_argument("no world file '" + world + "'");
    return world;
  }
  const std::string package = ros::package::getPath("air_ground");
  if (package.empty())
    throw std::runtime_error(
        "the package air_ground is not found: source the workspace's setup.bash, or give --world a .yaml file");
  const fs::path folder = fs::path(package) / "config" / "worlds";
  const fs::path file = folder / (world + ".yaml");
  if (fs::exists(file)) return file.string();
  std::string names;
  if (fs::exists(folder))
    for (const auto& entry : fs::directory_iterator(folder))
      if (entry.path().extension() == ".yaml") names += " " + entry.path().stem().string();
  throw std::invalid_argument("no world '" + world + "' in " + folder.string() + "; there are:" + names);
}

std::string contentKey(const std::string& world_file, const SimConfig& config, const Options& o) {
  std::ifstream in(world_file);
  std::stringstream text;
  text << in.rdbuf() << '|' << AIR_GROUND_SIM_SOURCES;
  if (!config.street.facade_images.empty()) {
    std::set<fs::path> images;
    for (const auto& entry : fs::directory_iterator(config.street.facade_images)) images.insert(entry.path());
    for (const fs::path& image : images)
      if (fs::is_regular_file(image)) text << '|' << image.filename() << std::ifstream(image, std::ios::binary).rdbuf();
  }
  text << '|' << o.seed << '|' << o.duration << '|' << o.samples << '|' << o.no_mav << '|' << o.no_ground << '|'
       << config.imu.ground_magnetometer << '|' << config.faults.describe() << '|'
       << air_ground_common::cameraFileText(config.mav_camera.camera, "");
  std::uint64_t h = 0;
  for (const char c : text.str()) h = mix(h ^ static_cast<unsigned char>(c));
  return air_ground_common::formatted("%016llx", static_cast<unsigned long long>(h));
}

void writeFaults(const Recording& recording, const std::string& path) {
  std::ofstream out(path);
  const Eigen::IOFormat list(Eigen::StreamPrecision, Eigen::DontAlignCols, ", ", ", ", "", "", "[", "]");
  out << "# What is wrong with the recording, in metres, seconds, radians. docs/air_ground_sim.md says what each "
         "means.\n"
      << recording.config().faults.describe() << "# At time 0, in the inertial units' frames.\n";
  const auto write = [&](const char* robot, const Imu& imu) {
    out << robot << "_gyro_bias: " << imu.gyroBias().format(list) << '\n'
        << robot << "_accel_bias: " << imu.accelBias().format(list) << '\n';
  };
  write("mav", recording.makeMavImu());
  if (recording.config().hasGroundRobot()) write("ground", recording.makeGroundImu());
  if (!out.flush()) throw std::runtime_error("cannot write " + path);
}

}  // namespace air_ground_sim
