// Alignments of other nodes, read from their messages. They throw std::invalid_argument for what cannot be used.
#pragma once

#include <air_ground/AlignmentEstimate.h>
#include <air_ground/VoStatus.h>

#include "icp_refine/known_alignment.h"
#include "icp_refine/localizability.h"

namespace icp_refine {

/// Of the child: an alignment that comes before any cloud tells the unit of the MAV's map.
inline std_msgs::Header childHeader(const air_ground::AlignmentEstimate& msg) {
  std_msgs::Header header = msg.header;
  header.frame_id = msg.child_frame_id;
  return header;
}

/// With the message's scale.
Similarity similarityFrom(const air_ground::AlignmentEstimate& msg);

/// Where the coarse stage has placed the MAV's map.
struct CoarseAlignment : KnownAlignment {
  bool sure = true;  ///< false: a guess
};

/// CONVERGED, or a guess for a refinement.
bool isUsable(const air_ground::AlignmentEstimate& msg);
/// Its author does not stand by what was CONVERGED before.
bool isWithdrawal(const air_ground::AlignmentEstimate& msg);

/// `own_unit`: the MAV's map has no scale but this; else the message's is left out.
CoarseAlignment coarseAlignmentFrom(const air_ground::AlignmentEstimate& msg, bool own_unit);

/// Not known where the message's numbers are none; never throws.
Vertical verticalFrom(const air_ground::VoStatus& msg);

KnownAlignment viewAlignmentFrom(const air_ground::AlignmentEstimate& msg, bool own_unit);

}  // namespace icp_refine
