#include "rgbd_slam/readout_estimator.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "air_ground_common/statistics.h"
#include "visual_frontend/rolling_shutter.h"

namespace rgbd_slam {

using air_ground_common::Pose;

namespace {

constexpr std::array<double, 3> kSpans{{0.4, 0.8, 1.6}};  // between the images that are compared [s]
constexpr double kViewInterval = 0.09;                    // between images that are used [s]
constexpr double kLongestStep = 0.25;                     // between images from whose poses a motion is taken [s]
constexpr int kMinPoints = 25;                            // that two images share
constexpr int kIterations = 4;
constexpr int kWideIterations = 2;  // of them, while the motion is coarse
constexpr double kWideLoss = 8;     // Cauchy, in sigmas
constexpr double kLoss = 2.5;
constexpr double kNormalMedian = 1.538;   // of the length of a standard normal vector in space
constexpr double kMaxMisfit = 2.5;        // of noise: these images are not of one rigid motion
constexpr double kMinMisfit = 0.5;        // what is believed of points at best
constexpr double kTrackCorrelation = 10;  // points of a pair over those that err on their own
constexpr double kSystematic = 1e-3;      // common to all pairs: depth that is read at other times, calibration [s]
constexpr double kDistrusted = 0.1;       // weight of what was found with another readout time
// Standard deviations of a calibration.
constexpr double kFocalStddev = 0.03;   // relative
constexpr double kCentreStddev = 0.02;  // of normalised coordinates
constexpr double kRadialStddev = 0.05;  // of k1

Eigen::Matrix<double, 2, 3> projectionJacobian(const Eigen::Vector3d& p) {
  Eigen::Matrix<double, 2, 3> J;
  J << 1 / p.z(), 0, -p.x() / (p.z() * p.z()), 0, 1 / p.z(), -p.y() / (p.z() * p.z());
  return J;
}

}  // namespace

/// The problem of two images: T_b_a and the states, by what the points of b see of those of a.
struct ReadoutEstimator::Pair {
  static constexpr int kAll = 6 + kStates;
  using VectorAll = Eigen::Matrix<double, kAll, 1>;
  using MatrixAll = Eigen::Matrix<double, kAll, kAll>;

  std::vector<std::pair<const RowObservation*, const RowObservation*>> points;
  double ray_sigma;
  Vector x;
  Pose T_b_a = Pose::Identity();

  struct Normal {
    MatrixAll H = MatrixAll::Zero();
    VectorAll g = VectorAll::Zero();
    double misfit = 2 * kMaxMisfit;  ///< median error over that of pure noise
  };

  /// Errors of image position and depth, by translation and rotation of T_b_a and by the states.
  Normal linearize(double loss_width) const {
    Normal normal;
    std::vector<double> errors;
    for (const auto& [a, b] : points) {
      const Eigen::Vector3d p_a = a->point.p_camera + a->by_state * x, p_b = b->point.p_camera + b->by_state * x;
      const Eigen::Vector3d seen = T_b_a * p_a;
      if (seen.z() < 0.2 * p_b.z() || p_a.z() <= 0 || p_b.z() <= 0) continue;
      // In sigmas.
      Eigen::Matrix3d by_seen, by_b;
      by_seen << projectionJacobian(seen) / ray_sigma, Eigen::RowVector3d(0, 0, 1 / b->point.depth_sigma);
      by_b << projectionJacobian(p_b) / ray_sigma, Eigen::RowVector3d(0, 0, 1 / b->point.depth_sigma);
      Eigen::Vector3d e;
      e << (seen.hnormalized() - p_b.hnormalized()) / ray_sigma, (seen.z() - p_b.z()) / b->point.depth_sigma;
      Eigen::Matrix<double, 3, kAll> J;
      J << by_seen, -by_seen * air_ground_common::skew(T_b_a.linear() * p_a),
          by_seen * T_b_a.linear() * a->by_state - by_b * b->by_state;
      // The depth of a moves the point along its ray.
      const Eigen::Vector3d along = by_seen * (T_b_a.linear() * (p_a / p_a.z() * a->point.depth_sigma));
      const Eigen::LLT<Eigen::Matrix3d> noise(Eigen::Matrix3d::Identity() + along * along.transpose());
      noise.matrixL().solveInPlace(e);
      noise.matrixL().solveInPlace(J);
      const double weight = 1 / (1 + e.squaredNorm() / (loss_width * loss_width));
      normal.H += weight * J.transpose() * J;
      normal.g += weight * J.transpose() * e;
      errors.push_back(e.norm());
    }
    if (static_cast<int>(errors.size()) >= kMinPoints)
      normal.misfit = air_ground_common::median(std::move(errors)) / kNormalMedian;
    return normal;
  }

  /// The pose alone.
  bool step(const Normal& normal) {
    Eigen::Matrix<double, 6, 6> H = normal.H.topLeftCorner<6, 6>();
    H.diagonal().array() += 1e-9;
    const Eigen::Matrix<double, 6, 1> dx = -H.ldlt().solve(normal.g.head<6>());
    if (!dx.allFinite()) return false;
    T_b_a.translation() += dx.head<3>();
    T_b_a.linear() = air_ground_common::expSO3(dx.tail<3>()) * T_b_a.linear();
    return true;
  }
};

ReadoutEstimator::ReadoutEstimator(double readout_time, double stddev, double ray_sigma)
    : given_(readout_time), given_stddev_(stddev), ray_sigma_(ray_sigma) {
  if (!std::isfinite(readout_time) || !(stddev > 0) || !(ray_sigma > 0))
    throw std::invalid_argument("ReadoutEstimator: standard deviations must be positive, the readout time finite");
  prior_ << 1 / (stddev * stddev), 1 / (kFocalStddev * kFocalStddev), 1 / (kCentreStddev * kCentreStddev),
      1 / (kCentreStddev * kCentreStddev), 1 / (kRadialStddev * kRadialStddev);
  reset();
}

void ReadoutEstimator::reset() {
  interrupt();
  H_.setZero();
  h_.setZero();
  scatter_ = pairs_ = 0;
  solve();
}

void ReadoutEstimator::interrupt() {
  before_.reset();
  last_.reset();
  views_.clear();
}

void ReadoutEstimator::distrust() {
  H_ *= kDistrusted;
  h_ *= kDistrusted;
  scatter_ *= kDistrusted;
  pairs_ *= kDistrusted;
  solve();
}

void ReadoutEstimator::solve() {
  Matrix H = H_;
  H.diagonal() += prior_;
  Vector h = h_;
  h(0) += prior_(0) * given_;
  const Matrix covariance = H.inverse();
  x_ = covariance * h;
  // Where pairs disagree by more than they claim, they know less.
  const double inflation = std::max(1.0, scatter_ / std::max(1.0, pairs_));
  const double variance = pairs_ > 0 ? inflation * covariance(0, 0) + kSystematic * kSystematic : covariance(0, 0);
  stddev_ = std::min(given_stddev_, std::sqrt(variance));
}

bool ReadoutEstimator::add(double stamp, const Pose& T_map_camera, const std::vector<RowPoint>& points) {
  if (last_ && !(stamp > last_->stamp && stamp - last_->stamp < kLongestStep)) interrupt();
  const bool changed = conclude(T_map_camera, stamp);
  before_ = std::move(last_);
  last_.emplace(stamp, T_map_camera);
  for (const RowPoint& point : points) last_->observations[point.track].point = point;
  return changed;
}

bool ReadoutEstimator::conclude(const Pose& T_map_after, double after) {
  if (!before_ || (!views_.empty() && last_->stamp - views_.back().stamp < kViewInterval)) return false;
  const auto velocity =
      visual_frontend::velocityBetween(before_->T_map_camera, last_->T_map_camera, T_map_after, after - before_->stamp);
  for (auto& [track, observation] : last_->observations) {
    const Eigen::Vector3d& p = observation.point.p_camera;
    const Eigen::Vector3d off_axis(p.x(), p.y(), 0);
    observation.by_state << observation.point.row * (velocity.angular.cross(p) + velocity.linear), off_axis,
        p.z() * Eigen::Vector3d::UnitX(), p.z() * Eigen::Vector3d::UnitY(), p.hnormalized().squaredNorm() * off_axis;
  }
  bool changed = false;
  for (const double span : kSpans) {
    const View* nearest = nullptr;
    for (const View& view : views_) {
      const double off = std::abs(last_->stamp - view.stamp - span);
      if (off < kViewInterval && (!nearest || off < std::abs(last_->stamp - nearest->stamp - span))) nearest = &view;
    }
    changed |= nearest && compare(*nearest, *last_);
  }
  views_.push_back(*last_);
  while (last_->stamp - views_.front().stamp > kSpans.back() + kViewInterval) views_.pop_front();
  if (changed) solve();
  return changed;
}

bool ReadoutEstimator::compare(const View& a, const View& b) {
  Pair pair;
  pair.ray_sigma = ray_sigma_;
  pair.x = x_;
  for (const auto& [track, seen] : b.observations) {
    const auto earlier = a.observations.find(track);
    if (earlier != a.observations.end()) pair.points.emplace_back(&earlier->second, &seen);
  }
  if (static_cast<int>(pair.points.size()) < kMinPoints) return false;
  // In one order whatever the tables' is: sums round by it.
  std::sort(pair.points.begin(), pair.points.end(),
            [](const auto& p, const auto& q) { return p.second->point.track < q.second->point.track; });
  pair.T_b_a = b.T_map_camera.inverse() * a.T_map_camera;
  for (int i = 0; i < kIterations; ++i) {
    if (!pair.step(pair.linearize(i < kWideIterations ? kWideLoss : kLoss))) return false;
  }
  const Pair::Normal normal = pair.linearize(kLoss);
  if (normal.misfit > kMaxMisfit) return false;
  Eigen::Matrix<double, 6, 6> pose = normal.H.topLeftCorner<6, 6>();
  pose.diagonal().array() += 1e-9;
  const Eigen::Matrix<double, kStates, 6> K = normal.H.bottomLeftCorner<kStates, 6>() * pose.inverse();
  const double inflation = kTrackCorrelation * std::pow(std::max(kMinMisfit, normal.misfit), 2);
  const Matrix H =
      (normal.H.bottomRightCorner<kStates, kStates>() - K * normal.H.topRightCorner<6, kStates>()) / inflation;
  const Vector g = (normal.g.tail<kStates>() - K * normal.g.head<6>()) / inflation;
  if (!H.allFinite() || !g.allFinite() || !(H(0, 0) > 0)) return false;
  H_ += H;
  h_ += H * x_ - g;
  scatter_ += g(0) * g(0) / H(0, 0);
  ++pairs_;
  return true;
}

}  // namespace rgbd_slam
