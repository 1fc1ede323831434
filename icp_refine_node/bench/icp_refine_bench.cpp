// The shipped chain against PCL's IterativeClosestPointWithNormals on the same filtered clouds, from the same start.
// Counters: error_mm at the middle of the aerial map.
#include <benchmark/benchmark.h>
#include <pcl/point_types.h>
#include <pcl/registration/icp.h>
#include <yaml-cpp/yaml.h>

#include "icp_refine/icp.h"
#include "synthetic_scene.h"

namespace {

using namespace icp_refine;

struct Problem {
  Problem()
      : scene(synthetic::makeScene(1)),
        chain(YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"]),
        reference(chain.prepareReference(scene.ground)),
        reading(chain.prepareReading(scene.aerial)),
        centre(synthetic::centroid(scene.aerial)) {
    std::mt19937 rng(2);
    start = synthetic::perturbed(scene.T_ground_map_mav_map, centre, 0.1, 0.05, true, rng);
  }
  double errorMillimetres(const Similarity& T) const { return 1e3 * (T * centre - scene.truth * centre).norm(); }

  synthetic::Scene scene;
  IcpChain chain;
  IcpReference reference;
  Cloud reading;
  Eigen::Vector3d centre;
  Pose start;
};

Problem& problem() {
  static Problem p;
  return p;
}

pcl::PointCloud<pcl::PointNormal>::Ptr toPcl(const Cloud& cloud) {
  auto out = std::make_shared<pcl::PointCloud<pcl::PointNormal>>();
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    pcl::PointNormal p;
    p.getVector3fMap() = cloud.points[i];
    p.getNormalVector3fMap() = cloud.normals[i];
    out->push_back(p);
  }
  return out;
}

void Chain(benchmark::State& state) {
  Problem& p = problem();
  IcpResult result;
  for (auto _ : state) result = p.chain.align(p.reading, p.reference, p.start);
  state.counters["error_mm"] = p.errorMillimetres(result.T_reference_reading);
  state.counters["iterations"] = result.iterations;
  state.counters["points"] = static_cast<double>(p.reading.size());
}
BENCHMARK(Chain)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();

// All that a new aerial cloud costs: filters, normals and alignment.
void FiltersAndChain(benchmark::State& state) {
  Problem& p = problem();
  IcpResult result;
  for (auto _ : state) result = p.chain.align(p.chain.prepareReading(p.scene.aerial), p.reference, p.start);
  state.counters["error_mm"] = p.errorMillimetres(result.T_reference_reading);
}
BENCHMARK(FiltersAndChain)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();

// One level, correspondences up to 0.3 m, no rejection: what PCL does by default.
void PclIcpWithNormals(benchmark::State& state) {
  Problem& p = problem();
  const auto target = toPcl(p.reference.cloud()), source = toPcl(p.reading);
  Eigen::Matrix4f T = Eigen::Matrix4f::Identity();
  for (auto _ : state) {
    pcl::IterativeClosestPointWithNormals<pcl::PointNormal, pcl::PointNormal> icp;
    icp.setInputSource(source);
    icp.setInputTarget(target);
    icp.setMaxCorrespondenceDistance(0.3);
    icp.setMaximumIterations(60);
    icp.setTransformationEpsilon(1e-8);
    pcl::PointCloud<pcl::PointNormal> aligned;
    icp.align(aligned, p.start.matrix().cast<float>());
    T = icp.getFinalTransformation();
  }
  Pose result = Pose::Identity();
  result.matrix() = T.cast<double>();
  state.counters["error_mm"] = p.errorMillimetres(similarity(result));
  state.counters["points"] = static_cast<double>(p.reading.size());
}
BENCHMARK(PclIcpWithNormals)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();

void PrepareReading(benchmark::State& state) {
  Problem& p = problem();
  for (auto _ : state) benchmark::DoNotOptimize(p.chain.prepareReading(p.scene.aerial));
  state.counters["points"] = static_cast<double>(p.scene.aerial.size());
}
BENCHMARK(PrepareReading)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();

void PrepareReference(benchmark::State& state) {
  Problem& p = problem();
  for (auto _ : state) benchmark::DoNotOptimize(p.chain.prepareReference(p.scene.ground));
  state.counters["points"] = static_cast<double>(p.scene.ground.size());
}
BENCHMARK(PrepareReference)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();

}  // namespace
