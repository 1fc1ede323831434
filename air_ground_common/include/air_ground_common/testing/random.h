// Repeatable random numbers for tests and benchmarks: the same stream with every standard library.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <random>

namespace air_ground_common::testing {

class Random {
 public:
  explicit Random(unsigned seed) : generator_(seed) {}
  double uniform(double a, double b) { return a + (b - a) * (generator_() / 4294967296.0); }
  double gauss(double sigma = 1) {
    const double u = 1.0 - uniform(0, 1);
    return sigma * std::sqrt(-2 * std::log(u)) * std::cos(2 * M_PI * uniform(0, 1));
  }
  /// Each coordinate in [-size, size).
  Eigen::Vector3d vector(double size) { return {uniform(-size, size), uniform(-size, size), uniform(-size, size)}; }
  Eigen::Vector3d gaussVector(double sigma) { return {gauss(sigma), gauss(sigma), gauss(sigma)}; }

 private:
  std::mt19937 generator_;
};

}  // namespace air_ground_common::testing
