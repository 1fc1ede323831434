#include <algorithm>
#include <cmath>

#include "icp_refine/icp_stages.h"
#include "registry.h"

namespace icp_refine {
namespace {

float squaredDistance(const MatchedClouds& c, std::size_t i) {
  return (c.reading.points[i] - c.reference.points[c.matches.reference_index[i]]).squaredNorm();
}

// Distances [m^2] of the matches that still count, as a sample for order statistics.
std::vector<float> squaredDistances(const MatchedClouds& c, const std::vector<float>& weights) {
  std::vector<float> d;
  d.reserve(weights.size());
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] > 0) d.push_back(squaredDistance(c, i));
  }
  return d;
}

class Trimmed : public OutlierFilter {
 public:
  explicit Trimmed(const Parameters& p) : ratio_(p("ratio")) {}
  void apply(const MatchedClouds& c, std::vector<float>& weights) const override {
    auto d = squaredDistances(c, weights);
    if (d.empty()) return;
    const auto k = std::min(d.size() - 1, static_cast<std::size_t>(ratio_ * static_cast<double>(d.size())));
    std::nth_element(d.begin(), d.begin() + static_cast<std::ptrdiff_t>(k), d.end());
    for (std::size_t i = 0; i < weights.size(); ++i) {
      if (weights[i] > 0 && squaredDistance(c, i) > d[k]) weights[i] = 0;
    }
  }

 private:
  double ratio_;
};

class NormalAngle : public OutlierFilter {
 public:
  explicit NormalAngle(const Parameters& p) : min_cos_(std::cos(p("max"))), signed_(p("oriented") != 0) {}
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
  explicit Cauchy(const Parameters& p) : scale_(p("scale")) {}
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
Filter make(const Parameters& p) {
  return std::make_unique<T>(p);
}

const std::vector<StageEntry<Filter>>& table() {
  static const std::vector<StageEntry<Filter>> entries = {
      {{"Trimmed", "Keeps the nearest share of the matches", {{"ratio", "share kept", 0.85, 0.01, 1}}}, make<Trimmed>},
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
