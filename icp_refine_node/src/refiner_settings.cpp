#include "air_ground_common/parameters.h"
#include "icp_refine/alignment_refiner.h"

namespace icp_refine {

void describe(air_ground_common::ParameterVisitor& v, RefinerSettings& r) {
  v.section("Refinement");
  v("recent_clouds", r.recent_clouds, {1, 10000}, "",
    "aerial clouds in a row that make up the reading: the newest, or those that a guess puts on the ground map");
  v("accumulation_leaf", r.accumulation_leaf, {0.001, 10}, "m", "each of them is thinned to this");
  v("margin", r.height_check.margin, {0.01, 1000}, "m",
    "aerial points farther than this from the ground map, in plan, are left out");
  v("retries", r.retries, {0, 100}, "", "other starts around a coarse or manual guess that was rejected");
  v("retry_distance", r.retry_distance, {0, 10}, "m", "this far from it");
  v("retry_angle", r.retry_angle, {0, 3.2}, "rad", "and turned this much");
  v.choice(
      "scale", r.scale.mode,
      {{"prior", ScalePrior::Mode::kPrior}, {"free", ScalePrior::Mode::kFree}, {"fixed", ScalePrior::Mode::kFixed}},
      "of the MAV's map: ground-map length per length of the MAV's map. prior: estimated, the odometry's own "
      "uncertainty counting as one more measurement, which holds it where the geometry does not fix it (a floor). "
      "free: from the clouds alone, else DEGENERATE. fixed: held at 1 (an RGB-D MAV), the uncertainty goes into the "
      "covariance");
  v("scale_prior_stddev", r.scale.stddev, {1e-4, 1}, "",
    "relative standard deviation; a larger one that mav/vo_status states counts instead");
  v("tilt_prior_stddev", r.tilt_stddev, {1e-5, 1}, "rad",
    "about each horizontal axis, by which both maps may lean apart beyond what their robots state (tilt_stddev of "
    "mav/vo_status and ground/slam_status; where one is not known, the clouds alone tell)");

  v.section("Acceptance: a refined pose is CONVERGED only when all of these hold");
  v("accept/min_points", r.min_points, {6, 1000000}, "", "points with a valid normal in each map, else SEARCHING");
  v("accept/min_overlap", r.min_overlap, {0, 1}, "",
    "share of the aerial map, in plan, that the ground robot saw too, else REJECTED");
  v("accept/max_rms", r.max_rms, {0, 10}, "m", "weighted RMS point-to-plane residual, else REJECTED");
  v("accept/max_sigma", r.max_sigma, {0, 100}, "m",
    "largest standard deviation of the position in any direction, else DEGENERATE");
  v("accept/max_sigma_angle", r.max_sigma_angle, {0, 4}, "rad", "and of the rotation about any axis");
  v("accept/min_agreement", r.min_agreement, {0, 1}, "",
    "share of the columns off the floor whose heights do not contradict each other, else REJECTED");
  v("accept/guess_agreement", r.guess_agreement, {0, 1}, "",
    "instead of min_agreement where the coarse stage gave but a guess, or the result lies far from the tracked pose; "
    "another cloud, or more of the ground map, must confirm it, too");
  v("accept/min_relief_cells", r.height_check.min_relief_cells, {0, 1000000}, "",
    "fewer such columns cannot verify a pose: DEGENERATE");
  v("accept/height_cell", r.height_check.cell, {0.005, 10}, "m", "edge of a column");
  v("accept/height_tolerance_xy", r.height_check.tolerance_xy, {0, 10}, "m",
    "heights are compared with the best column this near");
  v("accept/height_tolerance_z", r.height_check.tolerance_z, {0, 10}, "m", "");
  v("accept/relief", r.height_check.relief, {0, 100}, "m", "off the floor: farther than this from its height");
  v("accept/view_squared_sigmas", r.known_squared_sigmas, {0, 1e6}, "",
    "by which the pose may differ from what images (alignment/views) or a CONVERGED coarse alignment tell, in sigmas "
    "of both, squared: then directions that the geometry does not fix are theirs, and heights need not verify it");

  v.section("Tracking: once CONVERGED, the next refinements start from the last refined pose");
  v("tracking/lost_after", r.lost_after, {1, 1000}, "",
    "contradictions in a row (residual or heights, not mere lack of overlap) that end it");
  v("tracking/held_agreement", r.held_agreement, {0, 1}, "",
    "instead of min_agreement where images lead to the same pose and the geometry fixes it: heights contradict where "
    "people or furniture have moved, and that much agreement keeps it (it does not make it CONVERGED)");
  v("tracking/coarse_distance", r.coarse_distance, {0, 1000}, "m",
    "a coarse pose disagrees when it is this far away ...");
  v("tracking/coarse_angle", r.coarse_angle, {0, 4}, "rad", "... or turned this much");
  v("tracking/coarse_disagreements", r.coarse_disagreements, {1, 1000}, "",
    "in a row: then both are refined, and the one whose heights agree better stays");
}

}  // namespace icp_refine
