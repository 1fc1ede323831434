// Triangle meshes and point clouds as plain data, PLY files, and ray casting against meshes with Embree.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace air_ground_common {

struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices;   ///< [m]
  std::vector<Eigen::Vector3i> triangles;  ///< indices into vertices, counter-clockwise seen from outside
  double area() const;                     ///< [m^2]
};

struct LabeledPoint {
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  ///< [m]
  Eigen::Matrix<std::uint8_t, 3, 1> rgb = Eigen::Matrix<std::uint8_t, 3, 1>::Zero();
  std::uint8_t source = 0;  ///< who saw it: 0 ground robot, 1 MAV
  /// Height from which on something that was seen hides what is above the point [m]; NaN: nothing does. Not in files.
  float hidden_from = std::numeric_limits<float>::quiet_NaN();
};

/// Binary little-endian PLY with x y z red green blue source. Written through a temporary file; throws
/// std::runtime_error.
void writePly(const std::string& path, const std::vector<LabeledPoint>& points);

/// Reads x y z and, where present, colours and `source` of a binary little-endian or ascii PLY. Throws
/// std::runtime_error.
std::vector<LabeledPoint> readPlyPoints(const std::string& path);

/// Binary little-endian PLY mesh. Throws std::runtime_error.
void writePly(const std::string& path, const TriangleMesh& mesh);
TriangleMesh readPlyMesh(const std::string& path);

struct RayHit {
  float distance;          ///< along the unit ray [m]
  int triangle;            ///< index into TriangleMesh::triangles
  Eigen::Vector2f uv;      ///< barycentric coordinates of vertices 1 and 2
  Eigen::Vector3f normal;  ///< unit geometric normal
};

/// Embree scene over one mesh. Queries are thread-safe.
class MeshScene {
 public:
  /// Throws std::invalid_argument for an empty mesh or an index out of range.
  explicit MeshScene(const TriangleMesh& mesh);
  ~MeshScene();
  MeshScene(MeshScene&&) noexcept;
  MeshScene& operator=(MeshScene&&) noexcept;

  std::optional<RayHit> cast(const Eigen::Vector3f& origin, const Eigen::Vector3f& direction,
                             float max_distance = 1e6f) const;
  /// As cast() for many rays from one point, in packets of eight: several times faster where neighbouring rays are
  /// alike. One entry a ray; triangle is -1, and the rest undefined, where nothing is hit.
  std::vector<RayHit> castMany(const Eigen::Vector3f& origin, const std::vector<Eigen::Vector3f>& directions,
                               float max_distance = 1e6f) const;
  bool occluded(const Eigen::Vector3f& origin, const Eigen::Vector3f& direction, float max_distance) const;
  /// Distance from a point to the nearest point of the surface [m]; max_distance when nothing is nearer.
  float distance(const Eigen::Vector3f& point, float max_distance) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace air_ground_common
