#include "view_match/pose_consensus.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace view_match {
namespace {

constexpr double kLeastBaseline = 4;  // of two cameras that fix the scale, in standard deviations of their positions

double positionSigma(const CameraInBoth& camera) { return std::sqrt(camera.covariance.topLeftCorner<3, 3>().trace()); }

Similarity fromOne(const CameraInBoth& camera, double scale) {
  const Eigen::Matrix3d R = camera.T_a_camera.linear() * camera.T_b_camera.linear().transpose();
  return {scale, R, camera.T_a_camera.translation() - scale * (R * camera.T_b_camera.translation())};
}

bool tellsScale(const CameraInBoth& camera) { return std::isfinite(camera.scale_stddev); }

/// Recognised less predicted: position, rotation, log of the scale.
Vector7d residualOf(const CameraInBoth& camera, const Similarity& T_a_b) {
  Vector7d r;
  r << camera.T_a_camera.translation() - T_a_b * camera.T_b_camera.translation(),
      air_ground_common::logSO3(camera.T_a_camera.linear() * (T_a_b.R * camera.T_b_camera.linear()).transpose()),
      std::log(camera.scale / T_a_b.scale);
  return r;
}

class Cameras {
 public:
  explicit Cameras(const std::vector<CameraInBoth>& cameras) : cameras_(cameras) {
    for (const auto& camera : cameras) {
      Matrix7d information = Matrix7d::Zero();
      information.topLeftCorner<6, 6>() = camera.covariance.ldlt().solve(Matrix6d(Matrix6d::Identity()));
      if (tellsScale(camera)) information(6, 6) = 1 / (camera.scale_stddev * camera.scale_stddev);
      information_.push_back(information);
    }
  }

  std::vector<int> agreeing(const Similarity& T_a_b, double max_squared_sigmas, double* cost) const {
    std::vector<int> out;
    *cost = 0;
    for (std::size_t i = 0; i < cameras_.size(); ++i) {
      const Vector7d r = residualOf(cameras_[i], T_a_b);
      const double squared = r.dot(information_[i] * r);
      *cost += std::min(squared, max_squared_sigmas);
      if (squared < max_squared_sigmas) out.push_back(static_cast<int>(i));
    }
    return out;
  }

  struct Normal {
    Matrix7d H = Matrix7d::Zero();
    Vector7d g = Vector7d::Zero();
    double square = 0;
    int measurements = 0;
  };
  Normal normalEquations(const std::vector<int>& which, const Similarity& T_a_b, const Eigen::Vector3d& centre) const {
    Normal n;
    for (const int i : which) {
      const Eigen::Vector3d lever = T_a_b * cameras_[i].T_b_camera.translation() - centre;
      Matrix7d J = Matrix7d::Identity();  // of what is predicted
      J.block<3, 3>(0, 3) = -air_ground_common::skew(lever);
      J.block<3, 1>(0, 6) = lever;
      const Vector7d r = residualOf(cameras_[i], T_a_b);
      n.H += J.transpose() * information_[i] * J;
      n.g += J.transpose() * information_[i] * r;
      n.square += r.dot(information_[i] * r);
      n.measurements += tellsScale(cameras_[i]) ? 7 : 6;
    }
    return n;
  }

 private:
  const std::vector<CameraInBoth>& cameras_;
  std::vector<Matrix7d> information_;
};

/// One guess a camera that the scale is known of, one a pair that lie apart.
std::vector<Similarity> guesses(const std::vector<CameraInBoth>& cameras, const ScaleKnowledge& scale) {
  std::vector<Similarity> out;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (scale.known()) out.push_back(fromOne(cameras[i], scale.mean));
    if (tellsScale(cameras[i])) out.push_back(fromOne(cameras[i], cameras[i].scale));
    if (scale.known() || tellsScale(cameras[i])) continue;
    for (std::size_t j = i + 1; j < cameras.size(); ++j) {
      const double a = (cameras[i].T_a_camera.translation() - cameras[j].T_a_camera.translation()).norm();
      const double b = (cameras[i].T_b_camera.translation() - cameras[j].T_b_camera.translation()).norm();
      if (a > kLeastBaseline * std::hypot(positionSigma(cameras[i]), positionSigma(cameras[j])) && b > 0)
        out.push_back(fromOne(cameras[i], a / b));
    }
  }
  return out;
}

Eigen::Vector3d middleOfScenes(const std::vector<CameraInBoth>& cameras, const std::vector<int>& which) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const int i : which) sum += cameras[i].scene;
  return sum / static_cast<double>(which.size());
}

}  // namespace

bool ScaleKnowledge::known() const { return std::isfinite(stddev); }

Consensus consensusOf(const std::vector<CameraInBoth>& cameras, const ScaleKnowledge& scale,
                      const ConsensusSettings& settings) {
  Consensus out;
  const Cameras all(cameras);
  double best = std::numeric_limits<double>::infinity();
  for (const Similarity& guess : guesses(cameras, scale)) {
    double cost = 0;
    auto agreeing = all.agreeing(guess, settings.max_squared_sigmas, &cost);
    if (agreeing.empty() || cost >= best) continue;
    best = cost;
    out.T_a_b = guess;
    out.agreeing = std::move(agreeing);
  }
  if (out.agreeing.empty()) {
    out.reason = cameras.empty() ? "no camera" : "no two cameras lie far enough apart to tell the scale";
    return out;
  }
  const double prior = scale.known() ? 1 / (scale.stddev * scale.stddev) : 0;
  Cameras::Normal n;
  Eigen::LDLT<Matrix7d> solver;
  for (int k = 0; k < settings.iterations; ++k) {
    out.centre = middleOfScenes(cameras, out.agreeing);
    n = all.normalEquations(out.agreeing, out.T_a_b, out.centre);
    n.H(6, 6) += prior;
    n.g[6] += prior * std::log(scale.mean / out.T_a_b.scale);
    solver.compute(n.H);
    if (solver.info() != Eigen::Success || !(solver.vectorD().minCoeff() > 0)) {
      out.reason = "the cameras do not fix the scale";
      return out;
    }
    const Vector7d step = solver.solve(n.g);
    out.T_a_b = air_ground_common::compose(air_ground_common::motion(step, out.centre), out.T_a_b);
    double cost = 0;
    out.agreeing = all.agreeing(out.T_a_b, settings.max_squared_sigmas, &cost);
    if (out.agreeing.empty()) {
      out.reason = "the cameras contradict each other";
      return out;
    }
    if (step.norm() < 1e-9) break;
  }
  const double freedom = n.measurements - (scale.known() ? 6 : 7);
  const Matrix7d inverse = solver.solve(Matrix7d(Matrix7d::Identity()));
  out.covariance = std::max(1.0, n.square / std::max(1.0, freedom)) * 0.5 * (inverse + inverse.transpose());
  out.found = out.T_a_b.t.allFinite() && out.covariance.allFinite();
  if (!out.found) out.reason = "the cameras contradict each other";
  return out;
}

}  // namespace view_match
