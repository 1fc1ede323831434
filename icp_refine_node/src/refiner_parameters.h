// The refiner's parameters, as config/icp_refine.yaml names them: read alike by the node and by icp_align.
#pragma once

#include <map>
#include <string>

#include "icp_refine/alignment_refiner.h"

namespace icp_refine {

/// `p` has number(name, default, min, max), integer(likewise) and choice(name, default, choices), which throw for a
/// value out of range.
template <class Parameters>
RefinerSettings readRefinerSettings(Parameters& p) {
  RefinerSettings r;
  r.recent_clouds = p.integer("recent_clouds", r.recent_clouds, 1, 10000);
  r.accumulation_leaf = p.number("accumulation_leaf", r.accumulation_leaf, 0.001, 10);
  r.margin = p.number("margin", r.margin, 0.01, 1000);
  r.retries = p.integer("retries", r.retries, 0, 100);
  r.retry_distance = p.number("retry_distance", r.retry_distance, 0, 10);
  r.retry_angle = p.number("retry_angle", r.retry_angle, 0, 3.2);
  static const std::map<std::string, ScalePrior::Mode> kModes = {
      {"fixed", ScalePrior::Mode::kFixed}, {"prior", ScalePrior::Mode::kPrior}, {"free", ScalePrior::Mode::kFree}};
  r.scale.mode = kModes.at(p.choice("scale", "prior", {"fixed", "prior", "free"}));
  r.scale.stddev = p.number("scale_prior_stddev", r.scale.stddev, 1e-4, 1);
  r.min_points = p.integer("accept/min_points", r.min_points, 6, 1000000);
  r.min_overlap = p.number("accept/min_overlap", r.min_overlap, 0, 1);
  r.max_rms = p.number("accept/max_rms", r.max_rms, 0, 10);
  r.max_sigma = p.number("accept/max_sigma", r.max_sigma, 0, 100);
  r.max_sigma_angle = p.number("accept/max_sigma_angle", r.max_sigma_angle, 0, 4);
  r.min_agreement = p.number("accept/min_agreement", r.min_agreement, 0, 1);
  r.height_check.cell = p.number("accept/height_cell", r.height_check.cell, 0.005, 10);
  r.height_check.tolerance_xy = p.number("accept/height_tolerance_xy", r.height_check.tolerance_xy, 0, 10);
  r.height_check.tolerance_z = p.number("accept/height_tolerance_z", r.height_check.tolerance_z, 0, 10);
  r.height_check.relief = p.number("accept/relief", r.height_check.relief, 0, 100);
  r.height_check.min_relief_cells = p.integer("accept/min_relief_cells", r.height_check.min_relief_cells, 0, 1000000);
  r.lost_after = p.integer("tracking/lost_after", r.lost_after, 1, 1000);
  r.coarse_distance = p.number("tracking/coarse_distance", r.coarse_distance, 0, 1000);
  r.coarse_angle = p.number("tracking/coarse_angle", r.coarse_angle, 0, 4);
  r.coarse_disagreements = p.integer("tracking/coarse_disagreements", r.coarse_disagreements, 1, 1000);
  return r;
}

}  // namespace icp_refine
