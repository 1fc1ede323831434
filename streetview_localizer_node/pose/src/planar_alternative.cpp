#include "planar_alternative.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>

namespace streetview_localizer::detail {

namespace {

constexpr double kVeto = 50;        // what cannot be: seen from inside the wall, below the ground
constexpr double kPriorLimit = 20;  // a prior alone may be wrong

/// IPPE on the points projected to their plane: up to two poses.
std::vector<Pose> planarPoses(const Matches& m, const std::vector<int>& positions) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const int i : positions) mean += m.points[i].p_map / static_cast<double>(positions.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const int i : positions) scatter += (m.points[i].p_map - mean) * (m.points[i].p_map - mean).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  const Eigen::Vector3d values = eigen.eigenvalues();
  // A line has no plane, and a corner of a house no second pose by this way.
  if (!(values[1] > 1e-6 * values[2]) || values[0] > 0.25 * values[1]) return {};
  Eigen::Matrix3d R_plane_world;
  R_plane_world.row(0) = eigen.eigenvectors().col(2);
  R_plane_world.row(1) = eigen.eigenvectors().col(1);
  R_plane_world.row(2) = eigen.eigenvectors().col(2).cross(eigen.eigenvectors().col(1));
  std::vector<cv::Point3d> object;
  std::vector<cv::Point2d> image;
  for (const int i : positions) {
    const Eigen::Vector3d q = R_plane_world * (m.points[i].p_map - mean);
    object.emplace_back(q.x(), q.y(), 0.0);
    image.emplace_back(m.points[i].normalized.x(), m.points[i].normalized.y());
  }
  std::vector<cv::Mat> rotations, translations;
  try {
    cv::solvePnPGeneric(object, image, cv::Matx33d::eye(), cv::noArray(), rotations, translations, false,
                        cv::SOLVEPNP_IPPE);
  } catch (const cv::Exception&) {  // degenerate homography
    return {};
  }
  std::vector<Pose> poses;
  for (std::size_t k = 0; k < rotations.size(); ++k) {
    Eigen::Vector3d rotation, translation;
    cv::cv2eigen(rotations[k], rotation);
    cv::cv2eigen(translations[k], translation);
    if (!rotation.allFinite() || !translation.allFinite()) continue;
    const Eigen::Matrix3d R_camera_world = air_ground_common::expSO3(rotation) * R_plane_world;
    Pose T = Pose::Identity();
    T.linear() = R_camera_world.transpose();
    T.translation() = mean - R_camera_world.transpose() * translation;
    poses.push_back(T);
  }
  return poses;
}

/// Same minimum: what is left of the distance is the optimiser's.
bool same(const Pose& a, const Pose& b, double range) {
  return (a.translation() - b.translation()).norm() < 0.005 * range &&
         air_ground_common::rotationAngle(a.linear(), b.linear()) < 0.005;
}

double logPrior(const Matches& m, const std::vector<int>& inliers, const Pose& T, const PosePrior& prior) {
  double value = 0;
  const double z = T.translation().z();
  if (z < prior.min_z || z > prior.max_z) value -= kVeto;
  if (facingShare(m, inliers, T.translation()) < 0.5) value -= kVeto;
  const double angle = tilt(prior, T) / prior.up_stddev;
  return value - std::min(kVeto, 0.5 * angle * angle);
}

/// Squared Mahalanobis distance to the predicted pose.
double predictionError(const Pose& T, const PosePrior& prior) {
  air_ground_common::Vector6d e;
  e.head<3>() = T.translation() - prior.T_world_camera->translation();
  e.tail<3>() = air_ground_common::logSO3(T.linear() * prior.T_world_camera->linear().transpose());
  return e.dot(prior.covariance.ldlt().solve(e));
}

}  // namespace

std::vector<std::vector<int>> wallsOf(const Matches& m, const std::vector<int>& inliers, double tolerance) {
  struct Wall {
    Eigen::Vector3d normal;
    double offset;
  };
  std::vector<Wall> walls;
  std::vector<std::vector<int>> members;
  for (const int i : inliers) {
    if (m.normals[i].squaredNorm() < 0.25) continue;
    const Eigen::Vector3d n = m.normals[i].normalized();
    std::size_t w = 0;
    while (w < walls.size() &&
           !(n.dot(walls[w].normal) > 0.966 &&
             std::abs(walls[w].normal.dot(m.points[i].p_map - m.origin) - walls[w].offset) < tolerance))
      ++w;
    if (w == walls.size()) {
      walls.push_back({n, n.dot(m.points[i].p_map - m.origin)});
      members.emplace_back();
    }
    members[w].push_back(i);
  }
  std::sort(members.begin(), members.end(), [](const auto& a, const auto& b) { return a.size() > b.size(); });
  return members;
}

std::vector<Pose> planarAlternatives(const Matches& m, const Pose& pose, const std::vector<int>& inliers, double noise,
                                     const PosePrior& prior, const PoseSettings& settings) {
  std::vector<Pose> starts = planarPoses(m, inliers);
  const auto walls = wallsOf(m, inliers);
  if (!walls.empty() && walls.front().size() >= 6 &&
      walls.front().size() < 0.95 * static_cast<double>(inliers.size())) {
    for (const Pose& T : planarPoses(m, walls.front())) starts.push_back(T);
  }
  const double range = (m.origin - pose.translation()).norm();
  // Gravity is left to the choice between the poses: as a prior here it would drag the wrong one away from its minimum.
  PosePrior free = prior;
  free.up_camera.reset();
  std::vector<Pose> found;
  for (const Pose& start : starts) {
    const auto refined = refine(m, inliers, start, std::max(noise, settings.inlier_threshold / 3), free);
    if (!refined) continue;
    const auto T = converge(m, inliersOf(m, *refined, 2 * settings.inlier_threshold), *refined, noise, free, settings);
    if (!T || same(*T, pose, range)) continue;
    const bool known =
        std::any_of(found.begin(), found.end(), [&](const Pose& other) { return same(*T, other, range); });
    if (!known) found.push_back(*T);
  }
  return found;
}

double logLikelihoodRatio(const Matches& m, const Pose& a, const Pose& b, const PosePrior& prior,
                          const PoseSettings& settings) {
  const std::vector<int> inliers_a = inliersOf(m, a, settings.inlier_threshold),
                         inliers_b = inliersOf(m, b, settings.inlier_threshold);
  std::vector<int> either;
  std::set_union(inliers_a.begin(), inliers_a.end(), inliers_b.begin(), inliers_b.end(), std::back_inserter(either));
  if (either.empty()) return 0;
  const double bound = settings.inlier_threshold * settings.inlier_threshold;
  const Pose inverse_a = a.inverse(), inverse_b = b.inverse();
  // Noise unknown: profile likelihood, (n/2) ln of the ratio of the sums of squares.
  double sum_a = 0, sum_b = 0;
  for (const int i : either) {
    sum_a += std::min(bound, squaredError(m, i, inverse_a));
    sum_b += std::min(bound, squaredError(m, i, inverse_b));
  }
  const double floor = 2.0 * static_cast<double>(either.size()) * 0.01;  // a tenth of a pixel
  const double measurements = std::min(kEffectiveMeasurements, 2.0 * static_cast<double>(either.size()));
  double ratio = 0.5 * measurements * std::log((sum_b + floor) / (sum_a + floor));
  ratio += logPrior(m, inliers_a, a, prior) - logPrior(m, inliers_b, b, prior);
  if (prior.T_world_camera) {
    const double error_a = predictionError(a, prior), error_b = predictionError(b, prior);
    constexpr double kChi2 = 22.46;  // 6 degrees of freedom, 99.9 %
    if (std::min(error_a, error_b) < kChi2) ratio += std::clamp(0.5 * (error_b - error_a), -kPriorLimit, kPriorLimit);
  }
  return ratio;
}

}  // namespace streetview_localizer::detail
