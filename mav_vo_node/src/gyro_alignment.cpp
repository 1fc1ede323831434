#include "mav_vo/gyro_alignment.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "air_ground_common/geometry.h"
#include "air_ground_common/statistics.h"
#include "gyro_turn.h"
#include "visual_frontend/feature_tracker.h"

namespace mav_vo {

using air_ground_common::expSO3;
using air_ground_common::rightJacobianSO3;

namespace {

constexpr double kLossWidth = 2.5;        // Cauchy, in sigmas
constexpr double kExactOffset = 1e-6;     // standard deviation of a time offset that is not estimated [s]
constexpr double kNormalMedian = 0.6745;  // of |x|, x standard normal
constexpr double kMinNoise = 0.3;         // of a track, in sigmas: what is believed at best
constexpr double kSystematicBias =
    4e-3;  // common to all pairs: calibration, rolling shutter, tracks on reflections [rad/s]
constexpr double kSystematicOffset = 5e-4;    // likewise [s]
constexpr double kSystematicReadout = 1e-3;   // likewise [s]
constexpr double kSystematicMounting = 3e-3;  // likewise: axes that are not square [rad]
constexpr double kUsualBias = 0.02;           // of most gyros, some have more: scale of a Cauchy distribution [rad/s]
constexpr double kMemory = 10;                // pairs older than the window count ever less [s]
constexpr double kTrackCorrelation = 10;      // tracks of a pair over those that err on their own
constexpr double kShare = 1.0 / 3;            // of a pair's information: the pairs of the three spans overlap
constexpr double kOpenOffset = 0.01;          // of a less certain offset other minima are looked for [s]
constexpr double kSearchInterval = 0.5;       // between such searches [s]
constexpr double kRoughBias = 0.02;           // a less certain bias is solved for with a loss that narrows [rad/s]
constexpr double kUsualTurn = 0.2;            // of a short pair, by which an unknown mounting errs [rad]
constexpr double kRestartInterval = 1.0;      // between searches from the bias that was given first [s]
constexpr double kContradiction = 3;          // likewise: the bias is none of the usual ones
constexpr double kFirstLook = 1;              // in which no bias is the less likely one [s]
constexpr double kYoung = 10;                 // an older estimate goes when it is refuted repeatedly only [s]
constexpr int kRepeated = 4;                  // times in a row
constexpr int kIterations = 4;                // from the last estimate
constexpr int kStartIterations = 14;          // while the bias may be anything, with a loss that narrows

Eigen::Matrix<double, 3, 2> tangent(const Eigen::Vector3d& t) {
  Eigen::Matrix<double, 3, 2> B;
  B.col(0) = t.unitOrthogonal();
  B.col(1) = t.cross(B.col(0));
  return B;
}

/// Signed epipolar error of a pair of rays in sigmas (Sampson).
double sampson(const Eigen::Vector3d& t, const Eigen::Vector3d& a, const Eigen::Vector3d& Rb,
               const Eigen::Matrix3d& R_b_a, double sigma, double* weight) {
  const Eigen::Vector3d line_a = t.cross(Rb), line_b = R_b_a * t.cross(a);
  *weight = 1 / (sigma * std::max(1e-9, std::sqrt(line_a.head<2>().squaredNorm() + line_b.head<2>().squaredNorm())));
  return *weight * t.dot(a.cross(Rb));
}

/// Direction of the translation for a rotation: the normals a x R b are perpendicular to it.
Eigen::Vector3d translationBetween(const std::vector<Eigen::Vector3d>& a, const std::vector<Eigen::Vector3d>& Rb,
                                   const Eigen::Matrix3d& R_b_a, double sigma, double width) {
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
  for (int round = 0; round < 3; ++round) {
    Eigen::Matrix3d M = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < a.size(); ++i) {
      const Eigen::Vector3d normal = a[i].cross(Rb[i]);
      double weight = 1;
      if (round > 0) {
        const double e = sampson(t, a[i], Rb[i], R_b_a, sigma, &weight);
        weight = weight * weight / (1 + e * e / (width * width));
      }
      M += weight * normal * normal.transpose();
    }
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
    solver.computeDirect(M);
    t = solver.eigenvectors().col(0);
  }
  return t;
}

}  // namespace

GyroAlignment::GyroAlignment(const GyroAlignmentSettings& settings, const ImuNoise& noise,
                             const Eigen::Matrix3d& R_camera_imu, double sigma, int rows)
    : settings_(settings), noise_(noise), R_camera_imu_(R_camera_imu), sigma_(sigma), flows_(sigma), rows_(rows) {
  reset();
}

void GyroAlignment::reset() {
  pairs_.clear();
  chain_end_ = {};
  first_view_ = last_view_ = last_search_ = last_restart_ = -1;
  refuted_ = 0;
  bias_given_ = false;
  flows_.clear();
  old_H_.setZero();
  old_h_.setZero();
  const double offset_stddev = settings_.time_offset_stddev > 0 ? settings_.time_offset_stddev : kExactOffset;
  const double readout_stddev = settings_.readout_time_stddev > 0 ? settings_.readout_time_stddev : kExactOffset;
  const double mounting_stddev = settings_.mounting_stddev > 0 ? settings_.mounting_stddev : kExactOffset;
  x_ << 0, 0, 0, settings_.time_offset, settings_.readout_time, 0, 0, 0;
  prior_mean_ = x_;
  Vector variance;
  variance << Eigen::Vector3d::Constant(settings_.bias_stddev * settings_.bias_stddev), offset_stddev * offset_stddev,
      readout_stddev * readout_stddev, Eigen::Vector3d::Constant(mounting_stddev * mounting_stddev);
  covariance_ = variance.asDiagonal();
  prior_ = variance.cwiseInverse().asDiagonal();
  misfit_ = 0;
  inflation_ = kTrackCorrelation;
}

void GyroAlignment::restartAt(double time_offset) {
  const Eigen::Vector3d mounting = x_.tail<3>();
  settings_.time_offset = time_offset;
  reset();
  setMounting(mounting);
}

void GyroAlignment::setBias(const Eigen::Vector3d& bias, double stddev) {
  bias_given_ = true;
  x_.head<3>() = bias;
  prior_mean_ = x_;
  covariance_.topLeftCorner<3, 3>() = Eigen::Matrix3d::Identity() * stddev * stddev;
  covariance_.topRightCorner<3, kStates - 3>().setZero();
  covariance_.bottomLeftCorner<kStates - 3, 3>().setZero();
  prior_ = covariance_.inverse();
  pairs_.clear();  // what they say of the offset is in the covariance
  chain_end_ = {};
  old_H_.setZero();
  old_h_.setZero();
}

void GyroAlignment::setReadoutTime(double readout_time) {
  settings_.readout_time = x_(4) = prior_mean_(4) = readout_time;
}

void GyroAlignment::setMounting(const Eigen::Vector3d& mounting) {
  x_.tail<3>() = prior_mean_.tail<3>() = mounting;
  old_H_.setZero();  // of turns about other axes
  old_h_.setZero();
}

double GyroAlignment::biasStddev() const { return std::sqrt(covariance_.diagonal().head<3>().maxCoeff()); }
double GyroAlignment::timeOffsetStddev() const { return std::sqrt(covariance_(3, 3)); }
double GyroAlignment::readoutTimeStddev() const { return std::sqrt(covariance_(4, 4)); }

bool GyroAlignment::add(double stamp, const std::vector<visual_frontend::Feature>& features, const ImuBuffer& imu) {
  flows_.add(stamp, features);
  if (last_view_ >= 0 && stamp - last_view_ < settings_.view_interval) return false;
  const double elapsed = last_view_ >= 0 ? stamp - last_view_ : 0;
  last_view_ = stamp;
  auto view = std::make_shared<View>();
  view->stamp = stamp;
  const bool rows = settings_.readout_time_stddev > 0 || settings_.readout_time != 0;
  for (const auto& f : features) {
    const Eigen::Vector2d* flow = flows_.steadyFlow(f.id);
    if (rows && !flow) continue;  // where its row sees it is not known
    RayObservation observation;
    observation.ray = f.normalized;
    if (rows) observation.by_readout = ((f.pixel.y() + 0.5) / rows_ - 0.5) * *flow;
    view->observations[f.id] = observation;
  }
  growOld(elapsed);

  const std::size_t before = pairs_.size();
  addPairs(view);
  if (pairs_.size() == before) return false;
  if (first_view_ < 0) first_view_ = stamp;
  retire(stamp - settings_.window, imu);
  const bool offset_open = settings_.time_offset_stddev > 0 && timeOffsetStddev() > kOpenOffset;
  const bool search = offset_open && stamp - last_search_ >= kSearchInterval;
  const double turn_error = std::hypot(biasStddev() * settings_.spans.front(),
                                       kUsualTurn * std::sqrt(covariance_.diagonal().tail<3>().maxCoeff()));
  const bool rough = search || biasStddev() > kRoughBias;
  // The loss narrows from what the present uncertainty allows; offsets have several minima when the motion is periodic.
  const double width = rough ? std::max(kLossWidth, 2 * turn_error / sigma_) : kLossWidth;
  Vector best = x_;
  double cost = std::numeric_limits<double>::infinity();
  for (const double shift : {0.0, -0.025, 0.025, -0.05, 0.05, -0.075, 0.075}) {
    if (shift != 0 && (!search || std::abs(shift) > 2.6 * timeOffsetStddev())) continue;
    Vector start = x_, solution;
    start(3) = std::clamp(start(3) + shift, settings_.time_offset - settings_.max_time_offset,
                          settings_.time_offset + settings_.max_time_offset);
    const double c = solveFrom(start, rough ? kStartIterations : kIterations, width, imu, &solution);
    if (c >= cost) continue;
    cost = c;
    best = solution;
  }
  if (search) last_search_ = stamp;
  if (stamp - last_restart_ >= kRestartInterval) {
    last_restart_ = stamp;
    leaveWrongMinimum(stamp - first_view_ < kYoung ? 1 : kRepeated, imu, &best);
  }
  const bool credible = best.allFinite() && best.head<3>().norm() <= 1.0 &&
                        std::abs(best(3) - settings_.time_offset) <= settings_.max_time_offset &&
                        std::abs(best(4)) <= settings_.max_readout_time &&
                        best.tail<3>().norm() <= settings_.max_mounting;
  if (!credible) return false;
  x_ = best;
  summarize(imu);
  return true;
}

// What was known `elapsed` seconds ago.
void GyroAlignment::growOld(double elapsed) {
  Matrix walk = Matrix::Zero();
  walk.diagonal() << Eigen::Vector3d::Constant(noise_.gyro_bias_walk * noise_.gyro_bias_walk),
      settings_.time_offset_stddev > 0 ? settings_.time_offset_walk * settings_.time_offset_walk : 0, 0,
      Eigen::Vector3d::Zero();
  prior_ = (Matrix(prior_.inverse()) + elapsed * walk).inverse();
  old_H_ *= std::exp(-elapsed / kMemory);
  old_h_ *= std::exp(-elapsed / kMemory);
}

double GyroAlignment::solveFromAfar(const Vector& start, const ImuBuffer& imu, Vector* solution) const {
  const double width = 2 * settings_.bias_stddev * settings_.spans.front() / sigma_;
  return solveFrom(start, kStartIterations, std::max(kLossWidth, width), imu, solution);
}

double GyroAlignment::beginAnew(const ImuBuffer& imu) {
  old_H_.setZero();
  old_h_.setZero();
  inflation_ = kTrackCorrelation;
  return solveFromAfar(prior_mean_, imu, &x_);
}

// The first pairs may have led to a wrong minimum, where every pair that leaves the window is linearised anew.
void GyroAlignment::leaveWrongMinimum(int times, const ImuBuffer& imu, Vector* best) {
  Vector start = *best, other;
  start.head<3>() = prior_mean_.head<3>();
  start.tail<3>() = prior_mean_.tail<3>();
  const Matrix old_H = std::exchange(old_H_, Matrix::Zero());
  const Vector old_h = std::exchange(old_h_, Vector::Zero());
  const double cost = solveFromAfar(start, imu, &other);
  refuted_ = cost + kOtherMinimum < costAt(*best, imu) ? refuted_ + 1 : 0;
  if (refuted_ >= times) {
    refuted_ = 0;
    *best = other;
    return;
  }
  old_H_ = old_H;
  old_h_ = old_h;
}

void GyroAlignment::addPairs(const std::shared_ptr<const View>& view) {
  for (std::size_t s = 0; s < settings_.spans.size(); ++s) {
    auto& first = chain_end_[s];
    if (!first) {
      first = view;
      continue;
    }
    const double span = view->stamp - first->stamp;
    if (span < 0.9 * settings_.spans[s]) continue;
    Pair pair;
    pair.begin = first->stamp;
    pair.end = view->stamp;
    std::vector<visual_frontend::TrackId> common;
    for (const auto& ray : view->observations)
      if (first->observations.count(ray.first)) common.push_back(ray.first);
    const auto previous = std::exchange(first, view);
    if (span > 2 * settings_.spans[s] + 0.2 || static_cast<int>(common.size()) < settings_.min_tracks) continue;
    std::sort(common.begin(), common.end());
    const std::size_t stride = 1 + (common.size() - 1) / static_cast<std::size_t>(settings_.max_tracks);
    for (std::size_t i = 0; i < common.size(); i += stride) {
      pair.a.push_back(previous->observations.at(common[i]));
      pair.b.push_back(view->observations.at(common[i]));
    }
    pairs_.push_back(std::move(pair));
  }
}

std::optional<GyroAlignment::Normal> GyroAlignment::linearize(const Pair& pair, const Vector& x, const ImuBuffer& imu,
                                                              double width, std::vector<double>* errors) const {
  const auto turn = gyroTurn(imu, pair.begin + x(3), pair.end + x(3), x.head<3>());
  if (!turn) return std::nullopt;
  const Eigen::Matrix3d R_camera_imu = R_camera_imu_ * expSO3(Eigen::Vector3d(x.tail<3>()));
  const Eigen::Matrix3d R = R_camera_imu * turn->R * R_camera_imu.transpose(), R_b_a = R.transpose();
  Eigen::Matrix<double, 3, 7> rotation_by_x;  // bias, offset, mounting
  rotation_by_x << R_camera_imu * turn->by_bias, R_camera_imu * turn->by_offset, Eigen::Matrix3d::Zero();
  if (settings_.mounting_stddev > 0)
    rotation_by_x.rightCols<3>() =
        R_camera_imu * (turn->R.transpose() - Eigen::Matrix3d::Identity()) * rightJacobianSO3(x.tail<3>());
  const std::size_t n = pair.a.size();
  std::vector<Eigen::Vector3d> a(n), b(n), Rb(n);
  for (std::size_t i = 0; i < n; ++i) {
    a[i] = pair.a[i].atMiddleRow(x(4));
    b[i] = pair.b[i].atMiddleRow(x(4));
    Rb[i] = R * b[i];
  }
  const Eigen::Vector3d t = translationBetween(a, Rb, R_b_a, sigma_, width);
  constexpr int kAll = kStates + 2;  // and the direction of t
  Eigen::Matrix<double, kAll, kAll> H = Eigen::Matrix<double, kAll, kAll>::Zero();
  Eigen::Matrix<double, kAll, 1> g = Eigen::Matrix<double, kAll, 1>::Zero();
  const Eigen::Matrix<double, 3, 2> B = tangent(t);
  Normal normal;
  for (std::size_t i = 0; i < n; ++i) {
    double weight = 0;
    const double e = sampson(t, a[i], Rb[i], R_b_a, sigma_, &weight);
    if (errors) errors->push_back(std::abs(e));
    const Eigen::Vector3d by_rotation = b[i].cross(R_b_a * t.cross(a[i]));
    const double by_readout =
        pair.a[i].derivative().dot(Rb[i].cross(t)) + pair.b[i].derivative().dot(R_b_a * t.cross(a[i]));
    Eigen::Matrix<double, kAll, 1> J;
    const Eigen::Matrix<double, 7, 1> by_turn = rotation_by_x.transpose() * by_rotation;
    J << by_turn.head<4>(), by_readout, by_turn.tail<3>(), B.transpose() * a[i].cross(Rb[i]);
    J *= weight;
    const double loss = 1 / (1 + e * e / (width * width));
    H += loss * J * J.transpose();
    g += loss * e * J;
    normal.cost += width * width * std::log1p(e * e / (width * width));
  }
  Eigen::Matrix2d Htt = H.bottomRightCorner<2, 2>();
  Htt.diagonal().array() += 1.0;  // where nothing moves the direction means nothing
  const Eigen::Matrix<double, kStates, 2> K = H.topRightCorner<kStates, 2>() * Htt.inverse();
  normal.H = kShare * (H.topLeftCorner<kStates, kStates>() - K * H.bottomLeftCorner<2, kStates>());
  normal.g = kShare * (g.head<kStates>() - K * g.tail<2>());
  normal.cost *= kShare;
  return normal;
}

double GyroAlignment::solveFrom(Vector x, int iterations, double first_width, const ImuBuffer& imu,
                                Vector* solution) const {
  double width = first_width;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    Matrix H = old_H_;
    Vector g = old_H_ * x - old_h_;
    for (const Pair& pair : pairs_) {
      // A wrong bias turns long spans too far: the short ones lead.
      if (width > 2 * kLossWidth && pair.end - pair.begin > 1.5 * settings_.spans.front()) continue;
      const auto normal = linearize(pair, x, imu, width, nullptr);
      if (!normal) continue;
      H += normal->H / inflation_;
      g += normal->g / inflation_;
    }
    const Matrix share = shareOfTracks(H);
    H = prior_ + share * H;
    g = prior_ * (x - prior_mean_) + share * g;
    const double unusual = unusualBias(x).weight;
    H.diagonal().head<3>().array() += unusual;
    g.head<3>() += unusual * x.head<3>();
    const Vector step = Eigen::Matrix<double, kStates, kStates>(H).ldlt().solve(-Eigen::Matrix<double, kStates, 1>(g));
    if (!step.allFinite()) break;
    // A step of the offset may not leap over the period of the motion.
    x += step * std::min(1.0, 0.03 / std::max(0.03, std::abs(step(3))));
    if (width <= kLossWidth && step.head<3>().norm() < 1e-5 && step.tail<kStates - 3>().cwiseAbs().maxCoeff() < 1e-5)
      break;
    width = std::max(kLossWidth, 0.6 * width);
  }
  *solution = x;
  return costAt(x, imu);
}

// Where blur, weak texture or a rolling shutter leave the bias open, a small one is likelier; a large one that the
// tracks show costs little. It makes the estimate no surer: the covariance is without it.
GyroAlignment::UnusualBias GyroAlignment::unusualBias(const Vector& x) const {
  if (bias_given_ || misfit_ > kContradiction || last_view_ - first_view_ < kFirstLook) return {};
  constexpr double scale = kUsualBias * kUsualBias;
  const double square = x.head<3>().squaredNorm();
  return {4 * std::log1p(square / scale), 4 / (scale + square)};
}

double GyroAlignment::costAt(const Vector& x, const ImuBuffer& imu) const {
  double cost = (x - prior_mean_).dot(prior_ * (x - prior_mean_)) + x.dot(old_H_ * x) - 2 * x.dot(old_h_);
  cost += unusualBias(x).cost;
  for (const Pair& pair : pairs_)
    if (const auto normal = linearize(pair, x, imu, kLossWidth, nullptr)) cost += normal->cost / inflation_;
  return cost;
}

void GyroAlignment::retire(double before, const ImuBuffer& imu) {
  while (!pairs_.empty() && pairs_.front().begin < before) {
    if (const auto normal = linearize(pairs_.front(), x_, imu, kLossWidth, nullptr)) {
      old_H_ += normal->H / inflation_;
      old_h_ += (normal->H * x_ - normal->g) / inflation_;
    }
    pairs_.pop_front();
  }
}

void GyroAlignment::summarize(const ImuBuffer& imu) {
  Matrix H = Matrix::Zero();
  std::vector<double> errors;
  double scatter = 0;
  int count = 0;
  for (const Pair& pair : pairs_) {
    const auto normal = linearize(pair, x_, imu, kLossWidth, &errors);
    if (!normal) continue;
    H += normal->H;
    // Squared Mahalanobis distance of this pair's own bias from that of all.
    const Eigen::Matrix3d own = normal->H.topLeftCorner<3, 3>();
    scatter += normal->g.head<3>().dot(own.ldlt().solve(Eigen::Vector3d(normal->g.head<3>()))) / kShare;
    count += 3;
  }
  if (errors.empty()) return;
  misfit_ = air_ground_common::median(std::move(errors)) / kNormalMedian;
  // Errors of tracks beside each other are alike (blur, edges, calibration): many are worth as much as a few.
  const double noise = std::max(kMinNoise, misfit_);
  inflation_ = std::max(kTrackCorrelation * noise * noise, scatter / count);
  H = old_H_ + H / inflation_;
  covariance_ = (prior_ + shareOfTracks(H) * H).inverse();
  covariance_ = 0.5 * (covariance_ + Matrix(covariance_.transpose()));
}

// The tracks measure x with the covariance H^-1 + S, S of what is common to all of them: (H^-1 + S)^-1 = share * H.
GyroAlignment::Matrix GyroAlignment::shareOfTracks(const Matrix& H) const {
  Matrix D = Matrix::Zero();
  D.diagonal() << Eigen::Vector3d::Constant(1 / (kSystematicBias * kSystematicBias)),
      1 / (kSystematicOffset * kSystematicOffset), 1 / (kSystematicReadout * kSystematicReadout),
      Eigen::Vector3d::Constant(1 / (kSystematicMounting * kSystematicMounting));
  return D * Matrix(H + D).inverse();
}

}  // namespace mav_vo
