#include "icp_refine/icp_stages.h"

#include <cmath>
#include <deque>
#include <sstream>

#include "air_ground_common/linear_algebra.h"
#include "registry.h"

namespace icp_refine {
namespace {

class PointToPlane : public ErrorMinimizer {
 public:
  explicit PointToPlane(const Parameters& p)
      : four_dof_(p("dof") == 4),
        symmetric_(p("symmetric") != 0),
        tilt_sigma_(p("tilt_sigma")),
        residual_sigma_(p("residual_sigma")) {
    if (p("dof") != 4 && p("dof") != 6) throw ConfigError("PointToPlane: parameter 'dof' must be 4 or 6");
  }

  bool fourDof() const override { return four_dof_; }

  Step solve(const MatchedClouds& c, const std::vector<float>& weights, const Pose& T) const override {
    Step step;
    double total = 0;
    std::size_t used = 0;
    for (std::size_t i = 0; i < weights.size(); ++i) {
      if (weights[i] <= 0) continue;
      step.centre += weights[i] * c.reading.points[i].cast<double>();
      total += weights[i];
      ++used;
    }
    if (used < 6) return step;
    step.centre /= total;
    Vector6d gradient = Vector6d::Zero();
    Matrix6d system = Matrix6d::Zero();
    for (std::size_t i = 0; i < weights.size(); ++i) {
      if (weights[i] <= 0) continue;
      const int j = c.matches.reference_index[i];
      Eigen::Vector3d n = c.reference.normals[j].cast<double>();
      const Eigen::Vector3d p = c.reading.points[i].cast<double>();
      const Eigen::Vector3d lever = p - step.centre;
      Vector6d J;
      J << n, lever.cross(n);
      step.hessian += weights[i] * J * J.transpose();
      if (symmetric_ && c.reading.hasNormals()) {
        // Mean of both normals: zero error along a curved surface as well as on a plane (Rusinkiewicz 2019).
        const Eigen::Vector3d m = c.reading.normals[i].cast<double>();
        const Eigen::Vector3d both = n.dot(m) < 0 ? Eigen::Vector3d(n - m) : Eigen::Vector3d(n + m);
        if (both.norm() > 0.5) n = both.normalized();
        J << n, lever.cross(n);
      }
      const double r = n.dot(p - c.reference.points[j].cast<double>());
      system += weights[i] * J * J.transpose();
      gradient += weights[i] * r * J;
    }
    if (tilt_sigma_ > 0 && !four_dof_) {
      // Prior: both maps hang from gravity, so T tilts by N(0, tilt_sigma). Weighed against residuals of
      // residual_sigma.
      const double w = residual_sigma_ * residual_sigma_ / (tilt_sigma_ * tilt_sigma_ * kIndependentShare);
      const Eigen::Vector3d tilt = Eigen::Vector3d::UnitZ().cross(T.linear().col(2));
      for (int k : {0, 1}) {
        system(3 + k, 3 + k) += w;
        gradient[3 + k] += w * tilt[k];
      }
    }
    step.solved = four_dof_ ? solveFour(system, gradient, step.delta) : solveSix(system, gradient, step.delta);
    return step;
  }

 private:
  // Neighbouring residuals are alike: about this share of them counts as independent against the prior.
  static constexpr double kIndependentShare = 0.01;

  // Directions that hardly any point constrains get no step, instead of a huge one.
  static bool solveSix(const Matrix6d& H, const Vector6d& g, Vector6d& delta) {
    const auto eigen = air_ground_common::symmetricEigen(H);
    const double limit = 1e-5 * eigen.values[5];
    if (!(limit > 0) || !g.allFinite()) return false;
    delta.setZero();
    for (int k = 0; k < 6; ++k) {
      const auto v = eigen.vectors.col(k);
      if (eigen.values[k] > limit) delta -= v * (v.dot(g) / eigen.values[k]);
    }
    return delta.allFinite();
  }

  static bool solveFour(const Matrix6d& H, const Vector6d& g, Vector6d& delta) {
    constexpr int kIndex[4] = {0, 1, 2, 5};
    Eigen::Matrix4d H4;
    Eigen::Vector4d g4;
    for (int a = 0; a < 4; ++a) {
      g4[a] = g[kIndex[a]];
      for (int b = 0; b < 4; ++b) H4(a, b) = H(kIndex[a], kIndex[b]);
    }
    const auto eigen = air_ground_common::symmetricEigen(H4);
    const double limit = 1e-5 * eigen.values[3];
    if (!(limit > 0) || !g4.allFinite()) return false;
    Eigen::Vector4d d = Eigen::Vector4d::Zero();
    for (int k = 0; k < 4; ++k) {
      const auto v = eigen.vectors.col(k);
      if (eigen.values[k] > limit) d -= v * (v.dot(g4) / eigen.values[k]);
    }
    delta.setZero();
    for (int a = 0; a < 4; ++a) delta[kIndex[a]] = d[a];
    return delta.allFinite();
  }

  bool four_dof_, symmetric_;
  double tilt_sigma_, residual_sigma_;
};

class Iterations : public TransformationChecker {
 public:
  explicit Iterations(const Parameters& p) : max_(static_cast<int>(p("max"))) {}
  void reset(const Pose&, const Eigen::Vector3d&) override { count_ = 0; }
  Check check(const Pose&, std::string&) override { return ++count_ >= max_ ? Check::kConverged : Check::kContinue; }

 private:
  int max_, count_ = 0;
};

class Differential : public TransformationChecker {
 public:
  explicit Differential(const Parameters& p)
      : translation_(p("translation")), rotation_(p("rotation")), smooth_(static_cast<std::size_t>(p("smooth"))) {}
  void reset(const Pose& T, const Eigen::Vector3d& centre) override {
    last_ = T;
    centre_ = centre;
    steps_.clear();
  }
  Check check(const Pose& T, std::string&) override {
    steps_.emplace_back((T * centre_ - last_ * centre_).norm(),
                        air_ground_common::rotationAngle(T.linear(), last_.linear()));
    last_ = T;
    if (steps_.size() > smooth_) steps_.pop_front();
    if (steps_.size() < smooth_) return Check::kContinue;
    double t = 0, r = 0;
    for (const auto& s : steps_) t += s.first, r += s.second;
    const double n = static_cast<double>(steps_.size());
    return t / n < translation_ && r / n < rotation_ ? Check::kConverged : Check::kContinue;
  }

 private:
  double translation_, rotation_;
  std::size_t smooth_;
  Pose last_ = Pose::Identity();
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
  std::deque<std::pair<double, double>> steps_;
};

class Bound : public TransformationChecker {
 public:
  explicit Bound(const Parameters& p) : translation_(p("translation")), rotation_(p("rotation")) {}
  void reset(const Pose& T, const Eigen::Vector3d& centre) override {
    initial_ = T;
    centre_ = centre;
  }
  Check check(const Pose& T, std::string& why) override {
    const double t = (T * centre_ - initial_ * centre_).norm();
    const double r = air_ground_common::rotationAngle(T.linear(), initial_.linear());
    if (t <= translation_ && r <= rotation_) return Check::kContinue;
    std::ostringstream message;
    message.precision(3);
    message << "moved " << t << " m and " << r * 180 / M_PI << " deg from the initial guess, beyond Bound's "
            << translation_ << " m and " << rotation_ * 180 / M_PI << " deg";
    why = message.str();
    return Check::kFailed;
  }

 private:
  double translation_, rotation_;
  Pose initial_ = Pose::Identity();
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
};

template <class Base, class T>
std::unique_ptr<Base> make(const Parameters& p) {
  return std::make_unique<T>(p);
}

const std::vector<StageEntry<Matcher>>& matcherTable() {
  static const std::vector<StageEntry<Matcher>> entries = {
      {{"KdTree",
        "Nearest reference point by a kd-tree (PCL, FLANN)",
        {{"max_distance", "farther points have no match [m]; with normal_weight, in the joint space", 0.5, 1e-4, 1e6},
         {"normal_weight", "0: by place only; else by place and normal, 1 rad counting for this [m]", 0, 0, 100}}},
       [](const Parameters& p) {
         return Matcher{static_cast<float>(p("max_distance")), static_cast<float>(p("normal_weight"))};
       }}};
  return entries;
}

const std::vector<StageEntry<std::unique_ptr<ErrorMinimizer>>>& minimizerTable() {
  static const std::vector<StageEntry<std::unique_ptr<ErrorMinimizer>>> entries = {
      {{"PointToPlane",
        "Gauss-Newton step of the weighted squares of n . (p - q)",
        {{"dof", "6, or 4: x y z and yaw, when both maps hang from gravity", 6, 4, 6},
         {"symmetric", "1: mean of both normals instead of the reference's", 0, 0, 1},
         {"tilt_sigma", "6 degrees of freedom: standard deviation of the maps' relative tilt [rad], 0 = no prior", 0, 0,
          1},
         {"residual_sigma", "standard deviation of a residual that the tilt prior is weighed against [m]", 0.03, 1e-4,
          10}}},
       make<ErrorMinimizer, PointToPlane>}};
  return entries;
}

const std::vector<StageEntry<std::unique_ptr<TransformationChecker>>>& checkerTable() {
  static const std::vector<StageEntry<std::unique_ptr<TransformationChecker>>> entries = {
      {{"Iterations", "Ends after a number of iterations", {{"max", "iterations", 30, 1, 1e6}}},
       make<TransformationChecker, Iterations>},
      {{"Differential",
        "Ends when the mean of the last steps is small",
        {{"translation", "[m]", 5e-4, 0, 10},
         {"rotation", "[rad]", 3e-4, 0, 3.2},
         {"smooth", "steps averaged", 3, 1, 100}}},
       make<TransformationChecker, Differential>},
      {{"Bound",
        "Fails when the pose leaves the neighbourhood of the initial guess",
        {{"translation", "[m]", 1, 0, 1e6}, {"rotation", "[rad]", 0.35, 0, 3.2}}},
       make<TransformationChecker, Bound>}};
  return entries;
}

}  // namespace

std::vector<StageDoc> matcherDocs() { return docsOf(matcherTable()); }
std::vector<StageDoc> errorMinimizerDocs() { return docsOf(minimizerTable()); }
std::vector<StageDoc> checkerDocs() { return docsOf(checkerTable()); }

Matcher makeMatcher(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(matcherTable(), "matcher", name, parameters);
}
std::unique_ptr<ErrorMinimizer> makeErrorMinimizer(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(minimizerTable(), "error minimiser", name, parameters);
}
std::unique_ptr<TransformationChecker> makeChecker(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(checkerTable(), "checker", name, parameters);
}

Matches match(const Matcher& matcher, const NeighborSearch& tree, const Cloud& reading) {
  const int n = static_cast<int>(reading.size());
  Matches out;
  out.reference_index.resize(n);
  out.weights.resize(n);
  const bool normals = reading.hasNormals();
#pragma omp parallel for schedule(static)
  for (int i = 0; i < n; ++i) {
    const Eigen::Vector3f normal = normals ? reading.normals[i] : Eigen::Vector3f(Eigen::Vector3f::Zero());
    out.reference_index[i] = tree.nearest(reading.points[i], normal, matcher.max_distance);
    out.weights[i] = out.reference_index[i] >= 0 ? 1.f : 0.f;
  }
  return out;
}

}  // namespace icp_refine
