#include "air_ground_common/mesh.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <random>
#include <stdexcept>

namespace air_ground_common {
namespace {

// Axis-aligned box from the origin to (1, 2, 3), outward triangles.
TriangleMesh box() {
  TriangleMesh m;
  for (int i = 0; i < 8; ++i) m.vertices.emplace_back(i & 1 ? 1.f : 0.f, i & 2 ? 2.f : 0.f, i & 4 ? 3.f : 0.f);
  const int quads[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& q : quads) {
    m.triangles.emplace_back(q[0], q[1], q[2]);
    m.triangles.emplace_back(q[0], q[2], q[3]);
  }
  return m;
}

TEST(Mesh, RayHitsTheNearFaceWithOutwardNormal) {
  const MeshScene scene(box());
  const auto hit = scene.cast({0.5f, 1.f, 10.f}, {0, 0, -1});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->distance, 7.f, 1e-5f);
  EXPECT_NEAR(hit->normal.z(), 1.f, 1e-6f);
  EXPECT_FALSE(scene.cast({0.5f, 1.f, 10.f}, {0, 0, 1}));
  EXPECT_TRUE(scene.occluded({-1, 1, 1}, {1, 0, 0}, 5.f));
  EXPECT_FALSE(scene.occluded({-1, 1, 1}, {1, 0, 0}, 0.5f));
}

TEST(Mesh, PacketsOfRaysAgreeWithSingleRays) {
  const MeshScene scene(box());
  std::mt19937 rng(8);
  std::normal_distribution<float> n;
  const Eigen::Vector3f origin(-2.f, 1.2f, 1.1f);
  std::vector<Eigen::Vector3f> directions;
  for (int i = 0; i < 1003; ++i) directions.push_back(Eigen::Vector3f(n(rng) + 1, n(rng), n(rng)).normalized());
  for (const float reach : {1e6f, 2.2f}) {
    const std::vector<RayHit> hits = scene.castMany(origin, directions, reach);
    ASSERT_EQ(hits.size(), directions.size());
    int met = 0;
    for (std::size_t i = 0; i < hits.size(); ++i) {
      const auto single = scene.cast(origin, directions[i], reach);
      ASSERT_EQ(single.has_value(), hits[i].triangle >= 0) << i;
      if (!single) continue;
      ++met;
      EXPECT_NEAR(hits[i].distance, single->distance, 1e-5f);
      EXPECT_LT((hits[i].normal - single->normal).norm(), 1e-6f);
      EXPECT_EQ(hits[i].triangle, single->triangle);
    }
    EXPECT_GT(met, 30);
    EXPECT_LT(met, 900);
  }
}

TEST(Mesh, DistanceAgreesWithTheAnalyticBox) {
  const MeshScene scene(box());
  std::mt19937 rng(4);
  std::uniform_real_distribution<float> u(-2.f, 5.f);
  for (int i = 0; i < 500; ++i) {
    const Eigen::Vector3f p(u(rng), u(rng), u(rng));
    const Eigen::Vector3f upper(1, 2, 3), clamped = p.cwiseMax(0.f).cwiseMin(upper);
    float expected = (p - clamped).norm();
    if (expected == 0) expected = std::min(p.minCoeff(), (upper - p).minCoeff());
    EXPECT_NEAR(scene.distance(p, 100.f), expected, 1e-4f);
  }
  EXPECT_FLOAT_EQ(scene.distance({10, 1, 1}, 2.f), 2.f) << "capped at max_distance";
}

// Of readers and exporters: two corners in one place make a triangle a line.
TEST(Mesh, DistanceToTrianglesWithoutArea) {
  for (const Eigen::Vector3i& corners : {Eigen::Vector3i(0, 0, 1), Eigen::Vector3i(0, 1, 0), Eigen::Vector3i(1, 0, 0),
                                         Eigen::Vector3i(1, 1, 0), Eigen::Vector3i(1, 0, 1)}) {
    TriangleMesh line;
    line.vertices = {{0, 0, 0}, {0, 4, 0}};
    line.triangles = {corners};
    const MeshScene scene(line);
    EXPECT_NEAR(scene.distance({3, 1, 4}, 100), 5, 1e-5f) << corners.transpose() << ": beside";
    EXPECT_NEAR(scene.distance({3, -4, 0}, 100), 5, 1e-5f) << corners.transpose() << ": before";
    EXPECT_NEAR(scene.distance({0, 7, 4}, 100), 5, 1e-5f) << corners.transpose() << ": beyond";
  }
  TriangleMesh both = box();
  both.vertices.emplace_back(0.f, 0.f, 4.5f);
  both.vertices.emplace_back(0.f, 2.f, 4.5f);
  both.triangles.emplace_back(8, 8, 9);
  EXPECT_NEAR(MeshScene(both).distance({0.5f, 1.f, 4.f}, 100.f), std::sqrt(0.5f), 1e-5f);
}

TEST(Mesh, PlyRoundTripKeepsMeshAndLabels) {
  const std::string path = testing::TempDir() + "mesh_test.ply";
  writePly(path, box());
  const TriangleMesh mesh = readPlyMesh(path);
  EXPECT_EQ(mesh.triangles.size(), 12u);
  EXPECT_NEAR(mesh.area(), 2 * (2 + 3 + 6), 1e-6);
  std::vector<LabeledPoint> points(3);
  points[1].position = {1, 2, 3};
  points[1].rgb << 10, 20, 30;
  points[2].source = 1;
  writePly(path, points);
  const auto read = readPlyPoints(path);
  ASSERT_EQ(read.size(), 3u);
  EXPECT_EQ(read[1].position, points[1].position);
  EXPECT_EQ(read[1].rgb, points[1].rgb);
  EXPECT_EQ(read[2].source, 1);
  std::remove(path.c_str());
}

TEST(Mesh, RefusesBrokenInput) {
  EXPECT_THROW(MeshScene{TriangleMesh{}}, std::invalid_argument);
  TriangleMesh wild = box();
  wild.triangles[0][0] = 99;
  EXPECT_THROW(MeshScene{wild}, std::invalid_argument);
  const std::string path = testing::TempDir() + "broken.ply";
  std::ofstream(path) << "ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\nend_header\nab";
  EXPECT_THROW(readPlyPoints(path), std::runtime_error);
  std::remove(path.c_str());
  EXPECT_THROW(readPlyPoints(path), std::runtime_error);
  // Promises beyond the file's size, with and without anything to read; refused before memory is asked for.
  for (const char* element :
       {"element vertex 1000000000000000\n", "element vertex 1000000000000000\nproperty float x\n",
        "element other 3\nproperty double x\nelement vertex 2\nproperty uchar x\n"})
    for (const char* format : {"binary_little_endian", "ascii"}) {
      std::ofstream(path) << "ply\nformat " << format << " 1.0\n" << element << "end_header\n1 2";
      try {
        readPlyPoints(path);
        ADD_FAILURE() << "taken: " << format << ", " << element;
      } catch (const std::runtime_error& e) {
        EXPECT_NE(std::string(e.what()).find("promises"), std::string::npos) << e.what();
      }
    }
  std::remove(path.c_str());
  EXPECT_THROW(writePly("/nonexistent/x.ply", box()), std::runtime_error);
}

}  // namespace
}  // namespace air_ground_common
