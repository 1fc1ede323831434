// What a robot's status says of gravity in its map.
#pragma once

#include <air_ground/VoStatus.h>

#include "air_ground_common/vertical.h"

namespace air_ground_common::ros_utils {

void setVertical(const Vertical& vertical, air_ground::VoStatus* status);

/// Not known (`stddev` 0) where the status does not state it, or states what is no direction.
Vertical verticalFromMsg(const air_ground::VoStatus& status);

}  // namespace air_ground_common::ros_utils
