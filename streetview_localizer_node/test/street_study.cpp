// Error and recall over a folder of the simulator's street world, for docs/streetview_localizer.md:
//   street_study CITY [DB [PICTURES]]     database DB, or, given as "", one made here from true poses disturbed as
//   after registration
// Environment: STUDY_PRIOR = standard deviation [m] of a predicted position to search by, STUDY_MAX_VIEWS,
// STUDY_NO_DOUBLING. The truth of the queries is read to print errors, never by the localizer.
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <sstream>

#include "air_ground_common/camera_file.h"
#include "streetview_localizer/features.h"
#include "streetview_localizer/localizer.h"
#include "streetview_localizer/match_picture.h"
#include "streetview_localizer/panorama_views.h"

using namespace streetview_localizer;

namespace {

std::map<std::string, Pose> readPoses(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path);
  std::map<std::string, Pose> poses;
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream words(line);
    std::string name;
    Eigen::Vector3d t;
    Eigen::Quaterniond q;
    if (!(words >> name >> t.x() >> t.y() >> t.z() >> q.x() >> q.y() >> q.z() >> q.w())) continue;
    Pose T = Pose::Identity();
    T.linear() = q.normalized().toRotationMatrix();
    T.translation() = t;
    poses[name] = T;
  }
  return poses;
}

std::shared_ptr<StreetviewDatabase> makeDatabase(const std::string& city, double position_stddev, double angle_stddev) {
  auto db = std::make_shared<StreetviewDatabase>();
  CityModelOptions options;
  const auto origin = YAML::LoadFile(city + "/city.yaml")["origin"].as<std::vector<double>>();
  options.origin = Eigen::Vector3d(origin[0], origin[1], origin[2]);
  db->model = readCityModel(city + "/model.gml", options);
  db->crs = db->model.crs;
  db->origin = db->model.origin;
  const BackProjector projector(db->model);
  std::mt19937 rng(5);
  std::normal_distribution<double> normal;
  for (const auto& [name, truth] : readPoses(city + "/panorama_truth.csv")) {
    Panorama p;
    p.id = name;
    p.T_world_panorama = truth;
    for (int i = 0; i < 3; ++i) p.T_world_panorama.translation()[i] += position_stddev * normal(rng);
    const Eigen::Vector3d turn(normal(rng), normal(rng), normal(rng));
    p.T_world_panorama.linear() = air_ground_common::expSO3(angle_stddev * turn) * truth.linear();
    p.T_world_geotag = p.T_world_panorama;
    p.registered = true;
    p.position_stddev = std::max(0.01, position_stddev);
    p.orientation_stddev = std::max(0.001, angle_stddev);
    for (View view : cutPanorama(cv::imread(city + "/panoramas/" + name + ".jpg"), p.T_world_panorama)) {
      view.id = static_cast<int>(db->views.size());
      view.panorama = static_cast<int>(db->panoramas.size());
      view.features = extractFeatures(view.image);
      projector.apply(&view);
      db->views.push_back(std::move(view));
    }
    db->panoramas.push_back(p);
  }
  db->buildIndex();
  return db;
}

int run(const std::string& city, const std::string& db_path, const std::string& pictures) {
  const auto db =
      db_path.empty() ? makeDatabase(city, 0.12, 0.0083) : std::make_shared<StreetviewDatabase>(loadDatabase(db_path));
  std::size_t features = 0;
  for (const View& v : db->views) features += v.features.size();
  std::printf("%zu panoramas, %zu views, %zu features\n", db->panoramas.size(), db->views.size(), features);
  StreetviewLocalizerSettings settings;
  const char* env = std::getenv("STUDY_MAX_VIEWS");
  if (env) settings.max_views = std::atoi(env);
  if (std::getenv("STUDY_NO_DOUBLING")) settings.features.original.double_image = false;
  if (!db_path.empty()) settings.index_file = db_path + ".index";
  const StreetviewLocalizer localizer(db, settings);
  std::printf("%s\n", localizer.indexRemark().c_str());
  const auto camera = air_ground_common::readCameraFile(city + "/camera.yaml");
  std::mt19937 rng(11);
  std::normal_distribution<double> normal;
  for (const std::string folder : {"queries", "queries_elsewhere"}) {
    const auto truth = readPoses(city + "/" + folder + "_truth.csv");
    std::vector<double> errors, turns, times;
    int all = 0, within = 0, wrong = 0;
    for (const auto& [name, T] : truth) {
      PosePrior prior;  // an IMU's direction of gravity
      const Eigen::Vector3d tilt(normal(rng), normal(rng), normal(rng));
      prior.up_camera = air_ground_common::expSO3(0.01 * tilt) * (T.linear().transpose() * Eigen::Vector3d::UnitZ());
      if (const char* stddev = std::getenv("STUDY_PRIOR")) {
        const double sigma = std::atof(stddev);
        prior.T_world_camera = T;
        prior.T_world_camera->translation() += sigma * Eigen::Vector3d(normal(rng), normal(rng), normal(rng));
        prior.T_world_camera->linear() = air_ground_common::expSO3({0, 0, 0.1 * normal(rng)}) * T.linear();
        prior.covariance.setZero();
        prior.covariance.diagonal() << sigma * sigma, sigma * sigma, sigma * sigma, 1e-4, 1e-4, 1e-2;
      }
      const cv::Mat image = cv::imread(city + "/" + folder + "/" + name);
      const LocalizerResult r = localizer.localize(image, camera, prior);
      if (!pictures.empty()) cv::imwrite(pictures + "/" + folder + "_" + name + ".jpg", drawMatch(image, *db, r));
      double nearest = 1e9;
      for (const Panorama& p : db->panoramas)
        nearest = std::min(nearest, (p.T_world_panorama.translation() - T.translation()).norm());
      const double error = (r.pose.T_world_camera.translation() - T.translation()).norm();
      const double turn = air_ground_common::rotationAngle(r.pose.T_world_camera.linear(), T.linear()) * 180 / M_PI;
      const auto& e = r.acceptance.evidence;
      std::printf(
          "%s %-8s z %4.1f nearest %4.1f error %6.2f m %5.1f deg sd %.2f; %4d features %4d matches %3zu inliers score "
          "%.3f share %.2f cells %d rival %.2f margin %.1f range %.1f; %.2f s (",
          name.c_str(), nameOf(r.status), T.translation().z(), nearest, error, turn,
          std::sqrt(r.pose.covariance.topLeftCorner<3, 3>().trace()), r.features, r.matches, r.pose.inliers.size(),
          r.acceptance.score, e.inlier_share, e.cells, e.competitor_share, e.alternative_margin, e.range, r.total_time);
      for (const double t : r.times) std::printf(" %.2f", t);
      std::printf(") %s\n", r.reason.c_str());
      ++all;
      within += nearest < 15;
      times.push_back(r.total_time);
      if (!r.accepted()) continue;
      wrong += error > 2 || turn > 5;
      errors.push_back(error);
      turns.push_back(turn);
    }
    std::sort(errors.begin(), errors.end());
    std::sort(turns.begin(), turns.end());
    std::printf("%s: %zu of %d accepted (%d within 15 m), %d wrong", folder.c_str(), errors.size(), all, within, wrong);
    if (!errors.empty())
      std::printf("; median %.3f m %.2f deg, 90 %% %.2f m, largest %.2f m", errors[errors.size() / 2],
                  turns[turns.size() / 2], errors[errors.size() * 9 / 10], errors.back());
    std::printf("\n");
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  if (argc < 2) {
    std::fprintf(stderr, "usage: %s CITY [DB [PICTURES]]\n", argv[0]);
    return 1;
  }
  try {
    return run(argv[1], argc > 2 ? argv[2] : "", argc > 3 ? argv[3] : "");
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return 1;
  }
}
