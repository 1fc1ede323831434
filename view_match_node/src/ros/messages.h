// Messages of view_match_node. What reads one throws std::invalid_argument for what cannot be used.
#pragma once

#include <air_ground/AlignmentEstimate.h>
#include <air_ground/MapKeyframes.h>

#include <map>

#include "view_match/view_matcher.h"

namespace view_match {

/// All keyframes of the map as they stand, by id.
std::map<std::uint32_t, Pose> posesOf(const air_ground::MapKeyframes& msg);

KeyframeView viewOf(const air_ground::KeyframeFeatures& msg, const Pose& T_ground_camera);

/// Without header, frame and map.
air_ground::AlignmentEstimate toMsg(const MatchEstimate& estimate);

}  // namespace view_match
