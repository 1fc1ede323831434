// What becomes of images and geotags of others: telephones, Mapillary, Street View's metadata; and of another model.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "street_files.h"
#include "synthetic_street.h"
#include "xmp_jpeg.h"

namespace streetview_localizer {
namespace {

TEST(BuildImages, AnotherModelThanTheDatabasesIsRefused) {
  Street street;
  BuildSettings s = street.settings;
  s.take_every = 3;
  EXPECT_EQ(buildDatabase(s).stored, 1);
  const auto error = [&](const BuildSettings& other) {
    const std::string m = messageOf([&] { buildDatabase(other); });
    EXPECT_TRUE(contains(m, "was made with other settings (model 1 buildings 1 polygons heights")) << m;
    EXPECT_FALSE(contains(m, "sift")) << m;  // the same in both
  };
  BuildSettings other = s;
  other.model_options.height_offset = -3;
  error(other);
  other = s;
  other.model_options.height_unit = 0.3048;
  error(other);
  other = s;
  other.model_options.crs = "EPSG:21781";  // the same survey's older grid: 2000 km and 1000 km less
  other.model_options.offset = Eigen::Vector3d(-2e6, -1e6, 0);
  other.model_options.origin.reset();
  error(other);
  // The same model may have moved, and settings may be told that databases of before do not hold.
  std::filesystem::rename(s.model, street.folder / "moved.obj");
  s.model = street.folder / "moved.obj";
  EXPECT_EQ(buildDatabase(s).resumed, 1);
}

/// That the only image's features lie on the wall; the database.
StreetviewDatabase expectOnTheWall(const BuildSettings& s, bool equirectangular) {
  const BuildReport report = buildDatabase(s);
  EXPECT_EQ(report.stored, 1) << (report.refused.empty() ? "" : report.refused[0].reason);
  EXPECT_TRUE(report.useful());
  StreetviewDatabase d = loadDatabase(s.output);
  std::size_t features = 0;
  for (const View& view : d.views) {
    features += view.features.size();
    for (const Eigen::Vector3f& p : view.points) EXPECT_NEAR(p.y(), 10, 2e-3);
  }
  EXPECT_GT(features, 30u);
  EXPECT_EQ(d.panoramas.at(0).equirectangular, equirectangular);
  return d;
}

/// Settings for one photograph as the panorama in the middle shows it, with its camera.
BuildSettings photographOf(Street* street, int width, int height, cv::Mat* image) {
  BuildSettings s = street->settings;
  PanoramaViewSettings views = s.views;
  views.width = width, views.height = height;
  const View view = cutPanorama(wallPanorama(1024, panoramaPose(0), false), panoramaPose(0), views)[0];
  *image = view.image;
  s.camera = view.camera;
  const auto g = street->frame.toGeodetic(panoramaPose(0).translation());
  s.geotags = street->listOf("photo.csv", formatted("photo.jpg,%.10f,%.10f,%.4f,%.6f,15,0\n", g.latitude, g.longitude,
                                                    g.height, 90 - 0.9 * 180 / M_PI));
  return s;
}

TEST(BuildImages, APhotographTwiceAsWideAsHighIsNoSphere) {
  Street street;
  cv::Mat image;
  BuildSettings s = photographOf(&street, 400, 200, &image);
  cv::imwrite(street.folder / "photo.jpg", image, {cv::IMWRITE_JPEG_QUALITY, 98});
  const StreetviewDatabase d = expectOnTheWall(s, false);
  EXPECT_EQ(d.views.size(), 1u);
  // Without camera nothing tells: that is said once.
  s.camera.reset();
  s.output = street.folder / "sphere.gpkg";
  const BuildReport report = buildDatabase(s);
  ASSERT_EQ(report.image_remarks.size(), 1u);
  EXPECT_TRUE(contains(report.image_remarks[0], "1 images twice as wide as high are taken for full spheres"));
  EXPECT_EQ(loadDatabase(s.output).panoramas.at(0).equirectangular, true);
}

// A telephone held upright stores what its sensor sees, and in EXIF how to turn it.
TEST(BuildImages, OrientationsTurnPhotographs) {
  const std::pair<int, int> cases[] = {
      {1, -1}, {6, cv::ROTATE_90_COUNTERCLOCKWISE}, {8, cv::ROTATE_90_CLOCKWISE}, {3, cv::ROTATE_180}};
  std::vector<std::size_t> features;
  for (const auto& [orientation, turn] : cases) {
    Street street;
    cv::Mat upright, stored;
    BuildSettings s = photographOf(&street, 240, 320, &upright);
    stored = upright;
    if (turn >= 0) cv::rotate(upright, stored, turn);
    if (stored.cols != upright.cols) {
      std::swap(s.camera->width, s.camera->height);
      std::swap(s.camera->fx, s.camera->fy);
      std::swap(s.camera->cx, s.camera->cy);
    }
    std::vector<uchar> jpeg;
    cv::imencode(".jpg", stored, jpeg, {cv::IMWRITE_JPEG_QUALITY, 98});
    street.folder.write("photo.jpg", withOrientation(jpeg, orientation));
    const StreetviewDatabase d = expectOnTheWall(s, false);
    // What the upright image shows at a feature's place is what the wall has there: noise of its formula.
    double difference = 0;
    for (const View& view : d.views)
      for (std::size_t i = 0; i < view.points.size(); ++i) {
        const cv::Point2f p = view.features.keypoints[i].pt;
        difference += std::abs(stored.at<cv::Vec3b>(cv::Point(cvRound(p.x), cvRound(p.y)))[1] -
                               noise(view.points[i].x(), view.points[i].z())) /
                      view.points.size();
      }
    EXPECT_LT(difference, 30) << orientation;  // two places that have nothing to do with each other: 60
    features.push_back(d.views.at(0).features.size());
    EXPECT_NEAR(1.0 * features.back() / features[0], 1, 0.2);
  }
  Street street;
  cv::Mat image;
  const BuildSettings s = photographOf(&street, 240, 320, &image);
  std::vector<uchar> jpeg;
  cv::imencode(".jpg", image, jpeg);
  street.folder.write("photo.jpg", withOrientation(jpeg, 5));
  EXPECT_TRUE(contains(messageOf([&] { buildDatabase(s); }), "is mirrored by its EXIF orientation"));
}

/// A street that panoramas can be registered in: its model in the Swiss grid, one panorama, and what is listed of it.
class RealisticStreet {
 public:
  RealisticStreet() {
    SyntheticStreetSettings settings;
    settings.seed = 213;
    const SyntheticStreet street(settings);
    std::string obj;
    const CityModel& model = street.model();
    for (const auto& v : model.mesh.vertices) {
      const Eigen::Vector3d p = frame.toCrs(v.cast<double>());
      obj += formatted("v %.4f %.4f %.4f\n", p.x(), p.y(), p.z());
    }
    for (std::size_t i = 0; i < model.mesh.triangles.size(); ++i) {
      const Eigen::Vector3i t = model.mesh.triangles[i] + Eigen::Vector3i::Ones();
      const bool ground = model.building[i] < 0;
      const std::string group = model.surface[i] == Surface::kRoof ? "roof" : ground ? "ground" : "wall";
      obj += formatted("o %s%d\ng %s\nf %d %d %d\n", ground ? "terrain " : "house", ground ? 0 : model.building[i],
                       group.c_str(), t.x(), t.y(), t.z());
    }
    s.model = folder.write("street.obj", obj);
    s.model_options.crs = "EPSG:2056";
    s.model_options.origin = kOrigin;
    std::mt19937_64 random(3);
    truth = street.panoramaPose(60, &random);
    cv::imwrite(folder / "17.jpg", street.render(truth), {cv::IMWRITE_JPEG_QUALITY, 95});
    s.output = folder / "street.gpkg";
    s.check_consistency = false;
    s.threads = 2;
    s.features.max_features = 50;
    s.views.width = s.views.height = 256;
  }
  /// One line of a list for the image, by its bare name, one metre off.
  std::string list(const std::string& header, const std::string& further) const {
    const auto g = frame.toGeodetic(truth.translation() + Eigen::Vector3d(1, 0.5, 0));
    return folder.write("list.csv", header + formatted("\n17,%.9f,%.9f", g.latitude, g.longitude) + further + "\n");
  }

  const air_ground_common::LocalFrame frame{"EPSG:2056", kOrigin};
  TemporaryFolder folder;
  BuildSettings s;
  air_ground_common::Pose truth = air_ground_common::Pose::Identity();
};

TEST(BuildImages, NeitherHeightNorHeadingIsNeeded) {
  RealisticStreet street;
  BuildSettings& s = street.s;
  const auto place = [&] {
    const BuildReport report = buildDatabase(s);
    EXPECT_EQ(report.stored, 1) << (report.refused.empty() ? "" : report.refused[0].reason);
    const Panorama p = loadDatabase(s.output).panoramas.at(0);
    std::filesystem::remove(s.output);
    EXPECT_TRUE(p.registered) << p.remark;
    EXPECT_LT((p.T_world_panorama.translation() - street.truth.translation()).norm(), 0.6);
    EXPECT_LT(air_ground_common::rotationAngle(p.T_world_panorama.linear(), street.truth.linear()), 0.0175);
    return p;
  };
  const double heading = 90 - air_ground_common::yawOf(street.truth.linear()) * 180 / M_PI;
  s.geotags = street.list("id,latitude,longitude,compass_angle", formatted(",%.3f", heading + 1));
  const Panorama no_height = place();
  EXPECT_EQ(no_height.id, "17.jpg");
  EXPECT_NEAR(no_height.T_world_geotag.translation().z(), street.truth.translation().z(), 0.5);
  s.geotags = street.list("pano_id,lat,lng", "");
  place();
  // Nothing finds the heading where nothing is corrected.
  s.register_panoramas = false;
  EXPECT_TRUE(contains(messageOf([&] { buildDatabase(s); }), "has no heading, which only the correction finds"));
  s.geotags = street.list("image,lat,lon,heading", ",10");
  s.registration.camera_height = 0;
  EXPECT_TRUE(contains(messageOf([&] { buildDatabase(s); }), "has no height: give the camera's above the ground"));
}

// A blank image is kept with its geotag where that is wanted; one without heading is never.
TEST(BuildImages, WhatIsNotCorrectedStatesWhatItsGeotagIsWorth) {
  RealisticStreet street;
  BuildSettings& s = street.s;
  cv::imwrite(street.folder / "17.jpg", cv::Mat(512, 1024, CV_8UC3, cv::Scalar(200, 200, 200)));
  s.keep_unregistered = true;
  s.registration.geotag_stddev = 12, s.registration.heading_stddev = 0.6;
  for (const bool heading : {true, false}) {
    s.geotags = heading ? street.list("image,lat,lon,heading", ",10") : street.list("image,lat,lon", "");
    const BuildReport report = buildDatabase(s);
    const Panorama p = loadDatabase(s.output).panoramas.at(0);
    std::filesystem::remove(s.output);
    EXPECT_NEAR(p.position_stddev, std::sqrt((2 * 144 + 9) / 3.0), 1e-3);
    const double yaw = heading ? 0.6 : M_PI / std::sqrt(3.0);
    EXPECT_NEAR(p.orientation_stddev, std::sqrt((2 * 0.03 * 0.03 + yaw * yaw) / 3), 1e-3);
    EXPECT_EQ(report.refused.size(), 1u);  // without features, too, nothing is to be seen in it
  }
}

// Ellipsoidal heights, 47 m above those of the model: cameras would stand above the roofs, and be believed.
TEST(BuildImages, GeotagsFarAboveTheGroundAreRemarkedOn) {
  Street street;
  BuildSettings s = street.settings;
  const auto remarks = [&](double height) {
    const auto g = street.frame.toGeodetic(panoramaPose(0).translation() + Eigen::Vector3d(0, 0, height));
    s.geotags = street.listOf("heights.csv",
                              formatted("p1.png,%.10f,%.10f,%.4f,38.4,0,0\n", g.latitude, g.longitude, g.height));
    std::string text;
    for (const std::string& remark : buildDatabase(s).image_remarks)
      if (contains(remark, "geotags lie")) text += remark;
    std::filesystem::remove(s.output);
    return text;
  };
  EXPECT_EQ(remarks(0), "");
  EXPECT_EQ(remarks(3), "");
  const std::string high = remarks(47);
  EXPECT_TRUE(contains(high, "geotags lie 47 m above where") && contains(high, "--geotag-height-offset -47")) << high;
  EXPECT_TRUE(contains(high, "--camera-height 0")) << high;  // a drone's or a mast's: not to be taken to the street
  const std::string low = remarks(-20);
  EXPECT_TRUE(contains(low, "geotags lie 20 m below where") && !contains(low, "--camera-height 0")) << low;
  s.geotag_height_offset = -40;  // not enough: the remark tells what would be
  EXPECT_TRUE(contains(remarks(47), "--geotag-height-offset -47"));
  s.geotag_height_offset = -47;
  EXPECT_EQ(remarks(47), "");
}

// A list beside which the images lie, given by its name alone.
TEST(BuildImages, BareNamesAreSoughtInTheFolderOneIsIn) {
  Street street;
  BuildSettings s = street.settings;
  s.check_consistency = false;
  street.listOf("bare.csv", street.lineOf("p0", -12) + street.lineOf("p1", 0) + street.lineOf("none", 12));
  s.geotags = "bare.csv";
  const std::filesystem::path before = std::filesystem::current_path();
  std::filesystem::current_path(street.folder / "");
  BuildReport report;
  const std::string m = messageOf([&] { report = buildDatabase(s); });
  std::filesystem::current_path(before);
  ASSERT_EQ(m, "");
  EXPECT_EQ(report.stored, 2);
  ASSERT_EQ(report.refused.size(), 1u);
  EXPECT_TRUE(contains(report.refused[0].reason, "is missing: there is no ./none")) << report.refused[0].reason;
  EXPECT_EQ(loadDatabase(s.output).panoramas.at(0).id, "p0.png");
}

TEST(BuildImages, ImagesFarFromTheModelAreToldHowFar) {
  Street street;
  BuildSettings s = street.settings;
  const CityModel model = readCityModel(s.model, s.model_options);
  std::string lines;
  std::vector<double> nearest;
  // Around the wall, which reaches from -30 to 30 m: before and beyond 500 m of its ends, and kilometres away.
  for (const Eigen::Vector2d& place :
       {Eigen::Vector2d(529, 10), {531, 10}, {-529, 10}, {-400, 411}, {700, -2200}, {0, 9000}}) {
    const std::string name = "far" + std::to_string(nearest.size()) + ".png";
    std::filesystem::copy_file(street.folder / "p0.png", street.folder / name);
    const auto g = street.frame.toGeodetic({place.x(), place.y(), 2});
    lines += formatted("%s,%.10f,%.10f,%.4f,0,0,0\n", name.c_str(), g.latitude, g.longitude, g.height);
    nearest.push_back(1e9);
    for (const auto& v : model.mesh.vertices)
      nearest.back() = std::min(nearest.back(), (v.cast<double>().head<2>() - place).norm());
  }
  s.geotags = street.listOf("far.csv", lines + street.lineOf("p1.png", 0));
  std::map<std::string, std::string> reasons;
  for (const auto& refusal : buildDatabase(s).refused) reasons[refusal.image] = refusal.reason;
  for (std::size_t i = 0; i < nearest.size(); ++i) {
    const std::string& reason = reasons["far" + std::to_string(i) + ".png"];
    const std::string far = formatted("lies %ld km from the city model", std::lround(nearest[i] / 1000));
    EXPECT_TRUE(nearest[i] > 500 ? contains(reason, far) : reason == "sees no facade of the model") << i << reason;
  }
}

TEST(BuildImages, ImagesOfRoughPoseHaveNoSayInWhatOthersShow) {
  Street street;
  BuildSettings s = street.settings;
  const auto featuresOfMiddle = [&] {
    const StreetviewDatabase d = loadDatabase(s.output);
    std::size_t features = 0;
    for (const View& view : d.views)
      if (d.panoramas[view.panorama].id == "p1.png") features += view.features.size();
    return features;
  };
  s.check_consistency = false;
  EXPECT_EQ(buildDatabase(s).stored, 3);
  const std::size_t all = featuresOfMiddle();
  s.check_consistency = true;
  s.output = street.folder / "rough.gpkg";
  // The middle one corrected, as by an earlier run; the others with geotags that are 2 m off.
  s.geotags = street.listOf("rough.csv",
                            street.lineOf("p0.png", -14) + street.lineOf("p1.png", 0) + street.lineOf("p2.png", 14));
  Panorama middle;
  middle.id = "p1.png";
  middle.T_world_geotag = middle.T_world_panorama = panoramaPose(0);
  middle.registered = true;
  middle.position_stddev = 0.15, middle.orientation_stddev = 0.003;
  {
    const CityModel model = readCityModel(s.model, s.model_options);
    DatabaseWriter(s.output, model, s.fingerprint(model.identity)).plan({middle});
  }
  const BuildReport report = buildDatabase(s);
  EXPECT_EQ(report.stored, 3);
  EXPECT_EQ(report.inconsistent, 0);
  EXPECT_GT(all, 300u);
  EXPECT_GT(featuresOfMiddle(), 0.9 * all);
}

// Surveyed in the model's file: what moves the file moves its cameras.
TEST(BuildImages, SurveyedPosesCountAsTheModelsFileDoes) {
  Street street;
  BuildSettings s = street.settings;
  s.geotags.clear();
  s.check_consistency = false;
  const View view = cutPanorama(wallPanorama(1024, panoramaPose(0), false), panoramaPose(0), s.views)[0];
  cv::imwrite(street.folder / "photo.png", view.image);
  air_ground_common::Pose T_crs_camera = view.T_world_camera;
  T_crs_camera.translation() = street.frame.toCrs(view.T_world_camera.translation());
  T_crs_camera.linear() =
      Eigen::AngleAxisd(street.frame.meridianConvergence(), Eigen::Vector3d::UnitZ()) * view.T_world_camera.linear();
  // To the file's coordinates, with y up and counted from elsewhere.
  const Eigen::Vector3d offset(2683000, 1247000, 400), height(0, 0, 7);
  const Eigen::AngleAxisd turn(-M_PI / 2, Eigen::Vector3d::UnitX());
  const auto build = [&](bool moved, const std::string& output) {
    air_ground_common::Pose T = T_crs_camera;
    if (moved) T = turn * air_ground_common::Pose(Eigen::Translation3d(-offset - height) * T);
    const Eigen::Quaterniond q(T.linear());
    const Eigen::Vector3d t = T.translation();
    s.poses = street.folder.write(
        output + ".txt",
        formatted("photo.png %.6f %.6f %.3f %.3f %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n", view.camera.fx, view.camera.fy,
                  view.camera.cx, view.camera.cy, t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()));
    s.output = street.folder / (output + ".gpkg");
    const BuildReport report = buildDatabase(s);
    EXPECT_EQ(report.stored, 1) << (report.refused.empty() ? "" : report.refused[0].reason);
    return loadDatabase(s.output);
  };
  const StreetviewDatabase plain = build(false, "plain");
  std::string obj = "o wall\n";
  for (const auto& v : wallModel().mesh.vertices) {
    const Eigen::Vector3d p = turn * (street.frame.toCrs(v.cast<double>()) - offset - height);
    obj += formatted("v %.6f %.6f %.6f\n", p.x(), p.y(), p.z());
  }
  s.model = street.folder.write("moved.obj", obj + "f 1 2 3 4\n");
  s.model_options.offset = offset;
  s.model_options.height_offset = height.z();
  s.model_options.y_up = true;
  const StreetviewDatabase moved = build(true, "moved");
  ASSERT_EQ(moved.views.size(), 1u);
  EXPECT_TRUE(moved.views[0].T_world_camera.isApprox(plain.views.at(0).T_world_camera, 1e-6));
  EXPECT_EQ(moved.views[0].features.size(), plain.views[0].features.size());
  // In the grid already: said, with what the options do.
  s.poses = street.folder / "plain.txt";
  s.output = street.folder / "twice.gpkg";
  const std::string twice = messageOf([&] { buildDatabase(s); });
  EXPECT_TRUE(contains(twice, "--model-offset and --model-height-offset move them, too")) << twice;
}

TEST(BuildImages, HowFarHeightsAreBelievedCanBeSaid) {
  Street street;
  const BuildSettings& s = street.settings;
  const std::string command = std::string(BUILD_STREETVIEW_DB) + " " + s.output + " --crs EPSG:2056 --model " +
                              s.model + " --geotags " + s.geotags +
                              " --no-registration --no-consistency --view-width 256 --view-height 256 --threads 2 "
                              "--geotag-stddev 0.05 --height-stddev 0.05 > /dev/null 2>&1";
  EXPECT_EQ(WEXITSTATUS(std::system(command.c_str())), 0);
  EXPECT_NEAR(loadDatabase(s.output).panoramas.at(0).position_stddev, 0.05, 1e-6);
}

// Scripts go by the status: a build of nothing is a failure, and says what the model's remarks were.
TEST(BuildImages, TheProgramsStatusTellsWhetherThereIsAnythingToSearch) {
  RealisticStreet street;
  const std::string blank = street.folder / "17.jpg", said = street.folder / "said.txt";
  street.folder.write("other.xml", "<Metadata/>");
  street.s.geotags = street.list("image,lat,lon,heading", ",10");
  const auto run = [&](const std::string& options) {
    const std::string command = std::string(BUILD_STREETVIEW_DB) + " " + street.s.output + " --crs EPSG:2056 --model " +
                                (street.folder / "") + " --geotags " + street.s.geotags +
                                " --no-consistency --max-features 50 --threads 2 " + options + " > " + said + " 2>&1";
    const int status = std::system(command.c_str());
    std::ifstream file(said);
    return std::make_pair(WEXITSTATUS(status), std::string(std::istreambuf_iterator<char>(file), {}));
  };
  const auto [good, good_text] = run("--search-yaw 180 --search-radius 5");
  EXPECT_EQ(good, 0) << good_text;
  EXPECT_TRUE(contains(good_text, "1 images stored")) << good_text;
  std::filesystem::remove(street.s.output);
  cv::imwrite(blank, cv::Mat(512, 1024, CV_8UC3, cv::Scalar(200, 200, 200)));
  const auto [bad, bad_text] = run("--search-radius 5");
  EXPECT_EQ(bad, 1);
  EXPECT_TRUE(contains(bad_text, "no image can be used: see the reasons above")) << bad_text;
  std::filesystem::remove(blank);
  const auto [missing, missing_text] = run("");
  EXPECT_EQ(missing, 1);
  EXPECT_TRUE(contains(missing_text, "other.xml is XML but not CityGML: passed over")) << missing_text;
}

}  // namespace
}  // namespace streetview_localizer
