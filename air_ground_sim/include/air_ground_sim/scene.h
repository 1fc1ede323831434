// A world ready to be rendered: Embree geometry and textures into which the light is baked.
#pragma once

#include <cstdint>
#include <vector>

#include "air_ground_sim/world.h"

struct RTCDeviceTy;
struct RTCSceneTy;

namespace air_ground_sim {

/// One level of a texture pyramid, RGBA bytes that hold the square root of the reflected light (A: luminance).
struct TextureLevel {
  const std::uint32_t* texels = nullptr;
  int width = 0, height = 0;
};

constexpr int kMaxLevels = 5;

struct PatchTexture {
  TextureLevel level[kMaxLevels];
  int levels = 1;
  float texel = 0.0025f;  ///< of level 0 [m]
};

/// What shading needs of a triangle: texture coordinates at vertex 0 and their change along both edges, unit normal.
struct TriangleShading {
  float s0, t0, su, tu, sv, tv;
  float nx, ny, nz;
  int patch;
};

/// Light arriving on static, matt surfaces does not depend on the camera: the key light's soft shadows and the
/// surrounding light are computed once per surface point and multiplied into the textures.
class Scene {
 public:
  explicit Scene(const World& world);
  ~Scene();
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  RTCSceneTy* embree() const { return scene_; }
  const std::vector<TriangleShading>& triangles() const { return triangles_; }
  const std::vector<PatchTexture>& textures() const { return textures_; }
  const air_ground_common::TriangleMesh& mesh() const { return mesh_; }
  float sky() const { return sky_; }
  const TextureLevel& skyMap() const { return sky_map_; }  ///< as World::sky_map, encoded as the textures; may be empty
  std::size_t texelCount() const { return texels_; }

 private:
  void buildGeometry();
  void bakeSky(const World& world);
  void bakePatch(const World& world, const Patch& patch, PatchTexture* texture,
                 std::vector<std::vector<std::uint32_t>>* storage) const;

  RTCDeviceTy* device_ = nullptr;
  RTCSceneTy* scene_ = nullptr;
  air_ground_common::TriangleMesh mesh_;
  std::vector<TriangleShading> triangles_;
  std::vector<PatchTexture> textures_;
  std::vector<std::vector<std::vector<std::uint32_t>>> storage_;  // levels of each patch
  std::size_t texels_ = 0;
  float sky_ = 0.5f;
  TextureLevel sky_map_;
  std::vector<std::uint32_t> sky_texels_;
};

}  // namespace air_ground_sim
