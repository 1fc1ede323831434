// The vertical of a map that no IMU levels: most of what lies about flat in a scene (floors, table tops, ceilings) is
// level.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

namespace rgbd_slam {

struct SurfacePatch {
  Eigen::Vector3d normal;  ///< unit, map frame
  double area;             ///< [m^2]
};

/// The direction, on the side of +z and within `max_tilt` [rad] of it, that most of the area faces or turns its back
/// to. Among two that hold about as much z is kept where it is one of them (a ramp), else none is up. Empty, too, where
/// little lies flat.
std::optional<Eigen::Vector3d> verticalOfSurfaces(const std::vector<SurfacePatch>& patches, double max_tilt);

}  // namespace rgbd_slam
