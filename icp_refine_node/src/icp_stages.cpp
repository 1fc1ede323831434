#include "icp_refine/icp_stages.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <sstream>

#include "registry.h"

namespace icp_refine {
namespace {

class Iterations : public TransformationChecker {
 public:
  explicit Iterations(const StageParameters& p) : max_(static_cast<int>(p("max"))) {}
  void reset(const Similarity&, const Eigen::Vector3d&) override { count_ = 0; }
  Check check(const Similarity&, std::string&) override {
    return ++count_ >= max_ ? Check::kConverged : Check::kContinue;
  }

 private:
  int max_, count_ = 0;
};

class Differential : public TransformationChecker {
 public:
  explicit Differential(const StageParameters& p)
      : limits_(p("translation"), p("rotation"), p("scale")), smooth_(static_cast<std::size_t>(p("smooth"))) {}
  void reset(const Similarity& T, const Eigen::Vector3d& centre) override {
    last_ = T;
    centre_ = centre;
    steps_.clear();
  }
  Check check(const Similarity& T, std::string&) override {
    steps_.emplace_back((T * centre_ - last_ * centre_).norm(), air_ground_common::rotationAngle(T.R, last_.R),
                        std::abs(std::log(T.scale / last_.scale)));
    last_ = T;
    if (steps_.size() > smooth_) steps_.pop_front();
    if (steps_.size() < smooth_) return Check::kContinue;
    Eigen::Array3d sum = Eigen::Array3d::Zero();
    for (const auto& s : steps_) sum += s;
    return (sum < limits_ * static_cast<double>(smooth_)).all() ? Check::kConverged : Check::kContinue;
  }

 private:
  Eigen::Array3d limits_;  // [m], [rad], relative
  std::size_t smooth_;
  Similarity last_;
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
  std::deque<Eigen::Array3d> steps_;
};

class Bound : public TransformationChecker {
 public:
  explicit Bound(const StageParameters& p)
      : translation_(p("translation")), rotation_(p("rotation")), scale_(p("scale")) {}
  void reset(const Similarity& T, const Eigen::Vector3d& centre) override {
    initial_ = T;
    centre_ = centre;
  }
  Check check(const Similarity& T, std::string& why) override {
    const double t = (T * centre_ - initial_ * centre_).norm();
    const double r = air_ground_common::rotationAngle(T.R, initial_.R);
    const double s = std::abs(std::log(T.scale / initial_.scale));
    if (t <= translation_ && r <= rotation_ && s <= scale_) return Check::kContinue;
    std::ostringstream message;
    message.precision(3);
    message << "moved " << t << " m, " << r * 180 / M_PI << " deg and " << 100 * s
            << " % in scale from the initial guess, beyond Bound's " << translation_ << " m, " << rotation_ * 180 / M_PI
            << " deg and " << 100 * scale_ << " %";
    why = message.str();
    return Check::kFailed;
  }

 private:
  double translation_, rotation_, scale_;
  Similarity initial_;
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
};

template <class Base, class T>
std::unique_ptr<Base> make(const StageParameters& p) {
  return std::make_unique<T>(p);
}

const std::vector<StageEntry<Matcher>>& matcherTable() {
  static const std::vector<StageEntry<Matcher>> entries = {
      {{"KdTree",
        "Nearest reference point by a kd-tree",
        {{"max_distance", "farther points have no match [m]; with normal_weight, in the joint space", 0.5, 1e-4, 1e6},
         {"normal_weight", "0: by place only; else by place and normal, 1 rad counting for this [m]", 0, 0, 100}}},
       [](const StageParameters& p) {
         return Matcher{static_cast<float>(p("max_distance")), static_cast<float>(p("normal_weight"))};
       }}};
  return entries;
}

const std::vector<StageEntry<ErrorMinimizer>>& minimizerTable() {
  static const std::vector<StageEntry<ErrorMinimizer>> entries = {
      {{"PointToPlane",
        "Gauss-Newton step of the weighted squares of n . (p - q)",
        {{"dof", "4: x y z and yaw, when both maps hang from gravity; 6: and roll, pitch; 7: and scale", 6, 4, 7}}},
       [](const StageParameters& p) {
         const double dof = p("dof");
         if (dof != 4 && dof != 6 && dof != 7) throw ConfigError("PointToPlane: parameter 'dof' must be 4, 6 or 7");
         return ErrorMinimizer{static_cast<int>(dof)};
       }}};
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
         {"scale", "relative", 3e-4, 0, 1},
         {"smooth", "steps averaged", 3, 1, 100}}},
       make<TransformationChecker, Differential>},
      {{"Bound",
        "Fails when the pose leaves the neighbourhood of the initial guess",
        {{"translation", "[m]", 1, 0, 1e6}, {"rotation", "[rad]", 0.35, 0, 3.2}, {"scale", "relative", 0.3, 0, 10}}},
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
ErrorMinimizer makeErrorMinimizer(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(minimizerTable(), "error minimiser", name, parameters);
}
std::unique_ptr<TransformationChecker> makeChecker(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(checkerTable(), "checker", name, parameters);
}

void match(const Matcher& matcher, const NeighborSearch& tree, const Cloud& reading, Matches& matches) {
  const int n = static_cast<int>(reading.size());
  matches.reference_index.resize(n);
  matches.traces.resize(n);
  matches.weights.resize(n);
  const bool normals = reading.hasNormals();
#pragma omp parallel for schedule(dynamic, 256)  // a thread may have to share its core
  for (int i = 0; i < n; ++i) {
    const Eigen::Vector3f normal = normals ? reading.normals[i] : Eigen::Vector3f(Eigen::Vector3f::Zero());
    int& index = matches.reference_index[i];
    index = tree.nearest(reading.points[i], normal, matcher.max_distance, matches.traces[i]);
    matches.weights[i] = index >= 0 ? 1.f : 0.f;
  }
}

Vector7d jacobian(const MatchedClouds& c, std::size_t i, const Eigen::Vector3d& centre) {
  const Eigen::Vector3d n = c.reference.normals[c.matches.reference_index[i]].cast<double>();
  const Eigen::Vector3d lever = c.reading.points[i].cast<double>() - centre;
  Vector7d J;
  J << n, lever.cross(n), n.dot(lever);
  return J;
}

NormalEquations normalEquations(const MatchedClouds& c, const std::vector<float>& weights) {
  NormalEquations out;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weight = 0;
  std::size_t used = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] <= 0) continue;
    sum += weights[i] * c.reading.points[i].cast<double>();
    weight += weights[i];
    ++used;
  }
  if (used < 6 || !(weight > 0)) return out;
  out.used = used;
  out.weight = weight;
  out.centre = sum / weight;
  double range = 0, slope = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] <= 0) continue;
    const Vector7d J = jacobian(c, i, out.centre);
    const double w = weights[i], r = c.residual(i);
    for (int k = 0; k < 7; ++k) out.hessian.col(k).head(k + 1) += w * J[k] * J.head(k + 1);
    out.gradient += w * r * J;
    out.square += w * r * r;
    slope += w * (2 * w - 1);
    range += w * (c.reading.points[i].cast<double>() - out.centre).norm();
  }
  for (int row = 1; row < 7; ++row) {
    for (int column = 0; column < row; ++column) out.hessian(row, column) = out.hessian(column, row);
  }
  out.mean_range = range / weight;
  out.slope = std::max(0.2, slope / weight);  // less would be no minimum
  return out;
}

}  // namespace icp_refine
