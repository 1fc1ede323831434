#include "air_ground_common/map_correction.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace air_ground_common {
namespace {

constexpr double kLeastWeight = 1e-6;

Eigen::Matrix3d nearestRotation(const Eigen::Matrix3d& m) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d d(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant());
  return svd.matrixU() * d.asDiagonal() * svd.matrixV().transpose();
}

}  // namespace

CloudCorrections correctionsSince(const CloudCorrections& before, const CloudCorrections& now) {
  CloudCorrections since;
  for (const auto& [stamp, S] : now) {
    const auto it = before.find(stamp);
    if (it == before.end() || !S)
      since.emplace(stamp, S);
    else
      since.emplace(stamp, it->second ? std::make_optional(compose(*S, inverse(*it->second))) : std::nullopt);
  }
  return since;
}

std::optional<Pose> poseOfImage(const PosesByStamp& poses, std::int64_t stamp) {
  constexpr std::int64_t kTolerance = 1000;
  const auto it = poses.lower_bound(stamp - kTolerance);
  if (it == poses.end() || it->first > stamp + kTolerance) return std::nullopt;
  return it->second;
}

MapCorrection::MapCorrection(const PosesByStamp& then, const PosesByStamp& now) {
  for (const auto& [stamp, T] : then)
    if (const auto T_now = poseOfImage(now, stamp)) cameras_.push_back({T, *T_now});
}

LocalCorrection MapCorrection::around(const Eigen::Vector3d& centre, double radius) const {
  constexpr double kTooNear = 0.05;  // spread of the cameras over the radius at which half of a change of scale counts
  LocalCorrection out;
  if (cameras_.empty()) return out;
  double nearest = std::numeric_limits<double>::infinity();
  for (const Camera& c : cameras_) nearest = std::min(nearest, (c.then.translation() - centre).squaredNorm());
  std::vector<std::pair<const Camera*, double>> weighed;  // a map has tens of thousands, its surroundings a few
  const double farthest = nearest - 2 * radius * radius * std::log(kLeastWeight);
  double sum = 0;
  Eigen::Vector3d middle_then = Eigen::Vector3d::Zero(), middle_now = Eigen::Vector3d::Zero();
  Eigen::Matrix3d turn = Eigen::Matrix3d::Zero();
  for (const Camera& c : cameras_) {
    const double d2 = (c.then.translation() - centre).squaredNorm();
    if (d2 > farthest) continue;
    const double weight = std::exp((nearest - d2) / (2 * radius * radius));
    weighed.emplace_back(&c, weight);
    sum += weight;
    middle_then += weight * c.then.translation();
    middle_now += weight * c.now.translation();
    turn += weight * c.now.linear() * c.then.linear().transpose();
  }
  middle_then /= sum;
  middle_now /= sum;
  Similarity& S = out.T_now_then;
  S.R = nearestRotation(turn);
  double squares = sum * kTooNear * kTooNear * radius * radius, products = squares;
  for (const auto& [c, weight] : weighed) {
    const Eigen::Vector3d before = c->then.translation() - middle_then, after = c->now.translation() - middle_now;
    squares += weight * before.squaredNorm();
    products += weight * after.dot(S.R * before);
  }
  S.scale = products / squares;
  S.t = middle_now - S.scale * (S.R * middle_then);
  constexpr double kLargestChange = 2;
  if (!(S.scale > 1 / kLargestChange && S.scale < kLargestChange && S.t.allFinite()))
    return {Similarity(), std::numeric_limits<double>::infinity()};
  double residuals = 0;
  for (const auto& [c, weight] : weighed)
    residuals += weight * (S * c->then.translation() - c->now.translation()).squaredNorm();
  out.residual = std::sqrt(residuals / sum) / S.scale;
  return out;
}

}  // namespace air_ground_common
