// Memory that runs out, at any allocation of a filter: an exception for the caller, never the end of the process.
#include <yaml-cpp/yaml.h>

#include "air_ground_common/testing/failing_memory.h"
#include "icp_refine/data_filters.h"
#include "synthetic_scene.h"

namespace icp_refine {
namespace {

using air_ground_common::testing::failuresWithoutMemory;

TEST(OutOfMemory, DataFiltersThrow) {
  Cloud cloud = synthetic::makeScene(3).aerial;
  cloud.points.resize(3000);
  const auto normals = makeDataFilter("SurfaceNormals", YAML::Node());
  const auto outliers = makeDataFilter("StatisticalOutlier", YAML::Node());
  for (const auto* filter : {&normals, &outliers}) {
    EXPECT_GT(failuresWithoutMemory([&] {
                Cloud copy = cloud;
                (*filter)->apply(copy);
              }),
              8);
  }
}

}  // namespace
}  // namespace icp_refine
