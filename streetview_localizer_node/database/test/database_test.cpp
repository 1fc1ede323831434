#include "streetview_localizer/database.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <random>

#include "test_files.h"
#include "wall_scene.h"

namespace streetview_localizer {
namespace {

CityModel swissModel() {
  CityModel m = wallModel();
  m.crs = "EPSG:2056";
  m.origin = {2683500, 1247800, 410};
  m.frame = std::make_shared<air_ground_common::LocalFrame>(m.crs, m.origin);
  // Terrain beside the building.
  for (const Eigen::Vector3f& v :
       {Eigen::Vector3f(-50, -50, 0), Eigen::Vector3f(50, -50, 0), Eigen::Vector3f(0, 50, 0)})
    m.mesh.vertices.push_back(v);
  m.mesh.triangles.emplace_back(4, 5, 6);
  m.surface.push_back(Surface::kGround);
  m.building.push_back(-1);
  return m;
}

Panorama panoramaAt(int i) {
  Panorama p;
  p.id = "pano_" + std::to_string(i) + ".jpg";
  p.T_world_panorama = panoramaPose(12.0 * i);
  p.T_world_geotag = panoramaPose(12.0 * i + 3);
  p.registered = i % 2 == 0;
  p.position_stddev = 0.1 + i;
  p.remark = i % 2 ? "it's \"odd\"" : "";
  return p;
}

std::vector<View> viewsAt(int i, int count = 2) {
  std::mt19937 rng(static_cast<unsigned>(i));
  std::uniform_real_distribution<float> u(0, 1);
  std::vector<View> views(static_cast<std::size_t>(count));
  for (View& v : views) {
    v.camera.width = 64, v.camera.height = 48;
    v.camera.fx = 50.25, v.camera.fy = 51.5, v.camera.cx = 31.5, v.camera.cy = 23.75, v.camera.k1 = -0.1,
    v.camera.p2 = 0.01;
    v.T_world_camera = panoramaPose(12.0 * i);
    v.image = cv::Mat(48, 64, CV_8UC3, cv::Scalar(10 * (i % 20), 100, 200));
    for (int k = 0; k < 20; ++k) {
      v.features.keypoints.emplace_back(64 * u(rng), 48 * u(rng), 5 * u(rng), 360 * u(rng), u(rng), 0x1ff02);
      cv::Mat row(1, 128, CV_8U);
      for (int c = 0; c < 128; ++c) row.at<uchar>(c) = static_cast<uchar>(255 * u(rng));
      v.features.descriptors.push_back(row);
      v.points.emplace_back(u(rng), u(rng), u(rng));
      v.normals.emplace_back(0.f, -1.f, 0.f);
    }
  }
  return views;
}

void writeDatabase(const std::string& path, int count) {
  DatabaseWriter writer(path, swissModel(), "settings");
  for (int i = 0; i < count; ++i) writer.add(panoramaAt(i), viewsAt(i));
  writer.finish();
}

void expectPanorama(const StreetviewDatabase& d, int index, int i) {
  const Panorama &p = d.panoramas[index], e = panoramaAt(i);
  EXPECT_EQ(p.id, e.id);
  EXPECT_EQ(p.registered, e.registered);
  EXPECT_EQ(p.remark, e.remark);
  EXPECT_DOUBLE_EQ(p.position_stddev, e.position_stddev);
  EXPECT_TRUE(p.T_world_panorama.isApprox(e.T_world_panorama, 1e-12));
  EXPECT_TRUE(p.T_world_geotag.isApprox(e.T_world_geotag, 1e-12));
  const std::vector<View> expected = viewsAt(i);
  const std::vector<int>& views = d.viewsOf(index);
  ASSERT_EQ(views.size(), expected.size());
  for (std::size_t k = 0; k < views.size(); ++k) {
    const View &v = d.views[views[k]], &w = expected[k];
    EXPECT_EQ(v.id, views[k]);
    EXPECT_EQ(v.panorama, index);
    EXPECT_EQ(v.camera.fy, w.camera.fy);
    EXPECT_EQ(v.camera.cy, w.camera.cy);
    EXPECT_EQ(v.camera.k1, w.camera.k1);
    EXPECT_EQ(v.camera.p2, w.camera.p2);
    EXPECT_TRUE(v.T_world_camera.isApprox(w.T_world_camera, 1e-12));
    ASSERT_EQ(v.features.size(), w.features.size());
    EXPECT_EQ(cv::norm(v.features.descriptors, w.features.descriptors, cv::NORM_L1), 0);
    for (std::size_t f = 0; f < v.features.size(); ++f) {
      EXPECT_EQ(v.features.keypoints[f].pt, w.features.keypoints[f].pt);
      EXPECT_EQ(v.features.keypoints[f].angle, w.features.keypoints[f].angle);
      EXPECT_EQ(v.features.keypoints[f].octave, w.features.keypoints[f].octave);
      EXPECT_EQ(v.points[f], w.points[f]);
      EXPECT_EQ(v.normals[f], w.normals[f]);
    }
    EXPECT_LT(cv::norm(v.image, w.image, cv::NORM_INF), 6);  // JPEG
  }
}

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
