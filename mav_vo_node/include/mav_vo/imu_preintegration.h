// Preintegrated inertial motion, of the shared front end, under this module's names.
#pragma once

#include "visual_frontend/imu_preintegration.h"

namespace mav_vo {

using visual_frontend::ImuBias;
using visual_frontend::ImuBuffer;
using visual_frontend::ImuNoise;
using visual_frontend::ImuSample;
using visual_frontend::kGravity;
using visual_frontend::Preintegration;
using visual_frontend::samplesBetween;

}  // namespace mav_vo
