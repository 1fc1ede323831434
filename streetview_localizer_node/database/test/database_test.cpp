#include "streetview_localizer/database.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <random>

#include "stored_scene.h"
#include "test_files.h"

namespace streetview_localizer {
namespace {

TEST(Database, ComesBackAsItWentIn) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg";
  writeDatabase(path, 5);
  EXPECT_FALSE(std::filesystem::exists(folder / "a.partial.gpkg"));
  const StreetviewDatabase d = loadDatabase(path);
  EXPECT_EQ(d.version, kDatabaseVersion);
  EXPECT_EQ(d.crs, "EPSG:2056");
  EXPECT_LT((d.origin - Eigen::Vector3d(2683500, 1247800, 410)).norm(), 1e-9);
  ASSERT_EQ(d.panoramas.size(), 5u);
  for (int i = 0; i < 5; ++i) expectPanorama(d, i, i);
  const CityModel m = swissModel();
  ASSERT_EQ(d.model.building_ids, m.building_ids);
  ASSERT_EQ(d.model.mesh.triangles.size(), 3u);
  EXPECT_NEAR(d.model.mesh.area(), m.mesh.area(), 1e-3);
  EXPECT_EQ(std::count(d.model.building.begin(), d.model.building.end(), -1), 1);
  EXPECT_EQ(std::count(d.model.surface.begin(), d.model.surface.end(), Surface::kGround), 1);
  ASSERT_TRUE(d.model.frame);
  EXPECT_LT((d.model.crsFromWorld({0, 0, 0}) - m.origin).norm(), 2e-3);
  DatabaseLoadOptions light;
  light.images = light.features = false;
  const StreetviewDatabase l = loadDatabase(path, light);
  EXPECT_EQ(l.views.size(), 10u);
  EXPECT_TRUE(l.views[0].image.empty());
  EXPECT_EQ(l.views[0].features.size(), 0u);
}

TEST(Database, NeighboursAgreeWithASearchThroughAll) {
  StreetviewDatabase d;
  std::mt19937 rng(2);
  std::uniform_real_distribution<double> u(-200, 200);
  for (int i = 0; i < 400; ++i) {
    Panorama p;
    p.T_world_panorama.translation() << u(rng), u(rng), u(rng);
    d.panoramas.push_back(p);
  }
  EXPECT_TRUE(d.near({0, 0, 0}, 50).empty());  // no index yet
  d.buildIndex();
  for (int trial = 0; trial < 50; ++trial) {
    const Eigen::Vector3d q(u(rng), u(rng), u(rng));
    std::vector<std::pair<double, int>> all;
    for (int i = 0; i < 400; ++i)
      all.emplace_back((d.panoramas[i].T_world_panorama.translation() - q).head<2>().norm(), i);
    std::sort(all.begin(), all.end());
    std::vector<int> within, eight;
    for (const auto& [distance, i] : all) {
      if (distance <= 50) within.push_back(i);
      if (eight.size() < 8) eight.push_back(i);
    }
    EXPECT_EQ(d.near(q, 50), within);
    EXPECT_EQ(d.nearest(q, 8), eight);
  }
}

TEST(Database, PartOfAFileByItsSpatialIndex) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg";
  writeDatabase(path, 20);  // 12 m apart, along the east
  DatabaseLoadOptions options;
  options.centre = Eigen::Vector2d(2683500 + 60, 1247800);  // near pano_5
  options.radius = 30;
  const StreetviewDatabase d = loadDatabase(path, options);
  ASSERT_EQ(d.panoramas.size(), 5u);  // 3 to 7: 24 m to each side
  for (int i = 0; i < 5; ++i) expectPanorama(d, i, i + 3);
  EXPECT_EQ(indexFileOf(path), path + ".index");
  EXPECT_EQ(indexFileOf(path, options), path + ".2683560_1247800_30.index");
  EXPECT_EQ(indexFileOf("PG:dbname=city", options), "");
  options.centre->y() += 5000;
  const std::string m = messageOf([&] { loadDatabase(path, options); });
  EXPECT_NE(m.find("no panorama within 30 m of 2683560, 1252800 in EPSG:2056"), std::string::npos) << m;
}

// A radius in metres, of a grid that counts in feet (New York) or whose metres are short ones (Web Mercator).
TEST(Database, PartOfAFileInAGridOfOtherUnits) {
  const TemporaryFolder folder;
  for (const auto& [crs, origin] : {std::make_pair("EPSG:2263", Eigen::Vector3d(985000, 200000, 9)),
                                    {"EPSG:3857", Eigen::Vector3d(930000, 6000000, 400)},
                                    {"EPSG:4326", Eigen::Vector3d(8.54, 47.37, 400)}}) {
    CityModel model = wallModel();
    model.crs = crs;
    model.origin = origin;
    model.frame = std::make_shared<air_ground_common::LocalFrame>(model.crs, origin);
    const std::string path = folder / (std::string(crs).substr(5) + ".gpkg");
    DatabaseWriter writer(path, model, "settings");
    for (int i = 0; i < 20; ++i) writer.add(panoramaAt(i), viewsAt(i));
    writer.finish();
    DatabaseLoadOptions options;
    options.centre = origin.head<2>();
    options.radius = 200;
    EXPECT_EQ(loadDatabase(path, options).panoramas.size(), 17u) << crs;  // to 192 m
  }
}

// Images, features and the index over them: what is larger than the memory is refused before it is read.
TEST(Database, WhatTheMemoryDoesNotHoldIsRefused) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg";
  writeDatabase(path, 20);
  // 40 views of 64x48 in three colours, 20 features each: 128 bytes, a keypoint of 28, point and normal, and
  // 520 of the index.
  const std::uint64_t view = 64 * 48 * 3 + 20 * (128 + 28 + 24 + 520);
  DatabaseLoadOptions options;
  options.memory = 40 * view - 1;
  const std::string m = messageOf([&] { loadDatabase(path, options); });
  EXPECT_NE(m.find(path + " needs 0.000929 GB of memory, and 0.000929 GB are free: "), std::string::npos) << m;
  EXPECT_NE(m.find("region/"), std::string::npos) << m;
  options.memory = 40 * view;
  EXPECT_EQ(loadDatabase(path, options).views.size(), 40u);
  options.memory = 10 * view;  // what is asked for counts
  options.centre = Eigen::Vector2d(2683500 + 60, 1247800);
  options.radius = 30;
  EXPECT_EQ(loadDatabase(path, options).views.size(), 10u);
  options.memory -= 1;
  EXPECT_NE(messageOf([&] { loadDatabase(path, options); }).find("needs"), std::string::npos);
  options.images = false;
  EXPECT_EQ(loadDatabase(path, options).views.size(), 10u);
}

TEST(Database, KilledBuildLeavesNoFileAndGoesOn) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg", partial = folder / "a.partial.gpkg";
  const pid_t child = fork();
  if (child == 0) {
    DatabaseWriter writer(path, swissModel(), "settings");
    writer.plan({panoramaAt(0), panoramaAt(1), panoramaAt(2), panoramaAt(3)});
    for (int i = 0; i < 3; ++i) writer.add(panoramaAt(i), viewsAt(i));
    kill(getpid(), SIGKILL);
  }
  int status = 0;
  waitpid(child, &status, 0);
  ASSERT_TRUE(WIFSIGNALED(status));
  EXPECT_FALSE(std::filesystem::exists(path));
  ASSERT_TRUE(std::filesystem::exists(partial));
  EXPECT_NE(messageOf([&] { loadDatabase(partial); }).find("not finished"), std::string::npos);
  EXPECT_NE(messageOf([&] { DatabaseWriter(path, swissModel(), "others"); }).find("other settings"), std::string::npos);
  DatabaseWriter writer(path, swissModel(), "settings");
  EXPECT_EQ(writer.panoramas().size(), 4u);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(writer.has(panoramaAt(i).id), i < 3);
  writer.add(panoramaAt(3), viewsAt(3));
  EXPECT_THROW(writer.add(panoramaAt(3), viewsAt(3)), std::invalid_argument);
  writer.finish();
  const StreetviewDatabase d = loadDatabase(path);
  ASSERT_EQ(d.panoramas.size(), 4u);
  for (int i = 0; i < 4; ++i) expectPanorama(d, i, i);
}

TEST(Database, APlannedPanoramaIsReplacedByTheOneThatIsAdded) {
  const TemporaryFolder folder;
  DatabaseWriter writer(folder / "a.gpkg", swissModel(), "settings");
  writer.plan({panoramaAt(0), panoramaAt(1), panoramaAt(2)});
  Panorama moved = panoramaAt(1);
  moved.position_stddev = 7;
  writer.add(moved, viewsAt(1));
  writer.add(panoramaAt(3), viewsAt(3));
  writer.add(panoramaAt(0), viewsAt(0));
  ASSERT_EQ(writer.panoramas().size(), 4u);
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(writer.panoramas()[i].id, panoramaAt(i).id);
    EXPECT_EQ(writer.panoramas()[i].position_stddev, i == 1 ? 7 : panoramaAt(i).position_stddev);
  }
}

TEST(Database, AddingToAFinishedFileKeepsItUntilDone) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg";
  writeDatabase(path, 2);
  {
    DatabaseWriter writer(path, swissModel(), "settings");
    writer.add(panoramaAt(2), viewsAt(2));
    EXPECT_EQ(loadDatabase(path).panoramas.size(), 2u);
  }
  EXPECT_EQ(loadDatabase(path).panoramas.size(), 2u);  // abandoned, not finished
  DatabaseWriter writer(path, swissModel(), "settings");
  EXPECT_TRUE(writer.has("pano_2.jpg"));
  EXPECT_FALSE(writer.has("pano_3.jpg"));
  writer.finish();
  EXPECT_EQ(loadDatabase(path).panoramas.size(), 3u);
}

TEST(Database, BrokenViewIsRefusedWhole) {
  const TemporaryFolder folder;
  DatabaseWriter writer(folder / "a.gpkg", swissModel(), "settings");
  std::vector<View> views = viewsAt(0);
  views[1].points.pop_back();
  EXPECT_THROW(writer.add(panoramaAt(0), views), std::invalid_argument);
  EXPECT_FALSE(writer.has("pano_0.jpg"));
  writer.add(panoramaAt(0), viewsAt(0));
  writer.finish();
  const StreetviewDatabase d = loadDatabase(folder / "a.gpkg");
  EXPECT_EQ(d.views.size(), 2u);
}

TEST(Database, BrokenStoredViewsAreNamed) {
  const TemporaryFolder folder;
  std::vector<View> camera = viewsAt(0), image = viewsAt(0);
  camera[1].camera.fx = 0;
  image[1].image = cv::Mat(10, 10, CV_8UC3, cv::Scalar::all(9));
  for (const auto& [views, word] : {std::make_pair(camera, "focal"), std::make_pair(image, "image")}) {
    const std::string path = folder / (std::string(word) + ".gpkg");
    DatabaseWriter writer(path, swissModel(), "settings");
    writer.add(panoramaAt(0), views);
    writer.finish();
    const std::string m = messageOf([&, path = path] { loadDatabase(path); });
    EXPECT_NE(m.find(path + " holds a broken view"), std::string::npos) << m;
    EXPECT_NE(m.find(word), std::string::npos) << m;
  }
}

TEST(Database, WhileABuildWritesASecondIsRefused) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg";
  for (const bool resumed : {false, true}) {
    DatabaseWriter first(path, swissModel(), "settings");
    const std::string m = messageOf([&] { DatabaseWriter(path, swissModel(), "settings"); });
    EXPECT_NE(m.find("another program is writing it"), std::string::npos) << m;
    first.add(panoramaAt(resumed), viewsAt(resumed));
    if (resumed) first.finish();
  }
  EXPECT_EQ(loadDatabase(path).panoramas.size(), 2u);
}

TEST(Database, UnfinishedFilesThatCannotBeReadAreKept) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg", partial = folder / "a.partial.gpkg";
  DatabaseWriter(path, swissModel(), "settings").add(panoramaAt(0), viewsAt(0));
  const auto size = std::filesystem::file_size(partial) / 2;
  std::filesystem::resize_file(partial, size);
  const std::string m = messageOf([&] { DatabaseWriter(path, swissModel(), "settings"); });
  EXPECT_NE(m.find("cannot resume " + partial), std::string::npos) << m;
  EXPECT_NE(m.find("delete it to start over"), std::string::npos) << m;
  EXPECT_EQ(std::filesystem::file_size(partial), size);
  // A build killed before its first commit has left nothing.
  folder.write("a.partial.gpkg", "");
  DatabaseWriter writer(path, swissModel(), "settings");
  EXPECT_TRUE(writer.panoramas().empty());
}

TEST(Database, BrokenFilesGiveOneClearLine) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.gpkg";
  writeDatabase(path, 3);
  const auto error = [&](const std::string& file) {
    const std::string m = messageOf([&] { loadDatabase(file); });
    EXPECT_EQ(m.find('\n'), std::string::npos) << m;
    EXPECT_NE(m.find(file), std::string::npos) << m;
    return m;
  };
  for (const double share : {0.9, 0.5, 0.1}) {
    const std::string cut = folder / "cut.gpkg";
    std::filesystem::copy_file(path, cut, std::filesystem::copy_options::overwrite_existing);
    std::filesystem::resize_file(cut, static_cast<std::uintmax_t>(share * double(std::filesystem::file_size(path))));
    EXPECT_NE(error(cut).find("truncated"), std::string::npos);
  }
  EXPECT_NE(error(folder / "none.gpkg").find("no such file"), std::string::npos);
  EXPECT_NE(error(folder.write("text.gpkg", std::string(200, 'x'))).find("no Street View database"), std::string::npos);
  EXPECT_NE(error(folder.write("empty.gpkg", "")).find("no Street View database"), std::string::npos);
  // Another version: the value lies in the file as text.
  std::ifstream in(path, std::ios::binary);
  std::string bytes((std::istreambuf_iterator<char>(in)), {});
  const std::size_t at = bytes.find(std::string("version") + std::to_string(kDatabaseVersion));
  ASSERT_NE(at, std::string::npos);
  bytes[at + 7] = '9';
  EXPECT_NE(error(folder.write("new.gpkg", bytes)).find("version 9"), std::string::npos);
}

}  // namespace
}  // namespace streetview_localizer
