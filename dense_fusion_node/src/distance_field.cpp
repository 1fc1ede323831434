#include "dense_fusion/distance_field.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "air_ground_common/first_exception.h"
#include "dense_fusion/fusion_kernels.h"

namespace dense_fusion {
namespace {

void checkSizes(const VoxelGrid& grid, const VoteBand& band, const Histograms<std::uint8_t>& votes) {
  if (votes.nx != grid.nx || votes.ny != grid.ny || votes.nz != grid.nz)
    throw std::invalid_argument("distance field: resize the histograms to the grid first");
  if (!(band.truncation > 0) || !(band.behind >= 0))
    throw std::invalid_argument("distance field: the truncation must be positive, the reach behind it not negative");
}

// Voxels of a row that a map may say something about: those before its camera, in its view and no farther than
// `deepest` form an interval, since every bound is linear along the row. One voxel more at each end, where rounding
// decides.
struct Interval {
  int begin = 0, end = 0;
};

Interval mayVote(const Eigen::Vector3d& start, const Eigen::Vector3d& step, int nx, const DepthMap& map,
                 double deepest) {
  const air_ground_common::CameraModel& c = map.camera;
  const double left = c.cx + 0.5, top = c.cy + 0.5;
  const Eigen::Vector3d bounds[] = {
      {0, 0, 1}, {c.fx, 0, left}, {-c.fx, 0, map.depth.cols - left}, {0, c.fy, top}, {0, -c.fy, map.depth.rows - top}};
  double begin = 0, end = nx - 1;
  const auto clip = [&](double at_start, double per_voxel) {
    if (std::abs(per_voxel) < 1e-12) {
      if (at_start < -1e-6) end = begin - 2;
    } else if (per_voxel > 0) {
      begin = std::max(begin, -at_start / per_voxel);
    } else {
      end = std::min(end, -at_start / per_voxel);
    }
  };
  for (const Eigen::Vector3d& bound : bounds) clip(bound.dot(start), bound.dot(step));
  clip(deepest - start.z(), -step.z());
  if (end < begin - 1) return {};
  return {std::max(0, static_cast<int>(std::floor(begin)) - 1), std::min(nx, static_cast<int>(std::ceil(end)) + 2)};
}

}  // namespace

float distanceAt(const DepthMap& map, const Eigen::Vector3d& point, const VoteBand& band) {
  constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
  const Eigen::Vector3d p = map.T_map_camera.inverse() * point;
  const auto pixel = map.camera.project(p);
  if (!pixel) return kNothing;
  const int u = static_cast<int>(std::floor(pixel->x() + 0.5)), v = static_cast<int>(std::floor(pixel->y() + 0.5));
  if (u < 0 || v < 0 || u >= map.camera.width || v >= map.camera.height) return kNothing;
  const double f = (map.depth.at<float>(v, u) - p.z()) / band.truncation;
  return f >= -1 - band.behind / band.truncation ? static_cast<float>(std::clamp(f, -1.0, 1.0)) : kNothing;
}

void addVotes(const DepthMap& map, const VoxelGrid& grid, const VoteBand& band, int threads,
              Histograms<std::uint8_t>* votes) {
  checkSizes(grid, band, *votes);
  const Eigen::Isometry3d T_camera_map = map.T_map_camera.inverse();
  const Eigen::Vector3d dx = grid.voxel_size * T_camera_map.linear().col(0);
  const float step[3] = {float(dx.x()), float(dx.y()), float(dx.z())};
  double deepest = 0;  // NaN compares false
  for (int v = 0; v < map.depth.rows; ++v)
    for (int u = 0; u < map.depth.cols; ++u) deepest = std::max(deepest, double(map.depth.ptr<float>(v)[u]));
  deepest += band.truncation + band.behind;
  const float camera[4] = {float(map.camera.fx), float(map.camera.fy), float(map.camera.cx), float(map.camera.cy)};
  const cv::Mat depth = map.depth.isContinuous() ? map.depth : map.depth.clone();
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
  for (int z = 0; z < grid.nz; ++z)
    failure.guard([&] {
      std::vector<std::uint8_t> bin(grid.nx);
      for (int y = 0; y < grid.ny; ++y) {
        const auto [begin, end] = mayVote(T_camera_map * grid.center(0, y, z), dx, grid.nx, map, deepest);
        if (begin >= end) continue;
        const Eigen::Vector3d p = T_camera_map * grid.center(begin, y, z);
        const float start[3] = {float(p.x()), float(p.y()), float(p.z())};
        kernels::voteRow(start, step, end - begin, camera, depth.ptr<float>(), depth.cols, depth.rows,
                         static_cast<float>(1 / band.truncation),
                         static_cast<float>(-1 - band.behind / band.truncation), bin.data());
        kernels::countRow(bin.data(), end - begin, votes->row(y, z) + begin, grid.nx);
      }
    });
  failure.rethrow();
}

void addVotesReference(const DepthMap& map, const VoxelGrid& grid, const VoteBand& band,
                       Histograms<std::uint8_t>* votes) {
  checkSizes(grid, band, *votes);
  for (int z = 0; z < grid.nz; ++z)
    for (int y = 0; y < grid.ny; ++y)
      for (int x = 0; x < grid.nx; ++x) {
        const float f = distanceAt(map, grid.center(x, y, z), band);
        if (std::isnan(f)) continue;
        const int bin = static_cast<int>(std::lround((f + 1) * 0.5 * (kBins - 1)));
        std::uint8_t& count = votes->row(y, z)[static_cast<std::size_t>(bin) * grid.nx + x];
        if (count < 255) ++count;
      }
}

}  // namespace dense_fusion
