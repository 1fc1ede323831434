// Shared by the visual front end. Frames: T_map_camera maps points of the optical camera frame (x right, y down, z
// forward) to the map. "Normalised" image coordinates are undistorted (x/z, y/z); divide pixels of noise by the focal
// length to get their sigma.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"

namespace visual_frontend {

using air_ground_common::CameraModel;
using air_ground_common::Matrix6d;
using air_ground_common::Pose;
using air_ground_common::Vector6d;

using TrackId = std::int64_t;
using LandmarkId = std::int64_t;
using KeyframeId = int;

constexpr TrackId kNoTrack = -1;
constexpr LandmarkId kNoLandmark = -1;
constexpr KeyframeId kNoKeyframe = -1;

}  // namespace visual_frontend
