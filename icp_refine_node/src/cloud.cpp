#include "icp_refine/cloud.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace icp_refine {

void Cloud::keep(const std::vector<char>& mask) {
  const bool with_normals = hasNormals();
  std::size_t n = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!mask[i]) continue;
    points[n] = points[i];
    if (with_normals) normals[n] = normals[i];
    ++n;
  }
  points.resize(n);
  normals.resize(with_normals ? n : 0);
}

void Cloud::select(const std::vector<int>& indices) {
  Cloud out;
  out.points.reserve(indices.size());
  for (int i : indices) out.points.push_back(points[i]);
  if (hasNormals()) {
    out.normals.reserve(indices.size());
    for (int i : indices) out.normals.push_back(normals[i]);
  }
  *this = std::move(out);
}

Cloud transformed(const Cloud& cloud, const Similarity& T) {
  const Eigen::Matrix3f R = T.R.cast<float>(), sR = (T.scale * T.R).cast<float>();
  const Eigen::Vector3f t = T.t.cast<float>();
  Cloud out;
  out.points.reserve(cloud.size());
  for (const auto& p : cloud.points) out.points.push_back(sR * p + t);
  if (cloud.hasNormals()) {
    out.normals.reserve(cloud.size());
    for (const auto& n : cloud.normals) out.normals.push_back(R * n);
  }
  return out;
}

Cloud transformed(const Cloud& cloud, const Pose& T) { return transformed(cloud, similarity(T)); }

Eigen::Vector3d middle(const Cloud& cloud) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const auto& p : cloud.points) sum += p.cast<double>();
  return sum / static_cast<double>(std::max<std::size_t>(1, cloud.size()));
}

std::size_t removeInvalid(Cloud& cloud) {
  std::vector<char> mask(cloud.size());
  std::size_t removed = 0;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const auto& p = cloud.points[i];
    // Beyond 1e6 m the coordinate is garbage, and would overflow the grids.
    mask[i] = p.allFinite() && p.cwiseAbs().maxCoeff() < 1e6f;
    removed += !mask[i];
  }
  if (removed) cloud.keep(mask);
  return removed;
}

std::uint64_t cellKey(const Eigen::Vector3f& p, float size) {
  constexpr std::int64_t kHalf = 1 << 20, kMask = (1 << 21) - 1;
  const auto cell = [size](float v) {
    return static_cast<std::uint64_t>((static_cast<std::int64_t>(std::floor(v / size)) + kHalf) & kMask);
  };
  return cell(p.x()) << 42 | cell(p.y()) << 21 | cell(p.z());
}

}  // namespace icp_refine
