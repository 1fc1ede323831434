// A cloud of the MAV's, as it comes.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "air_ground_common/similarity.h"

namespace heightmap_mcl {

struct AerialCloud {
  std::vector<Eigen::Vector3f> points;                  ///< in mav_map [m]; points that are not finite are ignored
  Eigen::Vector3d reference = Eigen::Vector3d::Zero();  ///< position of the MAV in mav_map [m]
  std::int64_t stamp = 0;                               ///< by which corrections know it [ns]
};

inline void moveBy(const air_ground_common::Similarity& S, AerialCloud* cloud) {
  for (Eigen::Vector3f& p : cloud->points) p = (S * p.cast<double>()).cast<float>();
  cloud->reference = S * cloud->reference;
}

}  // namespace heightmap_mcl
