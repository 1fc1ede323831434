// What the ground robot saw from below: no camera that looks down sees it.
#pragma once

#include <vector>

#include "icp_refine/icp.h"

namespace icp_refine {

/// Mask of the points of `ground` (in the ground map's frame, with normals) that lie on ceilings: about level, higher
/// than `camera` (greatest z of the camera that saw them [m]; not finite: not known, none), and somewhere so far above
/// what else there is about them that a MAV may fly between. A hillside above the camera has nothing beneath it.
std::vector<char> onCeilings(const Cloud& ground, double camera);

/// Mask of the points that lie on the underside (or at the edge) of what hangs over a floor that was seen, a table's:
/// the MAV sees the top, which is higher by its thickness. `hidden_from`: height from which on something hides what is
/// above a point [m], NaN where nothing does. Throws std::invalid_argument unless there are as many as points.
std::vector<char> onUndersides(const std::vector<Eigen::Vector3f>& ground, const std::vector<float>& hidden_from);

/// The chain's reference of a map without its ceilings.
IcpReference referenceBelowCeilings(const IcpChain& chain, const Cloud& ground, double camera);

}  // namespace icp_refine
