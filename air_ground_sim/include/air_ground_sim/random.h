// Random numbers that are the same on every platform and for every number of threads.
#pragma once

#include <cmath>
#include <cstdint>

namespace air_ground_sim {

/// Mixes 64 bits (the finaliser of splitmix64); a hash good enough to seed streams from counters.
inline std::uint64_t mix(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

inline std::uint64_t mix(std::uint64_t a, std::uint64_t b) { return mix(a ^ mix(b)); }

/// Small generator; the standard library's distributions differ between implementations, these do not.
class Rng {
 public:
  explicit Rng(std::uint64_t seed) : state_(mix(seed)) {}

  std::uint64_t next() {
    state_ += 0x9e3779b97f4a7c15ULL;
    std::uint64_t x = state_;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
    return x ^ (x >> 31);
  }
  double uniform() { return static_cast<double>(next() >> 11) * 0x1.0p-53; }  ///< [0, 1)
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  int integer(int n) { return static_cast<int>(next() % static_cast<std::uint64_t>(n)); }  ///< 0 .. n-1
  bool chance(double probability) { return uniform() < probability; }
  double gaussian() {  ///< mean 0, variance 1 (Box-Muller)
    const double u = 1.0 - uniform(), v = uniform();
    return std::sqrt(-2.0 * std::log(u)) * std::cos(6.283185307179586 * v);
  }

 private:
  std::uint64_t state_;
};

}  // namespace air_ground_sim
