// Rendering: images of both cameras, and depth by packets against one ray after the other.
#include <benchmark/benchmark.h>
#include <omp.h>

#include "air_ground_common/mesh.h"
#include "air_ground_sim/build_world.h"
#include "air_ground_sim/recording.h"

namespace {

using namespace air_ground_sim;
using air_ground_common::Pose;

struct Setup {
  SimConfig config = SimConfig::defaults();
  World world;
  Setup() {
    omp_set_num_threads(1);
    config.world.texel = 0.005;
    for (const Eigen::Vector2d& center :
         {Eigen::Vector2d(-0.9, 0.5), Eigen::Vector2d(0.9, 0.8), Eigen::Vector2d(0.3, -1)}) {
      ClusterConfig cluster;
      cluster.center = center;
      config.world.clusters.push_back(cluster);
    }
    config.lane.points = {{2.5, -1.2}, {2.7, 0.2}, {2.3, 1.6}, {1.2, 2.5}};
    world = buildWorld(config, 1);
  }
  Pose mavPose() const { return air_ground_common::yawPose(0.3, {0.2, 0.1, 2.3}) * config.T_mav_base_camera; }
  Pose groundPose() const { return air_ground_common::yawPose(2.8, {2.6, -0.5, 0}) * config.T_ground_base_camera; }
};

const Setup& setup() {
  static const Setup s;
  return s;
}

const Scene& scene() {
  static const Scene s(setup().world);
  return s;
}

void BM_MavImage(benchmark::State& state) {
  const int samples = static_cast<int>(state.range(0));
  const Renderer renderer(scene(), setup().config.mav_camera.camera, samples, 1);
  std::vector<float> light;
  for (auto _ : state) renderer.light(std::vector<Pose>(samples, setup().mavPose()), 1, &light);
  state.counters["rays"] =
      benchmark::Counter(static_cast<double>(light.size()) * samples, benchmark::Counter::kIsIterationInvariantRate);
}
BENCHMARK(BM_MavImage)->Arg(1)->Arg(4)->Unit(benchmark::kMillisecond);

void BM_GroundImage(benchmark::State& state) {
  const Renderer renderer(scene(), setup().config.ground_camera.camera, 4, 1);
  std::vector<float> light;
  for (auto _ : state) renderer.light(std::vector<Pose>(4, setup().groundPose()), 3, &light);
}
BENCHMARK(BM_GroundImage)->Unit(benchmark::kMillisecond);

void BM_DepthPackets(benchmark::State& state) {
  const Renderer renderer(scene(), setup().config.ground_camera.camera, 1, 1);
  DepthImage image;
  for (auto _ : state) renderer.depth(setup().groundPose(), 0, &image);
}
BENCHMARK(BM_DepthPackets)->Unit(benchmark::kMillisecond);

// Reference for BM_DepthPackets.
void BM_DepthSingleRays(benchmark::State& state) {
  const air_ground_common::MeshScene mesh(meshOf(setup().world));
  const auto& camera = setup().config.ground_camera.camera;
  const Pose T = setup().groundPose();
  std::vector<float> depth(static_cast<std::size_t>(camera.width) * camera.height);
  for (auto _ : state)
    for (int y = 0; y < camera.height; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const Eigen::Vector3d ray = camera.ray({x, y});
        const auto hit = mesh.cast(T.translation().cast<float>(), (T.linear() * ray).cast<float>());
        depth[static_cast<std::size_t>(y) * camera.width + x] = hit ? static_cast<float>(hit->distance * ray.z()) : 0;
      }
  benchmark::DoNotOptimize(depth.data());
}
BENCHMARK(BM_DepthSingleRays)->Unit(benchmark::kMillisecond);

void BM_DepthNoise(benchmark::State& state) {
  const Renderer renderer(scene(), setup().config.ground_camera.camera, 1, 1);
  DepthImage image;
  renderer.depth(setup().groundPose(), 0.075f, &image);
  std::vector<std::uint16_t> mm;
  for (auto _ : state) measureDepth(image, setup().config.depth, 1, 0, &mm);
}
BENCHMARK(BM_DepthNoise)->Unit(benchmark::kMillisecond);

}  // namespace
