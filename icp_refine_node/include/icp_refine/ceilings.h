// What the ground robot saw from below: no camera that looks down sees it.
#pragma once

#include <vector>

#include "icp_refine/icp.h"

namespace icp_refine {

/// Mask of the points of `ground` (in the ground map's frame, with normals) that lie on ceilings: about level, higher
/// than `camera` (greatest z of the camera that saw them [m]; not finite: not known, none), and somewhere so far above
/// what else there is about them that a MAV may fly between. A hillside above the camera has nothing beneath it.
std::vector<char> onCeilings(const Cloud& ground, double camera);

/// The chain's reference of a map without its ceilings.
IcpReference referenceBelowCeilings(const IcpChain& chain, const Cloud& ground, double camera);

}  // namespace icp_refine
