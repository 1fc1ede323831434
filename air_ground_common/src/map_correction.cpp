#include "air_ground_common/map_correction.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace air_ground_common {
namespace {

struct Pair {
  Pose then, now;
  double weight = 0;  // at first the squared distance
};

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

LocalCorrection localCorrection(const PosesByStamp& then, const PosesByStamp& now, const Eigen::Vector3d& centre,
                                double radius) {
  constexpr double kTooNear = 0.05;  // spread of the cameras over the radius at which half of a change of scale counts
  std::vector<Pair> pairs;
  double nearest = std::numeric_limits<double>::infinity();
  for (const auto& [stamp, T] : then) {
    const auto T_now = poseOfImage(now, stamp);
    if (!T_now) continue;
    pairs.push_back({T, *T_now, (T.translation() - centre).squaredNorm()});
    nearest = std::min(nearest, pairs.back().weight);
  }
  LocalCorrection out;
  if (pairs.empty()) return out;
  Similarity& S = out.T_now_then;
  double sum = 0;
  Eigen::Vector3d middle_then = Eigen::Vector3d::Zero(), middle_now = Eigen::Vector3d::Zero();
  Eigen::Matrix3d turn = Eigen::Matrix3d::Zero();
  for (Pair& p : pairs) {
    p.weight = std::exp((nearest - p.weight) / (2 * radius * radius));
    sum += p.weight;
    middle_then += p.weight * p.then.translation();
    middle_now += p.weight * p.now.translation();
    turn += p.weight * p.now.linear() * p.then.linear().transpose();
  }
  middle_then /= sum;
  middle_now /= sum;
  S.R = nearestRotation(turn);
  double squares = sum * kTooNear * kTooNear * radius * radius, products = squares;
  for (const Pair& p : pairs) {
    const Eigen::Vector3d before = p.then.translation() - middle_then, after = p.now.translation() - middle_now;
    squares += p.weight * before.squaredNorm();
    products += p.weight * after.dot(S.R * before);
  }
  S.scale = products / squares;
  S.t = middle_now - S.scale * (S.R * middle_then);
  constexpr double kLargestChange = 2;
  if (!(S.scale > 1 / kLargestChange && S.scale < kLargestChange && S.t.allFinite()))
    return {Similarity(), std::numeric_limits<double>::infinity()};
  double residuals = 0;
  for (const Pair& p : pairs) residuals += p.weight * (S * p.then.translation() - p.now.translation()).squaredNorm();
  out.residual = std::sqrt(residuals / sum) / S.scale;
  return out;
}

}  // namespace air_ground_common
