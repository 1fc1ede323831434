// The street world: plan, frames and conventions of what is written, statistics of its errors.
#include <gtest/gtest.h>
#include <omp.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <regex>
#include <set>
#include <sstream>

#include "air_ground_common/mesh.h"
#include "air_ground_common/units.h"
#include "air_ground_sim/street/city.h"

namespace air_ground_sim {
namespace {

namespace fs = std::filesystem;
using air_ground_common::kDegree;
using air_ground_common::LocalFrame;
using air_ground_common::Pose;
using Eigen::Vector3d;

SimConfig shipped() { return loadSimConfig(std::string(AIR_GROUND_WORLDS) + "/street.yaml"); }

// A short street with coarse pictures: quick to render.
SimConfig small() {
  SimConfig c = shipped();
  c.street.lines = {{{0, 0}, {32, 12}, true}};
  c.street.texel = 0.04;
  c.street.panorama_width = 512;
  c.street.panorama_samples = 1;
  c.mav_camera.samples = 1;
  c.flight.duration = 20;
  return c;
}

std::string contents(const fs::path& path) {
  std::ifstream in(path);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

std::vector<std::vector<std::string>> table(const fs::path& path) {
  std::vector<std::vector<std::string>> rows;
  std::stringstream text(contents(path));
  for (std::string line; std::getline(text, line);) {
    rows.emplace_back();
    std::stringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) rows.back().push_back(cell);
  }
  return rows;
}

TEST(StreetPlan, RowsOfHousesOnRisingGroundWithPanoramasBetween) {
  const SimConfig config = shipped();
  for (std::uint64_t seed : {1, 2, 3}) {
    const Street s = planStreet(config.street, seed);
    const auto& line = config.street.lines[0];
    const Eigen::Vector2d d = (line.to - line.from).normalized(), n(-d.y(), d.x());
    EXPECT_GT(s.ground(line.to) - s.ground(line.from), 3.5);
    int sides[2] = {0, 0}, shops = 0;
    std::set<std::string> ids;
    for (const auto& b : s.buildings) {
      ids.insert(b.id);
      shops += b.shop;
      EXPECT_GE(b.openings.size(), 6u);
      // The facade frame: y goes into the building, away from the street; nobody builds on it.
      EXPECT_NEAR(b.T_world_front.linear().determinant(), 1, 1e-9);
      for (const double x : {0.0, 0.5, 1.0})
        for (const double y : {0.0, 0.5, 1.0})
          EXPECT_GT(s.distanceToLine(b.point(x * b.width, y * b.depth, 0).head<2>()), 0.5 * config.street.width - 0.1);
      EXPECT_LT(s.distanceToLine(b.point(0.5 * b.width, 0, 0).head<2>()),
                s.distanceToLine(b.point(0.5 * b.width, 5, 0).head<2>()));
      for (const double x : {0.0, 1.0})
        EXPECT_LT(b.point(x * b.width, 0, 0).z(), s.ground(b.point(x * b.width, 0, 0).head<2>()))
            << "the wall must reach the ground";
      if (b.line == 0) ++sides[n.dot(b.point(0.5 * b.width, 1, 0).head<2>() - line.from) > 0];
    }
    EXPECT_EQ(ids.size(), s.buildings.size());
    EXPECT_GE(sides[0], 7);
    EXPECT_GE(sides[1], 7);
    EXPECT_GT(shops, 3);
    ASSERT_GE(s.panoramas.size(), 10u);
    for (std::size_t i = 0; i < s.panoramas.size(); ++i) {
      const Vector3d p = s.panoramas[i].T_world_panorama.translation();
      EXPECT_NEAR(p.z() - s.ground(p.head<2>()), 2.5, 0.1);
      EXPECT_LT(s.distanceToLine(p.head<2>()), 2.5);
      if (i == 0) continue;
      const double gap = (p - s.panoramas[i - 1].T_world_panorama.translation()).norm();
      EXPECT_GT(gap, 10);
      EXPECT_LT(gap, 15);
    }
    EXPECT_GT(s.cars[0].size(), 5u);
    EXPECT_NE(s.cars[0].size() ? s.cars[0][0].position : Vector3d(),
              s.cars[1].size() ? s.cars[1][0].position : Vector3d())
        << "other cars on the day of the flight";
  }
  EXPECT_NE(planStreet(config.street, 1).buildings[0].width, planStreet(config.street, 2).buildings[0].width);
}

TEST(StreetPlan, ErrorsOfGeotagsAndModelHaveTheirStatedSize) {
  SimConfig config = shipped();
  double position = 0, angle = 0, lateral = 0, height = 0, yaw = 0;
  int panoramas = 0, buildings = 0;
  for (std::uint64_t seed = 1; seed <= 150; ++seed) {
    const Street s = planStreet(config.street, seed);
    for (const auto& p : s.panoramas) {
      position += (p.T_world_geotag.translation() - p.T_world_panorama.translation()).norm();
      angle += air_ground_common::rotationAngle(p.T_world_geotag.linear(), p.T_world_panorama.linear());
      yaw += air_ground_common::wrapAngle(air_ground_common::yawOf(p.T_world_geotag.linear()) -
                                          air_ground_common::yawOf(p.T_world_panorama.linear()));
      ++panoramas;
    }
    for (const auto& b : s.buildings) {
      lateral += b.model_error.head<2>().squaredNorm() / 2;
      height += b.model_error.z() * b.model_error.z();
      ++buildings;
    }
  }
  EXPECT_NEAR(position / panoramas, 3.7, 0.2);
  EXPECT_NEAR(angle / panoramas / kDegree, 1.9, 0.08);
  EXPECT_NEAR(yaw / panoramas / kDegree, 0, 0.1);
  EXPECT_NEAR(std::sqrt(lateral / buildings), 0.1, 0.004);
  EXPECT_NEAR(std::sqrt(height / buildings), 0.5, 0.025);
}

TEST(LongStreet, TwoKilometresOfClearFlightAroundTheBlock) {
  const SimConfig config = loadSimConfig(std::string(AIR_GROUND_WORLDS) + "/street_long.yaml");
  const Street s = planStreet(config.street, 1);
  EXPECT_GT(s.buildings.size(), 100u);
  EXPECT_GT(s.panoramas.size(), 60u);
  const BodyTrajectory flight = makeStreetFlight(s, config.flight, mix(1, 11));
  EXPECT_GT(flight.pathLength(0, config.flight.duration), 1900);
  const air_ground_common::MeshScene mesh(meshOf(buildStreetWorld(s, Season::kFlight)));
  for (double t = 8; t < config.flight.duration; t += 0.5)
    ASSERT_GT(mesh.distance(flight.pose(t).translation().cast<float>(), 5), 0.6)
        << "at " << t << " s, " << flight.pose(t).translation().transpose();
}

TEST(Geotags, HeadingIsClockwiseFromTrueNorthPitchUpRollRightSideDown) {
  const StreetConfig c;
  const LocalFrame frame(c.crs, c.origin);
  Pose T = Pose::Identity();
  // Looks to the north-east by east (60 degrees from north), 10 degrees up, right side 5 degrees down.
  const Vector3d forward = Vector3d(std::sin(60 * kDegree) * std::cos(10 * kDegree),
                                    std::cos(60 * kDegree) * std::cos(10 * kDegree), std::sin(10 * kDegree));
  const Vector3d level_left = Vector3d(-std::cos(60 * kDegree), std::sin(60 * kDegree), 0),
                 up = forward.cross(level_left);
  T.linear().col(0) = forward;
  T.linear().col(1) = std::cos(5 * kDegree) * level_left + std::sin(5 * kDegree) * up;  // left side up, right side down
  T.linear().col(2) = T.linear().col(0).cross(T.linear().col(1));
  const Geotag g = geotagOf(frame, T);
  EXPECT_NEAR(g.heading, 60, 1e-9);
  EXPECT_NEAR(g.pitch, 10, 1e-9);
  EXPECT_NEAR(g.roll, 5, 1e-9);
  EXPECT_NEAR(g.place.height, c.origin.z(), 1e-6);
  const Eigen::Matrix3d back = (Eigen::AngleAxisd((90 - g.heading) * kDegree, Vector3d::UnitZ()) *
                                Eigen::AngleAxisd(-g.pitch * kDegree, Vector3d::UnitY()) *
                                Eigen::AngleAxisd(g.roll * kDegree, Vector3d::UnitX()))
                                   .toRotationMatrix();
  EXPECT_LT((back - T.linear()).norm(), 1e-9);

  // Facing along the grid's north is not facing true north: the convergence near Zurich is 0.8 degrees.
  const Vector3d north = frame.fromCrs(c.origin + Vector3d(0, 100, 0));
  const double grid_heading =
      geotagOf(frame, air_ground_common::yawPose(std::atan2(north.y(), north.x()), Vector3d::Zero())).heading;
  EXPECT_NEAR(grid_heading, frame.meridianConvergence() / kDegree, 1e-4);
  EXPECT_NEAR(grid_heading, (8.55 - 7.439) * std::sin(47.37 * kDegree), 0.05);
  // A place 100 m to the true north has the larger latitude and the same longitude.
  T.translation() = Vector3d(0, 100, 3);
  const Geotag moved = geotagOf(frame, T);
  EXPECT_NEAR((moved.place.latitude - g.place.latitude) * 111170, 100, 0.2);
  EXPECT_NEAR(moved.place.longitude, g.place.longitude, 1e-8);
  EXPECT_NEAR(moved.place.height, c.origin.z() + 3, 1e-2);
}

// A white box in an empty, dark world: its picture lies where the convention says.
TEST(Panorama, AKnownPointLandsOnItsPixel) {
  World w;
  const Vector3d target(6, 9, 4);
  Cuboid c;
  c.T_world_base.translation() = target - Vector3d(0, 0, 0.15);
  c.size = {0.3, 0.3, 0.3};
  c.material = Material::kPaper;
  c.printed = false;
  addCuboid(c, 0.05, &w);
  w.sky = 0;
  const Scene scene(w);
  Pose T = Pose::Identity();
  T.translation() = Vector3d(1, -2, 1.5);
  T.linear() = (Eigen::AngleAxisd(2.0, Vector3d::UnitZ()) * Eigen::AngleAxisd(-0.2, Vector3d::UnitY()) *
                Eigen::AngleAxisd(0.15, Vector3d::UnitX()))
                   .toRotationMatrix();
  const int width = 1024;
  std::vector<float> rgb;
  renderPanorama(scene, T, width, 4, 1, &rgb);
  double sum = 0, u = 0, v = 0;
  for (int y = 0; y < width / 2; ++y)
    for (int x = 0; x < width; ++x) {
      const double l = rgb[(static_cast<std::size_t>(y) * width + x) * 3];
      sum += l > 0;
      u += x * (l > 0);
      v += y * (l > 0);
    }
  ASSERT_GT(sum, 20);
  const Vector3d q = T.inverse() * target;
  EXPECT_NEAR(u / sum, (0.5 + std::atan2(-q.y(), q.x()) / (2 * M_PI)) * width - 0.5, 0.7);
  EXPECT_NEAR(v / sum, (0.5 - std::atan2(q.z(), q.head<2>().norm()) / M_PI) * (width / 2) - 0.5, 0.7);
}

TEST(StreetMesh, FacadesStandWhereTheModelWithoutErrorHasThem) {
  const SimConfig config = small();
  const Street s = planStreet(config.street, 4);
  const air_ground_common::MeshScene mesh(meshOf(buildStreetWorld(s, Season::kFlight)));
  int walls = 0, on_wall = 0, panes = 0, behind = 0;
  for (const auto& b : s.buildings) {
    const Vector3d inward = b.T_world_front.linear().col(1);
    const auto depthAt = [&](double x, double z) {  // behind the facade's plane, seen from 3 m before it
      const auto hit = mesh.cast((b.point(x, 0, z) - 3 * inward).cast<float>(), inward.cast<float>());
      return hit ? hit->distance - 3.0 : 1e9;
    };
    for (double x = 0.25; x < b.width; x += 0.5)
      for (double z = b.street_level + 0.3; z < b.eaves - 0.3; z += 0.5, ++walls)
        on_wall += std::abs(depthAt(x, z)) < 0.01;
    for (const auto& o : b.openings) {
      if (o.floor == 0 || !b.balconies.empty()) continue;  // free of cars, people, railings
      const double depth = depthAt(o.x + 0.5 * o.width, o.z + 0.5 * o.height);
      ++panes;
      behind += std::abs(depth - 0.16) < 0.01;
    }
    const auto surfaces = modelSurfaces(b, false);
    EXPECT_LT((surfaces[1].polygon[0] - b.point(0, 0, 0)).norm(), 1e-9);
    // Closed and facing outwards: the divergence theorem gives the volume.
    double volume = 0;
    for (const auto& f : surfaces)
      for (std::size_t k = 1; k + 1 < f.polygon.size(); ++k)
        volume += (f.polygon[0] - b.point(1, 1, 1))
                      .dot((f.polygon[k] - b.point(1, 1, 1)).cross(f.polygon[k + 1] - b.point(1, 1, 1))) /
                  6;
    const double ridge = b.roof == RoofKind::kGable ? b.width : b.width - 2 * b.hipInset() / 3 * 2;
    EXPECT_GT(volume, b.width * b.depth * b.eaves - 1e-6);
    EXPECT_LT(volume, b.width * b.depth * b.eaves + 0.5 * std::max(ridge, b.width) * b.depth * b.roof_rise + 1e-6);
    const auto moved = modelSurfaces(b, true);
    for (std::size_t i = 0; i < moved.size(); ++i)
      EXPECT_LT((moved[i].polygon[0] - surfaces[i].polygon[0] - b.model_error).norm(), 1e-9);
  }
  EXPECT_GT(on_wall, 0.45 * walls) << "the rest are openings, balconies, signs, trees";
  EXPECT_GT(panes, 30);
  EXPECT_GT(behind, 0.85 * panes);
}

TEST(City, FilesAgreeWithThePlan) {
  const SimConfig config = small();
  const Street s = planStreet(config.street, 5);
  const fs::path folder = fs::path(testing::TempDir()) / "air_ground_street_city";
  fs::remove_all(folder);
  writeCity(config, s, folder.string(), nullptr);
  const LocalFrame frame(config.street.crs, config.street.origin);

  const auto tags = table(folder / "geotags.csv"), truth = table(folder / "panorama_truth.csv");
  ASSERT_EQ(tags.size(), s.panoramas.size() + 1);
  ASSERT_EQ(truth.size(), s.panoramas.size() + 1);
  for (std::size_t i = 0; i < s.panoramas.size(); ++i) {
    ASSERT_EQ(tags[i + 1].size(), 7u);
    EXPECT_EQ(tags[i + 1][0], s.panoramas[i].id + ".jpg");
    const cv::Mat image = cv::imread((folder / "panoramas" / tags[i + 1][0]).string());
    EXPECT_EQ(image.cols, 512);
    EXPECT_EQ(image.rows, 256);
    const Vector3d p =
        frame.fromGeodetic({std::stod(tags[i + 1][1]), std::stod(tags[i + 1][2]), std::stod(tags[i + 1][3])});
    EXPECT_LT((p - s.panoramas[i].T_world_geotag.translation()).norm(), 2e-3);
    EXPECT_NEAR(std::stod(truth[i + 1][2]), s.panoramas[i].T_world_panorama.translation().y(), 1e-5);
    const Eigen::Quaterniond q(std::stod(truth[i + 1][7]), std::stod(truth[i + 1][4]), std::stod(truth[i + 1][5]),
                               std::stod(truth[i + 1][6]));
    EXPECT_LT(air_ground_common::rotationAngle(q.toRotationMatrix(), s.panoramas[i].T_world_panorama.linear()), 1e-6);
  }

  const std::string gml = contents(folder / "model.gml"), obj = contents(folder / "model.obj");
  EXPECT_NE(gml.find("srsName=\"EPSG:2056\""), std::string::npos);
  std::size_t surfaces = 0;
  for (const auto& b : s.buildings) {
    EXPECT_NE(gml.find("<bldg:Building gml:id=\"" + b.id + "\">"), std::string::npos);
    EXPECT_NE(obj.find("o " + b.id + "\n"), std::string::npos);
    surfaces += modelSurfaces(b, true).size();
  }
  const std::regex list("<gml:posList[^>]*>([^<]*)<");
  EXPECT_EQ(static_cast<std::size_t>(
                std::distance(std::sregex_iterator(gml.begin(), gml.end(), list), std::sregex_iterator())),
            surfaces);
  std::smatch first;
  ASSERT_TRUE(std::regex_search(gml, first, list));
  std::stringstream numbers(first[1].str());
  Vector3d p;
  numbers >> p.x() >> p.y() >> p.z();
  const Vector3d expected = modelSurfaces(s.buildings[0], true)[0].polygon[0];
  EXPECT_LT((frame.fromCrs(p) - expected).norm(), 2e-3);
  std::stringstream vertex(obj.substr(obj.find("\nv ") + 3));
  Vector3d q;
  vertex >> q.x() >> q.y() >> q.z();
  EXPECT_LT((p - q).norm(), 1e-9);
  EXPECT_NE(contents(folder / "city.yaml").find("crs: EPSG:2056"), std::string::npos);
  fs::remove_all(folder);
}

TEST(Facades, MayBePhotographs) {
  SimConfig config = small();
  const fs::path folder = fs::path(testing::TempDir()) / "air_ground_street_photos";
  fs::create_directories(folder);
  cv::imwrite((folder / "a.png").string(), cv::Mat(60, 80, CV_8UC3, cv::Scalar(10, 20, 240)));  // B G R: red
  config.street.facade_images = folder.string();
  const Street s = planStreet(config.street, 5);
  const World w = buildStreetWorld(s, Season::kFlight);
  int red = 0;
  for (const Patch& p : w.patches) {
    if (p.width < 6 || p.height < 6) continue;
    const cv::Vec3b c = p.painter(p).at<cv::Vec3b>(2, 2);
    red += c[0] == 240 && c[2] == 10;
  }
  EXPECT_EQ(red, static_cast<int>(s.buildings.size()));
  config.street.facade_images = (folder / "missing").string();
  EXPECT_THROW(planStreet(config.street, 5), std::invalid_argument);
  fs::remove_all(folder);
}

TEST(StreetFlight, StandsClimbsAndFliesPastTheFacades) {
  const SimConfig config = shipped();
  for (std::uint64_t seed : {1, 2, 3}) {
    const Street s = planStreet(config.street, seed);
    const BodyTrajectory flight = makeStreetFlight(s, config.flight, mix(seed, 11));
    const air_ground_common::MeshScene mesh(meshOf(buildStreetWorld(s, Season::kFlight)));
    EXPECT_LT((flight.pose(0.0).translation() - flight.pose(1.2).translation()).norm(), 1e-3);
    const double length = flight.pathLength(0, config.flight.duration);
    EXPECT_GT(length, 120);
    EXPECT_LT(length, 190);
    double lowest = 1e9, highest = 0;
    for (double t = 0; t < config.flight.duration; t += 0.25) {
      const BodyState b = flight.state(t);
      const Vector3d p = b.T_world_body.translation();
      const double height = p.z() - s.ground(p.head<2>());
      if (t > 8) {
        lowest = std::min(lowest, height);
        highest = std::max(highest, height);
        EXPECT_GT(mesh.distance(p.cast<float>(), 5), 0.6) << "seed " << seed << " at " << t << " s";
      }
      EXPECT_LT(b.velocity.norm(), 3.2);
      EXPECT_LT(b.acceleration.norm(), 5);
      EXPECT_LT(b.angular_velocity.norm(), 2);
    }
    EXPECT_GT(lowest, 1.4);
    EXPECT_LT(highest, 15);
    EXPECT_GT(highest, 8);
  }
  // The camera looks to the left and a little up; image right is forward.
  const Eigen::Matrix3d R = config.T_mav_base_camera.linear();
  EXPECT_NEAR(R.determinant(), 1, 1e-12);
  EXPECT_GT(R.col(2).y(), 0.99);
  EXPECT_NEAR(R.col(2).z(), std::sin(config.street.camera_pitch), 1e-12);
  EXPECT_NEAR(R.col(0).x(), 1, 1e-12);
  EXPECT_LT(R.col(1).z(), -0.99);
}

TEST(StreetRecording, SameSeedSameQueriesForAnyNumberOfThreads) {
  const SimConfig config = small();
  const int threads = omp_get_max_threads();
  std::vector<std::uint8_t> images[2];
  for (int k = 0; k < 2; ++k) {
    omp_set_num_threads(1 + k);
    Recording r(config, 6);
    const BodyState s = r.mav().state(12);
    r.photograph(s.T_world_body * config.T_mav_base_camera, s.velocity, 3, &images[k]);
  }
  omp_set_num_threads(threads);
  ASSERT_EQ(images[0].size(), 752u * 480u);
  EXPECT_EQ(images[0], images[1]);
  double mean = 0;
  for (const auto v : images[0]) mean += v / 255.0 / static_cast<double>(images[0].size());
  EXPECT_NEAR(mean, config.mav_camera.target_mean, 0.1);
}

TEST(StreetFile, ErrorsNameTheKey) {
  const std::string path = testing::TempDir() + "/air_ground_street_bad.yaml";
  const auto errorOf = [&](const std::string& text) {
    std::ofstream(path) << "world: {kind: street}\n" << text;
    try {
      loadSimConfig(path);
    } catch (const std::invalid_argument& e) {
      return std::string(e.what());
    }
    return std::string();
  };
  EXPECT_EQ(errorOf("street: {lines: [{from: [0, 0], to: [60, 0]}]}"), "");
  EXPECT_NE(errorOf("").find("'lines' must name at least one street"), std::string::npos);
  EXPECT_NE(errorOf("street: {lines: [{from: [0, 0], to: [6, 0]}]}").find("at least 20 m"), std::string::npos);
  EXPECT_NE(errorOf("street: {origin: [1, 2], lines: [{from: [0, 0], to: [60, 0]}]}").find("three numbers"),
            std::string::npos);
  EXPECT_NE(errorOf("street: {camera_side: up, lines: [{from: [0, 0], to: [60, 0]}]}").find("must be one of"),
            std::string::npos);
}

}  // namespace
}  // namespace air_ground_sim
