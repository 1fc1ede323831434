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

float quantile(std::vector<float>& values, double q) {
  const auto k = std::min(values.size() - 1, static_cast<std::size_t>(q * static_cast<double>(values.size())));
  std::nth_element(values.begin(), values.begin() + k, values.end());
  return values[k];
}

void keepNearer(const MatchedClouds& c, float squared_limit, std::vector<float>& weights) {
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (weights[i] > 0 && squaredDistance(c, i) > squared_limit) weights[i] = 0;
  }
}

class Trimmed : public OutlierFilter {
 public:
  explicit Trimmed(const Parameters& p) : ratio_(p("ratio")) {}
  void apply(const MatchedClouds& c, std::vector<float>& weights) const override {
    auto d = squaredDistances(c, weights);
    if (!d.empty()) keepNearer(c, quantile(d, ratio_), weights);
  }

 private:
  double ratio_;
};

class MaxDistance : public OutlierFilter {
 public:
  explicit MaxDistance(const Parameters& p) : limit_(p("max")) {}
  void apply(const MatchedClouds& c, std::vector<float>& weights) const override {
    keepNearer(c, limit_ * limit_, weights);
  }

 private:
  float limit_;
};

class MedianDistance : public OutlierFilter {
 public:
  explicit MedianDistance(const Parameters& p) : factor_(p("factor")) {}
  void apply(const MatchedClouds& c, std::vector<float>& weights) const override {
    auto d = squaredDistances(c, weights);
    if (!d.empty()) keepNearer(c, factor_ * factor_ * quantile(d, 0.5), weights);
  }

 private:
  float factor_;
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

// M-estimators on the point-to-plane residual r with scale s: fixed, or from the data (1.4826 times the median of |r|).
class RobustKernel : public OutlierFilter {
 public:
  enum class Kind { kHuber, kCauchy, kTukey };
  RobustKernel(Kind kind, const Parameters& p) : kind_(kind), scale_(p("scale")), adaptive_(p("adaptive") != 0) {}
  void apply(const MatchedClouds& c, std::vector<float>& weights) const override {
    float s = scale_;
    if (adaptive_) {
      std::vector<float> r;
      for (std::size_t i = 0; i < weights.size(); ++i) {
        if (weights[i] > 0) r.push_back(std::abs(c.residual(i)));
      }
      if (r.empty()) return;
      s = std::max(scale_, 1.4826f * quantile(r, 0.5));
    }
    for (std::size_t i = 0; i < weights.size(); ++i) {
      if (weights[i] > 0) weights[i] *= weight(std::abs(c.residual(i)) / s);
    }
  }

 private:
  float weight(float u) const {
    switch (kind_) {
      case Kind::kHuber:
        return u <= 1 ? 1 : 1 / u;
      case Kind::kCauchy:
        return 1 / (1 + u * u);
      case Kind::kTukey:
        return u < 1 ? (1 - u * u) * (1 - u * u) : 0;
    }
    return 0;
  }

  Kind kind_;
  float scale_;
  bool adaptive_;
};

using Filter = std::unique_ptr<OutlierFilter>;

StageEntry<Filter> kernelEntry(const std::string& name, const std::string& formula, double scale,
                               RobustKernel::Kind kind) {
  return {{name,
           "Weights by the point-to-plane residual r: " + formula,
           {{"scale", "s [m]; with adaptive, its smallest value", scale, 1e-4, 100},
            {"adaptive", "1: s = 1.4826 median |r| of the matches left", 0, 0, 1}}},
          [kind](const Parameters& p) { return Filter(std::make_unique<RobustKernel>(kind, p)); }};
}

template <class T>
Filter make(const Parameters& p) {
  return std::make_unique<T>(p);
}

const std::vector<StageEntry<Filter>>& table() {
  static const std::vector<StageEntry<Filter>> entries = {
      {{"Trimmed", "Keeps the nearest share of the matches", {{"ratio", "share kept", 0.85, 0.01, 1}}}, make<Trimmed>},
      {{"MaxDistance", "Drops matches farther apart", {{"max", "[m]", 0.3, 1e-4, 1e6}}}, make<MaxDistance>},
      {{"MedianDistance",
        "Drops matches farther apart than a multiple of the median",
        {{"factor", "multiple", 3, 0.1, 1e3}}},
       make<MedianDistance>},
      {{"NormalAngle",
        "Drops matches whose normals differ",
        {{"max", "largest angle [rad]", 0.8, 0, 3.15},
         {"oriented", "0: a normal and its opposite count as the same", 1, 0, 1}}},
       make<NormalAngle>},
      kernelEntry("Huber", "1 below s, s/|r| above", 0.03, RobustKernel::Kind::kHuber),
      kernelEntry("Cauchy", "1 / (1 + (r/s)^2)", 0.05, RobustKernel::Kind::kCauchy),
      kernelEntry("Tukey", "(1 - (r/s)^2)^2 below s, 0 above", 0.1, RobustKernel::Kind::kTukey),
  };
  return entries;
}

}  // namespace

std::vector<StageDoc> outlierFilterDocs() { return docsOf(table()); }

std::unique_ptr<OutlierFilter> makeOutlierFilter(const std::string& name, const YAML::Node& parameters) {
  return makeFrom(table(), "outlier filter", name, parameters);
}

}  // namespace icp_refine
