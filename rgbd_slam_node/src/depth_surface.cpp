#include "rgbd_slam/depth_surface.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/text.h"

namespace rgbd_slam {

using air_ground_common::CameraModel;
using air_ground_common::formatted;
using air_ground_common::Matrix6d;
using air_ground_common::Pose;
using air_ground_common::Vector6d;

namespace {

constexpr int kColumns = 80;               // of cells, about
constexpr double kMinKnown = 0.6;          // share of a cell's pixels with depth
constexpr float kMaxStep = 0.15f;          // of depth between neighbouring cells of one surface, relative
constexpr float kMaxBend = 0.03f;          // of inverse depth from cell to cell to cell, relative
constexpr float kMinCosine = 0.2f;         // between ray and normal: more grazing cells are left out
constexpr float kMinAgreement = 0.85f;     // cosine between normals of the same surface
constexpr double kTukey = 4;               // sigmas beyond which a distance does not count
constexpr double kGate = 0.01;             // of distances in the end, beside their noise [m]
constexpr double kConverged = 2e-5;        // step at which iterations end [m, rad]
constexpr double kNearlyConverged = 1e-3;  // pairs that come and go keep it from resting [m, rad]
constexpr int kMinPairs = 50;

/// Mean depth of a cell, by its inverse, which is linear over a plane; 0: unknown or an edge.
float meanDepth(const cv::Mat& depth, int u0, int v0, int edge) {
  float sum = 0, least = std::numeric_limits<float>::infinity(), most = 0;
  int count = 0;
  for (int v = v0; v < v0 + edge; ++v) {
    const float* row = depth.ptr<float>(v);
    for (int u = u0; u < u0 + edge; ++u) {
      if (!(row[u] > 0) || !std::isfinite(row[u])) continue;
      sum += 1 / row[u];
      least = std::min(least, row[u]);
      most = std::max(most, row[u]);
      ++count;
    }
  }
  if (count < kMinKnown * edge * edge || most - least > 2 * kMaxStep * least) return 0;
  return static_cast<float>(count) / sum;
}

}  // namespace

DepthSurface::DepthSurface(const CameraModel& camera, const cv::Mat& depth, const DepthModel& model,
                           const visual_frontend::RollingShutter& rows) {
  if (depth.type() != CV_32F || depth.cols != camera.width || depth.rows != camera.height)
    throw std::invalid_argument("DepthSurface: needs a CV_32F depth image of the camera's size");
  edge_ = std::max(1, camera.width / kColumns);
  columns_ = camera.width / edge_;
  rows_ = camera.height / edge_;
  cells_.assign(static_cast<std::size_t>(columns_) * rows_, {Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero(), 0});
  for (int r = 0; r < rows_; ++r) {
    for (int c = 0; c < columns_; ++c) {
      const float z = meanDepth(depth, c * edge_, r * edge_, edge_);
      if (!(z > model.min_range && z < model.max_range)) continue;
      const Eigen::Vector2d pixel(c * edge_ + 0.5 * (edge_ - 1), rowOfPixels(r));
      const Eigen::Vector3d p = rows.pointToMiddleRow(pixel.y(), z * camera.unproject(pixel).homogeneous());
      if (p.allFinite() && p.z() > 0) cells_[static_cast<std::size_t>(r) * columns_ + c].position = p.cast<float>();
    }
  }
  for (int r = 1; r + 1 < rows_; ++r) {
    for (int c = 1; c + 1 < columns_; ++c) {
      Cell& here = cells_[static_cast<std::size_t>(r) * columns_ + c];
      const Eigen::Vector3f &left = cell(c - 1, r).position, &right = cell(c + 1, r).position,
                            &above = cell(c, r - 1).position, &below = cell(c, r + 1).position;
      const float z = here.position.z();
      // Inverse depth is linear over a plane, however much it leans away.
      const auto bent = [z](const Eigen::Vector3f& p, const Eigen::Vector3f& q) {
        return !(p.z() > 0 && q.z() > 0 && std::abs(z / p.z() + z / q.z() - 2) < kMaxBend &&
                 std::abs(z / p.z() - z / q.z()) < 2 * kMaxStep);
      };
      if (!(z > 0) || bent(left, right) || bent(above, below)) continue;
      const Eigen::Vector3f normal = (below - above).cross(right - left).normalized();
      if (!(-normal.dot(here.position) > kMinCosine * here.position.norm())) continue;
      here.normal = normal;
      here.sigma = static_cast<float>(model.sigma(z));
      ++known_;
    }
  }
}

void DepthSurface::moveRows(const visual_frontend::RollingShutter& shift) {
  for (std::size_t i = 0; i < cells_.size(); ++i) {
    Cell& cell = cells_[i];
    if (cell.sigma > 0)
      cell.position = shift.pointToMiddleRow(rowOfPixels(static_cast<int>(i) / columns_), cell.position.cast<double>())
                          .cast<float>();
  }
}

void DepthSurface::recalibrate(const CameraModel& before, const CameraModel& better_known) {
  for (Cell& cell : cells_) {
    const auto pixel = before.project(cell.position.cast<double>());
    if (!(cell.sigma > 0) || !pixel) continue;
    const Eigen::Vector2d ray = better_known.unproject(*pixel);
    if (ray.allFinite()) cell.position = (cell.position.z() * ray.homogeneous()).cast<float>();
  }
}

double DepthSurface::area(const CameraModel& camera, const Cell& cell) const {
  const double z = cell.position.z();
  return edge_ * edge_ * z * z * z / (camera.fx * camera.fy * std::abs(cell.normal.dot(cell.position)));
}

const DepthSurface::Cell* DepthSurface::seenAt(const CameraModel& camera, const Eigen::Vector3d& p_camera) const {
  const auto pixel = camera.project(p_camera);
  if (!pixel) return nullptr;
  const int c = static_cast<int>(std::floor((pixel->x() + 0.5) / edge_)),
            r = static_cast<int>(std::floor((pixel->y() + 0.5) / edge_));
  if (c < 0 || r < 0 || c >= columns_ || r >= rows_) return nullptr;
  const Cell& seen = cell(c, r);
  return seen.sigma > 0 ? &seen : nullptr;
}

namespace {

/// Gauss-Newton system of the distances.
struct Normal {
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  double weights = 0, squares = 0, squared_range = 0;
  int pairs = 0;
};

/// At T_a_b; surfaces farther apart than `gate` [m] and their noise are not the same.
Normal build(const CameraModel& camera, const DepthSurface& a, const DepthSurface& b, const Pose& T_a_b, double gate) {
  Normal n;
  const Eigen::Matrix3d R_b_a = T_a_b.linear().transpose();
  for (const DepthSurface::Cell& from : b.cells()) {
    if (!(from.sigma > 0)) continue;
    const Eigen::Vector3d p = from.position.cast<double>(), p_a = T_a_b * p;
    const DepthSurface::Cell* onto = a.seenAt(camera, p_a);
    if (!onto) continue;
    const Eigen::Vector3d normal = onto->normal.cast<double>(), normal_b = R_b_a * normal;
    if (!(normal_b.dot(from.normal.cast<double>()) > kMinAgreement)) continue;
    const double distance = normal.dot(p_a - onto->position.cast<double>());
    // Noise lies along the rays; what of it is along the normal counts.
    const double along_a = normal.dot(onto->position.cast<double>().normalized()),
                 along_b = normal_b.dot(p.normalized());
    const double variance = std::pow(onto->sigma * along_a, 2) + std::pow(from.sigma * along_b, 2);
    const double share = distance * distance / std::max(gate * gate, variance * kTukey * kTukey);
    if (share >= 1) continue;
    ++n.pairs;
    const double weight = (1 - share) * (1 - share) / variance;
    Vector6d J;
    J << normal_b, p.cross(normal_b);
    n.H.noalias() += weight * J * J.transpose();
    n.g.noalias() += weight * distance * J;
    n.weights += weight;
    n.squares += weight * distance * distance;
    n.squared_range += weight * p.squaredNorm();
  }
  return n;
}

struct Information {
  Matrix6d H;
  Matrix6d pseudo_inverse;
};

/// What of the information is the surfaces' shape and not noise of their normals: noise alone points a little in every
/// direction.
Information significant(const Normal& n, double min_normal) {
  Vector6d unit = Vector6d::Ones();
  unit.tail<3>().setConstant(std::sqrt(n.weights / n.squared_range));
  const Matrix6d shape = unit.asDiagonal() * n.H * unit.asDiagonal();
  const auto eigen = air_ground_common::symmetricEigen(shape);
  Vector6d values = Vector6d::Zero(), inverses = Vector6d::Zero();
  for (int k = 0; k < 6; ++k) {
    if (eigen.values[k] < min_normal * min_normal * n.weights) continue;
    values[k] = eigen.values[k];
    inverses[k] = 1 / eigen.values[k];
  }
  const Matrix6d to = unit.cwiseInverse().asDiagonal() * eigen.vectors, from = unit.asDiagonal() * eigen.vectors;
  return {to * values.asDiagonal() * to.transpose(), from * inverses.asDiagonal() * from.transpose()};
}

/// (H^-1 + Q)^-1 for a singular H: H - H (H + Q^-1)^-1 H, with Q diagonal.
Matrix6d withFloor(const Matrix6d& H, const Vector6d& floor_sigma) {
  Matrix6d K = H;
  K.diagonal() += floor_sigma.cwiseAbs2().cwiseInverse();
  const Matrix6d information = H - H * air_ground_common::inverse(K) * H;
  return 0.5 * (information + information.transpose());
}

}  // namespace

SurfaceAlignment alignSurfaces(const CameraModel& camera, const DepthSurface& a, const DepthSurface& b,
                               const Pose& T_a_b_start, const SurfaceAlignmentSettings& settings) {
  SurfaceAlignment result;
  result.T_a_b = T_a_b_start;
  const double smaller = static_cast<double>(std::min(a.known(), b.known()));
  double gate = settings.max_distance;
  for (int i = 0; i <= settings.max_iterations; ++i) {
    const Normal n = build(camera, a, b, result.T_a_b, gate);
    if (n.pairs < std::max<double>(kMinPairs, settings.min_overlap * smaller) || !(n.weights > 0)) {
      result.reason = formatted("%d of %.0f cells of the surfaces meet", n.pairs, smaller);
      return result;
    }
    const Information known = significant(n, settings.min_normal);
    result.overlap = n.pairs / smaller;
    result.rms = std::sqrt(n.squares / n.pairs);
    Vector6d floor;
    floor << Eigen::Vector3d::Constant(settings.floor_sigma), Eigen::Vector3d::Constant(settings.floor_angle);
    result.information = withFloor(known.H / settings.dependence, floor);
    const Vector6d step = -known.pseudo_inverse * n.g;
    if (!step.allFinite()) break;
    const bool settled = gate <= kGate && step.norm() < kConverged;
    if (settled || i == settings.max_iterations) {
      result.success = settled || step.norm() < kNearlyConverged;
      break;
    }
    result.T_a_b.translation() += result.T_a_b.linear() * step.head<3>();
    result.T_a_b.linear() = result.T_a_b.linear() * air_ground_common::expSO3(step.tail<3>());
    result.T_a_b = air_ground_common::normalized(result.T_a_b);
    if (step.norm() < 0.1 * gate) gate = std::max(kGate, 0.4 * gate);
  }
  if (!result.success) result.reason = "the alignment of the surfaces does not come to rest";
  return result;
}

}  // namespace rgbd_slam
