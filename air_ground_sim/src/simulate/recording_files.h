// Files of a recording: the world's, the name in the cache, what is wrong with it.
#pragma once

#include <string>

#include "air_ground_sim/recording.h"
#include "options.h"

namespace air_ground_sim {

/// Path of a world of the package, or `world` itself where it is a YAML file's.
std::string worldFile(const std::string& world);

/// Hash of everything that decides the recording's content: the world's parameters, the options, the simulator's own
/// sources.
std::string contentKey(const std::string& world_file, const SimConfig& config, const Options& options);

/// What is wrong with the recording, for whoever compares estimates with it.
void writeFaults(const Recording& recording, const std::string& path);

}  // namespace air_ground_sim
