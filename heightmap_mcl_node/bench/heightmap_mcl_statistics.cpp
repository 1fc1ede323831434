// Success statistics of the coarse alignment over synthetic worlds, as in Forster 2013, Fig. 11 and 12: error and
// spread of the particles after each aerial map. Prints a table; writes one CSV line a map on demand, and pictures of
// one run.
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <map>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "synthetic_world.h"

namespace hm = heightmap_mcl;
namespace syn = heightmap_mcl::synthetic;

namespace {

/// Grey by height, red by height for bounds, dark blue for holes, y up.
cv::Mat picture(const hm::HeightMap& map, float low, float high) {
  cv::Mat image(map.height, map.width, CV_8UC3);
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      const float h = map.at(r, c);
      const auto v = static_cast<unsigned char>(std::clamp(255 * (h - low) / (high - low), 0.f, 255.f));
      image.at<cv::Vec3b>(map.height - 1 - r, c) = std::isnan(h) ? cv::Vec3b(90, 40, 20)
                                                   : map.isBound(static_cast<std::size_t>(r) * map.width + c)
                                                       ? cv::Vec3b(0, 0, 100 + v * 155 / 255)
                                                       : cv::Vec3b(v, v, v);
    }
  }
  return image;
}

void writePictures(const std::string& prefix, hm::HeightMapLocalizer& localizer, const Eigen::Vector3d& truth) {
  const auto& ground = localizer.groundMap();
  const auto limits = [](const hm::HeightMap& m) {
    float low = 1e9f, high = -1e9f;
    for (float h : m.heights) {
      if (!std::isnan(h)) low = std::min(low, h), high = std::max(high, h);
    }
    return std::make_pair(low, high);
  };
  const auto g = limits(ground), a = limits(localizer.aerialMap());
  cv::imwrite(prefix + "_ground.png", picture(ground, g.first, g.second));
  cv::imwrite(prefix + "_air.png", picture(localizer.aerialMap(), a.first, a.second));

  Eigen::Vector2d pivot;
  const hm::CostMap cost = localizer.costMap(&pivot);
  if (cost.cost.empty()) return;
  float low = 1e9f, high = 0;
  for (float c : cost.cost) {
    if (std::isfinite(c)) low = std::min(low, c), high = std::max(high, c);
  }
  cv::Mat image(cost.height, cost.width, CV_8UC3, cv::Scalar(255, 255, 255));
  for (int r = 0; r < cost.height; ++r) {
    for (int c = 0; c < cost.width; ++c) {
      if (!std::isfinite(cost.at(r, c))) continue;
      const auto v = static_cast<unsigned char>(230 * std::sqrt((cost.at(r, c) - low) / (high - low + 1e-9f)));
      image.at<cv::Vec3b>(cost.height - 1 - r, c) = cv::Vec3b(v, v, v);
    }
  }
  const auto pixel = [&](double x, double y) {
    return cv::Point(static_cast<int>(std::lround((x - cost.x0) / cost.resolution)),
                     cost.height - 1 - static_cast<int>(std::lround((y - cost.y0) / cost.resolution)));
  };
  // Particles and truth are positions of the MAV; the map's cells are positions of the pivot.
  const Eigen::Vector2d reference = localizer.filter().reference();
  for (const auto& p : localizer.filter().particles()) {
    const auto q = hm::changeReference(p.pose, reference, pivot);
    cv::circle(image, pixel(q.x, q.y), 2, {0, 200, 0}, cv::FILLED);
    cv::line(image, pixel(q.x, q.y), pixel(q.x + 0.15 * std::cos(q.yaw), q.y + 0.15 * std::sin(q.yaw)), {0, 160, 0});
  }
  const auto t = hm::changeReference({truth.x(), truth.y(), truth.z()}, reference, pivot);
  cv::drawMarker(image, pixel(t.x, t.y), {0, 0, 255}, cv::MARKER_CROSS, 24, 2);
  cv::imwrite(prefix + "_cost.png", image);
}

/// A unit between 0.5 and 5 m, and a vertical up to 0.3 rad off.
syn::OwnUnit ownUnit(std::uint64_t seed) {
  std::mt19937_64 random(seed * 15485863 + 3);
  std::uniform_real_distribution<double> u(0, 1);
  syn::OwnUnit own;
  own.unit = 0.5 * std::pow(10, u(random));
  const double axis = 2 * M_PI * u(random), tilt = 0.3 * u(random);
  own.R_raw_level = air_ground_common::expSO3({tilt * std::cos(axis), tilt * std::sin(axis), 0});
  return own;
}

/// Error of an estimate that places clouds in a unit of their own, at the aerial cloud's reference point.
syn::Error similarityError(const hm::CoarseEstimate& e, const syn::OwnUnit& own, const air_ground_common::Pose& truth,
                           const hm::AerialCloud& cloud) {
  const Eigen::Vector3d raw = own.raw(cloud).reference;
  const Eigen::Vector3d d = e.similarityPose() * (e.scale * raw) - truth * cloud.reference;
  const double yaw = air_ground_common::yawOf(Eigen::Matrix3d(e.similarityPose().linear() * own.R_raw_level)) -
                     air_ground_common::yawOf(truth.rotation());
  return {d.head<2>().norm(), std::abs(air_ground_common::wrapAngle(yaw)), std::abs(d.z())};
}

/// Other worlds around what the ground robot has seen, until that is a square of so many metres.
void addNeighbours(syn::Options options, double extent, std::vector<Eigen::Vector3f>* ground) {
  constexpr int kApart = 10;  // [m]
  const int count = static_cast<int>(std::lround(extent / kApart));
  options.aerial_clouds = 1;
  for (int i = 0; i < count * count; ++i) {
    const Eigen::Vector3f shift(static_cast<float>(kApart * (i % count - count / 2)),
                                static_cast<float>(kApart * (i / count - count / 2)), 0);
    if (shift.isZero()) continue;
    options.seed += 100000;
    for (const auto& p : syn::makeRun(options).ground) ground->push_back(p + shift);
  }
}

/// Most memory of this process so far [GB].
double peakMemory() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return 1e-6 * static_cast<double>(usage.ru_maxrss);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Statistics of the height-map Monte Carlo localization on synthetic worlds");
  int first_seed = 1001, runs = 41, maps = 12;
  std::string world = "boxes", csv, pictures;
  hm::HeightMapLocalizerSettings s;
  syn::Options options;
  double known_heading_deg = -1;
  std::string dilation = "all";
  std::string merge = "mean";
  app.add_option("--first-seed", first_seed, "seed of the first world");
  app.add_option("--runs", runs, "number of worlds");
  app.add_option("--maps", maps, "aerial clouds a world");
  app.add_option("--world", world, "boxes, few, identical, flat, ridge or room")
      ->check(CLI::IsMember({"boxes", "few", "identical", "flat", "ridge", "room"}));
  app.add_option("--csv", csv, "file for one line a map");
  app.add_option("--pictures", pictures, "prefix of PNG files for the first world");
  app.add_option("--known-heading", known_heading_deg,
                 "standard deviation of a known heading [deg]; negative: searched");
  app.add_option("--particles", s.filter.particles, "");
  app.add_option("--sampling-sigma", s.filter.sampling_sigma, "[m^2]");
  app.add_option("--weight-sigma", s.filter.weight_sigma, "[m^2]");
  app.add_option("--mixture", s.filter.mixture_ratio, "");
  app.add_option("--unknown-weight", s.unknown_weight, "");
  app.add_option("--min-overlap", s.min_overlap, "");
  app.add_option("--edge-width", s.edge_width, "[m]");
  app.add_option("--cutoff", s.cutoff, "[m]");
  app.add_option("--min-agreement", s.verdict.min_agreement, "");
  app.add_option("--probe-ratio", s.verdict.probe_ratio, "");
  app.add_option("--accumulate", s.accumulate, "");
  app.add_option("--verify", s.verify, "");
  app.add_option("--coarse", s.coarse_factor, "");
  app.add_option("--headings", s.headings, "");
  app.add_option("--quantile", s.air_map.height_quantile, "");
  app.add_option("--dilation", dilation, "none, holes, all");
  app.add_option("--merge", merge, "highest, mean");
  app.add_option("--ambiguity-ratio", s.verdict.ambiguity_ratio, "");
  app.add_option("--scale-error", options.scale_error, "");

  app.add_option("--noise", options.cloud_noise, "[m]");
  app.add_option("--ground-path", options.ground_path, "[m]");
  std::string tops = "bounded", mode = "search";
  app.add_option("--mode", mode, "search or paper")->check(CLI::IsMember({"search", "paper"}));
  double region = 0;
  app.add_option("--region", region, "radius about the ground robot in which the MAV is looked for [m]; 0: everywhere");
  double tilt_deg = 0;
  app.add_option("--tops", tops, "highest, clipped, bounded");
  app.add_option("--min-maps", s.verdict.min_maps, "");
  app.add_option("--min-evidence", s.verdict.min_evidence, "");
  app.add_option("--scale-evidence", s.own_unit.scale_evidence, "");
  double cells_per_metre = 50;
  app.add_option("--cells-per-metre", cells_per_metre, "fewer are faster");
  app.add_option("--cap", s.air_map.cap, "[m]");
  app.add_option("--tilt", tilt_deg, "of the MAV's map [deg]");
  app.add_flag("!--no-ceiling", options.ceiling, "rooms without ceiling and lamp");
  app.add_flag("--other-world", options.other_world, "the MAV is in another world: every pose is wrong");
  bool summary = false;
  app.add_flag("--summary", summary, "one line of a Markdown table, as in docs/results/heightmap_mcl.md");
  bool own_unit = false;
  app.add_flag("--own-unit", own_unit,
               "a MAV without IMU: unit and level of its map unknown; right: scale to 10 %, too");
  double extent = 0;
  app.add_option("--ground-extent", extent, "the ground robot has seen a square of other worlds around, too [m]");
  app.add_option("--ground-noise", options.ground_noise, "of the ground robot's depths, times that of a Kinect");
  CLI11_PARSE(app, argc, argv);
  if (own_unit) options.scale_error = 0;
  const std::map<std::string, syn::World> worlds{
      {"boxes", syn::World::kBoxes},    {"few", syn::World::kFewBoxes}, {"identical", syn::World::kIdenticalBoxes},
      {"flat", syn::World::kFlatFloor}, {"ridge", syn::World::kRidge},  {"room", syn::World::kRoom}};
  s.air_map.dilation = s.ground_map.dilation = dilation == "none"    ? hm::Dilation::kNone
                                               : dilation == "holes" ? hm::Dilation::kHoles
                                                                     : hm::Dilation::kAll;
  s.air_map.tops = s.ground_map.tops = tops == "highest"   ? hm::Tops::kHighest
                                       : tops == "clipped" ? hm::Tops::kClipped
                                                           : hm::Tops::kBounded;
  s.ground_map.cap = s.air_map.cap;
  s.air_map.resolution = s.ground_map.resolution = 1 / cells_per_metre;
  if (mode == "paper") s = hm::paperSettings(s);
  options.tilt = tilt_deg * M_PI / 180;
  s.merge = merge == "mean" ? hm::Merge::kMean : hm::Merge::kHighest;
  s.verify = std::max(s.verify, s.accumulate);
  options.world = worlds.at(world);
  options.aerial_clouds = maps;

  std::ofstream out;
  if (!csv.empty()) {
    out.open(csv);
    out << "seed,map,status,error_m,error_deg,error_z_m,mean_error_m,spread_m,spread_deg,rival_ratio,explained,"
           "agreement,relief,"
           "probe,cost,overlap,nees,"
           "mode_weight,ms,evidence,lead,scale_error,scale_stddev,sigma_m,sigma_deg,guess\n";
  }
  std::vector<std::vector<double>> errors(maps), mean_errors(maps), yaws(maps), spreads(maps);
  std::vector<int> good(maps, 0), mean_good(maps, 0), converged(maps, 0), wrong(maps, 0);
  std::map<std::string, int> statuses;
  std::vector<double> scale_errors;  // of converged estimates
  double total_ms = 0, most_ms = 0, ground_ms = 0, before = 0, total_nees = 0, scale_nees = 0;
  int nees_count = 0;
  for (int run_index = 0; run_index < runs; ++run_index) {
    options.seed = first_seed + run_index;
    auto run = syn::makeRun(options);
    if (extent > 0) addNeighbours(options, extent, &run.ground);
    if (extent > 0) s.ground_map.max_extent = extent + 10;  // with its rims
    s.seed = options.seed;
    before = peakMemory();
    hm::HeightMapLocalizer localizer(s);
    hm::Prior prior;
    if (region > 0) {
      prior.position = run.T_ground_robot.translation().head<2>();
      prior.position_radius = region;
      prior.position_reference = run.aerial[0].reference.head<2>();
      localizer.setPrior(prior);
    }
    if (known_heading_deg >= 0) {
      prior.yaw = air_ground_common::yawOf(run.T_ground_mav[0].rotation());
      prior.yaw_sigma = std::max(known_heading_deg, 0.5) * M_PI / 180;
      localizer.setPrior(prior);
    }
    const syn::OwnUnit own = own_unit ? ownUnit(options.seed) : syn::OwnUnit();
    localizer.setOwnUnit(own_unit);
    const auto begin = std::chrono::steady_clock::now();
    localizer.setGround(run.ground);
    ground_ms += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
    for (int k = 0; k < maps; ++k) {
      const auto start = std::chrono::steady_clock::now();
      localizer.addAerial(own.raw(run.aerial[k]));
      const double ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
      total_ms += ms;
      most_ms = std::max(most_ms, ms);
      const auto& e = localizer.estimate();
      const Eigen::Vector3d& reference = run.aerial[k].reference;
      const auto error = own_unit ? similarityError(e, own, run.T_ground_mav[k], run.aerial[k])
                                  : syn::errorOf(e.T_ground_mav, run.T_ground_mav[k], reference);
      const double scale_error = std::log(e.scale / own.unit);
      const Eigen::Vector2d mean(e.particle_mean.x, e.particle_mean.y);
      const double mean_error = (mean - (run.T_ground_mav[k] * reference).head<2>()).norm();
      errors[k].push_back(error.position);
      mean_errors[k].push_back(mean_error);
      yaws[k].push_back(error.yaw * 180 / M_PI);
      spreads[k].push_back(e.particle_spread);
      const bool ok = !options.other_world && error.position < 0.25 && std::abs(error.z) < 0.25 &&
                      error.yaw < 5 * M_PI / 180 && (!own_unit || std::abs(scale_error) < 0.1);
      good[k] += ok;
      mean_good[k] += mean_error < 0.25;
      const bool is_converged = e.status == hm::Status::kConverged;
      converged[k] += is_converged;
      wrong[k] += is_converged && !ok;
      ++statuses[hm::toString(e.status)];
      // Consistency at the overlap's centre in x, y, z and yaw.
      const Eigen::Vector3d d =
          e.reference_point - run.T_ground_mav[k] * (e.T_ground_mav.inverse() * e.reference_point);
      Eigen::Vector4d delta(d.x(), d.y(), d.z(),
                            air_ground_common::wrapAngle(air_ground_common::yawOf(e.T_ground_mav.rotation()) -
                                                         air_ground_common::yawOf(run.T_ground_mav[k].rotation())));
      const int index[4] = {0, 1, 2, 5};
      Eigen::Matrix4d P;
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) P(i, j) = e.covariance(index[i], index[j]);
      }
      const double nees = delta.dot(P.ldlt().solve(delta));
      if (is_converged && ok && own_unit) {
        scale_errors.push_back(scale_error);
        scale_nees += std::pow(scale_error * e.scale / e.scale_stddev, 2);
      }
      if (is_converged) {
        total_nees += nees;
        ++nees_count;
      }
      if (out) {
        out << options.seed << ',' << k << ',' << hm::toString(e.status) << ',' << error.position << ','
            << error.yaw * 180 / M_PI << ',' << error.z << ',' << mean_error << ',' << e.particle_spread << ','
            << e.particle_spread_yaw * 180 / M_PI << ',' << e.rival_ratio << ',' << e.explained << ',' << e.agreement
            << ',' << e.relief << ',' << e.probe_ratio << ',' << e.cost << ',' << e.overlap << ',' << nees << ','
            << e.mode_weight << ',' << ms << ',' << e.evidence << ',' << e.evidence_lead << ',' << scale_error << ','
            << e.scale_stddev / e.scale << ',' << std::sqrt(std::max(e.covariance(0, 0), e.covariance(1, 1))) << ','
            << std::sqrt(e.covariance(5, 5)) * 180 / M_PI << ',' << e.guess << '\n';
      }
      if (!pictures.empty() && run_index == 0) {
        const Eigen::Vector3d p = run.T_ground_mav[k] * reference;
        writePictures(pictures + "_" + std::to_string(k + 1), localizer,
                      {p.x(), p.y(), air_ground_common::yawOf(run.T_ground_mav[k].rotation())});
      }
    }
  }
  if (summary) {
    std::printf("| %s%s | %d | %d |", options.other_world ? "other " : "", world.c_str(), runs, runs * maps);
    for (int k = 0; k < maps; ++k) std::printf("%s %d", k ? "," : "", converged[k]);
    std::printf(" | %d |\n", std::accumulate(wrong.begin(), wrong.end(), 0));
    return 0;
  }
  const auto quantile = [](std::vector<double> v, double q) {
    std::sort(v.begin(), v.end());
    return v[static_cast<std::size_t>(std::min<double>(v.size() - 1, q * v.size()))];
  };
  std::printf("%d worlds '%s' from seed %d; pose within 0.25 m and 5 deg counts as right\n", runs, world.c_str(),
              first_seed);
  std::printf(
      "map  right  particle mean<0.25m  CONVERGED  wrongly  error[m] median  90%%   heading[deg] median  spread[m] "
      "median\n");
  for (int k = 0; k < maps; ++k) {
    std::printf("%3d  %4.0f%%  %19.0f%%  %8.0f%%  %7d  %15.3f  %.3f  %19.2f  %16.3f\n", k + 1, 100.0 * good[k] / runs,
                100.0 * mean_good[k] / runs, 100.0 * converged[k] / runs, wrong[k], quantile(errors[k], 0.5),
                quantile(errors[k], 0.9), quantile(yaws[k], 0.5), quantile(spreads[k], 0.5));
  }
  for (const auto& status : statuses) std::printf("%s %d  ", status.first.c_str(), status.second);
  std::printf(
      "\nmean NEES of converged estimates (4 degrees of freedom): %.2f; %.0f ms a map, at most %.0f; %.0f ms a ground "
      "map; "
      "at most %.2f GB, %.2f of them without maps\n",
      nees_count ? total_nees / nees_count : 0.0, total_ms / (runs * maps), most_ms, ground_ms / runs, peakMemory(),
      before);
  if (!scale_errors.empty())
    std::printf(
        "scale of %zu right and converged estimates: median error %+.2f %%, 10 %% %+.2f, 90 %% %+.2f; NEES %.2f\n",
        scale_errors.size(), 100 * quantile(scale_errors, 0.5), 100 * quantile(scale_errors, 0.1),
        100 * quantile(scale_errors, 0.9), scale_nees / static_cast<double>(scale_errors.size()));
  return 0;
}
