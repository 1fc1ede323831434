// build_streetview_db: from images with geotags (or surveyed poses) and a city model to the database of the localizer.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <string>

#include "air_ground_common/camera_file.h"
#include "air_ground_common/units.h"
#include "streetview_localizer/database_builder.h"

namespace {

using namespace streetview_localizer;

using air_ground_common::kDegree;

// A bar on a terminal, a line every tenth of the way elsewhere.
class Progress {
 public:
  void operator()(const std::string& stage, int done, int all) {
    if (stage != stage_) {
      stage_ = stage;
      tenth_ = -1;
    }
    if (isatty(STDERR_FILENO)) {
      const int full = all > 0 ? 40 * done / all : 40;
      std::fprintf(stderr, "\r%-24s [%s%s] %d of %d ", stage.c_str(), std::string(full, '#').c_str(),
                   std::string(40 - full, ' ').c_str(), done, all);
      if (done == all) std::fputc('\n', stderr);
    } else if (const int tenth = all > 0 ? 10 * done / all : 10; tenth != tenth_) {
      tenth_ = tenth;
      std::fprintf(stderr, "%s: %d of %d\n", stage.c_str(), done, all);
    }
  }

 private:
  std::string stage_;
  int tenth_ = -1;
};

void printRemarks(const BuildReport& report) {
  for (const std::string& remark : report.remarks) std::printf("model: %s\n", remark.c_str());
  for (const std::string& remark : report.image_remarks) std::printf("images: %s\n", remark.c_str());
  for (const auto& refusal : report.refused)
    std::printf("not used: %s: %s\n", refusal.image.c_str(), refusal.reason.c_str());
  for (const auto& image : report.uncorrected)
    std::printf("used with its geotag: %s: %s\n", image.image.c_str(), image.reason.c_str());
  for (const auto& image : report.doubtful)
    std::printf("used, but stated to be less certain: %s: %s\n", image.image.c_str(), image.reason.c_str());
  for (const auto& image : report.corrected_anew)
    std::printf("corrected anew, where its neighbours place it: %s: %s\n", image.image.c_str(), image.reason.c_str());
  if (report.neighbour_pairs > 0)
    std::printf("%d pairs of neighbours were compared by their images\n", report.neighbour_pairs);
  if (report.gained > 0)
    std::printf("%d images could be corrected only where their neighbours place them\n", report.gained);
}

void printCounts(const BuildReport& report, const std::string& output) {
  const auto& f = report.features;
  std::printf("%s: %d images stored, %d were there already, %zu not used; %d views with %d features\n", output.c_str(),
              report.stored, report.resumed, report.refused.size(), report.views, f.kept - report.inconsistent);
  std::printf(
      "features left out: %d sky, %d ground and road, %d too near or far, %d grazing, %d at edges, %d unlike in other "
      "images\n",
      f.sky, f.ground, f.range, f.grazing, f.edge, report.inconsistent);
}

/// Angles in degrees. What is not given (`heading_stddev` 0) grows with the search: who searches wider believes less.
void adoptSearch(double yaw, bool default_stddev, double heading_stddev, double tilt_stddev, RegistrationSettings* s) {
  const RegistrationSettings usual;
  if (default_stddev) s->geotag_stddev = usual.geotag_stddev * std::max(1.0, s->search_radius / usual.search_radius);
  s->search_yaw = std::min(M_PI, yaw * kDegree);
  s->heading_stddev = heading_stddev > 0 ? heading_stddev * kDegree
                                         : usual.heading_stddev * std::max(1.0, s->search_yaw / usual.search_yaw);
  s->tilt_stddev = tilt_stddev * kDegree;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Builds the Street View database: cuts panoramas into views, extracts features, casts them onto the city model.\n"
      "Interrupted, it goes on when started again; given an existing database, it adds the new images.");
  BuildSettings s;
  std::string camera, north = "true";
  std::vector<double> origin, offset;
  double fov = s.views.horizontal_fov / kDegree, step = s.views.yaw_step / kDegree,
         incidence = s.back_projection.max_incidence / kDegree, search_yaw = s.registration.search_yaw / kDegree,
         heading_stddev = s.registration.heading_stddev / kDegree, tilt_stddev = s.registration.tilt_stddev / kDegree,
         pose_angle_stddev = s.pose_angle_stddev / kDegree;
  std::string up = "z";
  BuildReport report;
  std::vector<double> pitches;
  bool no_registration = false, no_neighbours = false, no_consistency = false, built = false;
  app.add_option("output", s.output, "the database: FILE.gpkg, or \"PG:dbname=...\" for PostGIS")->required();
  app.add_option("--model", s.model, "city model: CityGML, CityJSON, OBJ, or a folder of them")->required();
  app.add_option("--geotags", s.geotags,
                 "CSV (image,lat,lon and, if known, alt,heading_deg,pitch_deg,roll_deg) or GeoJSON of the images");
  app.add_option("--poses", s.poses,
                 "instead: surveyed photographs, lines of `image fx fy cx cy tx ty tz qx qy qz qw` (camera to model, "
                 "as its file counts: --up, --model-offset and --model-height-offset move them, too)");
  app.add_option("--pose-stddev", s.pose_stddev,
                 "of the positions of --poses, one axis [m]: the default is of bundle adjustment of good photographs, "
                 "give what your survey states")
      ->check(CLI::Range(1e-4, 100.0))
      ->capture_default_str();
  app.add_option("--pose-angle-stddev", pose_angle_stddev, "of their attitudes, one axis [deg]; the default the same")
      ->check(CLI::Range(1e-4, 28.6))
      ->capture_default_str();
  app.add_option("--images", s.images, "folder of the images [that of the list]; alone: geotags from EXIF");
  app.add_option("--every", s.take_every, "take every n-th image of the list")->capture_default_str();
  app.add_option("--first", s.take_first, "index of the first image taken")->capture_default_str();
  app.add_option("--crs", s.model_options.crs,
                 "coordinate system of the model, if its file does not tell, like EPSG:2056");
  app.add_option("--origin", origin,
                 "of the local frame: easting northing height as the model counts them [middle of the model]")
      ->expected(3);
  app.add_option("--lod", s.model_options.lod, "level of detail to take of the model [finest]");
  app.add_option(
         "--height-unit", s.model_options.height_unit,
         "of the heights of the model, --origin and --poses [m], 0.3048 for feet [as the model's vertical system "
         "says, else 1]")
      ->check(CLI::Range(1e-3, 1e3));
  app.add_option("--model-offset", offset,
                 "easting northing height of the place that the model's coordinates are counted from, added to them")
      ->expected(3);
  app.add_option("--up", up, "which axis of an OBJ is up, `z` or `y`")
      ->check(CLI::IsMember({"z", "y"}))
      ->capture_default_str();
  app.add_option("--model-height-offset", s.model_options.height_offset, "added to the model's heights [m]");
  app.add_option("--geotag-height-offset", s.geotag_height_offset,
                 "added to the geotags' heights, into the model's vertical datum [m]");
  app.add_option("--north", north, "headings are counted from `true` north or from `grid` north of the model's system")
      ->check(CLI::IsMember({"true", "grid"}))
      ->capture_default_str();
  app.add_option("--camera", camera,
                 "calibration (ROS camera_info YAML) of geotagged photographs; images of its size are no panoramas");
  app.add_flag("--no-registration", no_registration, "take the geotags as they are");
  app.add_flag("--no-neighbour-check", no_neighbours,
               "keep corrected poses that contradict what neighbouring images show");
  app.add_flag("--keep-unregistered", s.keep_unregistered,
               "use the geotag of an image whose pose could not be corrected");
  app.add_flag("--no-consistency", no_consistency, "keep features that other images do not see on the facade");
  app.add_option("--min-correlation", s.consistency.min_correlation,
                 "of a feature's surroundings with what other images show there")
      ->capture_default_str();
  app.add_option("--camera-height", s.registration.camera_height,
                 "of the panoramas above the model's ground [m], 0 if not known")
      ->capture_default_str();
  app.add_option("--search-radius", s.registration.search_radius,
                 "around a geotag in plan [m]: as far as it may be wrong")
      ->check(CLI::Range(0.5, 50.0))
      ->capture_default_str();
  app.add_option("--search-yaw", search_yaw, "to either side of its heading [deg], 180 for the full circle")
      ->check(CLI::Range(0.6, 180.0))
      ->capture_default_str();
  auto* geotag_stddev = app.add_option("--geotag-stddev", s.registration.geotag_stddev,
                                       "of a geotag's place, one axis [m] [a third of --search-radius]")
                            ->check(CLI::Range(0.01, 100.0));
  app.add_option("--height-stddev", s.registration.height_stddev, "of its height [m]")
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  auto* heading_given =
      app.add_option("--heading-stddev", heading_stddev, "of its heading [deg] [--search-yaw / 3.43: 2 degrees of 6.9]")
          ->check(CLI::Range(0.006, 180.0));
  app.add_option("--tilt-stddev", tilt_stddev, "of its pitch and roll [deg]")
      ->check(CLI::Range(0.006, 28.6))
      ->capture_default_str();
  app.add_option("--view-width", s.views.width, "of the cut views [px]")->capture_default_str();
  app.add_option("--view-height", s.views.height, "[px]")->capture_default_str();
  app.add_option("--view-fov", fov, "their horizontal field of view [deg]")->capture_default_str();
  app.add_option("--view-step", step, "angle between them [deg]")->capture_default_str();
  app.add_option("--view-pitch", pitches, "of their axes, one ring of views each [15 deg]");
  app.add_option("--photograph-focal", s.photograph_focal,
                 "focal length of photographs in the database [px]: those of more than 1.25 times as much are reduced")
      ->check(CLI::Range(100.0, 1e5))
      ->capture_default_str();
  app.add_option("--max-depth", s.back_projection.max_depth, "of features [m]")->capture_default_str();
  app.add_option("--max-incidence", incidence, "between ray and facade normal [deg]")->capture_default_str();
  app.add_option("--max-features", s.features.max_features, "of a view, 0: all")->capture_default_str();
  app.add_option("--textured-model", s.textured_model,
                 "also write the city model with the facades' pictures: FILE.obj, with .mtl and .jpg beside it");
  app.add_option("--texel", s.texture.resolution, "its resolution on the facades [m]")->capture_default_str();
  app.add_option("--threads", s.threads, "0: all cores")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  std::signal(SIGXFSZ, SIG_IGN);  // a quota that is used up is an error of the write, not the end of the process
  try {
    s.north = north == "grid" ? North::kGrid : North::kTrue;
    s.register_panoramas = !no_registration;
    s.check_neighbours = !no_neighbours;
    s.check_consistency = !no_consistency;
    s.views.horizontal_fov = fov * kDegree;
    s.views.yaw_step = step * kDegree;
    s.back_projection.max_incidence = incidence * kDegree;
    if (!pitches.empty()) s.views.pitches.clear();
    for (const double p : pitches) s.views.pitches.push_back(p * kDegree);
    if (!origin.empty()) s.model_options.origin = Eigen::Vector3d(origin[0], origin[1], origin[2]);
    if (!offset.empty()) s.model_options.offset = Eigen::Vector3d(offset[0], offset[1], offset[2]);
    s.model_options.y_up = up == "y";
    s.pose_angle_stddev = pose_angle_stddev * kDegree;
    adoptSearch(search_yaw, geotag_stddev->empty(), heading_given->empty() ? 0 : heading_stddev, tilt_stddev,
                &s.registration);
    if (!camera.empty()) s.camera = air_ground_common::readCameraFile(camera);
    if (s.camera && s.camera->model != air_ground_common::DistortionModel::kPlumbBob)
      throw std::invalid_argument("--camera: photographs of the database must be plumb_bob, not " +
                                  s.camera->distortionName() + "; undistort them");
    Progress progress;
    buildDatabase(s, std::ref(progress), &report);
    built = true;
    printRemarks(report);
    printCounts(report, s.output);
    if (!report.useful())
      throw std::runtime_error(std::string("no image can be used: see the reasons above") +
                               (s.keep_unregistered
                                    ? ""
                                    : ". With --keep-unregistered those whose pose could not be corrected are used "
                                      "with their geotags, and poses are as uncertain as these"));
  } catch (const std::exception& e) {
    if (!built) printRemarks(report);  // they may say what went wrong
    std::fprintf(stderr, "build_streetview_db: %s\n", e.what());
    return 1;
  }
  return 0;
}
