#include <cmath>

#include "icp_refine/icp_stages.h"
#include "registry.h"

namespace icp_refine {
namespace {

class NormalAngle : public OutlierFilter {
 public:
  explicit NormalAngle(const StageParameters& p) : min_cos_(std::cos(p("max"))), signed_(p("oriented") != 0) {}
  void apply(const MatchedClouds& c, std::vector<float>& weights) const override {
    if (!c.reading.hasNormals()) throw ConfigError("NormalAngle needs normals: add SurfaceNormals to reading_filters");
    for (std::size_t i = 0; i < weights.size(); ++i) {
      if (weights[i] <= 0) continue;
      float cos = c.reading.normals[i].dot(c.reference.normals[c.matches.reference_index[i]]);
      if (!signed_) cos = std::abs(cos);
      if (cos < min_cos_) weights[i] = 0;
    }
  }

 private:
  float min_cos_;
  bool signed_;
};

class Cauchy : public OutlierFilter {
 public:
  explicit Cauchy(const StageParameters& p) : scale_(p("scale")) {}
  void apply(const MatchedClouds& c, std::vector<float>& weights) const override {
    for (std::size_t i = 0; i < weights.size(); ++i) {
      if (weights[i] <= 0) continue;
      const float u = c.residual(i) / scale_;
      weights[i] /= 1 + u * u;
    }
  }

 private:
  float scale_;
};

using Filter = std::unique_ptr<OutlierFilter>;

template <class T>
Filter make(const StageParameters& p) {
  return std::make_unique<T>(p);
}

const std::vector<StageEntry<Filter>>& table() {
  static const std::vector<StageEntry<Filter>> entries = {
      {{"NormalAngle",
        "Drops matches whose normals differ",
        {{"max", "largest angle [rad]", 0.8, 0, 3.15},
         {"oriented", "0: a normal and its opposite count as the same", 1, 0, 1}}},
       make<NormalAngle>},
      {{"Cauchy", "Weights 1 / (1 + (r/s)^2) by the point-to-plane residual r", {{"scale", "s [m]", 0.05, 1e-4, 100}}},
       make<Cauchy>},
  };
  return entries;
}

}  // namespace

std::vector<StageDoc> outlierFilterDocs() { return docsOf(table()); }

std::unique_ptr<OutlierFilter> makeOutlierFilter(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(table(), "outlier filter", name, parameters);
}

}  // namespace icp_refine
