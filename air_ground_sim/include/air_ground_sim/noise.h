// Band-limited value noise in two and three dimensions: the base of every procedural texture and height field.
#pragma once

#include <cstdint>

namespace air_ground_sim {

/// Value noise in [-1, 1] with features of size 1; C^1, the same for the same seed.
float valueNoise(float x, float y, std::uint32_t seed);
float valueNoise(float x, float y, float z, std::uint32_t seed);

/// Sum of `octaves` of value noise, each of half the size and `gain` times the amplitude of the one before; about [-1,
/// 1].
float fractalNoise(float x, float y, std::uint32_t seed, int octaves, float gain = 0.6f);
float fractalNoise(float x, float y, float z, std::uint32_t seed, int octaves, float gain = 0.6f);

/// Hash of integer lattice coordinates to [0, 1).
float latticeHash(int x, int y, int z, std::uint32_t seed);

}  // namespace air_ground_sim
