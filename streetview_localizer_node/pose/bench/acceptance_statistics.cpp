// How often is a wrong street-level pose accepted? Facades drawn at random, matched as they are, with the next window
// (repeated facades), mirrored, with images of elsewhere and under wrong predictions. Writes the evidence of each pose.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <map>
#include <memory>

#include "../test/facade.h"
#include "streetview_localizer/acceptance.h"

using namespace streetview_localizer;
using namespace streetview_localizer::simulation;

namespace {

enum Kind { kRight, kWrongPrediction, kNextWindow, kMirrored, kElsewhere, kKinds };
const char* const kNames[] = {"right matches", "right matches, wrong prediction", "most matches with the next window",
                              "mirrored image", "image of elsewhere"};

struct Trial {
  Kind kind = kRight;
  int world = 0;  ///< a class of facades
  bool right = false;
  double error = 0, turn = 0;  ///< [m], [deg]
  Acceptance acceptance;
};

Trial tryOne(unsigned seed) {
  Random random(seed);
  Trial t;
  t.kind = static_cast<Kind>(random.uniform(0, kKinds));
  t.world = static_cast<int>(random.uniform(0, 4));
  FacadeSettings s;
  s.span = std::vector<double>{6, 10, 14, 18}[static_cast<std::size_t>(t.world)];
  s.relief = random.uniform(0, 1) < 0.5 ? 0 : 0.2;
  s.hidden_relief = random.uniform(0, 0.1);
  s.distance = random.uniform(8, 14);
  s.panorama_distance = random.uniform(6, 12);
  s.database_errors = true;
  s.inliers = static_cast<int>(random.uniform(8, 120));
  s.outliers = static_cast<int>(random.uniform(0, 2.5 * s.inliers));
  Scene scene = facadeScene(random, s);
  PosePrior prior;
  if (t.kind == kWrongPrediction) {
    prior.T_world_camera = scene.T_world_camera;
    prior.T_world_camera->translation() += random.gaussVector(20);
    prior.covariance.diagonal() << 1, 1, 1, 0.01, 0.01, 0.01;
  }
  // Repeated windows: the right one is mostly missed, the others share the matches, one with more of them.
  const double period = random.uniform(2, 4), next = random.uniform(0.2, 0.6), kept = random.uniform(0, 0.5 * next);
  for (Correspondence& c : scene.matches) {
    if (t.kind == kMirrored) c.pixel.x() = scene.camera.width - 1 - c.pixel.x();
    if (t.kind == kElsewhere) c.pixel = {random.uniform(0, scene.camera.width), random.uniform(0, scene.camera.height)};
    if (t.kind == kNextWindow) {
      const double drawn = random.uniform(0, 1);
      const double windows = drawn < next ? 1 : drawn < next + kept ? 0 : std::floor(random.uniform(-3, 4));
      c.p_world += scene.T_world_facade.linear().col(0) * windows * period;
    }
  }
  const PoseResult pose = estimatePose(scene.matches, scene.camera, scene.source, prior, {});
  t.acceptance = judge(pose, scene.matches, scene.camera, scene.source, {}, {});
  const Eigen::Vector3d error = pose.T_world_camera.translation() - scene.T_world_camera.translation();
  const double turn = air_ground_common::rotationAngle(pose.T_world_camera.linear(), scene.T_world_camera.linear());
  // The model's heights err by 0.5 m for all of the facade.
  t.right = pose.success && error.head<2>().norm() < 1 && std::abs(error.z()) < 2.5 && turn < 3 * M_PI / 180;
  t.error = error.norm();
  t.turn = turn * 180 / M_PI;
  return t;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("How often is a wrong street-level pose accepted? Random facades; a Markdown table");
  int runs = 10000, first_seed = 1;
  std::string evidence;
  app.add_option("--runs", runs, "trials");
  app.add_option("--first-seed", first_seed, "of the first");
  app.add_option("--evidence", evidence, "CSV to write, for fit_acceptance");
  CLI11_PARSE(app, argc, argv);
  std::vector<Trial> trials(static_cast<std::size_t>(runs));
#pragma omp parallel for schedule(dynamic, 16)
  for (int i = 0; i < runs; ++i) trials[static_cast<std::size_t>(i)] = tryOne(static_cast<unsigned>(first_seed + i));

  std::printf(
      "| %d trials from seed %d | trials | right poses | accepted | wrong poses | accepted "
      "|\n|---|---|---|---|---|---|\n",
      runs, first_seed);
  for (int kind = 0; kind <= kKinds; ++kind) {
    int n = 0, right = 0, wrong = 0, taken[2] = {0, 0};
    for (const Trial& t : trials) {
      if (kind < kKinds && t.kind != kind) continue;
      ++n;
      ++(t.right ? right : wrong);
      taken[t.right] += t.acceptance.accepted;
    }
    std::printf("| %s | %d | %d | %d | %d | %d |\n", kind < kKinds ? kNames[kind] : "all", n, right, taken[1], wrong,
                taken[0]);
  }
  for (std::size_t i = 0; i < trials.size(); ++i)
    if (trials[i].acceptance.accepted && !trials[i].right)
      std::fprintf(stderr, "seed %zu: %s, %.2f m, %.1f deg, score %.3f\n", static_cast<std::size_t>(first_seed) + i,
                   kNames[trials[i].kind], trials[i].error, trials[i].turn, trials[i].acceptance.score);
  if (evidence.empty()) return 0;
  std::ofstream out(evidence);
  out << "world,right,share_all,share_kept,stddev_m,competitor,cells\n";
  for (const Trial& t : trials) {
    const PoseEvidence& e = t.acceptance.evidence;
    if (e.inliers > 0)
      out << "facade of " << std::vector<int>{6, 10, 14, 18}[static_cast<std::size_t>(t.world)] << " m," << t.right
          << ',' << e.inlier_share << ',' << e.kept_share << ',' << e.position_stddev << ',' << e.competitor_share
          << ',' << e.cells << '\n';
  }
  return out.good() ? 0 : 1;
}
