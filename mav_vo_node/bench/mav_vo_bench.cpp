// Costs of the odometry's parts and of a whole image.
#include <benchmark/benchmark.h>

#include "../test/synthetic_camera.h"
#include "mav_vo/odometry.h"
#include "mav_vo/scale_filter.h"

using namespace mav_vo;

namespace {

void preintegrateOneImage(benchmark::State& state) {
  std::mt19937 random(1);
  const auto samples = synthetic::Flight{}.imuSamples(3.0, 3.05, 200, ImuNoise{}, ImuBias{}, random);
  for (auto _ : state) {
    Preintegration motion(ImuNoise{}, ImuBias{});
    motion.integrate(samples);
    benchmark::DoNotOptimize(motion.position());
  }
}
BENCHMARK(preintegrateOneImage)->Unit(benchmark::kMicrosecond);

void scaleFilterImage(benchmark::State& state) {
  std::mt19937 random(1);
  const synthetic::Flight flight;
  Preintegration motion(ImuNoise{}, ImuBias{});
  motion.integrate(flight.imuSamples(3.0, 3.05, 200, ImuNoise{}, ImuBias{}, random));
  ScaleFilter filter(ScaleFilterSettings{}, ImuNoise{}, 0.01);
  ScaleMeasurement m;
  filter.startAt(m, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(), 0.1);
  for (auto _ : state) {
    filter.add(m, motion);
    benchmark::DoNotOptimize(filter.scale());
  }
}
BENCHMARK(scaleFilterImage)->Unit(benchmark::kMicrosecond);

/// A rendered flight; reports tracking alone (images that make no keyframe) and all images, adjustment included.
void wholeFlight(benchmark::State& state) {
  const synthetic::PlateWorld world(3);
  const synthetic::Flight flight;
  std::mt19937 random(11);
  const auto samples = flight.imuSamples(0, 12.1, 200, ImuNoise{}, ImuBias{}, random);
  std::vector<cv::Mat> images;
  for (int i = 1; i <= 240; ++i) images.push_back(world.render(synthetic::camera(), flight.T_world_imu(0.05 * i) * synthetic::T_imu_camera()));
  double tracking = 0, all = 0;
  std::size_t tracked = 0, processed = 0;
  for (auto _ : state) {
    Odometry odometry(synthetic::camera(), synthetic::T_imu_camera(), air_ground_common::Pose::Identity(), OdometrySettings{});
    std::size_t next = 0;
    for (std::size_t i = 0; i < images.size(); ++i) {
      const double t = 0.05 * static_cast<double>(i + 1);
      for (; next < samples.size() && samples[next].stamp <= t + 1e-9; ++next) odometry.addImu(samples[next]);
      const FrameResult r = odometry.process(t, images[i]);
      all += r.seconds;
      ++processed;
      if (r.state != OdometryState::kTracking || r.keyframe) continue;
      tracking += r.seconds;
      ++tracked;
    }
  }
  state.counters["tracking_ms"] = 1e3 * tracking / static_cast<double>(std::max<std::size_t>(1, tracked));
  state.counters["with_adjustment_ms"] = 1e3 * all / static_cast<double>(std::max<std::size_t>(1, processed));
}
BENCHMARK(wholeFlight)->Unit(benchmark::kMillisecond)->Iterations(1);

}  // namespace
