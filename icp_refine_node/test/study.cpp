// Error distributions of the refinement over perturbed starts: the figures of docs/icp_refine.md.
// Synthetic scenes, or clouds in PLY files whose true relative pose is the identity.
#include <yaml-cpp/yaml.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/statistics.h"
#include "icp_refine/alignment_refiner.h"
#include "synthetic_scene.h"

using namespace icp_refine;
using air_ground_common::quantile;

namespace {

struct Case {
  std::string name;
  Cloud ground;
  std::vector<Cloud> aerial;
  Similarity truth;
  Pose placed;                                                     ///< rigid, at the middle of the reading
  double ground_camera = std::numeric_limits<double>::infinity();  ///< z in ground_map [m]; infinite: not known
};

struct Options {
  std::string config, ground;
  double ground_camera = std::numeric_limits<double>::infinity();
  std::vector<std::string> aerial;
  unsigned first_seed = 1000;
  int scenes = 20, runs = 5, recent = 6;
  double translation = 0.2, angle = 3, aerial_scale = 1;
  bool exact = false, yaw_only = false, verbose = false;
  synthetic::SceneSettings scene;
};

Cloud readCloud(const std::string& path, double scale = 1) {
  Cloud out;
  for (const auto& p : air_ground_common::readPlyPoints(path))
    out.points.push_back(static_cast<float>(scale) * p.position);
  return out;
}

std::vector<Case> cases(const Options& options) {
  std::vector<Case> out;
  for (int s = 0; options.ground.empty() && s < options.scenes; ++s) {
    auto scene = synthetic::makeScene(options.first_seed + s, options.scene);
    out.push_back({"seed " + std::to_string(options.first_seed + s),
                   std::move(scene.ground),
                   {std::move(scene.aerial)},
                   scene.truth,
                   scene.T_ground_map_mav_map,
                   (scene.T_world_ground_map.inverse() * Eigen::Vector3d(0, 0, 0.5)).z()});
  }
  // The node's reading: a sliding window over the fused clouds.
  for (std::size_t last = 0; last < options.aerial.size(); ++last) {
    Case c{options.aerial[last],       readCloud(options.ground), {},
           {1 / options.aerial_scale}, Pose::Identity(),          options.ground_camera};
    for (std::size_t k = last + 1 >= static_cast<std::size_t>(options.recent) ? last + 1 - options.recent : 0;
         k <= last; ++k) {
      c.aerial.push_back(readCloud(options.aerial[k], options.aerial_scale));
    }
    out.push_back(std::move(c));
  }
  return out;
}

struct Statistics {
  std::vector<double> before, translation, rotation, scale, nees, milliseconds, agreement;
  double scale_sum = 0;
  int converged = 0, wrong = 0, statuses[4] = {0, 0, 0, 0};
};

Pose start(const Case& c, const Eigen::Vector3d& centre, const Options& options, int run, std::mt19937& rng) {
  if (!options.exact)
    return synthetic::perturbed(c.placed, centre, options.translation, options.angle * M_PI / 180, options.yaw_only,
                                rng);
  const double heading = 2 * M_PI * (run + rng() / 4294967296.0) / options.runs;
  const Eigen::Vector3d m = c.placed * centre;
  return Eigen::Translation3d(m + options.translation * Eigen::Vector3d(std::cos(heading), std::sin(heading), 0)) *
         Pose(Eigen::AngleAxisd((run % 2 ? 1 : -1) * options.angle * M_PI / 180, Eigen::Vector3d::UnitZ())) *
         Eigen::Translation3d(-m) * c.placed;
}

void runOne(const Case& c, const Options& options, AlignmentRefiner& refiner, int run, std::mt19937& rng,
            Statistics& out) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const auto& cloud : c.aerial) centre += synthetic::centroid(cloud) / static_cast<double>(c.aerial.size());
  const Pose guess = start(c, centre, options, run, rng);
  refiner.setManual(guess);
  const RefineOutcome result = refiner.refine();
  const Similarity& T = result.T_ground_map_mav_map;
  const Eigen::Vector3d at = inverse(T) * result.reference_point;
  Vector6d e;
  e.head<3>() = T * at - c.truth * at;
  e.tail<3>() = air_ground_common::logSO3(T.R * c.truth.R.transpose());
  const double t = e.head<3>().norm(), a = e.tail<3>().norm() * 180 / M_PI,
               nees = air_ground_common::squaredMahalanobis(e, result.covariance);
  const bool good = result.status == RefineStatus::kConverged;
  ++out.statuses[static_cast<int>(result.status)];
  if (good) {
    out.scale.push_back(100 * std::abs(std::log(T.scale / c.truth.scale)));
    out.scale_sum += 100 * std::log(T.scale / c.truth.scale);
    out.before.push_back((guess * centre - c.truth * centre).norm());
    out.translation.push_back(t);
    out.rotation.push_back(a);
    out.nees.push_back(nees);
    out.milliseconds.push_back(result.icp.seconds * 1e3);
    out.agreement.push_back(result.heights.agreement());
    out.wrong += t > 0.08 || a > 3;
  }
  if (!options.verbose) return;
  static const char* kNames[] = {"SEARCHING", "DEGENERATE", "CONVERGED", "REJECTED"};
  std::printf("%s %d: %s %.3f m %.2f deg (%.3f %.3f %.3f; %.2f %.2f %.2f) nees %.1f, %s\n", c.name.c_str(), run,
              kNames[static_cast<int>(result.status)], t, a, e[0], e[1], e[2], e[3] * 57.3, e[4] * 57.3, e[5] * 57.3,
              nees, result.reason.c_str());
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Error distributions of ICP refinement from perturbed starts");
  Options options;
  app.add_option("--config", options.config, "YAML with a `chain`")->required();
  app.add_option("--ground", options.ground, "PLY of the ground cloud; with --aerial, instead of synthetic scenes");
  app.add_option("--aerial", options.aerial, "PLYs of the aerial clouds, in order, in the frame of the ground cloud");
  app.add_option("--aerial-scale", options.aerial_scale, "multiplies their coordinates");
  app.add_option("--ground-camera", options.ground_camera,
                 "height of the camera of the ground cloud, in its frame [m]");
  app.add_option("--recent", options.recent, "aerial clouds in one reading");
  app.add_option("--first-seed", options.first_seed);
  app.add_option("--scenes", options.scenes);
  app.add_option("--runs", options.runs, "starts a scene");
  app.add_option("--sigma-translation", options.translation, "[m]");
  app.add_option("--sigma-angle", options.angle, "[deg]");
  app.add_flag("--exact", options.exact, "horizontal offset and yaw of exactly the sigmas, in all directions");
  app.add_flag("--yaw-only", options.yaw_only);
  app.add_option("--scale-error", options.scene.scale_error);
  app.add_flag("!--sharp-edges", options.scene.smooth_edges, "aerial depth without smearing at edges");
  app.add_option("--drift", options.scene.ground_drift);
  app.add_flag("--verbose", options.verbose);
  CLI11_PARSE(app, argc, argv);
  const YAML::Node chain = YAML::LoadFile(options.config)["chain"];
  Statistics s;
  std::mt19937 rng(options.first_seed);
  for (const auto& c : cases(options)) {
    RefinerSettings settings;
    settings.recent_clouds = options.recent;
    AlignmentRefiner refiner{IcpChain(chain), settings};
    refiner.setGround(c.ground);
    refiner.setGroundCamera(c.ground_camera);
    for (const auto& cloud : c.aerial) refiner.addAerial(0, cloud);
    for (int run = 0; run < options.runs; ++run) runOne(c, options, refiner, run, rng, s);
  }
  double mean = 0;
  for (double n : s.nees) mean += n / static_cast<double>(s.nees.size());
  std::printf("converged %d, degenerate %d, rejected %d, searching %d; converged but beyond 0.08 m or 3 deg: %d\n",
              s.statuses[2], s.statuses[1], s.statuses[3], s.statuses[0], s.wrong);
  std::printf(
      "before: median %.3f m; after: median %.4f, 95 %% %.4f, max %.4f m; rotation median %.3f, 95 %% %.3f, max %.3f "
      "deg\n",
      quantile(s.before, .5), quantile(s.translation, .5), quantile(s.translation, .95), quantile(s.translation, 1),
      quantile(s.rotation, .5), quantile(s.rotation, .95), quantile(s.rotation, 1));
  std::printf("scale: mean %+.2f, absolute median %.2f, 95 %% %.2f, max %.2f %%\n",
              s.scale_sum / static_cast<double>(std::max<std::size_t>(1, s.scale.size())), quantile(s.scale, .5),
              quantile(s.scale, .95), quantile(s.scale, 1));
  std::printf("NEES mean %.2f, 95 %% %.1f; heights agree: least %.2f; ICP median %.0f ms, 95 %% %.0f ms\n", mean,
              quantile(s.nees, .95), quantile(s.agreement, 0), quantile(s.milliseconds, .5),
              quantile(s.milliseconds, .95));
}
