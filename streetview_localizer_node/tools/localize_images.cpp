// Locates photographs in a Street View database, without ROS running: one line an image.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>

#include "air_ground_common/camera_file.h"
#include "air_ground_common/text.h"
#include "query_list.h"
#include "streetview_localizer/localizer.h"
#include "streetview_localizer/match_picture.h"
#include "streetview_localizer/view_synthesis.h"

namespace {

using namespace streetview_localizer;

constexpr char kHeader[] =
    "image,status,frame,x,y,z,qx,qy,qz,qw,crs_x,crs_y,crs_z,stddev_x,stddev_y,stddev_z,stddev_rot_x,stddev_rot_y,"
    "stddev_rot_z,"
    "score,panorama,searched,features,matches,inliers,rms_px,range_m,time_s,share_all,share_kept,stddev_m,competitor,"
    "cells,"
    "reason\n";

using air_ground_common::formatted;

std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string lineOf(const std::string& image, const LocalizerResult& r, const StreetviewDatabase& database) {
  std::string line = quoted(image) + "," + nameOf(r.status) + "," +
                     (database.crs.empty() ? "local" : quoted("world of " + database.crs));
  if (r.pose.success) {
    const auto& T = r.pose.T_world_camera;
    Eigen::Quaterniond q(T.linear());
    if (q.w() < 0) q.coeffs() *= -1;
    for (const double v : {T.translation().x(), T.translation().y(), T.translation().z()})
      line += formatted(",%.4f", v);
    for (const double v : {q.x(), q.y(), q.z(), q.w()}) line += formatted(",%.7f", v);
    const Eigen::Vector3d crs = database.model.crsFromWorld(T.translation());
    for (int i = 0; i < 3; ++i) line += formatted(",%.3f", crs[i]);
    for (int i = 0; i < 6; ++i) line += formatted(",%.5f", std::sqrt(std::max(0.0, r.pose.covariance(i, i))));
  } else {
    line += std::string(16, ',');
  }
  line += formatted(",%.3f,", r.acceptance.score) +
          (r.panorama >= 0 ? quoted(database.panoramas[static_cast<std::size_t>(r.panorama)].id) : "");
  line += "," + std::to_string(r.searched.size()) + "," + std::to_string(r.features) + "," + std::to_string(r.matches) +
          "," + std::to_string(r.pose.success ? r.pose.inliers.size() : 0);
  line += formatted(",%.3f", r.pose.rms) + formatted(",%.2f", r.acceptance.evidence.range) +
          formatted(",%.3f", r.total_time);
  const PoseEvidence& e = r.acceptance.evidence;
  for (const double v : {e.inlier_share, e.kept_share, e.position_stddev, e.competitor_share})
    line += formatted(",%.4f", v);
  line += "," + std::to_string(e.cells) + "," + quoted(r.reason);
  return line + "\n";
}

struct Arguments {
  std::string db, images, camera, cameras, up, out, pictures;
  double up_stddev = 2;
  std::vector<double> region;
  bool keep_index = true, mirrored = false;
  std::string covariance = "refined";
  int monte_carlo_samples = 1000;
  StreetviewLocalizerSettings settings;
};

/// What is known of the images beforehand.
struct Flight {
  std::optional<air_ground_common::CameraModel> common;           ///< of all images; else each has its own
  std::map<std::string, air_ground_common::CameraModel> cameras;  ///< by file name
  std::map<std::string, Eigen::Vector3d> ups;                     ///< up in the camera's frame, by file name
  std::vector<std::string> names;                                 ///< of the files

  air_ground_common::CameraModel cameraOf(const std::string& name, const cv::Mat& image) const {
    if (common) return *common;
    air_ground_common::CameraModel camera = cameras.at(name);
    camera.width = image.cols, camera.height = image.rows;
    return camera;
  }
};

Flight readFlight(const Arguments& a) {
  if (a.camera.empty() == a.cameras.empty()) throw std::runtime_error("give either --camera or --cameras");
  Flight flight;
  if (!a.camera.empty())
    flight.common = air_ground_common::readCameraFile(a.camera);
  else
    flight.cameras = readCameraList(a.cameras);
  if (!a.up.empty()) flight.ups = readUpList(a.up);
  flight.names = flight.common ? listImages(a.images) : listCalibratedImages(a.images, flight.cameras, a.cameras);
  return flight;
}

LocalizerResult locate(const StreetviewLocalizer& localizer, const cv::Mat& image, const std::string& name,
                       const Flight& flight, double up_stddev) {
  LocalizerResult result;
  if (image.empty()) {
    result.reason = "the image cannot be read";
    return result;
  }
  PosePrior prior;
  if (const auto it = flight.ups.find(name); it != flight.ups.end())
    prior.up_camera = it->second, prior.up_stddev = up_stddev;
  try {
    result = localizer.localize(image, flight.cameraOf(name, image), prior);
  } catch (const std::invalid_argument& e) {
    result.reason = e.what();
  }
  return result;
}

int run(Arguments a) {
  const Flight flight = readFlight(a);
  DatabaseLoadOptions load;
  if (!a.region.empty()) {
    if (!(a.region[2] > 0)) throw std::runtime_error("--region needs a positive radius");
    load.centre = Eigen::Vector2d(a.region[0], a.region[1]);
    load.radius = a.region[2];
  }
  const auto database = std::make_shared<const StreetviewDatabase>(loadDatabase(a.db, load));
  if (a.keep_index) a.settings.index_file = indexFileOf(a.db, load);
  if (a.covariance == "monte_carlo") {
    a.settings.covariance = CovarianceKind::kMonteCarlo;
    a.settings.pose.monte_carlo_samples = a.monte_carlo_samples;
  }
  const StreetviewLocalizer localizer(database, a.settings);
  std::fprintf(stderr, "%s\n", localizer.indexRemark().c_str());
  std::unique_ptr<ViewSynthesizer> synthesizer;
  if (!a.pictures.empty()) {
    std::filesystem::create_directories(a.pictures);
    synthesizer = std::make_unique<ViewSynthesizer>(*database, localizer.projector());
  }
  const std::string partial = a.out + ".partial";
  std::ofstream out(partial);
  if (!out) throw std::runtime_error("cannot write " + partial);
  out << kHeader;
  int accepted = 0;
  std::array<double, kSteps> times{};
  double total = 0;
  for (const std::string& name : flight.names) {
    cv::Mat image =
        cv::imread(a.images + "/" + name, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);  // as the database's
    if (a.mirrored && !image.empty()) cv::flip(image, image, 1);
    const LocalizerResult result = locate(localizer, image, name, flight, a.up_stddev * M_PI / 180);
    if (synthesizer && !image.empty()) {
      const std::string stem = a.pictures + "/" + std::filesystem::path(name).stem().string();
      cv::imwrite(stem + "_match.jpg", drawMatch(image, *database, result));
      if (result.pose.success)
        cv::imwrite(stem + "_view.jpg",
                    drawBeside(image, synthesizer->render(flight.cameraOf(name, image), result.pose.T_world_camera)));
    }
    accepted += result.accepted();
    for (std::size_t i = 0; i < times.size(); ++i) times[i] += result.times[i];
    total += result.total_time;
    out << lineOf(name, result, *database);
    std::fprintf(stderr, "%s: %s%s%s\n", name.c_str(), nameOf(result.status), result.accepted() ? "" : ", ",
                 result.accepted() ? "" : result.reason.c_str());
  }
  out.close();
  if (!out) throw std::runtime_error("cannot write " + partial);
  std::filesystem::rename(partial, a.out);
  const double n = static_cast<double>(flight.names.size());
  std::printf("%s: %d of %zu images located\n", a.out.c_str(), accepted, flight.names.size());
  for (int i = 0; i < kSteps; ++i)
    std::printf("  %-28s %6.3f s an image\n", nameOf(static_cast<Step>(i)), times[static_cast<std::size_t>(i)] / n);
  std::printf("  %-28s %6.3f s an image\n", "all", total / n);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Locates photographs in a Street View database and writes a line each: status, position, quaternion (camera to "
      "world, x y z w), standard "
      "deviations [m, rad], panorama, inliers, time.\n"
      "  rosrun air_ground localize_images --db city.gpkg --images flight --camera camera.yaml --out poses.csv");
  Arguments a;
  app.add_option("--db", a.db, "database made by build_streetview_db (.gpkg, or \"PG:...\")")->required();
  app.add_option("--region", a.region,
                 "only its panoramas around a place: easting northing radius, in the database's system [m]")
      ->expected(3);
  app.add_option("--images", a.images, "folder of photographs")->required();
  app.add_option("--camera", a.camera, "calibration of all of them (ROS camera_info YAML)");
  app.add_option("--cameras", a.cameras,
                 "instead: lines of `image fx fy cx cy [k1 k2 p1 p2 k3]`; images not listed are left out");
  app.add_option("--up", a.up,
                 "optional, from an IMU: lines of `image x y z`, the direction against gravity in the optical frame");
  app.add_option("--up-stddev", a.up_stddev, "of those directions [deg]")
      ->capture_default_str()
      ->check(CLI::Range(0.01, 45.0));
  app.add_option("--out", a.out, "CSV to write")->required();
  app.add_option("--pictures", a.pictures,
                 "folder for a picture of each match, and of the textured model from each pose");
  app.add_flag("!--no-index-file", a.keep_index, "do not keep the search index beside the database (DB.index)");
  app.add_flag("--mirrored", a.mirrored, "flip the images left to right: nothing may be located");
  app.add_option("--max-views", a.settings.max_views, "views matched pairwise with an image")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));
  app.add_option("--max-range", a.settings.acceptance.max_range, "from the panorama [m]")
      ->capture_default_str()
      ->check(CLI::Range(1.0, 1000.0));
  app.add_option("--model-lateral-stddev", a.settings.model_lateral_stddev, "of the city model's walls [m]")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 10.0));
  app.add_option("--model-relief-stddev", a.settings.model_relief_stddev, "of what the model lacks on its walls [m]")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 10.0));
  app.add_option("--model-height-stddev", a.settings.model_height_stddev, "of the city model's heights [m]")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 10.0));
  app.add_option("--covariance", a.covariance, "of the estimate, or the paper's scatter of minimal samples")
      ->capture_default_str()
      ->check(CLI::IsMember({"refined", "monte_carlo"}));
  app.add_option("--monte-carlo-samples", a.monte_carlo_samples, "of five matches")
      ->capture_default_str()
      ->check(CLI::Range(10, 1000000));
  CLI11_PARSE(app, argc, argv);
  try {
    return run(a);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "localize_images: %s\n", e.what());
    return 1;
  }
}
