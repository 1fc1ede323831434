// Alignments of other nodes, read from their messages. Both throw std::invalid_argument for what cannot be used.
#pragma once

#include <air_ground/AlignmentEstimate.h>

#include "icp_refine/view_alignment.h"

namespace icp_refine {

/// Where the coarse stage has placed the MAV's map.
struct CoarseAlignment {
  Similarity T_ground_map_mav_map;
  double scale_stddev = 0;  ///< relative
};

/// `own_unit`: the MAV's map has no scale but this; else the message's is left out.
CoarseAlignment coarseAlignmentFrom(const air_ground::AlignmentEstimate& msg, bool own_unit);

ViewAlignment viewAlignmentFrom(const air_ground::AlignmentEstimate& msg, bool own_unit);

}  // namespace icp_refine
