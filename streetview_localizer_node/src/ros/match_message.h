// What became of an image, as a message.
#pragma once

#include <air_ground/StreetviewMatch.h>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

/// All but the header and the camera's frame.
air_ground::StreetviewMatch matchMessage(const LocalizerResult& result, const StreetviewDatabase& database);

}  // namespace streetview_localizer
