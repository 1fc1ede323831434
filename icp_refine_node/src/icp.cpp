#include "icp_refine/icp.h"

#include <chrono>
#include <cmath>
#include <sstream>

#include "registry.h"

namespace icp_refine {
namespace {

using Filters = std::vector<std::unique_ptr<OutlierFilter>>;
using Checkers = std::vector<std::unique_ptr<TransformationChecker>>;

struct Level {
  DataFilters reading_filters;
  Matcher matcher;
  Filters outlier_filters;
  std::unique_ptr<ErrorMinimizer> minimizer;
  Checkers checkers;
};

struct NamedStage {
  std::string name;
  YAML::Node parameters;
};

NamedStage namedStage(const YAML::Node& node, const std::string& where) {
  if (node.IsScalar()) return {node.as<std::string>(), YAML::Node()};
  if (node.IsMap() && node.size() == 1) return {node.begin()->first.as<std::string>(), node.begin()->second};
  throw ConfigError(where + ": a stage is written 'Name' or 'Name: {parameter: value}'");
}

std::vector<NamedStage> stageList(const YAML::Node& node, const std::string& where) {
  std::vector<NamedStage> out;
  if (!node || node.IsNull()) return out;
  if (!node.IsSequence()) throw ConfigError(where + " must be a list of stages");
  for (const auto& item : node) out.push_back(namedStage(item, where));
  return out;
}

void checkKeys(const YAML::Node& node, const std::string& where, const std::vector<std::string>& known) {
  if (!node.IsMap()) throw ConfigError(where + " must be a map");
  for (const auto& item : node) {
    const auto key = item.first.as<std::string>();
    bool found = false;
    std::string names;
    for (const auto& k : known) {
      found |= k == key;
      names += (names.empty() ? "" : ", ") + k;
    }
    if (!found) throw ConfigError(where + ": unused entry '" + key + "'; it has: " + names);
  }
}

DataFilters dataFilters(const YAML::Node& node, const std::string& where) {
  DataFilters out;
  for (const auto& s : stageList(node, where)) out.push_back(makeDataFilter(s.name, s.parameters));
  return out;
}

const StageDoc& localizabilityDoc() {
  static const StageDoc doc = [] {
    const LocalizabilitySettings d;
    return StageDoc{"localizability",
                    "Which directions of the pose the geometry can fix",
                    {{"strong", "a match counts for a direction with at least this component of its scaled Jacobian",
                      d.strong, 0, 1},
                     {"min_points", "strong matches that a direction needs", double(d.min_points), 1, 1e6},
                     {"min_share", "and as a share of all matches", d.min_share, 0, 1},
                     {"min_patches", "in at least so many cells", double(d.min_patches), 1, 1e6},
                     {"patch_size", "edge of a cell [m]", d.patch_size, 1e-3, 10}}};
  }();
  return doc;
}

const StageDoc& covarianceDoc() {
  static const StageDoc doc = [] {
    const CovarianceSettings d;
    return StageDoc{
        "covariance",
        "Covariance of the pose",
        {{"block_size", "residuals in a block of this edge count as one observation [m]", d.block_size, 1e-3, 100},
         {"scale_sigma", "standard deviation of the relative scale of the two maps", d.scale_sigma, 0, 1},
         {"noise_floor", "smallest standard deviation of a block's mean residual [m]", d.noise_floor, 0, 1},
         {"map_translation_sigma", "drift of the maps that no residual shows, an axis [m]", d.map_translation_sigma, 0,
          10},
         {"map_rotation_sigma", "likewise [rad]", d.map_rotation_sigma, 0, 1},
         {"inflation", "factor on the standard deviation of the residuals' part", d.inflation, 0.01, 100}}};
  }();
  return doc;
}

// The step without its part along directions that the geometry does not fix: there it would only follow the noise.
// Eigenvectors of the Hessian are conjugate, so that this is the minimum under the hard constraint (Tuna 2024).
Vector6d constrained(const Step& step, const Localizability& localizability, bool four_dof) {
  if (localizability.complete()) return step.delta;
  Vector6d scale = Vector6d::Ones();
  scale.tail<3>().setConstant(localizability.mean_range);
  Vector6d d = scale.cwiseProduct(step.delta);
  for (const auto& direction : localizability.directions) {
    if (!direction.localizable) d -= direction.v * direction.v.dot(d);
  }
  d = d.cwiseQuotient(scale.cwiseMax(1e-9)).eval();
  if (four_dof) d.segment<2>(3).setZero();
  return d;
}

// p' = centre + exp(rotation) (p - centre) + translation.
Pose motion(const Vector6d& delta, const Eigen::Vector3d& centre) {
  Pose out = Pose::Identity();
  out.linear() = air_ground_common::expSO3(delta.tail<3>());
  out.translation() = centre + delta.head<3>() - out.linear() * centre;
  return out;
}

}  // namespace

struct IcpChain::Impl {
  DataFilters reading_filters, reference_filters;
  std::vector<Level> levels;
  LocalizabilitySettings localizability;
  CovarianceSettings covariance;
};

IcpChain::IcpChain(const YAML::Node& config) : impl_(std::make_unique<Impl>()) {
  checkKeys(config, "chain", {"reading_filters", "reference_filters", "levels", "localizability", "covariance"});
  impl_->reading_filters = dataFilters(config["reading_filters"], "reading_filters");
  impl_->reference_filters = dataFilters(config["reference_filters"], "reference_filters");
  const YAML::Node levels = config["levels"];
  if (!levels || !levels.IsSequence() || levels.size() == 0)
    throw ConfigError("chain: 'levels' must list at least one level");
  for (std::size_t i = 0; i < levels.size(); ++i) {
    const std::string where = "levels[" + std::to_string(i) + "]";
    const YAML::Node node = levels[i];
    checkKeys(node, where, {"reading_filters", "matcher", "outlier_filters", "error_minimizer", "checkers"});
    for (const char* required : {"matcher", "error_minimizer", "checkers"}) {
      if (!node[required]) throw ConfigError(where + ": '" + required + "' is missing");
    }
    Level level;
    level.reading_filters = dataFilters(node["reading_filters"], where + ".reading_filters");
    const auto matcher = namedStage(node["matcher"], where + ".matcher");
    level.matcher = makeMatcher(matcher.name, matcher.parameters);
    for (const auto& s : stageList(node["outlier_filters"], where + ".outlier_filters")) {
      level.outlier_filters.push_back(makeOutlierFilter(s.name, s.parameters));
    }
    const auto minimizer = namedStage(node["error_minimizer"], where + ".error_minimizer");
    level.minimizer = makeErrorMinimizer(minimizer.name, minimizer.parameters);
    bool bounded = false;
    for (const auto& s : stageList(node["checkers"], where + ".checkers")) {
      level.checkers.push_back(makeChecker(s.name, s.parameters));
      bounded |= s.name == "Iterations";
    }
    if (!bounded) throw ConfigError(where + ".checkers: 'Iterations' is missing; without it a level may never end");
    impl_->levels.push_back(std::move(level));
  }
  const Parameters l(localizabilityDoc(), config["localizability"]);
  impl_->localizability = {l("strong"), static_cast<int>(l("min_points")), l("min_share"),
                           static_cast<int>(l("min_patches")), l("patch_size")};
  const Parameters c(covarianceDoc(), config["covariance"]);
  impl_->covariance = {c("block_size"),         c("scale_sigma"), c("noise_floor"), c("map_translation_sigma"),
                       c("map_rotation_sigma"), c("inflation")};
}

IcpChain IcpChain::fromString(const std::string& yaml) {
  try {
    return IcpChain(YAML::Load(yaml));
  } catch (const YAML::Exception& e) {
    throw ConfigError(std::string("the chain is no valid YAML: ") + e.what());
  }
}

IcpChain IcpChain::fromFile(const std::string& path) {
  try {
    return IcpChain(YAML::LoadFile(path));
  } catch (const YAML::Exception& e) {
    throw ConfigError("cannot read the chain from " + path + ": " + e.what());
  }
}

IcpChain::~IcpChain() = default;
IcpChain::IcpChain(IcpChain&&) noexcept = default;
IcpChain& IcpChain::operator=(IcpChain&&) noexcept = default;

IcpReference IcpChain::prepareReference(Cloud cloud) const {
  removeInvalid(cloud);
  for (const auto& f : impl_->reference_filters) f->apply(cloud);
  if (!cloud.empty() && !cloud.hasNormals()) {
    throw ConfigError("point-to-plane needs normals: add SurfaceNormals to reference_filters");
  }
  IcpReference out;
  out.cloud_ = std::move(cloud);
  if (out.cloud_.empty()) return out;
  for (const auto& level : impl_->levels) {
    const float weight = level.matcher.normal_weight;
    if (!out.trees_.count(weight)) out.trees_.emplace(weight, NeighborSearch(out.cloud_, weight));
  }
  return out;
}

Cloud IcpChain::prepareReading(Cloud cloud) const {
  removeInvalid(cloud);
  for (const auto& f : impl_->reading_filters) f->apply(cloud);
  return cloud;
}

IcpResult IcpChain::align(const Cloud& reading, const IcpReference& reference, const Pose& T_initial) const {
  const auto start = std::chrono::steady_clock::now();
  IcpResult out;
  out.T_reference_reading = T_initial;
  out.reading_points = reading.size();
  out.reference_points = reference.cloud().size();
  const auto fail = [&](const std::string& why) {
    out.reason = why;
    out.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return out;
  };
  if (reading.empty()) return fail("the reading has no point left after its filters");
  if (reference.empty()) return fail("the reference has no point left after its filters");
  if (!air_ground_common::isValid(T_initial)) return fail("the initial guess is not a rigid transform");

  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const auto& p : reading.points) centre += p.cast<double>();
  centre /= static_cast<double>(reading.size());

  Pose T = T_initial;
  for (std::size_t l = 0; l < impl_->levels.size(); ++l) {
    const Level& level = impl_->levels[l];
    Cloud sampled = reading;
    for (const auto& f : level.reading_filters) f->apply(sampled);
    const NeighborSearch& tree = reference.trees_.at(level.matcher.normal_weight);
    for (const auto& c : level.checkers) c->reset(T_initial, centre);

    for (bool running = true; running;) {
      const Cloud moved = transformed(sampled, T);
      const Matches matches = match(level.matcher, tree, moved);
      const MatchedClouds clouds{moved, reference.cloud(), matches};
      std::vector<float> weights = matches.weights;
      for (const auto& f : level.outlier_filters) f->apply(clouds, weights);
      const Step step = level.minimizer->solve(clouds, weights, T);
      ++out.iterations;
      if (!step.solved) return fail("fewer than 6 matches are left: the clouds do not overlap at the initial guess");
      const auto localizability = analyzeLocalizability(clouds, weights, step.centre, impl_->localizability);
      T = air_ground_common::normalized(
          motion(constrained(step, localizability, level.minimizer->fourDof()), step.centre) * T);

      for (const auto& c : level.checkers) {
        std::string why;
        const Check check = c->check(T, why);
        if (check == Check::kFailed) return fail(why);
        if (check == Check::kConverged) running = false;
      }
    }
  }

  // Statistics at the solution, with the last level's matches.
  const Level& level = impl_->levels.back();
  Cloud sampled = reading;
  for (const auto& f : level.reading_filters) f->apply(sampled);
  const Cloud moved = transformed(sampled, T);
  const Matches matches = match(level.matcher, reference.trees_.at(level.matcher.normal_weight), moved);
  const MatchedClouds clouds{moved, reference.cloud(), matches};
  std::vector<float> weights = matches.weights;
  for (const auto& f : level.outlier_filters) f->apply(clouds, weights);
  const Step step = level.minimizer->solve(clouds, weights, T);
  if (!step.solved) return fail("fewer than 6 matches are left at the solution");
  double sum = 0, total = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] <= 0) continue;
    ++out.inliers;
    total += weights[i];
    sum += weights[i] * clouds.residual(i) * clouds.residual(i);
  }
  out.T_reference_reading = T;
  out.centre = step.centre;
  out.hessian = step.hessian;
  out.overlap = static_cast<double>(out.inliers) / static_cast<double>(sampled.size());
  out.residual_rms = std::sqrt(sum / total);
  out.localizability = analyzeLocalizability(clouds, weights, step.centre, impl_->localizability);
  out.covariance = estimateCovariance(clouds, weights, step, out.localizability, impl_->covariance);
  out.outcome = IcpResult::Outcome::kConverged;
  out.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return out;
}

std::string describeStages() {
  std::ostringstream out;
  const auto list = [&out](const std::string& title, const std::vector<StageDoc>& docs) {
    out << title << ":\n";
    for (const auto& stage : docs) {
      out << "  " << stage.name << ": " << stage.doc << "\n";
      for (const auto& p : stage.parameters) {
        out << "    " << p.name << ": " << p.doc << "; default " << p.default_value << ", range [" << p.min << ", "
            << p.max << "]\n";
      }
    }
  };
  list("data filters", dataFilterDocs());
  list("matchers", matcherDocs());
  list("outlier filters", outlierFilterDocs());
  list("error minimisers", errorMinimizerDocs());
  list("transformation checkers", checkerDocs());
  list("settings", {localizabilityDoc(), covarianceDoc()});
  return out.str();
}

}  // namespace icp_refine
