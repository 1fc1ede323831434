// Minimal solvers against OpenGV, refinement, tracker, descriptors and bundle adjustment.
#include <benchmark/benchmark.h>

#include <opengv/absolute_pose/CentralAbsoluteAdapter.hpp>
#include <opengv/absolute_pose/methods.hpp>

#include "../test/textured_plane.h"
#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/place_recognition.h"
#include "visual_frontend/pose_solver.h"
#include "visual_frontend/realignment.h"

namespace visual_frontend {
namespace {

using synthetic::Random;

struct Scene {
  explicit Scene(int points, double outliers = 0) {
    Random random(1);
    T = synthetic::randomPose(random);
    for (int i = 0; i < points; ++i) {
      PoseCorrespondence c;
      c.p_map = synthetic::visiblePoint(random, T);
      const Eigen::Vector3d p = T.inverse() * c.p_map;
      c.normalized = p.head<2>() / p.z() + Eigen::Vector2d(random.gauss(1e-3), random.gauss(1e-3));
      if (i < outliers * points) c.normalized = {random.uniform(-0.5, 0.5), random.uniform(-0.4, 0.4)};
      c.sigma = 1e-3;
      correspondences.push_back(c);
      points_map.push_back(c.p_map);
      bearings.push_back(c.normalized.homogeneous().normalized());
    }
  }
  Pose T;
  std::vector<PoseCorrespondence> correspondences;
  opengv::points_t points_map;
  opengv::bearingVectors_t bearings;
};

void P2P(benchmark::State& state) {
  const Scene s(2);
  for (auto _ : state) {
    benchmark::DoNotOptimize(solveP2P(s.T.linear(), s.points_map[0], s.bearings[0], s.points_map[1], s.bearings[1]));
  }
}
BENCHMARK(P2P);

void P2POpenGV(benchmark::State& state) {
  const Scene s(2);
  opengv::absolute_pose::CentralAbsoluteAdapter adapter(s.bearings, s.points_map, s.T.linear());
  for (auto _ : state) benchmark::DoNotOptimize(opengv::absolute_pose::p2p(adapter, 0, 1));
}
BENCHMARK(P2POpenGV);

void P3P(benchmark::State& state) {
  const Scene s(3);
  Eigen::Matrix3d points, rays;
  for (int i = 0; i < 3; ++i) {
    points.col(i) = s.points_map[i];
    rays.col(i) = s.bearings[i];
  }
  for (auto _ : state) benchmark::DoNotOptimize(solveP3PFixed(points, rays));
}
BENCHMARK(P3P);

void P3PKneipOpenGV(benchmark::State& state) {
  const Scene s(3);
  opengv::absolute_pose::CentralAbsoluteAdapter adapter(s.bearings, s.points_map);
  for (auto _ : state) benchmark::DoNotOptimize(opengv::absolute_pose::p3p_kneip(adapter));
}
BENCHMARK(P3PKneipOpenGV);

void RansacTwoPoint(benchmark::State& state) {
  const Scene s(200, 0.3);
  for (auto _ : state) benchmark::DoNotOptimize(ransacKnownRotation(s.correspondences, s.T.linear(), {}));
}
BENCHMARK(RansacTwoPoint)->Unit(benchmark::kMicrosecond);

void RansacThreePoint(benchmark::State& state) {
  const Scene s(200, 0.3);
  for (auto _ : state) benchmark::DoNotOptimize(ransacPose(s.correspondences, {}));
}
BENCHMARK(RansacThreePoint)->Unit(benchmark::kMicrosecond);

void Refine(benchmark::State& state) {
  const Scene s(200, 0.1);
  Pose start = s.T;
  start.translation() += Eigen::Vector3d(0.03, -0.02, 0.01);
  for (auto _ : state) benchmark::DoNotOptimize(refinePose(s.correspondences, start, {}));
}
BENCHMARK(Refine)->Unit(benchmark::kMicrosecond);

void RefineOpenGV(benchmark::State& state) {
  const Scene s(200);
  opengv::absolute_pose::CentralAbsoluteAdapter adapter(s.bearings, s.points_map);
  adapter.sett(s.T.translation() + Eigen::Vector3d(0.03, -0.02, 0.01));
  adapter.setR(s.T.linear());
  for (auto _ : state) benchmark::DoNotOptimize(opengv::absolute_pose::optimize_nonlinear(adapter));
}
BENCHMARK(RefineOpenGV)->Unit(benchmark::kMicrosecond);

void Track(benchmark::State& state) {
  const CameraModel camera = synthetic::camera();
  const cv::Mat texture = synthetic::texture(1600, 7);
  const cv::Mat images[2] = {synthetic::renderPlane(camera, synthetic::above(0, 0, 2), texture, 6),
                             synthetic::renderPlane(camera, synthetic::above(0.02, 0.01, 2, 0.01), texture, 6)};
  cv::setNumThreads(1);
  FeatureTracker tracker(camera, {});
  tracker.track(images[0]);
  int i = 0;
  for (auto _ : state) {
    tracker.track(images[++i % 2]);
    tracker.replenish();
  }
  state.counters["features"] = static_cast<double>(tracker.features().size());
}
BENCHMARK(Track)->Unit(benchmark::kMillisecond);

void Realign(benchmark::State& state) {
  const CameraModel camera = synthetic::camera();
  const Pose T_keyframe = synthetic::above(0, 0, 2), T = synthetic::above(0.1, 0.05, 1.9, 0.3);
  const Map map = synthetic::planeMap(camera, T_keyframe);
  FeatureTracker tracker(camera, {});
  LandmarkTracks tracks;
  tracker.track(synthetic::renderPlane(camera, T, synthetic::planeTexture(), synthetic::kPlane));
  std::vector<std::optional<Eigen::Vector2d>> drifted;
  for (const Eigen::Vector2d& pixel : synthetic::trackLandmarks(map, T, &tracker, &tracks))
    drifted.emplace_back(pixel + Eigen::Vector2d(0.2, -0.1));
  for (auto _ : state) {
    tracker.move(drifted);
    benchmark::DoNotOptimize(realignTracks(map, tracks, T, 2, {}, &tracker));
  }
  state.counters["features"] = static_cast<double>(drifted.size());
}
BENCHMARK(Realign)->Unit(benchmark::kMicrosecond);

void MatchDescriptors(benchmark::State& state) {
  cv::RNG rng(5);
  cv::Mat a(500, 32, CV_8U), b(500, 32, CV_8U);
  rng.fill(a, cv::RNG::UNIFORM, 0, 256);
  rng.fill(b, cv::RNG::UNIFORM, 0, 256);
  for (auto _ : state) benchmark::DoNotOptimize(matchDescriptors(a, b, {}));
}
BENCHMARK(MatchDescriptors)->Unit(benchmark::kMicrosecond);

/// Window of 7 free and 5 fixed cameras, 400 points.
void WindowedBundle(benchmark::State& state) {
  Random random(3);
  BundleProblem problem;
  for (int i = 0; i < 12; ++i) {
    BundleProblem::Camera c;
    c.T_map_camera = synthetic::above(0.15 * i, 0, 2, 0.05 * i);
    c.fixed = i < 5;
    problem.cameras.push_back(c);
  }
  for (int k = 0; k < 400; ++k) {
    const Eigen::Vector3d p(random.uniform(-1, 3), random.uniform(-1, 1), random.uniform(0, 0.5));
    problem.points.push_back(p + random.gaussVector(0.01));
    for (int i = 0; i < 12; ++i) {
      const Eigen::Vector3d q = problem.cameras[i].T_map_camera.inverse() * p;
      if (std::abs(q.x() / q.z()) > 0.6 || std::abs(q.y() / q.z()) > 0.45) continue;
      problem.measurements.push_back({i, k,
                                      q.head<2>() / q.z() + Eigen::Vector2d(random.gauss(1e-3), random.gauss(1e-3)),
                                      1e-3, q.z() + random.gauss(0.01), 0.01});
    }
  }
  for (auto& c : problem.cameras) {
    if (!c.fixed) c.T_map_camera.translation() += random.gaussVector(0.01);
  }
  BundleSettings settings;
  settings.max_iterations = 6;
  for (auto _ : state) {
    BundleProblem copy = problem;
    benchmark::DoNotOptimize(solveBundle(copy, settings));
  }
  state.counters["measurements"] = static_cast<double>(problem.measurements.size());
}
BENCHMARK(WindowedBundle)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace visual_frontend
