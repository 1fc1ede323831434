// Costs of the odometry's parts and of a whole image.
#include <benchmark/benchmark.h>

#include <chrono>
#include <opengv/relative_pose/CentralRelativeAdapter.hpp>
#include <opengv/relative_pose/methods.hpp>

#include "../test/synthetic_camera.h"
#include "mav_vo/increment_covariance.h"
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

/// The paper's covariance: 1000 samples of five correspondences, against a loop over OpenGV's Nister solver on the same
/// samples.
void incrementCovariance(benchmark::State& state) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::normal_distribution<double> noise(0, 0.001);
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  T.linear() = air_ground_common::expSO3({0.01, -0.02, 0.015});
  T.translation() = Eigen::Vector3d(0.08, 0.03, 0.02);
  std::vector<RayPair> pairs;
  opengv::bearingVectors_t previous, current;
  while (pairs.size() < 150) {
    const double z = 2.5 + unit(random);
    const Eigen::Vector3d p(0.6 * z * unit(random), 0.45 * z * unit(random), z), q = T.inverse() * p;
    RayPair pair{p.head<2>() / p.z() + Eigen::Vector2d(noise(random), noise(random)),
                 q.head<2>() / q.z() + Eigen::Vector2d(noise(random), noise(random))};
    pairs.push_back(pair);
    previous.push_back(pair.previous.homogeneous().normalized());
    current.push_back(pair.current.homogeneous().normalized());
  }
  std::vector<std::vector<int>> samples(1000, std::vector<int>(5));
  for (auto& sample : samples) {
    for (std::size_t i = 0; i < 5; ++i) {
      do sample[i] = static_cast<int>(random() % pairs.size());
      while (std::find(sample.begin(), sample.begin() + i, sample[i]) != sample.begin() + i);
    }
  }
  opengv::relative_pose::CentralRelativeAdapter adapter(previous, current);
  double ours = 0, opengvs = 0;
  const auto now = [] { return std::chrono::steady_clock::now(); };
  for (auto _ : state) {
    const auto start = now();
    benchmark::DoNotOptimize(monteCarloIncrement(pairs, T, air_ground_common::Pose::Identity(),
                                                 Eigen::Matrix3d::Identity(), 1e-6, 0.001, {}));
    const auto middle = now();
    for (const auto& sample : samples) benchmark::DoNotOptimize(opengv::relative_pose::fivept_nister(adapter, sample));
    ours += std::chrono::duration<double>(middle - start).count();
    opengvs += std::chrono::duration<double>(now() - middle).count();
  }
  const double n = static_cast<double>(state.iterations());
  state.counters["ours_ms"] = 1e3 * ours / n;
  state.counters["OpenGV_Nister_ms"] = 1e3 * opengvs / n;
  state.counters["OpenGV/ours"] = opengvs / ours;
}
BENCHMARK(incrementCovariance)->Unit(benchmark::kMillisecond)->Iterations(20);

/// A rendered flight; reports tracking alone (images that make no keyframe) and all images, adjustment included.
void wholeFlight(benchmark::State& state) {
  const synthetic::PlateWorld world(3);
  const synthetic::Flight flight;
  std::mt19937 random(11);
  const auto samples = flight.imuSamples(0, 12.1, 200, ImuNoise{}, ImuBias{}, random);
  std::vector<cv::Mat> images;
  for (int i = 1; i <= 240; ++i)
    images.push_back(world.render(synthetic::camera(), flight.T_world_imu(0.05 * i) * synthetic::T_imu_camera()));
  double tracking = 0, all = 0;
  std::size_t tracked = 0, processed = 0;
  for (auto _ : state) {
    Odometry odometry(synthetic::camera(), synthetic::T_imu_camera(), air_ground_common::Pose::Identity(),
                      OdometrySettings{});
    std::size_t next = 0;
    for (std::size_t i = 0; i < images.size(); ++i) {
      const double t = 0.05 * static_cast<double>(i + 1);
      for (; next < samples.size() && samples[next].stamp <= t + 1e-9; ++next) odometry.addImu(samples[next]);
      const VoResult r = odometry.process(t, images[i]);
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
