#include "icp_refine/data_filters.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "air_ground_common/first_exception.h"
#include "icp_refine/neighbor_search.h"
#include "key_table.h"
#include "registry.h"

namespace icp_refine {
namespace {

// One point a cell, at the mean of the cell's points; cells in the order of their first point, so that it is
// deterministic.
class VoxelGrid : public DataFilter {
 public:
  explicit VoxelGrid(const StageParameters& p) : leaf_(p("leaf")), min_points_(static_cast<int>(p("min_points"))) {}
  void apply(Cloud& cloud) const override {
    struct Cell {
      Eigen::Vector3f sum = Eigen::Vector3f::Zero(), normal = Eigen::Vector3f::Zero();
      int count = 0;
    };
    const bool normals = cloud.hasNormals();
    KeyTable index;
    std::vector<Cell> cells;
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      const auto number = static_cast<std::size_t>(index.insert(cellKey(cloud.points[i], leaf_)));
      if (number == cells.size()) cells.emplace_back();
      Cell& cell = cells[number];
      cell.sum += cloud.points[i];
      if (normals) cell.normal += cloud.normals[i];
      ++cell.count;
    }
    Cloud out;
    for (const auto& cell : cells) {
      if (cell.count < min_points_ || (normals && cell.normal.norm() < 1e-3f)) continue;
      out.points.push_back(cell.sum / static_cast<float>(cell.count));
      if (normals) out.normals.push_back(cell.normal.normalized());
    }
    cloud = std::move(out);
  }

 private:
  float leaf_;
  int min_points_;
};

// Neighbours of one point of a cloud after the other: those of the last one bound the search for the next.
class NeighborWalk {
 public:
  NeighborWalk(const Cloud& cloud, const NeighborSearch& tree, int count, float max_distance)
      : cloud_(cloud), tree_(tree), count_(count), max_distance_(max_distance) {}

  void at(int i) {
    float reach = max_distance_;
    // All `count` neighbours of the last point lie within this of the present one.
    if (static_cast<int>(squared.size()) == count_) {
      const float around_last = std::sqrt(squared.back()) + (cloud_.points[i] - cloud_.points[last_]).norm();
      reach = std::min(reach, around_last * 1.0001f + 1e-6f);
    }
    last_ = i;
    tree_.nearestK(cloud_.points[i], count_, index, squared, reach * reach);
  }
  std::vector<int> index;
  std::vector<float> squared;

 private:
  const Cloud& cloud_;
  const NeighborSearch& tree_;
  int count_;
  float max_distance_;
  int last_ = 0;
};

// job(i, neighbours) for every point i of the cloud, in the tree's order: each is near to the one before.
template <class Job>
void forNeighbors(const Cloud& cloud, int count, float max_distance, const Job& job) {
  Cloud bare;
  bare.points = cloud.points;
  const NeighborSearch tree(bare);
  const int n = static_cast<int>(cloud.size());
  constexpr int kBlock = 512;  // points that one thread walks through
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(dynamic, 1)  // a thread may have to share its core
  for (int begin = 0; begin < n; begin += kBlock)
    failure.guard([&] {
      NeighborWalk near(cloud, tree, count, max_distance);
      for (int k = begin; k < std::min(n, begin + kBlock); ++k) {
        const int i = tree.pointAt(k);
        near.at(i);
        job(i, near);
      }
    });
  failure.rethrow();
}

// Principal component analysis of the neighbourhood. A normal is valid when enough neighbours are near, they do not lie
// on a line, and they lie on a plane: points without a valid normal are removed, because they pull the pose away.
class SurfaceNormals : public DataFilter {
 public:
  explicit SurfaceNormals(const StageParameters& p)
      : neighbors_(static_cast<int>(p("neighbors"))),
        radius_(p("radius")),
        min_neighbors_(static_cast<int>(p("min_neighbors"))),
        max_curvature_(p("max_curvature")),
        min_width_(p("min_width")) {}

  void apply(Cloud& cloud) const override {
    if (cloud.empty()) return;
    std::vector<Eigen::Vector3f> normals(cloud.size(), Eigen::Vector3f::UnitZ());
    std::vector<char> valid(cloud.size());
    forNeighbors(cloud, neighbors_, radius_,
                 [&](int i, const NeighborWalk& near) { valid[i] = normal(cloud, near.index, normals[i]); });
    cloud.normals = std::move(normals);
    cloud.keep(valid);
  }

 private:
  bool normal(const Cloud& cloud, const std::vector<int>& index, Eigen::Vector3f& out) const {
    if (static_cast<int>(index.size()) < min_neighbors_) return false;
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (int k : index) mean += cloud.points[k].cast<double>();
    mean /= static_cast<double>(index.size());
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (int k : index) {
      const Eigen::Vector3d d = cloud.points[k].cast<double>() - mean;
      covariance += d * d.transpose();
    }
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
    solver.computeDirect(covariance);
    const Eigen::Vector3d values = solver.eigenvalues().cwiseMax(0);
    const double sum = values.sum();
    if (!(sum > 0) || values[0] > max_curvature_ * sum || values[1] < min_width_ * values[2]) return false;
    out = solver.eigenvectors().col(0).cast<float>();
    if (!out.allFinite() || std::abs(out.norm() - 1) > 1e-3f) return false;
    if (out.z() < 0) out = -out;
    return true;
  }

  int neighbors_;
  float radius_;
  int min_neighbors_;
  double max_curvature_, min_width_;
};

// Turns normals to the free side without knowing the viewpoint: surfaces seen from above point up; a steep face points
// to where the cloud is lower. Where nothing was seen (behind a face) it counts as solid.
class OrientNormals : public DataFilter {
 public:
  explicit OrientNormals(const StageParameters& p)
      : cell_(p("cell")), reach_(p("reach")), steep_(std::cos(p("steep"))) {}
  void apply(Cloud& cloud) const override {
    if (cloud.empty()) return;
    if (!cloud.hasNormals()) throw ConfigError("OrientNormals needs normals: put SurfaceNormals before it");
    KeyTable columns;
    std::vector<float> tops;
    for (const auto& p : cloud.points) {
      const auto k = static_cast<std::size_t>(columns.insert(column(p)));
      if (k == tops.size())
        tops.push_back(p.z());
      else
        tops[k] = std::max(tops[k], p.z());
    }
    const auto height = [&](const Eigen::Vector3f& p, float unseen) {
      const int k = columns.find(column(p));
      return k < 0 ? unseen : tops[static_cast<std::size_t>(k)];
    };
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      auto& n = cloud.normals[i];
      if (n.z() < 0) n = -n;
      if (n.z() > steep_) continue;
      const Eigen::Vector3f side = Eigen::Vector3f(n.x(), n.y(), 0).normalized();
      float front = 0, back = 0;
      for (int k = 1; k <= 2; ++k) {
        front += height(cloud.points[i] + 0.5f * k * reach_ * side, cloud.points[i].z());
        back += height(cloud.points[i] - 0.5f * k * reach_ * side, cloud.points[i].z());
      }
      if (front > back) n = -n;
    }
  }

 private:
  std::uint64_t column(const Eigen::Vector3f& p) const { return cellKey({p.x(), p.y(), 0}, cell_); }

  float cell_, reach_, steep_;
};

class StatisticalOutlier : public DataFilter {
 public:
  explicit StatisticalOutlier(const StageParameters& p)
      : neighbors_(static_cast<int>(p("neighbors"))), factor_(p("stddev_factor")) {}
  void apply(Cloud& cloud) const override {
    if (static_cast<int>(cloud.size()) <= neighbors_) return;
    const int n = static_cast<int>(cloud.size());
    std::vector<double> mean_distance(n);
    forNeighbors(cloud, neighbors_ + 1, std::numeric_limits<float>::infinity(), [&](int i, const NeighborWalk& near) {
      double sum = 0;
      for (float d : near.squared) sum += std::sqrt(d);
      mean_distance[i] = sum / neighbors_;
    });
    double sum = 0, sum2 = 0;
    for (double d : mean_distance) sum += d, sum2 += d * d;
    const double mean = sum / n, stddev = std::sqrt(std::max(0.0, sum2 / n - mean * mean));
    std::vector<char> mask(n);
    for (int i = 0; i < n; ++i) mask[i] = mean_distance[i] <= mean + factor_ * stddev;
    cloud.keep(mask);
  }

 private:
  int neighbors_;
  double factor_;
};

std::vector<int> randomSubset(std::size_t size, std::size_t count, std::uint32_t seed) {
  std::vector<int> indices(size);
  std::iota(indices.begin(), indices.end(), 0);
  std::mt19937 rng(seed);
  // Fisher-Yates by hand: std::shuffle's sequence is not the same in every standard library.
  for (std::size_t i = 0; i < count; ++i) std::swap(indices[i], indices[i + rng() % (size - i)]);
  indices.resize(count);
  std::sort(indices.begin(), indices.end());
  return indices;
}

// Rusinkiewicz 2001: as many points from each direction of the normals, so that the few steep faces, which alone fix x,
// y and yaw, are not outvoted by the floor.
class NormalSpaceSampling : public DataFilter {
 public:
  explicit NormalSpaceSampling(const StageParameters& p)
      : count_(static_cast<std::size_t>(p("count"))), seed_(static_cast<std::uint32_t>(p("seed"))) {}
  void apply(Cloud& cloud) const override {
    if (cloud.size() <= count_) return;
    if (!cloud.hasNormals()) throw ConfigError("NormalSpaceSampling needs normals: put SurfaceNormals before it");
    // 3 bands of elevation (steep, slanted, flat) by 8 of azimuth, one bin for flat.
    std::vector<std::vector<int>> bins(17);
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      const auto& n = cloud.normals[i];
      const float z = std::abs(n.z());
      const int azimuth = static_cast<int>((std::atan2(n.y(), n.x()) + M_PI) / (2 * M_PI) * 7.999);
      bins[z > 0.9f ? 16 : azimuth + (z > 0.5f ? 8 : 0)].push_back(static_cast<int>(i));
    }
    // Smallest bins first: what they cannot fill is shared by the larger ones.
    std::sort(bins.begin(), bins.end(),
              [](const auto& a, const auto& b) { return a.size() != b.size() ? a.size() < b.size() : a < b; });
    std::vector<int> chosen;
    for (std::size_t b = 0; b < bins.size(); ++b) {
      const std::size_t share = (count_ - chosen.size()) / (bins.size() - b);
      if (bins[b].empty()) continue;
      for (int k : randomSubset(bins[b].size(), std::min(share, bins[b].size()), seed_)) chosen.push_back(bins[b][k]);
    }
    std::sort(chosen.begin(), chosen.end());
    cloud.select(chosen);
  }

 private:
  std::size_t count_;
  std::uint32_t seed_;
};

template <class T>
std::unique_ptr<DataFilter> make(const StageParameters& p) {
  return std::make_unique<T>(p);
}

const std::vector<StageEntry<std::unique_ptr<DataFilter>>>& table() {
  static const std::vector<StageEntry<std::unique_ptr<DataFilter>>> entries = {
      {{"VoxelGrid",
        "One point a cell, the mean of the points in it",
        {{"leaf", "edge of a cell [m]", 0.03, 1e-3, 100},
         {"min_points", "cells with fewer points are dropped", 1, 1, 1e6}}},
       make<VoxelGrid>},
      {{"SurfaceNormals",
        "Normals by principal components of the neighbourhood; points without a valid normal are removed",
        {{"neighbors", "nearest points used, the point itself included", 15, 4, 200},
         {"radius", "and no farther than this [m]", 0.15, 1e-3, 100},
         {"min_neighbors", "fewer make the normal invalid", 7, 3, 200},
         {"max_curvature", "largest share of the smallest eigenvalue in their sum (0 plane, 1/3 ball)", 0.08, 0, 0.34},
         {"min_width", "smallest ratio of the middle to the largest eigenvalue (0 line, 1 disc)", 0.1, 0, 1}}},
       make<SurfaceNormals>},
      {{"OrientNormals",
        "Points normals to the free side: up, or for steep faces to where the cloud is lower",
        {{"cell", "edge of a height cell [m]", 0.06, 1e-3, 10},
         {"reach", "how far before and behind the face heights are compared [m]", 0.2, 1e-3, 10},
         {"steep", "a face is steep when its normal is farther than this from vertical [rad]", 0.8, 0, 1.6}}},
       make<OrientNormals>},
      {{"StatisticalOutlier",
        "Removes points whose mean distance to their neighbours is unusually large",
        {{"neighbors", "neighbours averaged", 8, 1, 200},
         {"stddev_factor", "limit: mean + this times the standard deviation, over the cloud", 2, 0, 100}}},
       make<StatisticalOutlier>},
      {{"NormalSpaceSampling",
        "Random subset with all directions of normals equally present",
        {{"count", "points kept", 5000, 1, 1e9}, {"seed", "seed of the random numbers", 1, 0, 4e9}}},
       make<NormalSpaceSampling>},
  };
  return entries;
}

}  // namespace

std::vector<StageDoc> dataFilterDocs() { return docsOf(table()); }

std::unique_ptr<DataFilter> makeDataFilter(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(table(), "data filter", name, parameters);
}

}  // namespace icp_refine
