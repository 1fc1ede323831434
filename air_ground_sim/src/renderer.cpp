#include "air_ground_sim/renderer.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "air_ground_common/clones.h"
#include "air_ground_sim/random.h"

namespace air_ground_sim {
namespace {

constexpr int kLanes = 8;  // packets of 4 x 2 pixels

struct CameraPose {
  float R[9];  // row-major, world from camera
  float t[3];
};

CameraPose toFloat(const air_ground_common::Pose& T) {
  CameraPose c;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) c.R[3 * i + j] = static_cast<float>(T.linear()(i, j));
    c.t[i] = static_cast<float>(T.translation()[i]);
  }
  return c;
}

// A packet's lane i as a fresh ray; the length of `direction` is the unit of its parameter.
inline __attribute__((always_inline)) void setRay(const float origin[3], const float direction[3], float max_depth,
                                                  int i, RTCRayHit8* r) {
  r->ray.org_x[i] = origin[0];
  r->ray.org_y[i] = origin[1];
  r->ray.org_z[i] = origin[2];
  r->ray.dir_x[i] = direction[0];
  r->ray.dir_y[i] = direction[1];
  r->ray.dir_z[i] = direction[2];
  r->ray.tnear[i] = 0;
  r->ray.tfar[i] = max_depth;
  r->ray.time[i] = 0;
  r->ray.mask[i] = ~0u;
  r->ray.id[i] = 0;
  r->ray.flags[i] = 0;
  r->hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
}

inline __attribute__((always_inline)) void rotate(const float R[9], float x, float y, float z, float out[3]) {
  for (int k = 0; k < 3; ++k) out[k] = R[3 * k] * x + R[3 * k + 1] * y + R[3 * k + 2] * z;
}

// Sets up a packet's rays through normalised coordinates, its upper row seen from one pose, its lower from another;
// length along the optical axis is then the ray parameter.
inline void makeRays(const CameraPose& upper, const CameraPose& lower, const float* x, const float* y, float max_depth,
                     RTCRayHit8* r) {
  for (int i = 0; i < kLanes; ++i) {
    const CameraPose& pose = i < 4 ? upper : lower;
    float direction[3];
    rotate(pose.R, x[i], y[i], 1, direction);
    setRay(pose.t, direction, max_depth, i, r);
  }
}

// Bilinear lookup of all four channels; returns squares, for textures hold square roots.
inline void fetch(const TextureLevel& level, float s, float t, float out[4]) {
  const float x = std::clamp(s * level.width - 0.5f, 0.0f, static_cast<float>(level.width) - 1.001f);
  const float y = std::clamp(t * level.height - 0.5f, 0.0f, static_cast<float>(level.height) - 1.001f);
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float a = x - ix, b = y - iy;
  const std::uint32_t* p = level.texels + static_cast<std::size_t>(iy) * level.width + ix;
  const std::uint32_t q[4] = {p[0], p[1], p[level.width], p[level.width + 1]};
  const float w[4] = {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
  for (int c = 0; c < 4; ++c) {
    const int shift = 8 * c;
    const float v = w[0] * ((q[0] >> shift) & 255) + w[1] * ((q[1] >> shift) & 255) + w[2] * ((q[2] >> shift) & 255) +
                    w[3] * ((q[3] >> shift) & 255);
    out[c] = v * v * (1.0f / (255 * 255));
  }
}

struct LightJob {
  RTCScene scene;
  const TriangleShading* triangles;
  const PatchTexture* textures;
  const CameraPose* poses;  // one a sample, row after row
  int row_stride;           // poses from one row to the next; 0: all rows share theirs
  const float* rays;
  int width, height, samples, channels;
  float sky, footprint;
  TextureLevel sky_map;
  float* result;
};

// Light from where lane i of a packet met nothing.
__attribute__((noinline)) void skyLight(const LightJob& job, const RTCRayHit8& packet, int i, float texel[4]) {
  for (int c = 0; c < 4; ++c) texel[c] = job.sky;
  if (!job.sky_map.texels) return;
  const float dx = packet.ray.dir_x[i], dy = packet.ray.dir_y[i], dz = packet.ray.dir_z[i];
  const float norm = 0.5f / (std::abs(dx) + std::abs(dy) + std::max(dz, 0.0f) + 1e-6f);
  fetch(job.sky_map, dx * norm + 0.5f, dy * norm + 0.5f, texel);
}

// Light from the surface that lane i of a packet met.
inline __attribute__((always_inline)) void surfaceLight(const LightJob& job, const RTCRayHit8& packet, int i,
                                                        float texel[4]) {
  const TriangleShading& t = job.triangles[packet.hit.primID[i]];
  const PatchTexture& texture = job.textures[t.patch];
  const float u = packet.hit.u[i], v = packet.hit.v[i];
  const float dx = packet.ray.dir_x[i], dy = packet.ray.dir_y[i], dz = packet.ray.dir_z[i];
  const float length2 = dx * dx + dy * dy + dz * dz;
  const float facing = std::abs(t.nx * dx + t.ny * dy + t.nz * dz);
  // Between the footprint's short and long axis, which grows with 1 / cos.
  float size2 = packet.ray.tfar[i] * job.footprint / texture.texel;
  size2 *= size2 * length2 / std::max(0.2f * std::sqrt(length2), facing);
  int level = 0;
  while (size2 > 2.0f && level + 1 < texture.levels) {
    size2 *= 0.25f;
    ++level;
  }
  fetch(texture.level[level], t.s0 + u * t.su + v * t.sv, t.t0 + u * t.tu + v * t.tv, texel);
}

// Adds what the packet's rays met to the lanes' sums.
inline __attribute__((always_inline)) void addLight(const LightJob& job, const RTCRayHit8& packet,
                                                    float sum[kLanes][4]) {
  for (int i = 0; i < kLanes; ++i) {
    float texel[4];
    if (packet.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID)
      skyLight(job, packet, i, texel);
    else
      surfaceLight(job, packet, i, texel);
    for (int c = 0; c < 4; ++c) sum[i][c] += texel[c];
  }
}

// Writes the mean of a packet's samples; grey images take the luminance.
inline __attribute__((always_inline)) void writeLight(const LightJob& job, int x0, int y0, const float sum[kLanes][4]) {
  const float scale = 1.0f / job.samples;
  for (int i = 0; i < kLanes; ++i) {
    const std::size_t pixel = static_cast<std::size_t>(y0 + i / 4) * job.width + x0 + i % 4;
    if (job.channels == 1)
      job.result[pixel] = sum[i][3] * scale;
    else
      for (int c = 0; c < 3; ++c) job.result[3 * pixel + c] = sum[i][c] * scale;
  }
}

// Two image rows.
AIR_GROUND_CLONES void lightRows(const LightJob& job, int y0) {
  const int w = job.width;
  const std::size_t pixels = static_cast<std::size_t>(w) * job.height;
  alignas(32) RTCRayHit8 packet;
  alignas(32) int valid[kLanes];
  std::fill(valid, valid + kLanes, -1);
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  const CameraPose *upper = job.poses + static_cast<std::size_t>(y0) * job.row_stride, *lower = upper + job.row_stride;
  for (int x0 = 0; x0 < w; x0 += 4) {
    float sum[kLanes][4] = {};
    const std::size_t top = static_cast<std::size_t>(y0) * w + x0;
    for (int s = 0; s < job.samples; ++s) {
      float nx[kLanes], ny[kLanes];
      const float *px = job.rays + 2 * s * pixels + top, *py = job.rays + (2 * s + 1) * pixels + top;
      for (int i = 0; i < 4; ++i) {
        nx[i] = px[i];
        ny[i] = py[i];
        nx[4 + i] = px[w + i];
        ny[4 + i] = py[w + i];
      }
      makeRays(upper[s], lower[s], nx, ny, 1e6f, &packet);
      rtcIntersect8(valid, job.scene, &context, &packet);
      addLight(job, packet, sum);
    }
    writeLight(job, x0, y0, sum);
  }
}

// Directions of a panorama's rays are products of a column's and a row's part, jittered for each sample.
struct PanoramaJob {
  LightJob light;
  float R[9], t[3];
  const float *cos_azimuth, *sin_azimuth;      // samples x width; azimuth clockwise from the body's x axis
  const float *cos_elevation, *sin_elevation;  // samples x height
};

AIR_GROUND_CLONES void panoramaRows(const PanoramaJob& job, int y0) {
  const int w = job.light.width, h = job.light.height;
  alignas(32) RTCRayHit8 packet;
  alignas(32) int valid[kLanes];
  std::fill(valid, valid + kLanes, -1);
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  for (int x0 = 0; x0 < w; x0 += 4) {
    float sum[kLanes][4] = {};
    for (int s = 0; s < job.light.samples; ++s) {
      for (int i = 0; i < kLanes; ++i) {
        const int x = s * w + x0 + i % 4, y = s * h + y0 + i / 4;
        float direction[3];
        rotate(job.R, job.cos_elevation[y] * job.cos_azimuth[x], -job.cos_elevation[y] * job.sin_azimuth[x],
               job.sin_elevation[y], direction);
        setRay(job.t, direction, 1e6f, i, &packet);
      }
      rtcIntersect8(valid, job.light.scene, &context, &packet);
      addLight(job.light, packet, sum);
    }
    writeLight(job.light, x0, y0, sum);
  }
}

// Ray i of the packet, from a camera's point at depth z along d to the projector beside it; it starts off the surface
// on the camera's side.
void aimAtProjector(const CameraPose& pose, const float d[3], float z, float projector_offset, int i, RTCRay8* rays) {
  float* const org[3] = {rays->org_x, rays->org_y, rays->org_z};
  float* const dir[3] = {rays->dir_x, rays->dir_y, rays->dir_z};
  const float back = z - std::min(0.003f, 0.01f * z);
  for (int k = 0; k < 3; ++k) {
    org[k][i] = pose.t[k] + back * d[k];
    dir[k][i] = pose.t[k] + pose.R[3 * k] * projector_offset - org[k][i];
  }
  rays->tnear[i] = 0;
  rays->tfar[i] = 1;
  rays->time[i] = 0;
  rays->mask[i] = ~0u;
  rays->id[i] = rays->flags[i] = 0;
}

}  // namespace

Renderer::Renderer(const Scene& scene, const air_ground_common::CameraModel& camera, int samples, std::uint64_t seed)
    : scene_(scene), camera_(camera), samples_(samples) {
  camera.validate();
  if (samples < 1) throw std::invalid_argument("the renderer needs at least one sample a pixel");
  if (camera.width % 4 || camera.height % 2)
    throw std::invalid_argument("image width must be a multiple of 4, height of 2");
  const std::size_t pixels = static_cast<std::size_t>(camera.width) * camera.height;
  rays_.resize(pixels * samples * 2);
  centers_.resize(pixels * 2);
  // Strata: a grid of about sqrt(samples) a side; their order over time is shuffled for each pixel.
  const int side = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(samples))));
#pragma omp parallel for schedule(dynamic, 8)
  for (int y = 0; y < camera.height; ++y) {
    Rng rng(mix(seed, static_cast<std::uint64_t>(y)));
    std::vector<int> cells(static_cast<std::size_t>(side) * side);
    for (int x = 0; x < camera.width; ++x) {
      const std::size_t pixel = static_cast<std::size_t>(y) * camera.width + x;
      const Eigen::Vector2d c = camera.unproject({x, y});
      centers_[pixel] = static_cast<float>(c.x());
      centers_[pixels + pixel] = static_cast<float>(c.y());
      for (std::size_t i = 0; i < cells.size(); ++i) cells[i] = static_cast<int>(i);
      for (std::size_t i = cells.size() - 1; i > 0; --i)
        std::swap(cells[i], cells[rng.integer(static_cast<int>(i) + 1)]);
      for (int s = 0; s < samples; ++s) {
        const double dx = (cells[s] % side + rng.uniform()) / side - 0.5,
                     dy = (cells[s] / side + rng.uniform()) / side - 0.5;
        // Outside a fisheye's image circle any ray will do: the imager leaves those pixels dark.
        const Eigen::Vector2d seen = camera.unproject({x + dx, y + dy});
        const Eigen::Vector2d n = seen.allFinite() ? seen : Eigen::Vector2d::Zero();
        rays_[2 * s * pixels + pixel] = static_cast<float>(n.x());
        rays_[(2 * s + 1) * pixels + pixel] = static_cast<float>(n.y());
      }
    }
  }
}

void Renderer::light(const std::vector<air_ground_common::Pose>& T_world_camera, int channels,
                     std::vector<float>* result) const {
  const bool rolling = T_world_camera.size() != static_cast<std::size_t>(samples_);
  if (rolling && T_world_camera.size() != static_cast<std::size_t>(samples_) * camera_.height)
    throw std::invalid_argument("one camera pose a sample is needed, or as many for every row");
  if (channels != 1 && channels != 3) throw std::invalid_argument("channels must be 1 or 3");
  std::vector<CameraPose> poses;
  for (const auto& T : T_world_camera) poses.push_back(toFloat(T));
  result->resize(static_cast<std::size_t>(camera_.width) * camera_.height * channels);
  LightJob job;
  job.scene = scene_.embree();
  job.triangles = scene_.triangles().data();
  job.textures = scene_.textures().data();
  job.poses = poses.data();
  job.row_stride = rolling ? samples_ : 0;
  job.rays = rays_.data();
  job.width = camera_.width;
  job.height = camera_.height;
  job.samples = samples_;
  job.channels = channels;
  job.sky = scene_.sky();
  job.sky_map = scene_.skyMap();
  // A sample's footprint at distance 1, in metres: its share of a pixel.
  job.footprint = static_cast<float>(1.0 / (camera_.fx * std::sqrt(static_cast<double>(samples_))));
  job.result = result->data();
#pragma omp parallel for schedule(dynamic, 4)
  for (int y0 = 0; y0 < camera_.height; y0 += 2) lightRows(job, y0);
}

void Renderer::depth(const std::vector<air_ground_common::Pose>& T_world_camera, float projector_offset,
                     DepthImage* result) const {
  const int w = camera_.width, h = camera_.height;
  const bool rolling = T_world_camera.size() != 1;
  if (rolling && T_world_camera.size() != static_cast<std::size_t>(h))
    throw std::invalid_argument("one camera pose is needed, or one a row");
  std::vector<CameraPose> poses;
  for (const auto& T : T_world_camera) poses.push_back(toFloat(T));
  const std::size_t pixels = static_cast<std::size_t>(w) * h;
  result->width = w;
  result->height = h;
  result->depth.assign(pixels, 0.0f);
  result->cosine.assign(pixels, 0.0f);
  result->lit.assign(pixels, 0);
#pragma omp parallel for schedule(dynamic, 4)
  for (int y0 = 0; y0 < h; y0 += 2) {
    alignas(32) RTCRayHit8 packet;
    alignas(32) RTCRay8 shadow;
    alignas(32) int valid[kLanes];
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    const CameraPose& upper = poses[rolling ? y0 : 0];
    const CameraPose& lower = poses[rolling ? y0 + 1 : 0];
    for (int x0 = 0; x0 < w; x0 += 4) {
      const std::size_t top = static_cast<std::size_t>(y0) * w + x0;
      float nx[kLanes], ny[kLanes];
      for (int i = 0; i < kLanes; ++i) {
        const std::size_t pixel = top + (i < 4 ? i : w + i - 4);
        nx[i] = centers_[pixel];
        ny[i] = centers_[pixels + pixel];
        valid[i] = std::isfinite(nx[i]) ? -1 : 0;
      }
      makeRays(upper, lower, nx, ny, 1e6f, &packet);
      rtcIntersect8(valid, scene_.embree(), &context, &packet);
      for (int i = 0; i < kLanes; ++i) {
        valid[i] = packet.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID ? -1 : 0;
        if (!valid[i]) continue;
        const std::size_t pixel = top + (i < 4 ? i : w + i - 4);
        const TriangleShading& t = scene_.triangles()[packet.hit.primID[i]];
        const float d[3] = {packet.ray.dir_x[i], packet.ray.dir_y[i], packet.ray.dir_z[i]};
        const float z = packet.ray.tfar[i];
        result->depth[pixel] = z;
        result->cosine[pixel] =
            std::abs(t.nx * d[0] + t.ny * d[1] + t.nz * d[2]) / std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        aimAtProjector(i < 4 ? upper : lower, d, z, projector_offset, i, &shadow);
        result->lit[pixel] = 1;
      }
      if (projector_offset == 0) continue;
      rtcOccluded8(valid, scene_.embree(), &context, &shadow);
      for (int i = 0; i < kLanes; ++i)
        if (valid[i] && shadow.tfar[i] < 0) result->lit[top + (i < 4 ? i : w + i - 4)] = 0;
    }
  }
}

void renderPanorama(const Scene& scene, const air_ground_common::Pose& T_world_panorama, int width, int samples,
                    std::uint64_t seed, std::vector<float>* rgb) {
  if (width < 8 || width % 8) throw std::invalid_argument("a panorama's width must be a multiple of 8");
  if (samples < 1) throw std::invalid_argument("the renderer needs at least one sample a pixel");
  const int height = width / 2;
  rgb->resize(static_cast<std::size_t>(width) * height * 3);
  std::vector<float> cos_a, sin_a, cos_e, sin_e;
  Rng rng(seed);
  const int side = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(samples))));
  for (int s = 0; s < samples; ++s) {
    for (int x = 0; x < width; ++x) {
      const double a = ((x + (s % side + rng.uniform()) / side) / width - 0.5) * 2 * M_PI;
      cos_a.push_back(static_cast<float>(std::cos(a)));
      sin_a.push_back(static_cast<float>(std::sin(a)));
    }
    for (int y = 0; y < height; ++y) {
      const double e = (0.5 - (y + (s / side + rng.uniform()) / side) / height) * M_PI;
      cos_e.push_back(static_cast<float>(std::cos(e)));
      sin_e.push_back(static_cast<float>(std::sin(e)));
    }
  }
  PanoramaJob job;
  job.light.scene = scene.embree();
  job.light.triangles = scene.triangles().data();
  job.light.textures = scene.textures().data();
  job.light.width = width;
  job.light.height = height;
  job.light.samples = samples;
  job.light.channels = 3;
  job.light.sky = scene.sky();
  job.light.sky_map = scene.skyMap();
  job.light.footprint = static_cast<float>(2 * M_PI / width / std::sqrt(static_cast<double>(samples)));
  job.light.result = rgb->data();
  const CameraPose pose = toFloat(T_world_panorama);
  std::copy(pose.R, pose.R + 9, job.R);
  std::copy(pose.t, pose.t + 3, job.t);
  job.cos_azimuth = cos_a.data();
  job.sin_azimuth = sin_a.data();
  job.cos_elevation = cos_e.data();
  job.sin_elevation = sin_e.data();
#pragma omp parallel for schedule(dynamic, 4)
  for (int y0 = 0; y0 < height; y0 += 2) panoramaRows(job, y0);
}

}  // namespace air_ground_sim
