#include <stdexcept>

#include "air_ground_common/parameters.h"
#include "dense_fusion/dense_mapper.h"

namespace dense_fusion {

void describe(air_ground_common::ParameterVisitor& v, MapperSettings& m) {
  v.section("View selection");
  v("nominal_distance", m.nominal_distance, {0.01, 1000}, "m",
    "distance of the scene for which all lengths are meant: where the map has no scale, what is in view counts as "
    "being so far away; of metric images beyond three times that, they grow with the scene's distance");
  v("view_selection/sweep_radius", m.sweep_radius, {0.005, 100}, "m",
    "frames this near to the reference view join its depth map (paper: 0.12)");
  v("view_selection/max_baseline", m.max_baseline, {0, 1}, "",
    "where images lie so far apart that fewer than 2.5 fit in sweep_radius, this and fusion_radius grow until 3.5 do, "
    "up to this share of the scene's distance; 0: they stay as set");
  v("view_selection/frame_spacing", m.frame_spacing, {0, 100}, "m",
    "frames nearer than this to the one before add nothing and are left out; below sweep_radius");
  v("view_selection/max_rotation", m.max_rotation, {0.05, 3.2}, "rad",
    "frames turned further than this from the reference end its depth map");
  v("view_selection/fusion_radius", m.fusion_radius, {0.01, 1000}, "m",
    "depth maps this near to the first are fused; one fused map goes out each time (paper: 0.70)");
  v("view_selection/overlap", m.overlap, {0, 1000}, "m",
    "depth maps this near to the last one also start the next fusion; below fusion_radius");
  v("view_selection/min_depth_maps", m.min_depth_maps, {1, 100}, "", "fewer are not fused, but dropped and counted");
  v("view_selection/min_valid", m.min_valid, {0, 1}, "",
    "share of pixels with depth below which a depth map is dropped and counted");

  v.section("Depth range", "The sweep spans [depth_min / near_margin, depth_max * far_margin] of the posed image.");
  v("depth_range/near_margin", m.near_margin, {1, 20}, "", "generous: the tops of tall things hold few sparse points");
  v("depth_range/far_margin", m.far_margin, {1, 20}, "", "");
  v("depth_range/default_min", m.default_depth_min, {0.01, 1000}, "m",
    "while the posed images do not tell their depth range");
  v("depth_range/default_max", m.default_depth_max, {0.02, 10000}, "m", "");

  v.section("Images");
  v("image/scale", m.rectifier.scale, {0.1, 1}, "",
    "size of the swept, undistorted images relative to the recorded ones (paper: 376x240 of 752x480)");
  v("image/max_field", m.rectifier.max_field, {0.2, 2.6}, "rad",
    "across and down: what is swept of rational_polynomial and equidistant (fisheye) images");
  v("image/normalization_radius", m.rectifier.normalization_radius, {1, 100}, "px",
    "half width of the window whose mean and contrast are taken out (exposure, vignetting)");
  v("image/contrast_floor", m.rectifier.contrast_floor, {0.1, 100}, "grey levels",
    "contrast of about this much counts as noise, not texture");
  v("image/contrast_gain", m.rectifier.contrast_gain, {1, 127}, "grey levels",
    "per standard deviation after normalisation");

  v.section("Plane sweep");
  v("threads", m.sweep.threads, {1, 64}, "", "threads of the sweep and the fusion");
  m.fusion.threads = m.sweep.threads;
  v("sweep/hypotheses", m.sweep.hypotheses, {16, 1000}, "", "planes, evenly spaced in inverse depth (paper: 200)");
  v("sweep/aggregation_radius", m.sweep.aggregation_radius, {0, 8}, "px",
    "costs are summed over a window of 2 r + 1 before the winner is taken");
  v("sweep/max_frames", m.sweep.max_frames, {1, 64}, "", "of one depth map; hovering ends it there");
  v("sweep/min_samples", m.sweep.min_samples, {1, 64}, "", "frames that must see a pixel beside the reference");
  v("sweep/min_parallax", m.sweep.min_parallax, {0, 100}, "px",
    "shift between the first and the last plane, RMS over the frames, below which there is no depth map");
  v("sweep/max_peak_ratio", m.sweep.max_peak_ratio, {0.01, 1}, "",
    "best cost over the best one elsewhere: above it the pixel is ambiguous");
  v("sweep/confidence_sigma", m.sweep.confidence_sigma, {1e-4, 100}, "m",
    "standard deviation of depth at which confidence is halved");
  v("sweep/min_confidence", m.sweep.min_confidence, {0, 1}, "", "pixels below it are rejected");

  v.section("Fusion");
  v("fusion/voxel_size", m.fusion.voxel_size, {0.001, 10}, "m",
    "grows where the scene would need more than max_voxels");
  v("fusion/voxel_pixels", m.fusion.voxel_pixels, {0, 20}, "px",
    "least edge of a voxel, in pixels of the swept images on what they see: finer ones of a scene far away take time "
    "and tell nothing; 0: voxels stay as set");
  v("fusion/max_voxels", m.fusion.max_voxels, {1000, 200000000}, "",
    "the paper's 376x240x150; about 31 bytes each, 420 MB in all");
  v("fusion/truncation_voxels", m.fusion.truncation_voxels, {1, 50}, "",
    "half width of the band around its surface in which a depth map votes for distances");
  v("fusion/behind_voxels", m.fusion.behind_voxels, {0, 1000}, "",
    "further reach behind a surface of its votes for matter, without which thin sheets vanish");
  v("fusion/min_support", m.fusion.min_support, {1, 255}, "",
    "depth maps that must agree within the band, else the surface is the regulariser's invention");
  v("fusion/min_agreeing", m.fusion.min_agreeing, {0, 255}, "",
    "depth maps that must agree with a point after its correction; other points are dropped; 0: every point stays");
  v("fusion/agreement", m.fusion.agreement, {0.01, 50}, "voxels",
    "they agree when their depth is this near to it, or within the standard deviation of the group's depths");
  v("fusion/fill_radius", m.fusion.fill_radius, {0, 50}, "voxels",
    "surface this far beside supported surface is kept, too: fills holes, less accurately");
  v("fusion/refine", m.fusion.refine, "move points to the mean of the depth maps that agree: below the voxel's size");
  v("fusion/extent_quantile", m.fusion.extent_quantile, {0, 0.2}, "",
    "share of the depths left out at each end of each axis when the grid is sized");
  v("fusion/sparse_margin", m.fusion.sparse_margin, {0, 1000}, "m",
    "the grid ends this far beyond the points of mav/sparse_cloud that are in view");
  v("fusion/min_sparse_points", m.fusion.min_sparse_points, {1, 1000000}, "",
    "in view; fewer do not bound the grid, which then ends where the depths do");
  v("fusion/lambda", m.fusion.tv_l1.lambda, {1e-4, 100}, "",
    "weight of the votes against the surface's area, equation 1 (paper: 0.26)");
  v("fusion/iterations", m.fusion.tv_l1.iterations, {1, 10000}, "",
    "of the minimisation at full resolution (paper: 8); the limit when relative_gap is set");
  v("fusion/relative_gap", m.fusion.tv_l1.relative_gap, {0, 1}, "",
    "stop when the primal-dual gap falls below this share of the energy; 0: run all iterations");
  v("fusion/coarse_levels", m.fusion.tv_l1.coarse_levels, {0, 3}, "",
    "coarser grids whose solutions start the finer ones; 0: cold start");
  v("fusion/coarse_iterations", m.fusion.tv_l1.coarse_iterations, {1, 1000}, "",
    "on the coarsest grid, half as many on each finer one");
}

void MapperSettings::validate() const {
  const auto require = [](bool ok, const char* rule) {
    if (!ok) throw std::invalid_argument(std::string("dense mapper: ") + rule);
  };
  air_ground_common::checkRanges(*this);
  require(frame_spacing < sweep_radius, "frame_spacing must lie in [0, sweep_radius)");
  require(overlap < fusion_radius, "overlap must lie in [0, fusion_radius)");
  require(default_depth_max > default_depth_min, "the default depth range must be rising");
}

}  // namespace dense_fusion
