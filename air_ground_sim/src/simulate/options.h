// The command line of `simulate`.
#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_sim/config.h"

namespace air_ground_sim {

/// Faults of the command line; what is not given there is the world file's.
struct FaultOptions {
  bool all = false, start_in_motion = false;
  std::optional<double> time_offset, readout_time, vibration, clock_offset, depth_delay, radial_error, focal_error,
      lost_images;
  std::vector<double> gyro_bias, accel_bias;
  std::optional<int> jpeg_quality;
  std::optional<StaticTransforms> tf_static;

  void apply(FaultsConfig* faults) const;
};

struct Options {
  std::string world = "indoor_boxes_a", out, cache, compression = "lz4", mav_camera;
  std::uint64_t seed = 1;
  double duration = 0;
  int samples = 0, threads = 0;
  int queries = 0;
  bool no_mav = false, no_ground = false, quiet = false, city_only = false, no_city = false, ground_mag = false;
  FaultOptions faults;

  /// Puts into the world's configuration what the command line says of it. Throws std::invalid_argument.
  void apply(SimConfig* config) const;
};

void addOptions(CLI::App* app, Options* options);

}  // namespace air_ground_sim
