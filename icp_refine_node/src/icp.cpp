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
  ErrorMinimizer minimizer;
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
         {"noise_floor", "smallest standard deviation of a block's mean residual [m]", d.noise_floor, 0, 1},
         {"map_translation_sigma", "drift of the maps that no residual shows, an axis [m]", d.map_translation_sigma, 0,
          10},
         {"map_rotation_sigma", "likewise [rad]", d.map_rotation_sigma, 0, 1},
         {"map_scale_sigma", "likewise, relative", d.map_scale_sigma, 0, 1},
         {"inflation", "factor on the standard deviation of the residuals' part", d.inflation, 0.01, 100}}};
  }();
  return doc;
}

// One level at work: the reading as it is placed now, its matches and their weights.
class Iteration {
 public:
  Iteration(const Level& level, const Cloud& reading, const IcpReference& reference, const NeighborSearch& tree)
      : level_(level), reading_(reading), reference_(reference), tree_(tree) {}

  /// Matches and weighs at T. False when fewer than 6 matches count.
  bool update(const Similarity& T) {
    moved_ = transformed(reading_, T);
    match(level_.matcher, tree_, moved_, matches_);
    weights_ = matches_.weights;
    for (const auto& f : level_.outlier_filters) f->apply(clouds(), weights_);
    equations_ = normalEquations(clouds(), weights_);
    return equations_.used > 0;
  }
  MatchedClouds clouds() const { return {moved_, reference_.cloud(), matches_}; }
  const std::vector<float>& weights() const { return weights_; }
  const NormalEquations& equations() const { return equations_; }

 private:
  const Level& level_;
  const Cloud& reading_;
  const IcpReference& reference_;
  const NeighborSearch& tree_;
  Cloud moved_;
  Matches matches_;
  std::vector<float> weights_;
  NormalEquations equations_;
};

Similarity normalized(Similarity T) {
  T.R = air_ground_common::normalized(poseOf(T)).linear();
  return T;
}

}  // namespace

struct IcpChain::Impl {
  DataFilters reading_filters, reference_filters;
  std::vector<Level> levels;
  LocalizabilitySettings localizability;
  CovarianceSettings covariance;

  // Statistics at the solution, with the last level's matches.
  void describe(const Iteration& at, int dof, const Priors& priors, IcpResult& out) const {
    const NormalEquations& equations = at.equations();
    out.centre = equations.centre;
    out.hessian = equations.hessian;
    out.inliers = equations.used;
    out.residual_rms = std::sqrt(equations.square / equations.weight);
    out.localizability = analyzeLocalizability(at.clouds(), at.weights(), equations, localizability, priors.scale.mode);
    const Matrix7d scatter = gradientScatter(at.clouds(), at.weights(), equations.centre, covariance);
    out.covariance = estimateCovariance(equations, out.localizability, scatter, dof, priors, covariance);
    out.scale_estimated = estimatesScale(out.localizability, dof, priors.scale);
  }
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
  const StageParameters l(localizabilityDoc(), config["localizability"]);
  impl_->localizability = {l("strong"), static_cast<int>(l("min_points")), l("min_share"),
                           static_cast<int>(l("min_patches")), l("patch_size")};
  const StageParameters c(covarianceDoc(), config["covariance"]);
  impl_->covariance = {c("block_size"),         c("noise_floor"),     c("map_translation_sigma"),
                       c("map_rotation_sigma"), c("map_scale_sigma"), c("inflation")};
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

Cloud IcpChain::filteredReference(Cloud cloud) const {
  removeInvalid(cloud);
  for (const auto& f : impl_->reference_filters) f->apply(cloud);
  if (!cloud.empty() && !cloud.hasNormals()) {
    throw ConfigError("point-to-plane needs normals: add SurfaceNormals to reference_filters");
  }
  return cloud;
}

IcpReference IcpChain::searchable(Cloud filtered) const {
  IcpReference out;
  out.cloud_ = std::move(filtered);
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

IcpResult IcpChain::align(const Cloud& reading, const IcpReference& reference, const Similarity& T_initial,
                          const Priors& priors) const {
  const auto start = std::chrono::steady_clock::now();
  IcpResult out;
  out.T_reference_reading = T_initial;
  const auto fail = [&](const std::string& why) {
    out.reason = why;
    out.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return out;
  };
  if (reading.empty()) return fail("the reading has no point left after its filters");
  if (reference.empty()) return fail("the reference has no point left after its filters");
  if (!isValid(T_initial)) return fail("the initial guess is not a rigid transform with a positive scale");

  const Eigen::Vector3d centre = middle(reading);
  Similarity T = T_initial;
  for (const Level& level : impl_->levels) {
    const bool last = &level == &impl_->levels.back();
    Cloud sampled = reading;
    for (const auto& f : level.reading_filters) f->apply(sampled);
    for (const auto& c : level.checkers) c->reset(T_initial, centre);
    Iteration iteration(level, sampled, reference, reference.trees_.at(level.matcher.normal_weight));

    for (bool running = true; running;) {
      ++out.iterations;
      if (!iteration.update(T))
        return fail("fewer than 6 matches are left: the clouds do not overlap at the initial guess");
      const NormalEquations& equations = iteration.equations();
      const auto localizability = analyzeLocalizability(iteration.clouds(), iteration.weights(), equations,
                                                        impl_->localizability, priors.scale.mode);
      // It weighs the priors.
      const int dof = level.minimizer.dof;
      const bool weigh =
          (dof == 7 && priors.scale.mode == ScalePrior::Mode::kPrior) || (dof > 4 && std::isfinite(priors.tilt_stddev));
      const Matrix7d scatter =
          weigh ? gradientScatter(iteration.clouds(), iteration.weights(), equations.centre, impl_->covariance)
                : Matrix7d(Matrix7d::Zero());
      const Vector7d step = constrainedStep(equations, localizability, scatter, dof, priors, T, impl_->covariance);
      T = normalized(compose(motion(step, equations.centre), T));

      for (const auto& c : level.checkers) {
        std::string why;
        const Check check = c->check(T, why);
        if (check == Check::kFailed) return fail(why);
        if (check == Check::kConverged) running = false;
      }
    }
    if (!last) continue;
    if (!iteration.update(T)) return fail("fewer than 6 matches are left at the solution");
    out.T_reference_reading = T;
    impl_->describe(iteration, level.minimizer.dof, priors, out);
    out.overlap = static_cast<double>(out.inliers) / static_cast<double>(sampled.size());
  }
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
