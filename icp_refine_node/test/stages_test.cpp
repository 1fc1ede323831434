// The stages of the chain one by one, and what a wrong configuration is told.
#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <random>
#include <set>
#include <sstream>

#include "icp_refine/icp.h"

namespace icp_refine {
namespace {

Cloud randomCloud(int n, unsigned seed, float size = 2) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<float> u(-size / 2, size / 2);
  Cloud out;
  for (int i = 0; i < n; ++i) {
    out.points.emplace_back(u(rng), u(rng), u(rng));
    out.normals.push_back(Eigen::Vector3f(u(rng), u(rng), u(rng)).normalized());
  }
  return out;
}

Cloud plane(int side, float spacing, float noise, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<float> n(0, noise > 0 ? noise : 1);
  Cloud out;
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) out.points.emplace_back(i * spacing, j * spacing, noise > 0 ? n(rng) : 0);
  }
  return out;
}

void apply(const std::string& name, const std::string& parameters, Cloud& cloud) {
  makeDataFilter(name, YAML::Load(parameters))->apply(cloud);
}

// Every point of the cloud by its squared distance in place and weighted normal, nearest first.
std::vector<std::pair<float, int>> bruteForce(const Cloud& cloud, const Eigen::Vector3f& point,
                                              const Eigen::Vector3f& normal, float weight) {
  std::vector<std::pair<float, int>> out;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    out.emplace_back(
        (cloud.points[i] - point).squaredNorm() + weight * weight * (cloud.normals[i] - normal).squaredNorm(), i);
  }
  std::sort(out.begin(), out.end());
  return out;
}

// Sizes about which leaves, and the levels of boxes above them, begin to be more than one.
TEST(NeighborSearch, TreesOfAnyHeightFindWhatAllPointsTell) {
  for (const int size : {1, 16, 17, 256, 257, 300, 4097, 9000}) {
    const Cloud cloud = randomCloud(size, 11), queries = randomCloud(20, 12, 3);
    const NeighborSearch place(cloud), both(cloud, 0.5f);
    for (std::size_t i = 0; i < queries.size(); ++i) {
      const Eigen::Vector3f &p = queries.points[i], &n = queries.normals[i];
      const auto by_place = bruteForce(cloud, p, n, 0);
      ASSERT_EQ(place.nearest(p, n, 10), by_place[0].second) << size;
      ASSERT_EQ(both.nearest(p, n, 10), bruteForce(cloud, p, n, 0.5f)[0].second) << size;
      std::vector<int> indices;
      std::vector<float> squared;
      place.nearestK(p, 12, indices, squared);
      ASSERT_EQ(indices.size(), std::min<std::size_t>(12, cloud.size()));
      for (std::size_t k = 0; k < indices.size(); ++k) ASSERT_EQ(indices[k], by_place[k].second) << size;
    }
    std::set<int> places;
    for (int k = 0; k < size; ++k) places.insert(place.pointAt(k));
    ASSERT_EQ(places.size(), cloud.size());
    ASSERT_EQ(*places.rbegin(), size - 1);
  }
}

// Steps that halve, as an alignment converges: most of the last ones need no search, and all find the nearest.
TEST(NeighborSearch, TracesOfMovingPointsChangeNothing) {
  const Cloud cloud = randomCloud(1000, 3), start = randomCloud(100, 4), directions = randomCloud(100, 5);
  for (const float weight : {0.f, 0.5f}) {
    const NeighborSearch tree(cloud, weight);
    for (const float max_distance : {0.03f, 0.1f, 1.f}) {
      for (std::size_t i = 0; i < start.size(); ++i) {
        NeighborSearch::Trace trace;
        Eigen::Vector3f point = start.points[i];
        for (float step = 0.2f; step > 1e-4f; step *= 0.5f) {
          point += step * (i % 2 ? 1.f : -1.f) * (directions.points[i] - Eigen::Vector3f::Constant(0.5f));
          const auto nearest = bruteForce(cloud, point, start.normals[i], weight)[0];
          const int expected = nearest.first < max_distance * max_distance ? nearest.second : -1;
          ASSERT_EQ(tree.nearest(point, start.normals[i], max_distance, trace), expected)
              << "step " << step << ", at most " << max_distance;
        }
      }
    }
  }
}

TEST(NeighborSearch, EqualsBruteForceWithAndWithoutNormals) {
  const Cloud queries = randomCloud(200, 2);
  for (const int points : {1, 15, 16, 17, 100, 1000}) {
    Cloud cloud = randomCloud(points, points);
    if (points == 1000) {  // a plane: splits of no width
      for (int i = 0; i < 500; ++i) cloud.points[i].z() = 0.25f;
    }
    for (const float weight : {0.f, 0.5f}) {
      const NeighborSearch tree(cloud, weight);
      for (std::size_t q = 0; q < queries.size(); ++q) {
        const auto all = bruteForce(cloud, queries.points[q], queries.normals[q], weight);
        const int expected = all[0].first < 0.3f * 0.3f ? all[0].second : -1;
        EXPECT_EQ(tree.nearest(queries.points[q], queries.normals[q], 0.3f), expected);
        if (weight > 0) continue;
        std::vector<int> indices;
        std::vector<float> squared;
        for (const float limit : {0.2f, std::numeric_limits<float>::infinity()}) {
          tree.nearestK(queries.points[q], 12, indices, squared, limit);
          std::size_t count = 0;
          while (count < all.size() && count < 12 && all[count].first < limit) ++count;
          ASSERT_EQ(indices.size(), count);
          for (std::size_t k = 0; k < count; ++k) EXPECT_NEAR(squared[k], all[k].first, 1e-6);
        }
      }
    }
  }
}

TEST(NeighborSearch, RefusesEmptyCloudsAndMissingNormals) {
  EXPECT_THROW(NeighborSearch(Cloud{}), std::invalid_argument);
  Cloud bare;
  bare.points.emplace_back(0, 0, 0);
  EXPECT_THROW(NeighborSearch(bare, 0.5f), std::invalid_argument);
}

TEST(DataFilters, VoxelGridAverages) {
  Cloud cloud;
  cloud.points = {{0.01f, 0.01f, 0.01f}, {0.03f, 0.03f, 0.03f}, {0.07f, 0.01f, 0.01f}, {-0.01f, 0.01f, 0.01f}};
  apply("VoxelGrid", "{leaf: 0.05}", cloud);
  ASSERT_EQ(cloud.size(), 3u);  // a negative coordinate is a cell of its own
  EXPECT_NEAR(cloud.points[0].x(), 0.02, 1e-6);
  Cloud sparse = cloud;
  apply("VoxelGrid", "{leaf: 0.05, min_points: 2}", sparse);
  EXPECT_TRUE(sparse.empty());
}

TEST(DataFilters, NormalsAreRightOnAPlaneAndInvalidElsewhere) {
  Cloud cloud = plane(30, 0.03f, 0.003f, 1);
  const std::size_t plane_points = cloud.size();
  for (int i = 0; i < 60; ++i) cloud.points.emplace_back(5 + 0.02f * i, 0, 0);  // a wire has no normal
  Cloud ball = randomCloud(300, 3, 0.3f);                                       // nor has a cloud
  for (const auto& p : ball.points) cloud.points.push_back(p + Eigen::Vector3f(0, 5, 0));
  cloud.points.emplace_back(20, 20, 20);  // nor a lonely point
  apply("SurfaceNormals", "{neighbors: 12, radius: 0.12, min_neighbors: 6, max_curvature: 0.05, min_width: 0.1}",
        cloud);
  std::size_t on_plane = 0, elsewhere = 0;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    if (cloud.points[i].x() < 1 && cloud.points[i].y() < 1) {
      ++on_plane;
      EXPECT_GT(cloud.normals[i].z(), 0.95);
      EXPECT_NEAR(cloud.normals[i].norm(), 1, 1e-4);
    } else {
      ++elsewhere;
    }
  }
  EXPECT_GT(on_plane, 0.97 * plane_points);
  EXPECT_LT(elsewhere, 15u);
}

TEST(DataFilters, SteepNormalsPointToTheFreeSide) {
  // A step: low for x < 0, high for x > 0, with its face at x = 0. The free side is -x.
  Cloud cloud;
  for (float y = 0; y < 1; y += 0.03f) {
    for (float x = -0.5f; x < 0; x += 0.03f) cloud.points.emplace_back(x, y, 0);
    for (float z = 0.03f; z < 0.5f; z += 0.03f) cloud.points.emplace_back(0, y, z);
    for (float x = 0.03f; x < 0.5f; x += 0.03f) cloud.points.emplace_back(x, y, 0.5f);
  }
  for (const bool top_seen : {true, false}) {  // a low camera sees the face, not the top
    Cloud seen = cloud;
    if (!top_seen) {
      std::vector<char> face_and_floor;
      for (const auto& p : seen.points) face_and_floor.push_back(p.x() < 0.02f);
      seen.keep(face_and_floor);
    }
    apply("SurfaceNormals", "{neighbors: 9, radius: 0.1, max_curvature: 0.02}", seen);
    apply("OrientNormals", "{}", seen);
    int faces = 0, right = 0;
    for (const auto& n : seen.normals) {
      if (std::abs(n.x()) < 0.9f) continue;
      ++faces;
      right += n.x() < 0;
    }
    EXPECT_GT(faces, 200);
    EXPECT_EQ(right, faces);
  }
}

TEST(DataFilters, StatisticalOutlierRemovesStragglers) {
  Cloud cloud = plane(30, 0.03f, 0.002f, 2);
  const std::size_t n = cloud.size();
  for (int i = 0; i < 10; ++i) cloud.points.emplace_back(0.1f * i, 0.4f, 0.3f + 0.1f * i);
  apply("StatisticalOutlier", "{neighbors: 6, stddev_factor: 3}", cloud);
  std::size_t stragglers = 0;
  for (const auto& p : cloud.points) stragglers += p.z() > 0.2f;
  EXPECT_EQ(stragglers, 0u);
  EXPECT_GT(cloud.size(), 0.97 * n);
}

TEST(DataFilters, NormalSpaceSamplingKeepsTheRareDirections) {
  Cloud cloud;
  for (int i = 0; i < 5000; ++i) {
    cloud.points.emplace_back(0.001f * i, 0, 0);
    cloud.normals.push_back(i % 50 ? Eigen::Vector3f::UnitZ() : Eigen::Vector3f::UnitX());  // 2 % steep
  }
  apply("NormalSpaceSampling", "{count: 400}", cloud);
  ASSERT_EQ(cloud.size(), 400u);
  int steep = 0;
  for (const auto& n : cloud.normals) steep += n.x() > 0.5f;
  EXPECT_EQ(steep, 100);  // all there are
}

TEST(DataFilters, AllSurviveAnEmptyCloud) {
  ASSERT_FALSE(dataFilterDocs().empty());
  for (const auto& doc : dataFilterDocs()) {
    Cloud empty;
    EXPECT_NO_THROW(apply(doc.name, "{}", empty)) << doc.name;
    EXPECT_TRUE(empty.empty());
  }
}

// Ten reading points above a floor of reference points, at known heights.
struct Heights {
  Heights(const std::vector<float>& heights) {
    for (std::size_t i = 0; i < heights.size(); ++i) {
      reference.points.emplace_back(i, 0, 0);
      reference.normals.push_back(Eigen::Vector3f::UnitZ());
      reading.points.emplace_back(i, 0, heights[i]);
      reading.normals.push_back(Eigen::Vector3f::UnitZ());
      matches.reference_index.push_back(static_cast<int>(i));
      matches.weights.push_back(1);
    }
  }
  std::vector<float> weights(const std::string& name, const std::string& parameters) {
    auto w = matches.weights;
    makeOutlierFilter(name, YAML::Load(parameters))->apply({reading, reference, matches}, w);
    return w;
  }
  Cloud reading, reference;
  Matches matches;
};

TEST(OutlierFilters, CauchyHalvesAtItsScale) {
  Heights h({0.f, 0.05f});
  const auto weights = h.weights("Cauchy", "{scale: 0.05}");
  EXPECT_NEAR(weights[0], 1, 1e-6);
  EXPECT_NEAR(weights[1], 0.5, 1e-6);
}

TEST(OutlierFilters, NormalAngleSeesTheSign) {
  Heights h({0, 0, 0});
  h.reading.normals[1] = Eigen::Vector3f(std::sin(0.7f), 0, std::cos(0.7f));
  h.reading.normals[2] = -Eigen::Vector3f::UnitZ();
  EXPECT_EQ(h.weights("NormalAngle", "{max: 0.6}"), (std::vector<float>{1, 0, 0}));
  EXPECT_EQ(h.weights("NormalAngle", "{max: 0.6, oriented: false}"), (std::vector<float>{1, 0, 1}));
  h.reading.normals.clear();
  EXPECT_THROW(h.weights("NormalAngle", "{}"), ConfigError);
}

TEST(OutlierFilters, NothingMatchedStaysNothing) {
  Heights h({0.1f, 0.2f});
  h.matches.reference_index = {-1, -1};
  h.matches.weights = {0, 0};
  ASSERT_FALSE(outlierFilterDocs().empty());
  for (const auto& doc : outlierFilterDocs()) {
    EXPECT_EQ(h.weights(doc.name, "{}"), (std::vector<float>{0, 0})) << doc.name;
  }
}

const char* kChain = R"(
reading_filters: [VoxelGrid, SurfaceNormals]
reference_filters: [{VoxelGrid: {leaf: 0.05}}, SurfaceNormals]
levels:
  - matcher: {KdTree: {max_distance: 0.3}}
    outlier_filters: [{NormalAngle: {max: 0.8}}]
    error_minimizer: PointToPlane
    checkers: [{Iterations: {max: 10}}]
)";

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

TEST(Chain, ErrorsNameTheCulprit) {
  EXPECT_NO_THROW(IcpChain::fromString(kChain));
  const std::vector<std::array<std::string, 3>> cases = {
      {"VoxelGrid: {leaf: 0.05}", "VoxelGird: {leaf: 0.05}", "VoxelGird"},
      {"leaf: 0.05", "leave: 0.05", "leave"},
      {"leaf: 0.05", "leaf: -1", "leaf"},
      {"leaf: 0.05", "leaf: big", "leaf"},
      {"leaf: 0.05", "leaf: .nan", "leaf"},
      {"KdTree", "Octree", "Octree"},
      {"NormalAngle", "NormalAngel", "NormalAngel"},
      {"max: 0.8", "max: 4", "max"},
      {"PointToPlane", "PointToPoint", "PointToPoint"},
      {"PointToPlane", "{PointToPlane: {dof: 5}}", "dof"},
      {"Iterations: {max: 10}", "Differential: {}", "Iterations"},
      {"Iterations: {max: 10}", "Forever: {}", "Forever"},
      {"outlier_filters", "outlier_filter", "outlier_filter"},
      {"reading_filters", "readingfilters", "readingfilters"},
      {"    error_minimizer: PointToPlane\n", "", "error_minimizer"},
      {"levels:", "steps:", "steps"},
  };
  for (const auto& [from, to, culprit] : cases) {
    try {
      IcpChain::fromString(replaced(kChain, from, to));
      ADD_FAILURE() << "accepted: " << to;
    } catch (const ConfigError& e) {
      EXPECT_NE(std::string(e.what()).find(culprit), std::string::npos) << e.what();
    }
  }
  EXPECT_THROW(IcpChain::fromString("{}"), ConfigError);
  EXPECT_THROW(IcpChain::fromString("[1, 2"), ConfigError);
  EXPECT_THROW(IcpChain::fromFile("/nonexistent.yaml"), ConfigError);
}

TEST(Chain, DeclarationsAreSound) {
  for (const auto& docs : {dataFilterDocs(), matcherDocs(), outlierFilterDocs(), errorMinimizerDocs(), checkerDocs()}) {
    for (const auto& stage : docs) {
      EXPECT_FALSE(stage.doc.empty()) << stage.name;
      for (const auto& p : stage.parameters) {
        EXPECT_FALSE(p.doc.empty()) << stage.name << "." << p.name;
        EXPECT_LE(p.min, p.default_value) << stage.name << "." << p.name;
        EXPECT_GE(p.max, p.default_value) << stage.name << "." << p.name;
      }
    }
  }
}

TEST(Chain, EveryStageIsDocumented) {
  std::ifstream file(AIR_GROUND_SOURCE_DIR "/docs/icp_refine.md");
  std::stringstream page;
  page << file.rdbuf();
  ASSERT_FALSE(page.str().empty());
  for (const auto& docs : {dataFilterDocs(), matcherDocs(), outlierFilterDocs(), errorMinimizerDocs(), checkerDocs()}) {
    for (const auto& stage : docs) {
      EXPECT_NE(page.str().find("`" + stage.name + "`"), std::string::npos)
          << stage.name << " is not in docs/icp_refine.md";
    }
  }
}

TEST(Chain, ShippedConfigLoads) {
  const YAML::Node config = YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml");
  ASSERT_TRUE(config["chain"]);
  EXPECT_NO_THROW(IcpChain{config["chain"]});
}

}  // namespace
}  // namespace icp_refine
