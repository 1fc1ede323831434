#include "dense_fusion/depth_fusion.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "air_ground_common/statistics.h"
#include "dense_fusion/distance_field.h"

namespace dense_fusion {
namespace {

class Stopwatch {
 public:
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - last_).count();
    last_ = now;
    return seconds;
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

// Enough maps agree, and no more of them see past it than have it.
bool believed(const DepthMapViews::Opinion& opinion, const FusionSettings& settings) {
  return opinion.agreeing >= settings.min_agreeing && opinion.seen_past <= opinion.voices;
}

// Typical standard deviation of a depth on the surface [m]: grows with distance and where texture is weak.
double depthDeviation(const DepthMapViews& views, const std::vector<SurfacePoint>& points) {
  std::vector<float> deviations;
  const std::size_t step = points.size() / 4000 + 1;
  for (std::size_t i = 0; i < points.size(); i += step)
    if (const float deviation = views.ask(points[i].position).deviation; deviation >= 0)
      deviations.push_back(deviation);
  return deviations.empty() ? 0 : air_ground_common::median(std::move(deviations));
}

// Asks the depth maps about the reference view's surface: moves it to what they say on average, drops what too few of
// them agree with, and tells how many do.
void askAboutView(const DepthMapViews& views, const FusionSettings& settings, DepthMap* map) {
  const Eigen::Matrix3f R = map->T_map_camera.linear().cast<float>();
  const Eigen::Vector3f t = map->T_map_camera.translation().cast<float>();
  const auto& c = map->camera;
  map->confidence = cv::Mat::zeros(map->depth.size(), CV_32F);
#pragma omp parallel for schedule(dynamic, 8) num_threads(settings.threads)
  for (int v = 0; v < map->depth.rows; ++v)
    for (int u = 0; u < map->depth.cols; ++u) {
      float& z = map->depth.at<float>(v, u);
      if (std::isnan(z)) continue;
      const Eigen::Vector3f ray(static_cast<float>((u - c.cx) / c.fx), static_cast<float>((v - c.cy) / c.fy), 1.f);
      const DepthMapViews::Opinion opinion = views.ask(R * (z * ray) + t);
      if (!believed(opinion, settings)) {
        z = std::numeric_limits<float>::quiet_NaN();
        continue;
      }
      if (settings.refine) z += opinion.shift;
      // One map's word is worth half, ten in agreement 10/11: a share of certainty without a claim of calibration.
      const float voices = static_cast<float>(opinion.voices);
      map->confidence.at<float>(v, u) = voices / (1 + voices);
    }
}

// The same about the whole surface; points move along the rays of the camera at T.
void askAboutPoints(const DepthMapViews& views, const FusionSettings& settings, const Eigen::Isometry3d& T,
                    std::vector<SurfacePoint>* points) {
  const Eigen::Vector3f centre = T.translation().cast<float>(), axis = T.linear().col(2).cast<float>();
#pragma omp parallel for schedule(static) num_threads(settings.threads)
  for (std::size_t i = 0; i < points->size(); ++i) {
    SurfacePoint& point = (*points)[i];
    const DepthMapViews::Opinion opinion = views.ask(point.position);
    point.intensity = opinion.intensity;
    if (!believed(opinion, settings)) {
      point.support = 0;
      continue;
    }
    const Eigen::Vector3f ray = point.position - centre;
    const float z = axis.dot(ray);
    if (settings.refine && z >= 0.05f) point.position += opinion.shift / z * ray;
  }
  points->erase(
      std::remove_if(points->begin(), points->end(), [](const SurfacePoint& point) { return point.support == 0; }),
      points->end());
}

// Drops crossings that face away from every camera: the far side of the band, where free-space votes of wrong depths
// are the only voice.
void dropBackFaces(const std::vector<DepthMap>& maps, std::vector<SurfacePoint>* points) {
  std::vector<Eigen::Vector3f> centres;
  for (const DepthMap& map : maps) centres.push_back(map.T_map_camera.translation().cast<float>());
  const auto faces_away = [&](const SurfacePoint& point) {
    return std::none_of(centres.begin(), centres.end(),
                        [&](const Eigen::Vector3f& c) { return point.normal.dot(c - point.position) > 0; });
  };
  points->erase(std::remove_if(points->begin(), points->end(), faces_away), points->end());
}

using Axes = std::array<std::vector<double>, 3>;

void append(const Eigen::Vector3d& point, Axes* axes) {
  for (int k = 0; k < 3; ++k) (*axes)[k].push_back(point[k]);
}

// Axis-aligned box without the share `tail` of the coordinates at each end of each axis.
Eigen::AlignedBox3d innerBox(Axes axes, double tail) {
  Eigen::AlignedBox3d box;
  for (int k = 0; k < 3; ++k) {
    box.min()[k] = air_ground_common::quantile(axes[k], tail);
    box.max()[k] = air_ground_common::quantile(std::move(axes[k]), 1 - tail);
  }
  return box;
}

bool inView(const DepthMap& map, const Eigen::Vector3d& point) {
  const Eigen::Vector3d p = map.T_map_camera.inverse() * point;
  if (!(p.z() > 0.05)) return false;
  const double u = map.camera.fx * p.x() / p.z() + map.camera.cx, v = map.camera.fy * p.y() / p.z() + map.camera.cy;
  return u >= 0 && v >= 0 && u <= map.camera.width - 1 && v <= map.camera.height - 1;
}

}  // namespace

std::optional<VoxelGrid> gridFor(const std::vector<DepthMap>& maps, const FusionSettings& settings,
                                 const std::vector<Eigen::Vector3f>& sparse_points) {
  Axes depths;
  std::vector<double> footprints;  // of a pixel on what it sees [m]
  constexpr int kStride = 3;
  for (const DepthMap& map : maps)
    for (int v = 0; v < map.depth.rows; v += kStride)
      for (int u = 0; u < map.depth.cols; u += kStride) {
        const float z = map.depth.at<float>(v, u);
        if (std::isnan(z)) continue;
        const auto& c = map.camera;
        append(map.T_map_camera * (z * Eigen::Vector3d((u - c.cx) / c.fx, (v - c.cy) / c.fy, 1)), &depths);
        footprints.push_back(z / c.fx);
      }
  if (depths[0].size() < 100) return std::nullopt;
  Eigen::AlignedBox3d box = innerBox(std::move(depths), settings.extent_quantile);

  Axes sparse;
  for (const Eigen::Vector3f& point : sparse_points) {
    const Eigen::Vector3d p = point.cast<double>();
    if (p.allFinite() && std::any_of(maps.begin(), maps.end(), [&](const DepthMap& map) { return inView(map, p); }))
      append(p, &sparse);
  }
  if (!sparse[0].empty() && static_cast<int>(sparse[0].size()) >= settings.min_sparse_points) {
    constexpr double kOutliers = 0.01;
    const Eigen::AlignedBox3d seen = innerBox(std::move(sparse), kOutliers);
    const Eigen::Vector3d room = Eigen::Vector3d::Constant(settings.sparse_margin);
    box = box.intersection(Eigen::AlignedBox3d(seen.min() - room, seen.max() + room));
  }
  if (!((box.max() - box.min()).array() > 0).all()) return std::nullopt;

  // The band grows with the voxels, and with it the room it needs around the box. Where the band alone is more than
  // max_voxels, that has no end: the last round's grid is within max_voxels all the same.
  VoxelGrid grid;
  grid.voxel_size =
      std::max(settings.voxel_size, settings.voxel_pixels * air_ground_common::median(std::move(footprints)));
  constexpr int kRounds = 8;
  for (int round = 0; round < kRounds; ++round) {
    const double wanted = grid.voxel_size;
    const Eigen::Vector3d band = Eigen::Vector3d::Constant((settings.truncation_voxels + 1) * wanted);
    grid = fitGrid(box.min() - band, box.max() + band, wanted, settings.max_voxels);
    if (grid.voxel_size == wanted) break;
  }
  return grid;
}

std::optional<FusedMap> fuseDepthMaps(const std::vector<DepthMap>& maps, std::size_t reference,
                                      const FusionSettings& settings, const std::vector<Eigen::Vector3f>& sparse_points,
                                      bool view) {
  if (reference >= maps.size()) throw std::invalid_argument("depth fusion: the reference view is not among the maps");
  if (maps.size() > 255) throw std::invalid_argument("depth fusion: at most 255 depth maps fit in the 8-bit votes");
  if (!(settings.truncation_voxels >= 1) || !(settings.behind_voxels >= 0))
    throw std::invalid_argument("depth fusion: truncation_voxels must be at least 1, behind_voxels not negative");
  if (settings.min_support < 1) throw std::invalid_argument("depth fusion: min_support must be at least 1");
  const auto grid = gridFor(maps, settings, sparse_points);
  if (!grid) return std::nullopt;

  FusedMap fused;
  fused.grid = *grid;
  fused.depth_maps = static_cast<int>(maps.size());
  Stopwatch watch;
  Histograms<std::uint8_t> votes;
  votes.resize(grid->nx, grid->ny, grid->nz);
  const double truncation = settings.truncation_voxels * grid->voxel_size;
  const VoteBand band{truncation, settings.behind_voxels * grid->voxel_size};
  for (const DepthMap& map : maps) addVotes(map, *grid, band, settings.threads, &votes);
  fused.timings.votes = watch.lap();
  TvL1Settings tv_l1 = settings.tv_l1;
  tv_l1.threads = settings.threads;
  const TvL1Solution solution = solveTvL1(votes, tv_l1);
  fused.timings.minimisation = watch.lap();

  const auto support = surfaceSupport(votes, settings.fill_radius, settings.threads);
  const SurfaceField field{*grid, solution.phi, support, settings.min_support};
  const DepthMap& seen = maps[reference];
  fused.depth_map.stamp = seen.stamp;
  fused.depth_map.camera = seen.camera;
  fused.depth_map.T_map_camera = seen.T_map_camera;
  fused.depth_map.intensity = seen.intensity;
  for (const DepthMap& map : maps) fused.depth_map.frames += map.frames;
  if (view) fused.depth_map.depth = castRays(field, seen.camera, seen.T_map_camera, settings.threads);
  fused.points = extractSurface(field, settings.threads);
  dropBackFaces(maps, &fused.points);
  DepthMapViews views(maps, reference, {truncation, 0.75 * truncation, grid->voxel_size, 0});
  views.setAgreement(std::max(settings.agreement * grid->voxel_size, depthDeviation(views, fused.points)));
  if (view) askAboutView(views, settings, &fused.depth_map);
  askAboutPoints(views, settings, seen.T_map_camera, &fused.points);
  double sum = 0;
  for (const SurfacePoint& p : fused.points) sum += p.support;
  fused.mean_support = fused.points.empty() ? 0 : sum / static_cast<double>(fused.points.size());
  fused.timings.surface = watch.lap();
  return fused;
}

}  // namespace dense_fusion
