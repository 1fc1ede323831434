// From a world's configuration to its patches: the one place that knows all layouts.
#pragma once

#include "air_ground_sim/world.h"

namespace air_ground_sim {

/// Builds the world for a seed; the same seed gives the same world.
World buildWorld(const SimConfig& config, std::uint64_t seed);

}  // namespace air_ground_sim
