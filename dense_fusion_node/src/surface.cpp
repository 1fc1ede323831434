#include "dense_fusion/surface.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>

#include "air_ground_common/first_exception.h"
#include "dense_fusion/fusion_kernels.h"

namespace dense_fusion {
namespace {

// Trilinear value at continuous voxel coordinates inside [0, n - 1].
float sample(const VoxelGrid& grid, const Field<float>& phi, const Eigen::Vector3f& g) {
  const int x = std::min(static_cast<int>(g.x()), grid.nx - 2), y = std::min(static_cast<int>(g.y()), grid.ny - 2),
            z = std::min(static_cast<int>(g.z()), grid.nz - 2);
  const float fx = g.x() - x, fy = g.y() - y, fz = g.z() - z;
  const float* p = &phi[grid.index(x, y, z)];
  const std::size_t dy = grid.nx, dz = static_cast<std::size_t>(grid.nx) * grid.ny;
  const auto face = [&](const float* q) {
    const float a = q[0] + fx * (q[1] - q[0]), b = q[dy] + fx * (q[dy + 1] - q[dy]);
    return a + fy * (b - a);
  };
  const float low = face(p), high = face(p + dz);
  return low + fz * (high - low);
}

constexpr float kFree = 0.9f;  // above it a voxel lies well in free space

std::size_t nearestVoxel(const VoxelGrid& grid, const Eigen::Vector3f& g) {
  return grid.index(static_cast<int>(g.x() + 0.5f), static_cast<int>(g.y() + 0.5f), static_cast<int>(g.z() + 0.5f));
}

bool inside(const VoxelGrid& grid, const Eigen::Vector3f& g) {
  return g.x() >= 0 && g.y() >= 0 && g.z() >= 0 && g.x() <= grid.nx - 1 && g.y() <= grid.ny - 1 && g.z() <= grid.nz - 1;
}

// Which cubes of 8^3 voxels lie well in free space as a whole: a ray passes them without reading the field.
class FreeBlocks {
 public:
  FreeBlocks(const VoxelGrid& grid, const Field<float>& phi, int threads)
      : nx_(blocks(grid.nx)), ny_(blocks(grid.ny)), free_(static_cast<std::size_t>(nx_) * ny_ * blocks(grid.nz)) {
    air_ground_common::FirstException failure;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int Z = 0; Z < blocks(grid.nz); ++Z)
      failure.guard([&] {
        for (int Y = 0; Y < ny_; ++Y) {
          std::vector<float> least(static_cast<std::size_t>(nx_) * kSide, 1.f);
          for (int z = Z * kSide; z < std::min(grid.nz, (Z + 1) * kSide); ++z)
            for (int y = Y * kSide; y < std::min(grid.ny, (Y + 1) * kSide); ++y)
              kernels::lowerTo(&phi[grid.index(0, y, z)], grid.nx, least.data());
          for (int X = 0; X < nx_; ++X) {
            const auto begin = least.begin() + X * kSide;
            free_[(static_cast<std::size_t>(Z) * ny_ + Y) * nx_ + X] = *std::min_element(begin, begin + kSide) > kFree;
          }
        }
      });
    failure.rethrow();
  }
  bool at(int x, int y, int z) const {
    return free_[(static_cast<std::size_t>(z / kSide) * ny_ + y / kSide) * nx_ + x / kSide];
  }

 private:
  static constexpr int kSide = 8;
  static int blocks(int voxels) { return (voxels + kSide - 1) / kSide; }
  int nx_, ny_;
  std::vector<std::uint8_t> free_;
};

// Unit gradient by differences over two voxels; zero where the field is constant.
Eigen::Vector3f gradient(const VoxelGrid& grid, const Field<float>& phi, const Eigen::Vector3f& g) {
  const Eigen::Array3f upper(grid.nx - 1.f, grid.ny - 1.f, grid.nz - 1.f);
  Eigen::Vector3f result;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3f e = Eigen::Vector3f::Unit(axis);
    const Eigen::Vector3f a = (g + e).array().min(upper), b = (g - e).array().max(0.f);
    result[axis] = (sample(grid, phi, a) - sample(grid, phi, b)) / std::max(a[axis] - b[axis], 1e-3f);
  }
  const float norm = result.norm();
  if (norm > 1e-6f)
    result /= norm;
  else
    result.setZero();
  return result;
}

// Interval of ray parameters inside the grid; empty when the ray misses it.
std::optional<Eigen::Vector2d> clipToGrid(const VoxelGrid& grid, const Eigen::Vector3d& start,
                                          const Eigen::Vector3d& direction) {
  const Eigen::Vector3d upper(grid.nx - 1, grid.ny - 1, grid.nz - 1);
  double begin = 1e-3, end = 1e9;
  for (int axis = 0; axis < 3; ++axis) {
    if (std::abs(direction[axis]) < 1e-12) {
      if (start[axis] < 0 || start[axis] > upper[axis]) return std::nullopt;
      continue;
    }
    const double a = -start[axis] / direction[axis], b = (upper[axis] - start[axis]) / direction[axis];
    begin = std::max(begin, std::min(a, b));
    end = std::min(end, std::max(a, b));
  }
  if (begin >= end) return std::nullopt;
  return Eigen::Vector2d(begin, end);
}

// Parameter of the first supported crossing from free space into matter on the ray o + z r, in voxels; NaN: none.
float firstCrossing(const SurfaceField& field, const FreeBlocks& blocks, const Eigen::Vector3f& o,
                    const Eigen::Vector3f& r, const Eigen::Vector2f& range) {
  const VoxelGrid& grid = field.grid;
  const float voxel = 1.f / r.norm();
  float z = range[0] + 1e-4f * voxel, before = -1.f, z_before = z;
  constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
  std::size_t unread = kNone;  // where `before` is still to be read
  while (z < range[1]) {
    const Eigen::Vector3f g = o + z * r;
    if (!inside(grid, g)) break;
    const int x = static_cast<int>(g.x() + 0.5f), y = static_cast<int>(g.y() + 0.5f),
              k = static_cast<int>(g.z() + 0.5f);
    const std::size_t nearest = grid.index(x, y, k);
    float value = 1.f;
    const bool skipped = blocks.at(x, y, k);
    if (!skipped) {
      // Far from a surface the nearest voxel tells enough.
      value = field.phi[nearest] > kFree ? field.phi[nearest] : sample(grid, field.phi, g);
      if (before > 0 && value <= 0) {
        if (unread != kNone) before = field.phi[unread];
        const float hit = z_before + (z - z_before) * before / (before - value);
        if (field.support[nearestVoxel(grid, o + hit * r)] >= field.min_support) return hit;
      }
    }
    unread = skipped ? nearest : kNone;
    before = value;
    z_before = z;
    // Where the field is near 1 a surface is several voxels away: longer steps are safe.
    z += (value > kFree ? 2.f : 0.7f) * voxel;
  }
  return std::numeric_limits<float>::quiet_NaN();
}

}  // namespace

Field<std::uint8_t> surfaceSupport(const Histograms<std::uint8_t>& votes, int fill_radius, int threads) {
  if (fill_radius < 0) throw std::invalid_argument("surface: fill_radius must not be negative");
  const int nx = votes.nx, ny = votes.ny, nz = votes.nz, r = fill_radius;
  Field<std::uint8_t> support(static_cast<std::size_t>(nx) * ny * nz, 0);
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int z = 0; z < nz; ++z)
    failure.guard([&] {
      std::uint8_t* slice = &support[static_cast<std::size_t>(z) * nx * ny];
      for (int y = 0; y < ny; ++y)
        kernels::supportRow(votes.row(y, z), nx, nx, slice + static_cast<std::size_t>(y) * nx);
      if (r == 0) return;
      std::vector<std::uint8_t> rows(static_cast<std::size_t>(nx) * ny);
      for (int y = 0; y < ny; ++y)
        for (int x = 0; x < nx; ++x) {
          const std::uint8_t* row = slice + static_cast<std::size_t>(y) * nx;
          rows[static_cast<std::size_t>(y) * nx + x] =
              *std::max_element(row + std::max(0, x - r), row + std::min(nx, x + r + 1));
        }
      for (int y = 0; y < ny; ++y)
        for (int x = 0; x < nx; ++x) {
          std::uint8_t best = 0;
          for (int k = std::max(0, y - r); k <= std::min(ny - 1, y + r); ++k)
            best = std::max(best, rows[static_cast<std::size_t>(k) * nx + x]);
          slice[static_cast<std::size_t>(y) * nx + x] = best;
        }
    });
  failure.rethrow();
  return support;
}

cv::Mat castRays(const SurfaceField& field, const air_ground_common::CameraModel& camera,
                 const Eigen::Isometry3d& T_map_camera, int threads, cv::Mat* normals) {
  const VoxelGrid& grid = field.grid;
  if (grid.nx < 2 || grid.ny < 2 || grid.nz < 2)
    throw std::invalid_argument("ray casting: the grid needs 2 voxels a side");
  cv::Mat depth(camera.height, camera.width, CV_32F, cv::Scalar(std::numeric_limits<float>::quiet_NaN()));
  if (normals) *normals = cv::Mat::zeros(camera.height, camera.width, CV_32FC3);
  const FreeBlocks blocks(grid, field.phi, threads);
  const Eigen::Vector3d origin = (T_map_camera.translation() - grid.origin) / grid.voxel_size;
  const Eigen::Vector3f o = origin.cast<float>();
#pragma omp parallel for schedule(dynamic, 8) num_threads(threads)
  for (int v = 0; v < camera.height; ++v)
    for (int u = 0; u < camera.width; ++u) {
      // In voxel units, per metre of depth along the optical axis.
      const Eigen::Vector3d ray = T_map_camera.linear() *
                                  Eigen::Vector3d((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1) /
                                  grid.voxel_size;
      const auto range = clipToGrid(grid, origin, ray);
      if (!range) continue;
      const Eigen::Vector3f r = ray.cast<float>();
      const float hit = firstCrossing(field, blocks, o, r, range->cast<float>());
      depth.at<float>(v, u) = hit;
      if (!normals || std::isnan(hit)) continue;
      const Eigen::Vector3f n = gradient(grid, field.phi, o + hit * r);
      normals->at<cv::Vec3f>(v, u) = {n.x(), n.y(), n.z()};
    }
  return depth;
}

std::vector<SurfacePoint> extractSurface(const SurfaceField& field, int threads) {
  const VoxelGrid& grid = field.grid;
  std::vector<std::vector<SurfacePoint>> of_slice(grid.nz);
  const std::size_t strides[3] = {1, static_cast<std::size_t>(grid.nx), static_cast<std::size_t>(grid.nx) * grid.ny};
  const auto addCrossing = [&](int x, int y, int z, int axis, std::vector<SurfacePoint>* points) {
    const std::size_t i = grid.index(x, y, z), j = i + strides[axis];
    const std::uint8_t support = std::max(field.support[i], field.support[j]);
    if (support < field.min_support) return;
    const float here = field.phi[i], there = field.phi[j];
    Eigen::Vector3f g(x, y, z);
    g[axis] += here / (here - there);
    SurfacePoint point;
    point.position = (grid.origin + grid.voxel_size * g.cast<double>()).cast<float>();
    point.normal = gradient(grid, field.phi, g);
    point.support = support;
    points->push_back(point);
  };
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
  for (int z = 0; z < grid.nz; ++z)
    failure.guard([&] {
      std::vector<std::uint8_t> changes(grid.nx);
      for (int y = 0; y < grid.ny; ++y) {
        const float* u = &field.phi[grid.index(0, y, z)];
        kernels::signChanges(u, y + 1 < grid.ny ? u + strides[1] : u, z + 1 < grid.nz ? u + strides[2] : u, grid.nx,
                             changes.data());
        const auto changed = [](std::uint8_t axes) { return axes != 0; };
        for (auto at = changes.begin(); (at = std::find_if(at, changes.end(), changed)) != changes.end(); ++at)
          for (int axis = 0; axis < 3; ++axis)
            if (*at >> axis & 1) addCrossing(static_cast<int>(at - changes.begin()), y, z, axis, &of_slice[z]);
      }
    });
  failure.rethrow();
  std::vector<SurfacePoint> points;
  for (const auto& slice : of_slice) points.insert(points.end(), slice.begin(), slice.end());
  return points;
}

DepthMapViews::DepthMapViews(const std::vector<DepthMap>& maps, std::size_t first, const Settings& settings)
    : settings_(settings) {
  for (std::size_t k = 0; k < maps.size(); ++k) {
    const DepthMap& map = maps[(first + k) % maps.size()];
    const Eigen::Isometry3d T_camera_map = map.T_map_camera.inverse();
    views_.push_back({T_camera_map.linear().cast<float>(), T_camera_map.translation().cast<float>(),
                      static_cast<float>(map.camera.fx), static_cast<float>(map.camera.fy),
                      static_cast<float>(map.camera.cx), static_cast<float>(map.camera.cy), &map});
  }
}

DepthMapViews::Opinion DepthMapViews::ask(const Eigen::Vector3f& point) const {
  constexpr int kMost = 255;
  float residuals[kMost];
  int known = 0, moving = 0;
  float sum = 0, weights = 0;
  const float radius = static_cast<float>(settings_.radius), truncation = static_cast<float>(settings_.truncation);
  Opinion opinion;
  for (const View& view : views_) {
    const Eigen::Vector3f p = view.R * point + view.t;
    if (!(p.z() > 1e-3f)) continue;
    const float u = view.fx * p.x() / p.z() + view.cx + 0.5f, v = view.fy * p.y() / p.z() + view.cy + 0.5f;
    const cv::Mat& depth = view.map->depth;
    if (!(u >= 0 && v >= 0 && u < static_cast<float>(depth.cols) && v < static_cast<float>(depth.rows))) continue;
    const int iu = static_cast<int>(u), iv = static_cast<int>(v);
    const float residual = depth.ptr<float>(iv)[iu] - p.z();
    opinion.seen_past += residual >= truncation;
    if (!(std::abs(residual) < truncation)) continue;
    if (opinion.voices++ == 0) opinion.intensity = view.map->intensity.ptr<std::uint8_t>(iv)[iu];
    if (known < kMost) residuals[known++] = residual;
    if (!(std::abs(residual) < radius)) continue;
    const float s = residual / radius, weight = (1 - s * s) * (1 - s * s) * view.map->confidence.ptr<float>(iv)[iu];
    sum += weight * residual;
    weights += weight;
    ++moving;
  }
  const float most = static_cast<float>(settings_.max_shift);
  if (moving >= 2 && weights > 1e-6f) opinion.shift = std::clamp(sum / weights, -most, most);
  float deviations = 0;
  for (int i = 0; i < known; ++i)
    if (std::abs(residuals[i]) < radius) deviations += std::abs(residuals[i] - opinion.shift);
  // Of normal noise, from its mean magnitude; the shift is fitted to the same maps.
  constexpr float kSigmaPerMagnitude = 1.2533f;
  if (moving >= 2) {
    const float n = static_cast<float>(moving);
    opinion.deviation = kSigmaPerMagnitude * deviations / n * std::sqrt(n / (n - 1));
  }
  for (int i = 0; i < known; ++i)
    opinion.agreeing += std::abs(residuals[i] - opinion.shift) < static_cast<float>(settings_.agreement);
  return opinion;
}

}  // namespace dense_fusion
