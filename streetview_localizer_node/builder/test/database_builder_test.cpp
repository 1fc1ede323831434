#include "streetview_localizer/database_builder.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <csignal>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "air_ground_common/mesh.h"
#include "street_files.h"
#include "streetview_localizer/textured_model.h"
#include "xmp_jpeg.h"

namespace streetview_localizer {
namespace {

/// What a textured model shows where a ray meets it.
double greenOf(const TexturedModel& model, const air_ground_common::RayHit& hit) {
  if (model.page[hit.triangle] < 0) return 0;
  const auto& uv = model.uv[hit.triangle];
  const Eigen::Vector2f p = (1 - hit.uv.x() - hit.uv.y()) * uv[0] + hit.uv.x() * uv[1] + hit.uv.y() * uv[2];
  const cv::Mat& page = model.pages[model.page[hit.triangle]];
  return page.at<cv::Vec3b>(std::clamp(cvRound(p.y()), 0, page.rows - 1),
                            std::clamp(cvRound(p.x()), 0, page.cols - 1))[1];
}

TEST(DatabaseBuilder, FeaturesLieOnTheWallWhereTheyAppear) {
  Street street;
  street.settings.textured_model = street.folder / "street.obj";
  RegistrationSettings& geotags = street.settings.registration;  // exact, so that images may be compared
  geotags.geotag_stddev = geotags.height_stddev = 0.05, geotags.heading_stddev = geotags.tilt_stddev = 0.002;
  int calls = 0;
  const BuildReport report = buildDatabase(street.settings, [&](const std::string&, int done, int all) {
    ++calls;
    EXPECT_LE(done, all);
  });
  EXPECT_EQ(report.stored, 3);
  EXPECT_TRUE(report.refused.empty());
  EXPECT_GE(calls, 3);
  const StreetviewDatabase d = loadDatabase(street.settings.output);
  ASSERT_EQ(d.panoramas.size(), 3u);
  std::size_t features = 0, on_car = 0;
  for (const View& view : d.views) {
    EXPECT_LT((view.T_world_camera.translation() - d.panoramas[view.panorama].T_world_panorama.translation()).norm(),
              1e-9);
    features += view.features.size();
    for (std::size_t i = 0; i < view.features.size(); ++i) {
      const Eigen::Vector3f& p = view.points[i];
      EXPECT_NEAR(p.y(), 10, 2e-3);
      EXPECT_LT((view.normals[i] - Eigen::Vector3f(0, -1, 0)).norm(), 1e-3f);
      // What the middle panorama sees of the car lands on the wall from x = 1.4 to 7.1, below 1.07 m.
      if (d.panoramas[view.panorama].id == "p1.png" && p.x() > 1.6f && p.x() < 6.9f && p.z() < 0.9f) ++on_car;
    }
  }
  EXPECT_GT(features, 600u);
  EXPECT_LT(on_car, 8u);  // of some hundred
  EXPECT_GT(report.inconsistent, 5);
  // From a new place the painted wall shows.
  const TexturedModel textured = makeTexturedModel(d);
  EXPECT_EQ(textured.pages.size(), 1u);
  View camera = d.views[0];
  camera.camera = camera.camera.scaled(0.5);
  camera.T_world_camera.translation() = Eigen::Vector3d(3, 2, 5);
  camera.T_world_camera.linear() = (Eigen::Matrix3d() << 1, 0, 0, 0, 0, 1, 0, -1, 0).finished();
  const air_ground_common::MeshScene scene(textured.mesh);
  double mean = 0, difference = 0;
  int count = 0;
  for (int y = 30; y < 70; ++y)
    for (int x = 20; x < 108; ++x) {
      const auto hit = (camera.T_world_camera.linear() * camera.camera.ray({double(x), double(y)})).eval();
      const Eigen::Vector3d p = camera.T_world_camera.translation() + 8 / hit.y() * hit;
      const double expected = noise(p.x(), p.z());
      const auto on_wall = scene.cast(camera.T_world_camera.translation().cast<float>(), hit.cast<float>());
      ASSERT_TRUE(on_wall);
      difference += std::abs(greenOf(textured, *on_wall) - expected);
      mean += std::abs(expected - 127);
      ++count;
    }
  EXPECT_LT(difference, 0.6 * mean) << count;  // blurred by 4 cm a pixel of the panoramas
  EXPECT_TRUE(std::filesystem::exists(street.folder / "street.mtl"));
  EXPECT_TRUE(std::filesystem::exists(street.folder / "street_0.jpg"));
}

TEST(DatabaseBuilder, TheTexturedModelOverwritesNothingButAnotherOfItsKind) {
  Street street;
  BuildSettings s = street.settings;
  const auto content = [](const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  const auto refused = [&](const std::string& reason) {
    const std::string message = messageOf([&] { buildDatabase(s); });
    EXPECT_TRUE(contains(message, reason)) << message;
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    EXPECT_FALSE(std::filesystem::exists(s.output));  // said before anything is built
  };
  const std::string survey = content(s.model);
  std::filesystem::create_symlink(s.model, street.folder / "link.obj");
  for (const std::string& path : {s.model, street.folder / "./wall.obj", street.folder / "link.obj"}) {
    s.textured_model = path;
    refused("is the city model itself");
  }
  EXPECT_EQ(content(s.model), survey);
  s.textured_model = street.folder / "street.obj";
  for (const char* name : {"street.obj", "street.mtl", "street_0.jpg"}) {
    const std::string path = street.folder.write(name, "of somebody else\n");
    refused(name);
    EXPECT_EQ(content(path), "of somebody else\n");
    std::filesystem::remove(path);
  }
  for (int run = 0; run < 2; ++run) {  // the second time over its own
    EXPECT_EQ(messageOf([&] { buildDatabase(s); }), "");
    EXPECT_EQ(content(s.textured_model).rfind("# city model with facade textures", 0), 0u);
    EXPECT_TRUE(std::filesystem::exists(street.folder / "street_0.jpg"));
  }
  // As after an interruption between the pages and the model.
  std::filesystem::remove(s.textured_model);
  EXPECT_EQ(messageOf([&] { buildDatabase(s); }), "");
  EXPECT_TRUE(std::filesystem::exists(s.textured_model));
}

TEST(DatabaseBuilder, AddsToAnExistingDatabaseWhatWasMissing) {
  Street street;
  BuildSettings first = street.settings;
  first.take_every = 2;  // p0 and p2
  EXPECT_EQ(buildDatabase(first).stored, 2);
  const BuildReport second = buildDatabase(street.settings);
  EXPECT_EQ(second.stored, 1);
  EXPECT_EQ(second.resumed, 2);
  EXPECT_EQ(loadDatabase(street.settings.output).panoramas.size(), 3u);
  BuildSettings other = street.settings;
  other.back_projection.max_depth = 20;
  EXPECT_NE(messageOf([&] { buildDatabase(other); }).find("other settings"), std::string::npos);
}

TEST(DatabaseBuilder, ImagesOfOneNameInSeveralFolders) {
  Street street;
  BuildSettings s = street.settings;
  for (const char* name : {"north", "south"}) {
    std::filesystem::create_directory(street.folder / name);
    std::filesystem::copy_file(street.folder / (*name == 'n' ? "p0.png" : "p2.png"),
                               street.folder / (std::string(name) + "/p.png"));
  }
  // As databases were built before: by the name alone.
  s.images = street.folder / "north";
  s.geotags = street.listOf("names.csv", street.lineOf("p.png", -12));
  EXPECT_EQ(buildDatabase(s).stored, 1);
  // Known by its name at this place; another of that name; that one again.
  s.images = street.folder / "";
  s.geotags = street.listOf("paths.csv", street.lineOf("north/p.png", -12) + street.lineOf("./south/p.png", 12) +
                                             street.lineOf("south//p.png", 12));
  const BuildReport report = buildDatabase(s);
  EXPECT_EQ(report.resumed, 1);
  EXPECT_EQ(report.stored, 1);
  ASSERT_EQ(report.refused.size(), 1u);
  EXPECT_EQ(report.refused[0].reason, "is listed twice");
  const StreetviewDatabase d = loadDatabase(s.output);
  ASSERT_EQ(d.panoramas.size(), 2u);
  EXPECT_EQ(d.panoramas[0].id, "p.png");
  EXPECT_EQ(d.panoramas[1].id, "south/p.png");
  EXPECT_NEAR(d.panoramas[1].T_world_panorama.translation().x(), 12, 0.01);
  // A name that stands for another image.
  s.images = street.folder / "south";
  s.geotags = street.listOf("others.csv", street.lineOf("p.png", 12));
  const BuildReport other = buildDatabase(s);
  EXPECT_EQ(other.resumed + other.stored, 0);
  ASSERT_EQ(other.refused.size(), 1u);
  EXPECT_TRUE(contains(other.refused[0].reason, "another image of this name is in the database, 24.0 m from here"))
      << other.refused[0].reason;
}

TEST(DatabaseBuilder, AGeotagOffTheGridRefusesItsImageAlone) {
  Street street;
  BuildSettings s = street.settings;
  // The antipode, which lies right below, and what is a quarter of the globe away.
  s.geotags = street.listOf(
      "far.csv", "p0.png,-47.3756,-171.4556,412,0,0,0\np1.png,-42.6,8.54,412,0,0,0\n" + street.lineOf("p2.png", 12));
  const BuildReport report = buildDatabase(s);
  EXPECT_EQ(report.stored, 1);
  ASSERT_EQ(report.refused.size(), 2u);
  for (const auto& refusal : report.refused)
    EXPECT_TRUE(contains(refusal.reason, "km from the city model, whose coordinates were taken as east, north"));
  s.model_options.crs.clear();
  s.model_options.origin.reset();
  s.model = street.folder.write("local.obj", "o wall\nv 0 0 0\nv 9 0 0\nv 9 0 9\nf 1 2 3\n");
  s.geotags = street.listOf("missing.csv", "none.png,47,8,412,0,0,0\n");  // said even where no image is there
  EXPECT_TRUE(contains(messageOf([&] { buildDatabase(s); }), "the city model has no coordinate system"));
}

TEST(DatabaseBuilder, PartsOfASphereAreRefused) {
  Street street;
  BuildSettings s = street.settings;
  s.check_consistency = false;
  s.camera.emplace();
  s.camera->width = 1024, s.camera->height = 256;
  s.camera->fx = s.camera->fy = 800, s.camera->cx = 511, s.camera->cy = 127;
  std::string lines;
  for (const int height : {512, 256}) {  // would pass for a sphere, and for a photograph
    const std::string name = std::to_string(height) + ".jpg";
    street.folder.write(name, panoramaJpeg({1024, height}, {1024, height}, {2048, 1024}));
    lines += street.lineOf(name, 0);
  }
  street.folder.write("padded.jpg", panoramaJpeg({1024, 512}, {1024, 256}, {1024, 512}));
  street.folder.write("whole.jpg", panoramaJpeg({1024, 512}, {4096, 2048}, {4096, 2048}));
  s.geotags = street.listOf("parts.csv", lines + street.lineOf("padded.jpg", 0) + street.lineOf("whole.jpg", 0) +
                                             street.lineOf("p0.png", -12));
  const BuildReport report = buildDatabase(s);
  EXPECT_EQ(report.stored, 1);
  ASSERT_EQ(report.refused.size(), 4u);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(report.refused[i].reason, "covers only part of the sphere (GPano): pad it to 2048x1024");
    EXPECT_EQ(report.refused[i + 2].reason, "sees no facade of the model");
  }
}

TEST(DatabaseBuilder, SurveyedPhotographsGridConvergenceAndUnits) {
  Street street;
  constexpr double kUnit = 0.3048;  // heights of model, origin and poses in feet, on a grid in metres
  street.writeWall(kUnit);
  BuildSettings s = street.settings;
  s.geotags.clear();
  // A view of the middle panorama as a photograph, its pose in the grid: turned back by the convergence.
  const air_ground_common::LocalFrame& frame = street.frame;
  const View view = cutPanorama(wallPanorama(1024, panoramaPose(0), false), panoramaPose(0), s.views)[0];
  cv::imwrite(street.folder / "photo.png", view.image);
  const Eigen::Quaterniond q(Eigen::AngleAxisd(frame.meridianConvergence(), Eigen::Vector3d::UnitZ()) *
                             view.T_world_camera.linear());
  const Eigen::Vector3d t = frame.toCrs(view.T_world_camera.translation());
  s.poses =
      street.folder.write("poses.txt", formatted("photo.png %.6f %.6f %.3f %.3f %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n",
                                                 view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy, t.x(),
                                                 t.y(), t.z() / kUnit, q.x(), q.y(), q.z(), q.w()));
  s.register_panoramas = true;  // must leave surveyed photographs alone
  EXPECT_EQ(buildDatabase(s).stored, 1);
  const StreetviewDatabase d = loadDatabase(s.output);
  ASSERT_EQ(d.views.size(), 1u);
  EXPECT_FALSE(d.panoramas[0].equirectangular);
  EXPECT_LT((d.views[0].T_world_camera.translation() - view.T_world_camera.translation()).norm(), 5e-3);
  EXPECT_LT(air_ground_common::rotationAngle(d.views[0].T_world_camera.linear(), view.T_world_camera.linear()), 1e-5);
  EXPECT_GT(d.views[0].features.size(), 30u);
  EXPECT_EQ(d.panoramas[0].position_stddev, 0.02);
  EXPECT_EQ(d.panoramas[0].orientation_stddev, 0.001);
  // A rough survey says so. What is stored was believed otherwise.
  s.pose_stddev = 0.3;
  s.pose_angle_stddev = 0.01;
  EXPECT_TRUE(contains(messageOf([&] { buildDatabase(s); }), "poses 0.3 0.01"));
  s.output = street.folder / "rough.gpkg";
  EXPECT_EQ(buildDatabase(s).stored, 1);
  const Panorama rough = loadDatabase(s.output).panoramas.at(0);
  EXPECT_EQ(rough.position_stddev, 0.3);
  EXPECT_EQ(rough.orientation_stddev, 0.01);
}

TEST(DatabaseBuilder, APhotographWhosePoseIsNotCorrectedIsRefusedUnlessWanted) {
  Street street;
  BuildSettings s = street.settings;
  const View view = cutPanorama(wallPanorama(1024, panoramaPose(0), false), panoramaPose(0), s.views)[0];
  cv::imwrite(street.folder / "photo.png", view.image);
  const auto g = air_ground_common::LocalFrame("EPSG:2056", kOrigin).toGeodetic(panoramaPose(0).translation());
  const std::string line =
      formatted("photo.png,%.10f,%.10f,%.4f,%.6f,15,0\n", g.latitude, g.longitude, g.height, 90 - 0.9 * 180 / M_PI);
  s.geotags = street.folder.write("photo.csv", "image,lat,lon,alt,heading_deg,pitch_deg,roll_deg\n" + line);
  s.camera = view.camera;
  s.register_panoramas = true;  // a single long wall does not tell the place
  for (int run = 0; run < 2; ++run) {
    const BuildReport report = buildDatabase(s);
    EXPECT_EQ(report.stored + report.resumed, 0);
    ASSERT_EQ(report.refused.size(), 1u) << run;
    EXPECT_NE(report.refused[0].reason.find("pose not corrected: "), std::string::npos) << report.refused[0].reason;
  }
  EXPECT_FALSE(buildDatabase(s).useful());
  EXPECT_TRUE(loadDatabase(s.output).views.empty());
  s.keep_unregistered = true;
  s.output = street.folder / "kept.gpkg";
  for (int run = 0; run < 2; ++run) {
    const BuildReport report = buildDatabase(s);
    EXPECT_EQ(report.stored, 1 - run);
    EXPECT_EQ(report.resumed, run);
    EXPECT_TRUE(report.refused.empty());
    ASSERT_EQ(report.uncorrected.size(), 1u);
    EXPECT_EQ(report.uncorrected[0].image, "photo.png");
  }
  const StreetviewDatabase d = loadDatabase(s.output);
  ASSERT_EQ(d.views.size(), 1u);
  EXPECT_FALSE(d.panoramas[0].registered);
  EXPECT_GT(d.panoramas[0].position_stddev, 1);
}

TEST(DatabaseBuilder, AnImageThatCannotBeReadIsTriedAgain) {
  for (const bool registration : {false, true}) {
    Street street;
    street.settings.register_panoramas = street.settings.keep_unregistered = registration;
    const std::string image = street.folder / "p1.png", whole = street.folder / "whole.png";
    std::filesystem::copy_file(image, whole);
    std::filesystem::resize_file(image, 40);  // its size can be read, its pixels not
    const BuildReport first = buildDatabase(street.settings);
    EXPECT_EQ(first.stored, 2);
    ASSERT_EQ(first.refused.size(), 1u);
    EXPECT_NE(first.refused[0].reason.find("cannot be read"), std::string::npos) << first.refused[0].reason;
    std::filesystem::rename(whole, image);
    const BuildReport second = buildDatabase(street.settings);
    EXPECT_EQ(second.stored, 1);
    EXPECT_EQ(second.resumed, 2);
    EXPECT_TRUE(second.refused.empty());
  }
}

/// No file may grow beyond so many bytes, as on a disk that is full.
class FullDisk {
 public:
  explicit FullDisk(std::uintmax_t bytes) {
    getrlimit(RLIMIT_FSIZE, &before_);
    rlimit limit = before_;
    limit.rlim_cur = bytes;
    setrlimit(RLIMIT_FSIZE, &limit);
    handler_ = std::signal(SIGXFSZ, SIG_IGN);
  }
  ~FullDisk() {
    setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_{};
  void (*handler_)(int) = SIG_DFL;
};

TEST(DatabaseBuilder, AFullDiskGivesOneLineAndTheNextRunGoesOn) {
  Street street;
  buildDatabase(street.settings);
  const std::uintmax_t whole = std::filesystem::file_size(street.settings.output);
  std::filesystem::remove(street.settings.output);
  {
    const FullDisk disk(whole * 7 / 10);
    try {
      buildDatabase(street.settings);
      ADD_FAILURE() << "a database of " << whole << " bytes fitted in seven tenths of them";
    } catch (const std::runtime_error& e) {
      EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << e.what();
      EXPECT_NE(std::string(e.what()).find("street.partial.gpkg"), std::string::npos) << e.what();
    }
  }
  EXPECT_FALSE(std::filesystem::exists(street.settings.output));
  const BuildReport report = buildDatabase(street.settings);
  EXPECT_GE(report.resumed, 1);
  EXPECT_EQ(report.resumed + report.stored, 3);
  EXPECT_EQ(loadDatabase(street.settings.output).panoramas.size(), 3u);
}

TEST(DatabaseBuilder, TheFingerprintNamesWhatShapesThePoses) {
  BuildSettings a, b;
  b.registration.search_radius = 12;
  EXPECT_NE(a.fingerprint("m"), b.fingerprint("m"));
  BuildSettings unchecked;
  unchecked.check_neighbours = false;
  EXPECT_NE(a.fingerprint("m"), unchecked.fingerprint("m"));
  // Databases from before neighbours were compared take more images.
  EXPECT_EQ(a.fingerprint("m").find("neighbours"), std::string::npos);
  a.register_panoramas = b.register_panoramas = false;
  EXPECT_EQ(a.fingerprint("m"), b.fingerprint("m"));  // not used
  EXPECT_NE(a.fingerprint("m"), b.fingerprint("another model"));
  b.registration.heading_stddev = 0.5;  // is what unregistered images state
  EXPECT_NE(a.fingerprint("m"), b.fingerprint("m"));
  a.registration.heading_stddev = 0.5;
  a.registration.height_stddev = 0.05;
  EXPECT_NE(a.fingerprint("m"), b.fingerprint("m"));
  b.registration.height_stddev = 0.05;
  a.photograph_focal = 700;
  EXPECT_NE(a.fingerprint("m"), b.fingerprint("m"));
  b.photograph_focal = 700;
  EXPECT_EQ(a.fingerprint("m"), b.fingerprint("m"));
  b.camera.emplace();
  EXPECT_NE(a.fingerprint("m"), b.fingerprint("m"));
  a.camera.emplace().k1 = 0.1;
  EXPECT_NE(a.fingerprint("m"), b.fingerprint("m"));
}

TEST(DatabaseBuilder, BrokenInputsGiveOneClearLineEach) {
  Street street;
  std::ofstream(street.settings.geotags, std::ios::app)
      << "missing.png,47.37,8.54,412,0,0,0\nzero.png,0,0,0,0,0,0\np0.png,47.37,8.54,412,0,0,0\nfar.png,46.9,7.4,412,0,"
         "0,0\ntext.png,47.3756,8.5444,412,0,0,0\n";
  std::filesystem::copy_file(street.folder / "p0.png", street.folder / "far.png");
  street.folder.write("text.png", "no image");
  const BuildReport report = buildDatabase(street.settings);
  EXPECT_EQ(report.stored, 3);
  std::map<std::string, std::string> reasons;
  for (const auto& r : report.refused) {
    reasons[r.image] = r.reason;
    EXPECT_EQ(r.reason.find('\n'), std::string::npos);
  }
  ASSERT_EQ(reasons.size(), 5u);
  EXPECT_NE(reasons["missing.png"].find("is missing"), std::string::npos);
  EXPECT_NE(reasons["zero.png"].find("0,0"), std::string::npos);
  EXPECT_NE(reasons["p0.png"].find("twice"), std::string::npos);
  EXPECT_NE(reasons["far.png"].find("km from"), std::string::npos);
  EXPECT_NE(reasons["text.png"].find("cannot be read"), std::string::npos);

  BuildSettings s = street.settings;
  s.output = street.folder / "other.gpkg";
  const auto error = [&] {
    const std::string m = messageOf([&] { buildDatabase(s); });
    EXPECT_EQ(m.find('\n'), std::string::npos);
    EXPECT_FALSE(std::filesystem::exists(s.output));
    EXPECT_FALSE(std::filesystem::exists(street.folder / "other.partial.gpkg"));
    return m;
  };
  s.model_options.crs = "EPSG:999999";
  EXPECT_NE(error().find("unknown coordinate system"), std::string::npos);
  s.model_options.crs = "EPSG:2056";
  s.model = street.folder.write("road.gml", "<CityModel><cityObjectMember><Road/></cityObjectMember></CityModel>");
  EXPECT_NE(error().find("no buildings"), std::string::npos);
  s = street.settings;
  s.output = street.folder / "other.gpkg";
  s.geotags = street.folder.write("none.csv", "image,lat,lon,alt,heading_deg\nzero.png,0,0,0,0\n");
  EXPECT_NE(error().find("zero.png has the geotag 0,0"), std::string::npos);
  s.geotags.clear();
  EXPECT_NE(error().find("--geotags"), std::string::npos);
}

}  // namespace
}  // namespace streetview_localizer
