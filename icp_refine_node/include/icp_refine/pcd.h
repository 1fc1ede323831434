// PCD files of labelled points.
#pragma once

#include <string>
#include <vector>

#include "air_ground_common/mesh.h"

namespace icp_refine {

/// Binary PCD v0.7 with x y z rgb source. Written through a temporary file; throws std::runtime_error.
void writePcd(const std::string& path, const std::vector<air_ground_common::LabeledPoint>& points);

}  // namespace icp_refine
