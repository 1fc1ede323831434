// Databases that are no fleet's panoramas: of fine photographs that look one way each, and of poses that are hardly
// known.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <fstream>
#include <opencv2/imgcodecs.hpp>

#include "../src/view_search.h"
#include "air_ground_common/text.h"
#include "streetview_localizer/database_builder.h"
#include "streetview_localizer/localizer.h"
#include "test_files.h"
#include "tiny_city.h"

namespace streetview_localizer {
namespace {

using air_ground_common::formatted;
using test::TinyCity;

StreetviewLocalizerSettings bruteForce() {
  StreetviewLocalizerSettings settings;
  settings.index.method = IndexMethod::kBruteForce;
  return settings;
}

std::string objOf(const CityModel& model) {
  std::string obj;
  for (const auto& v : model.mesh.vertices) obj += formatted("v %.6f %.6f %.6f\n", v.x(), v.y(), v.z());
  for (std::size_t i = 0; i < model.mesh.triangles.size(); ++i) {
    const Eigen::Vector3i t = model.mesh.triangles[i] + Eigen::Vector3i::Ones();
    const int b = model.building[i];
    obj += formatted("o %s%d\ng %s\nf %d %d %d\n", b < 0 ? "terrain " : "house", b, b < 0 ? "ground" : "wall", t.x(),
                     t.y(), t.z());
  }
  return obj;
}

std::string surveyed(const std::string& image, const CameraModel& c, const Pose& T) {
  const Eigen::Quaterniond q(T.linear());
  const Eigen::Vector3d t = T.translation();
  return formatted("%s %.3f %.3f %.3f %.3f %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n", image.c_str(), c.fx, c.fy, c.cx, c.cy,
                   t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
}

// As a camera of 12 megapixels takes them: the database holds no more than a smaller image can be matched with.
TEST(Photographs, OfTwelveMegapixelsLocateASmallImage) {
  const TinyCity city(1);
  const TemporaryFolder folder;
  CameraModel large;
  large.width = 4000, large.height = 3000;
  large.fx = large.fy = 3000;
  large.cx = 1999.5, large.cy = 1499.5;
  const Pose T_photograph = TinyCity::look({-4, 1, 3}, M_PI / 2, 0.05);
  cv::imwrite(folder / "photo.jpg", city.photograph(large, T_photograph));
  BuildSettings s;
  s.model = folder.write("city.obj", objOf(city.model()));
  s.poses = folder.write("poses.txt", surveyed("photo.jpg", large, T_photograph));
  s.output = folder / "city.gpkg";
  ASSERT_EQ(buildDatabase(s).stored, 1);
  const auto database = std::make_shared<StreetviewDatabase>(loadDatabase(s.output));
  ASSERT_EQ(database->views.size(), 1u);
  const View& view = database->views[0];
  EXPECT_NEAR(view.camera.fx, 900, 1e-6);
  EXPECT_EQ(view.image.size(), cv::Size(1200, 900));
  // The points lie where the full image shows them.
  for (std::size_t i = 0; i < view.points.size(); ++i) {
    const auto pixel = view.camera.project(T_photograph.inverse() * view.points[i].cast<double>());
    ASSERT_TRUE(pixel);
    const cv::Point2f& p = view.features.keypoints[i].pt;
    EXPECT_LT((*pixel - Eigen::Vector2d(p.x, p.y)).norm(), 0.05);
  }
  const Pose T = TinyCity::look({-3.4, 0.6, 4.2}, M_PI / 2 + 0.05, 0);
  const LocalizerResult r =
      StreetviewLocalizer(database, bruteForce()).localize(city.photograph(TinyCity::camera(), T), TinyCity::camera());
  EXPECT_TRUE(r.accepted()) << r.reason;
  EXPECT_LT((r.pose.T_world_camera.translation() - T.translation()).norm(), 0.1);
  // What is hardly finer stays as it was taken.
  s.photograph_focal = 2500;
  s.output = folder / "fine.gpkg";
  ASSERT_EQ(buildDatabase(s).stored, 1);
  EXPECT_EQ(loadDatabase(s.output).views.at(0).camera.width, 4000);
}

/// The city's database with its last panorama, and all that it shows, moved.
std::shared_ptr<StreetviewDatabase> movedLast(const StreetviewDatabase& database, const Pose& move) {
  auto db = std::make_shared<StreetviewDatabase>(database);
  const int last = static_cast<int>(db->panoramas.size()) - 1;
  db->panoramas.back().T_world_panorama = move * db->panoramas.back().T_world_panorama;
  for (View& view : db->views) {
    if (view.panorama != last) continue;
    view.T_world_camera = move * view.T_world_camera;
    for (auto& p : view.points) p = (move * p.cast<double>()).cast<float>();
    for (auto& n : view.normals) n = (move.linear() * n.cast<double>()).cast<float>();
  }
  return db;
}

// Poses from two panoramas lie as far apart as the panoramas err: a contradiction only where they claim to be better.
TEST(RoughPoses, ContradictOnlyBeyondWhatTheyState) {
  const TinyCity city(1);
  const auto exact = city.database();
  const cv::Mat image = city.photograph(TinyCity::camera(), TinyCity::look({3, 0, 4}, M_PI / 2, 0.05));
  Pose shifted = Pose::Identity(), turned = Pose::Identity();
  shifted.translation().x() = 1.6;
  const Eigen::Vector3d centre = exact->panoramas.back().T_world_panorama.translation();
  turned.linear() = Eigen::AngleAxisd(0.12, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  turned.translation() = centre - turned.linear() * centre;
  struct Case {
    Pose move;
    double position_stddev, orientation_stddev;
    bool accepted;
  };
  for (const Case& c : {Case{shifted, 1, 0.004, true}, Case{shifted, 0.05, 0.004, false}, Case{turned, 1, 0.05, true},
                        Case{turned, 1, 0.004, false}}) {
    const auto db = movedLast(*exact, c.move);
    for (Panorama& p : db->panoramas)
      p.position_stddev = c.position_stddev, p.orientation_stddev = c.orientation_stddev;
    const LocalizerResult r = StreetviewLocalizer(db, bruteForce()).localize(image, TinyCity::camera());
    EXPECT_EQ(r.accepted(), c.accepted) << c.position_stddev << " " << c.orientation_stddev << ": " << r.reason;
    EXPECT_EQ(r.contradicted, !c.accepted) << r.reason;
  }
}

// Photographs from one place that look the other way leave room for one from farther off that shows the wall.
TEST(Photographs, ThoseThatShowNothingOfAPredictedImageTakeNoPlace) {
  const TinyCity city(1);
  StreetviewDatabase db;
  db.model = city.model();
  const BackProjector projector(db.model);
  const auto add = [&](const Pose& T) {
    Panorama p;
    p.id = std::to_string(db.panoramas.size());
    p.equirectangular = false;
    p.T_world_panorama.translation() = T.translation();
    View view;
    view.id = view.panorama = static_cast<int>(db.panoramas.size());
    view.camera = TinyCity::camera();
    view.T_world_camera = T;
    view.image = city.photograph(view.camera, T);
    view.features = extractFeatures(view.image);
    projector.apply(&view);
    db.panoramas.push_back(p);
    db.views.push_back(view);
  };
  for (int i = 0; i < 7; ++i) add(TinyCity::look({3 + 0.01 * i, 0.5, 2.5}, M_PI / 2, 0));
  add(TinyCity::look({-3, 0.5, 2.5}, -M_PI / 2, 0));
  db.buildIndex();
  const StreetviewLocalizerSettings settings = bruteForce();
  const ViewSearch search(db, settings);
  PosePrior prior;
  prior.T_world_camera = TinyCity::look({3, 0.5, 4}, -M_PI / 2, 0);
  prior.covariance = 0.01 * Matrix6d::Identity();
  EXPECT_EQ(search.byPrior(TinyCity::camera(), prior, 8), std::vector<int>{7});
  // Six of those that show it do, and none from beyond the range in which poses are accepted.
  prior.T_world_camera = TinyCity::look({3, 0.5, 4}, M_PI / 2, 0);
  EXPECT_EQ(search.byPrior(TinyCity::camera(), prior, 8).size(), 6u);
  prior.T_world_camera = TinyCity::look({3, -20, 4}, M_PI / 2, 0);
  EXPECT_TRUE(search.byPrior(TinyCity::camera(), prior, 8).empty());
}

}  // namespace
}  // namespace streetview_localizer
