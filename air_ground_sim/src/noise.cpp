#include "air_ground_sim/noise.h"

#include <cmath>

namespace air_ground_sim {
namespace {

inline std::uint32_t hash(std::uint32_t x, std::uint32_t y, std::uint32_t z, std::uint32_t seed) {
  std::uint32_t h = seed ^ (x * 0x8da6b343u) ^ (y * 0xd8163841u) ^ (z * 0xcb1ab31fu);
  h ^= h >> 15;
  h *= 0x2c1b3c6du;
  h ^= h >> 12;
  h *= 0x297a2d39u;
  h ^= h >> 15;
  return h;
}

inline float lattice(int x, int y, int z, std::uint32_t seed) {
  return static_cast<float>(
             hash(static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y), static_cast<std::uint32_t>(z), seed) >>
             8) *
             (2.0f / 16777216.0f) -
         1.0f;
}

// std::floor is a library call on the baseline instruction set.
inline int floorInt(float x) {
  const int i = static_cast<int>(x);
  return i - (x < static_cast<float>(i));
}

inline float fade(float t) { return t * t * (3 - 2 * t); }
inline float lerp(float a, float b, float t) { return a + (b - a) * t; }

}  // namespace

float latticeHash(int x, int y, int z, std::uint32_t seed) { return 0.5f * (lattice(x, y, z, seed) + 1.0f); }

float valueNoise(float x, float y, std::uint32_t seed) {
  const int ix = floorInt(x), iy = floorInt(y);
  const float u = fade(x - ix), v = fade(y - iy);
  return lerp(lerp(lattice(ix, iy, 0, seed), lattice(ix + 1, iy, 0, seed), u),
              lerp(lattice(ix, iy + 1, 0, seed), lattice(ix + 1, iy + 1, 0, seed), u), v);
}

float valueNoise(float x, float y, float z, std::uint32_t seed) {
  const int ix = floorInt(x), iy = floorInt(y), iz = floorInt(z);
  const float u = fade(x - ix), v = fade(y - iy), w = fade(z - iz);
  float plane[2];
  for (int k = 0; k < 2; ++k)
    plane[k] = lerp(lerp(lattice(ix, iy, iz + k, seed), lattice(ix + 1, iy, iz + k, seed), u),
                    lerp(lattice(ix, iy + 1, iz + k, seed), lattice(ix + 1, iy + 1, iz + k, seed), u), v);
  return lerp(plane[0], plane[1], w);
}

float fractalNoise(float x, float y, std::uint32_t seed, int octaves, float gain) {
  float sum = 0, amplitude = 1, norm = 0, frequency = 1;
  for (int i = 0; i < octaves; ++i) {
    sum += amplitude * valueNoise(x * frequency, y * frequency, seed + static_cast<std::uint32_t>(i) * 0x9e37u);
    norm += amplitude * amplitude;
    amplitude *= gain;
    frequency *= 2.03f;  // not 2: lattices of the octaves must not coincide
  }
  return sum / std::sqrt(norm);
}

float fractalNoise(float x, float y, float z, std::uint32_t seed, int octaves, float gain) {
  float sum = 0, amplitude = 1, norm = 0, frequency = 1;
  for (int i = 0; i < octaves; ++i) {
    sum += amplitude *
           valueNoise(x * frequency, y * frequency, z * frequency, seed + static_cast<std::uint32_t>(i) * 0x9e37u);
    norm += amplitude * amplitude;
    amplitude *= gain;
    frequency *= 2.03f;
  }
  return sum / std::sqrt(norm);
}

}  // namespace air_ground_sim
