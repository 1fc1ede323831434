#include "air_ground_sim/world.h"

#include <algorithm>
#include <cmath>

#include "air_ground_sim/random.h"

namespace air_ground_sim {

Patch rectanglePatch(const Eigen::Vector3d& origin, const Eigen::Vector3d& u, const Eigen::Vector3d& v) {
  Patch p;
  p.vertices = {origin.cast<float>(), (origin + u).cast<float>(), (origin + v).cast<float>(),
                (origin + u + v).cast<float>()};
  p.width = static_cast<float>(u.norm());
  p.height = static_cast<float>(v.norm());
  return p;
}

Material floorMaterial(FloorStyle style) {
  switch (style) {
    case FloorStyle::kPlanks:
      return Material::kPlanks;
    case FloorStyle::kTiles:
      return Material::kTiles;
    case FloorStyle::kGravel:
      return Material::kGravel;
    case FloorStyle::kPlain:
      return Material::kPlain;
    case FloorStyle::kConcrete:
      break;
  }
  return Material::kConcrete;
}

Eigen::Vector3f Patch::point(float u, float v) const {
  if (!column_at.empty()) {  // uneven grids are flat rectangles
    const Eigen::Vector3f &a = vertices.front(), &b = vertices[columns],
                          &c = vertices[static_cast<std::size_t>(rows) * (columns + 1)];
    return a + u * (b - a) + v * (c - a);
  }
  const float x = u * columns, y = v * rows;
  const int ix = std::clamp(static_cast<int>(x), 0, columns - 1), iy = std::clamp(static_cast<int>(y), 0, rows - 1);
  const float a = x - ix, b = y - iy;
  const Eigen::Vector3f* p = &vertices[iy * (columns + 1) + ix];
  return (1 - b) * ((1 - a) * p[0] + a * p[1]) + b * ((1 - a) * p[columns + 1] + a * p[columns + 2]);
}

void addCuboid(const Cuboid& c, double texel, World* world) {
  const Eigen::Vector3d h(0.5 * c.size.x(), 0.5 * c.size.y(), c.size.z());
  const auto at = [&](double x, double y, double z) -> Eigen::Vector3d {
    return c.T_world_base * Eigen::Vector3d(x * h.x(), y * h.y(), z * h.z());
  };
  // Each face: origin, end of columns, end of rows; columns x rows points outwards.
  const Eigen::Vector3d faces[6][3] = {
      {at(-1, -1, 1), at(1, -1, 1), at(-1, 1, 1)},  {at(-1, 1, 0), at(1, 1, 0), at(-1, -1, 0)},
      {at(-1, -1, 0), at(1, -1, 0), at(-1, -1, 1)}, {at(1, 1, 0), at(-1, 1, 0), at(1, 1, 1)},
      {at(1, -1, 0), at(1, 1, 0), at(1, -1, 1)},    {at(-1, 1, 0), at(-1, -1, 0), at(-1, 1, 1)}};
  for (int i = 0; i < 6; ++i) {
    Patch p = rectanglePatch(faces[i][0], faces[i][1] - faces[i][0], faces[i][2] - faces[i][0]);
    p.material = c.material;
    p.printed = c.printed && i != 1;
    p.top = i == 0;
    p.texel = static_cast<float>(i == 1 ? 8 * texel : texel);
    p.seed = mix(c.seed, i);
    p.object = c.seed;
    world->patches.push_back(p);
  }
}

air_ground_common::TriangleMesh meshOf(const World& world) {
  air_ground_common::TriangleMesh mesh;
  for (const Patch& p : world.patches) {
    const int base = static_cast<int>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), p.vertices.begin(), p.vertices.end());
    for (int r = 0; r < p.rows; ++r)
      for (int c = 0; c < p.columns; ++c) {
        if (p.isHole(c, r)) continue;
        const int i = base + r * (p.columns + 1) + c, below = i + p.columns + 1;
        mesh.triangles.emplace_back(i, i + 1, below + 1);
        mesh.triangles.emplace_back(i, below + 1, below);
      }
  }
  return mesh;
}

}  // namespace air_ground_sim
