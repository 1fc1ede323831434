#include "node_parameters.h"

#include "air_ground_common/ros/parameters.h"

namespace dense_fusion {

NodeSettings readParameters(const ros::NodeHandle& private_handle) {
  air_ground_common::ros_utils::Parameters p(private_handle);
  NodeSettings s;
  MapperSettings& m = s.mapper;
  s.queue_size = p.integer("queue_size", s.queue_size, 10, 10000);
  s.flush_timeout = p.number("flush_timeout", s.flush_timeout, 0, 3600);
  s.service_timeout = p.number("service_timeout", s.service_timeout, 0.01, 3600);
  s.map_cell = p.number("map_cell", s.map_cell, 0.001, 1);
  s.map_max_points = p.integer("map_max_points", s.map_max_points, 1000, 100000000);
  const int threads = p.integer("threads", m.sweep.threads, 1, 64);
  m.sweep.threads = m.fusion.threads = threads;

  m.sweep_radius = p.number("view_selection/sweep_radius", m.sweep_radius, 0.005, 100);
  m.frame_spacing = p.number("view_selection/frame_spacing", m.frame_spacing, 0, 100);
  m.max_rotation = p.number("view_selection/max_rotation", m.max_rotation, 0.05, 3.2);
  m.fusion_radius = p.number("view_selection/fusion_radius", m.fusion_radius, 0.01, 1000);
  m.overlap = p.number("view_selection/overlap", m.overlap, 0, 1000);
  m.min_depth_maps = p.integer("view_selection/min_depth_maps", m.min_depth_maps, 1, 100);
  m.min_valid = p.number("view_selection/min_valid", m.min_valid, 0, 1);

  m.near_margin = p.number("depth_range/near_margin", m.near_margin, 1, 20);
  m.far_margin = p.number("depth_range/far_margin", m.far_margin, 1, 20);
  m.default_depth_min = p.number("depth_range/default_min", m.default_depth_min, 0.01, 1000);
  m.default_depth_max = p.number("depth_range/default_max", m.default_depth_max, 0.02, 10000);

  m.rectifier.scale = p.number("image/scale", m.rectifier.scale, 0.1, 1);
  m.rectifier.max_field = p.number("image/max_field", m.rectifier.max_field, 0.2, 2.6);
  m.rectifier.normalization_radius = p.integer("image/normalization_radius", m.rectifier.normalization_radius, 1, 100);
  m.rectifier.contrast_floor = p.number("image/contrast_floor", m.rectifier.contrast_floor, 0.1, 100);
  m.rectifier.contrast_gain = p.number("image/contrast_gain", m.rectifier.contrast_gain, 1, 127);

  m.sweep.hypotheses = p.integer("sweep/hypotheses", m.sweep.hypotheses, 16, 1000);
  m.sweep.aggregation_radius = p.integer("sweep/aggregation_radius", m.sweep.aggregation_radius, 0, 8);
  m.sweep.max_frames = p.integer("sweep/max_frames", m.sweep.max_frames, 1, 64);
  m.sweep.min_samples = p.integer("sweep/min_samples", m.sweep.min_samples, 1, 64);
  m.sweep.min_parallax = p.number("sweep/min_parallax", m.sweep.min_parallax, 0, 100);
  m.sweep.max_peak_ratio = p.number("sweep/max_peak_ratio", m.sweep.max_peak_ratio, 0.01, 1);
  m.sweep.confidence_sigma = p.number("sweep/confidence_sigma", m.sweep.confidence_sigma, 1e-4, 100);
  m.sweep.min_confidence = p.number("sweep/min_confidence", m.sweep.min_confidence, 0, 1);

  m.fusion.voxel_size = p.number("fusion/voxel_size", m.fusion.voxel_size, 0.001, 10);
  m.fusion.max_voxels =
      static_cast<std::size_t>(p.integer("fusion/max_voxels", static_cast<int>(m.fusion.max_voxels), 1000, 200000000));
  m.fusion.truncation_voxels = p.number("fusion/truncation_voxels", m.fusion.truncation_voxels, 1, 50);
  m.fusion.behind_voxels = p.number("fusion/behind_voxels", m.fusion.behind_voxels, 0, 1000);
  m.fusion.min_support = p.integer("fusion/min_support", m.fusion.min_support, 1, 255);
  m.fusion.min_agreeing = p.integer("fusion/min_agreeing", m.fusion.min_agreeing, 0, 255);
  m.fusion.agreement = p.number("fusion/agreement", m.fusion.agreement, 0.01, 50);
  m.fusion.fill_radius = p.integer("fusion/fill_radius", m.fusion.fill_radius, 0, 50);
  m.fusion.refine = p.flag("fusion/refine", m.fusion.refine);
  m.fusion.extent_quantile = p.number("fusion/extent_quantile", m.fusion.extent_quantile, 0, 0.2);
  m.fusion.sparse_margin = p.number("fusion/sparse_margin", m.fusion.sparse_margin, 0, 1000);
  m.fusion.min_sparse_points = p.integer("fusion/min_sparse_points", m.fusion.min_sparse_points, 1, 1000000);
  m.fusion.tv_l1.lambda = p.number("fusion/lambda", m.fusion.tv_l1.lambda, 1e-4, 100);
  m.fusion.tv_l1.iterations = p.integer("fusion/iterations", m.fusion.tv_l1.iterations, 1, 10000);
  m.fusion.tv_l1.relative_gap = p.number("fusion/relative_gap", m.fusion.tv_l1.relative_gap, 0, 1);
  m.fusion.tv_l1.coarse_levels = p.integer("fusion/coarse_levels", m.fusion.tv_l1.coarse_levels, 0, 3);
  m.fusion.tv_l1.coarse_iterations = p.integer("fusion/coarse_iterations", m.fusion.tv_l1.coarse_iterations, 1, 1000);
  p.finish();
  return s;
}

}  // namespace dense_fusion
