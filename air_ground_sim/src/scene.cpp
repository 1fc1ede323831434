#include "air_ground_sim/scene.h"
#include "air_ground_common/first_exception.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "air_ground_sim/random.h"
#include "air_ground_sim/texture.h"

namespace air_ground_sim {
namespace {

// Normal of a patch at texture coordinates: the geometric one of flat patches, smooth over grids.
Eigen::Vector3f normalAt(const Patch& p, float u, float v) {
  const float hu = 0.5f / p.columns, hv = 0.5f / p.rows;
  const Eigen::Vector3f du = p.point(std::min(1.0f, u + hu), v) - p.point(std::max(0.0f, u - hu), v);
  const Eigen::Vector3f dv = p.point(u, std::min(1.0f, v + hv)) - p.point(u, std::max(0.0f, v - hv));
  const Eigen::Vector3f n = du.cross(dv);
  const float norm = n.norm();
  return norm > 0 ? Eigen::Vector3f(n / norm) : Eigen::Vector3f::UnitZ();
}

Eigen::Matrix3f basisAround(const Eigen::Vector3f& z) {
  Eigen::Matrix3f B;
  B.col(2) = z;
  B.col(0) = (std::abs(z.x()) < 0.8f ? Eigen::Vector3f::UnitX() : Eigen::Vector3f::UnitY()).cross(z).normalized();
  B.col(1) = z.cross(B.col(0));
  return B;
}

constexpr float kLampRadius = 0.07f;  // sine of half the angle under which the lamp is seen, 4 degrees
constexpr float kHemisphereRadius = 0.98f;

// Share of 16 rays from p that nothing stops within reach; stratified over a disc about the basis' z, of this sine of
// half angle.
float visible(RTCScene scene, const Eigen::Vector3f& p, const Eigen::Vector3f& n, const Eigen::Matrix3f& basis,
              float largest_radius, float reach, Rng* rng) {
  alignas(64) RTCRay16 rays;
  alignas(64) int valid[16];
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  for (int i = 0; i < 16; ++i) {
    const float a = (i % 4 + static_cast<float>(rng->uniform())) / 4,
                b = (i / 4 + static_cast<float>(rng->uniform())) / 4;
    const float radius = std::sqrt(a) * largest_radius, phi = 2 * static_cast<float>(M_PI) * b;
    const Eigen::Vector3f d =
        basis * Eigen::Vector3f(radius * std::cos(phi), radius * std::sin(phi), std::sqrt(1 - radius * radius));
    valid[i] = n.dot(d) > 0 ? -1 : 0;
    rays.org_x[i] = p.x();
    rays.org_y[i] = p.y();
    rays.org_z[i] = p.z();
    rays.dir_x[i] = d.x();
    rays.dir_y[i] = d.y();
    rays.dir_z[i] = d.z();
    rays.tnear[i] = 0;
    rays.tfar[i] = reach;
    rays.time[i] = 0;
    rays.mask[i] = ~0u;
    rays.id[i] = 0;
    rays.flags[i] = 0;
  }
  rtcOccluded16(valid, scene, &context, &rays);
  int count = 0;
  for (int i = 0; i < 16; ++i) count += valid[i] && rays.tfar[i] >= 0;
  return static_cast<float>(count) / 16;
}

// Light at a fraction of the texture's resolution: shadows of a lamp of some size have no finer detail.
cv::Mat bakeLight(RTCScene scene, const World& world, const Patch& patch, const cv::Size& size) {
  cv::Mat light(size, CV_32F);
  const Eigen::Matrix3f sun_basis = basisAround(world.sun);
#pragma omp parallel for schedule(dynamic, 4)
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x) {
      const float u = (x + 0.5f) / size.width, v = (y + 0.5f) / size.height;
      const Eigen::Vector3f n = normalAt(patch, u, v), p = patch.point(u, v) + 2e-3f * n;
      Rng rng(mix(patch.seed, static_cast<std::uint64_t>(y) * size.width + x));
      const float facing = std::max(0.0f, n.dot(world.sun));
      // Outer walls do not cast the key light's shadow into the room: the lamp hangs inside.
      const float sun =
          facing > 0 ? facing * visible(scene, p, n, sun_basis, kLampRadius, world.sun_reach, &rng) : 0.0f;
      const float surround = visible(scene, p, n, basisAround(n), kHemisphereRadius, world.ambient_reach, &rng);
      // A tenth of the light is reflected by the surroundings whatever stands in the way.
      light.at<float>(y, x) = world.ambient * (0.15f + 0.85f * surround) + (1 - world.ambient) * sun;
    }
  cv::GaussianBlur(light, light, {3, 3}, 0.7, 0.7, cv::BORDER_REPLICATE);  // Monte Carlo noise of the light
  return light;
}

}  // namespace

Scene::Scene(const World& world) : mesh_(meshOf(world)), sky_(world.sky) {
  buildGeometry();
  triangles_.reserve(mesh_.triangles.size());
  for (std::size_t i = 0; i < world.patches.size(); ++i) {
    const Patch& p = world.patches[i];
    const bool even = p.column_at.empty();
    for (int r = 0; r < p.rows; ++r)
      for (int c = 0; c < p.columns; ++c)
        for (int half = 0; half < 2 && !p.isHole(c, r); ++half) {
          const float cu = even ? 1.0f / p.columns : p.columnAt(c + 1) - p.columnAt(c),
                      cv = even ? 1.0f / p.rows : p.rowAt(r + 1) - p.rowAt(r);
          TriangleShading t;
          t.s0 = even ? c * cu : p.columnAt(c);
          t.t0 = even ? r * cv : p.rowAt(r);
          t.su = cu;
          t.tu = half ? cv : 0;  // triangle 0: (c,r) (c+1,r) (c+1,r+1); triangle 1: (c,r) (c+1,r+1) (c,r+1)
          t.sv = half ? 0 : cu;
          t.tv = cv;
          t.patch = static_cast<int>(i);
          const auto& tri = mesh_.triangles[triangles_.size()];
          const Eigen::Vector3f& a = mesh_.vertices[tri[0]];
          const Eigen::Vector3f n = (mesh_.vertices[tri[1]] - a).cross(mesh_.vertices[tri[2]] - a).normalized();
          t.nx = n.x();
          t.ny = n.y();
          t.nz = n.z();
          triangles_.push_back(t);
        }
  }
  if (!world.sky_map.empty()) bakeSky(world);
  textures_.resize(world.patches.size());
  storage_.resize(world.patches.size());
  // Large patches share their pixels among the threads, small ones are shared whole.
  const auto isLarge = [&](const Patch& p) { return p.width * p.height > 2e6f * p.texel * p.texel; };
  const int patches = static_cast<int>(world.patches.size());
  for (int i = 0; i < patches; ++i)
    if (isLarge(world.patches[i])) bakePatch(world, world.patches[i], &textures_[i], &storage_[i]);
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(dynamic, 4)
  for (int i = 0; i < patches; ++i) {
    failure.guard([&] {
      if (!isLarge(world.patches[i])) bakePatch(world, world.patches[i], &textures_[i], &storage_[i]);
    });
  }
  failure.rethrow();
  for (const auto& levels : storage_)
    for (const auto& level : levels) texels_ += level.size();
}

Scene::~Scene() {
  if (scene_) rtcReleaseScene(scene_);
  if (device_) rtcReleaseDevice(device_);
}

void Scene::buildGeometry() {
  device_ = rtcNewDevice("threads=1");
  if (!device_)
    throw std::runtime_error("Embree could not start (error " + std::to_string(rtcGetDeviceError(nullptr)) + ")");
  scene_ = rtcNewScene(device_);
  rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);  // no light leaks along shared edges
  RTCGeometry g = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* v = static_cast<float*>(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                        3 * sizeof(float), mesh_.vertices.size()));
  for (std::size_t i = 0; i < mesh_.vertices.size(); ++i)
    for (int k = 0; k < 3; ++k) v[3 * i + k] = mesh_.vertices[i][k];
  auto* t = static_cast<unsigned*>(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                           3 * sizeof(unsigned), mesh_.triangles.size()));
  for (std::size_t i = 0; i < mesh_.triangles.size(); ++i)
    for (int k = 0; k < 3; ++k) t[3 * i + k] = static_cast<unsigned>(mesh_.triangles[i][k]);
  rtcCommitGeometry(g);
  rtcAttachGeometry(scene_, g);
  rtcReleaseGeometry(g);
  rtcCommitScene(scene_);
}

void Scene::bakeSky(const World& world) {
  const cv::Mat& map = world.sky_map;
  sky_texels_.resize(map.total());
  for (int y = 0; y < map.rows; ++y)
    for (int x = 0; x < map.cols; ++x) {
      const auto& c = map.at<cv::Vec3b>(y, x);
      float l[4] = {0, 0, 0, 0};
      for (int k = 0; k < 3; ++k) l[k] = world.sky * std::pow(c[k] / 255.0f, 2.2f);
      l[3] = 0.30f * l[0] + 0.59f * l[1] + 0.11f * l[2];
      std::uint32_t texel = 0;
      for (int k = 0; k < 4; ++k)
        texel |= static_cast<std::uint32_t>(std::clamp(255.0f * std::sqrt(l[k]) + 0.5f, 0.0f, 255.0f)) << (8 * k);
      sky_texels_[static_cast<std::size_t>(y) * map.cols + x] = texel;
    }
  sky_map_ = {sky_texels_.data(), map.cols, map.rows};
}

void Scene::bakePatch(const World& world, const Patch& patch, PatchTexture* texture,
                      std::vector<std::vector<std::uint32_t>>* storage) const {
  const cv::Mat albedo = paintPatch(patch);
  const int w = albedo.cols, h = albedo.rows;
  texture->texel = patch.texel;

  cv::Mat full;
  cv::resize(bakeLight(scene_, world, patch, {std::max(2, w / patch.light_step), std::max(2, h / patch.light_step)}),
             full, {w, h}, 0, 0, cv::INTER_LINEAR);

  float linear[256];
  for (int i = 0; i < 256; ++i) linear[i] = std::pow(i / 255.0f, 2.2f);
  cv::Mat level(h, w, CV_8UC4);
#pragma omp parallel for schedule(static)
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const auto& a = albedo.at<cv::Vec3b>(y, x);
      const float l = full.at<float>(y, x);
      const float red = linear[a[0]] * world.tint[0], green = linear[a[1]] * world.tint[1],
                  blue = linear[a[2]] * world.tint[2];
      const float c[4] = {red * l, green * l, blue * l, (0.30f * red + 0.59f * green + 0.11f * blue) * l};
      auto& out = level.at<cv::Vec4b>(y, x);
      for (int k = 0; k < 4; ++k)
        out[k] = static_cast<std::uint8_t>(std::clamp(255.0f * std::sqrt(c[k]) + 0.5f, 0.0f, 255.0f));
    }
  texture->levels = 0;
  for (int i = 0; i < kMaxLevels; ++i) {
    storage->emplace_back(static_cast<std::size_t>(level.cols) * level.rows);
    for (int y = 0; y < level.rows; ++y)
      std::memcpy(storage->back().data() + static_cast<std::size_t>(y) * level.cols, level.ptr(y), 4u * level.cols);
    texture->level[i] = {storage->back().data(), level.cols, level.rows};
    texture->levels = i + 1;
    if (level.cols < 8 || level.rows < 8) break;
    cv::Mat smaller;
    cv::resize(level, smaller, {(level.cols + 1) / 2, (level.rows + 1) / 2}, 0, 0, cv::INTER_AREA);
    level = smaller;
  }
}

}  // namespace air_ground_sim
