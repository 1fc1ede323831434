// Data filters: change a cloud before the iterations (sampling, normals, removal of points). Deterministic.
#pragma once

#include <memory>

#include "icp_refine/cloud.h"
#include "icp_refine/stage.h"

namespace icp_refine {

class DataFilter {
 public:
  virtual ~DataFilter() = default;
  /// Changes the cloud in place. An empty cloud stays empty.
  virtual void apply(Cloud& cloud) const = 0;
};
using DataFilters = std::vector<std::unique_ptr<DataFilter>>;

/// All data filters with their parameters.
std::vector<StageDoc> dataFilterDocs();

/// Throws ConfigError for an unknown name or bad parameters.
std::unique_ptr<DataFilter> makeDataFilter(const std::string& name, const YAML::Node& parameters);

}  // namespace icp_refine
