// The engine on a painted courtyard with exact geometry: right where it answers, silent where it cannot know.
#include "streetview_localizer/localizer.h"

#include <gtest/gtest.h>

#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "streetview_localizer/match_picture.h"
#include "streetview_localizer/view_synthesis.h"
#include "tiny_city.h"

namespace streetview_localizer {
namespace {

using test::TinyCity;

class LocalizerTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    city_ = new TinyCity(1);
    database_ = city_->database();
    localizer_ = new StreetviewLocalizer(database_);
  }
  static void TearDownTestSuite() {
    delete localizer_;
    database_.reset();
    delete city_;
  }

  static LocalizerResult locate(const Pose& T, const PosePrior& prior = {}) {
    return localizer_->localize(city_->photograph(TinyCity::camera(), T), TinyCity::camera(), prior);
  }
  static double error(const LocalizerResult& r, const Pose& T) {
    return (r.pose.T_world_camera.translation() - T.translation()).norm();
  }
  static double turn(const LocalizerResult& r, const Pose& T) {
    return air_ground_common::rotationAngle(r.pose.T_world_camera.linear(), T.linear());
  }

  static TinyCity* city_;
  static std::shared_ptr<StreetviewDatabase> database_;
  static StreetviewLocalizer* localizer_;
};

TinyCity* LocalizerTest::city_ = nullptr;
std::shared_ptr<StreetviewDatabase> LocalizerTest::database_;
StreetviewLocalizer* LocalizerTest::localizer_ = nullptr;

TEST_F(LocalizerTest, FindsCamerasInTheAir) {
  const Pose poses[] = {TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05),
                        TinyCity::look({3, -1, 6}, -M_PI / 2 + 0.2, -0.15, 0.05),
                        TinyCity::look({4, 0, 3}, 0.2, 0.1, -0.1), TinyCity::look({0, 2, 7}, -M_PI / 2 - 0.3, -0.2)};
  for (const Pose& T : poses) {
    const LocalizerResult r = locate(T);
    EXPECT_TRUE(r.accepted()) << T.translation().transpose() << ": " << r.reason;
    EXPECT_FALSE(r.used_prior);
    EXPECT_LT(error(r, T), 0.1) << T.translation().transpose();
    EXPECT_LT(turn(r, T), 0.01);
    EXPECT_LT(r.acceptance.evidence.range, 8);
    ASSERT_EQ(r.views.size(), r.correspondences.size());
    // The covariance holds the error: 5 standard deviations of the largest axis.
    EXPECT_LT(error(r, T), 5 * std::sqrt(r.pose.covariance.topLeftCorner<3, 3>().trace()));
    for (const int i : r.pose.inliers) EXPECT_GE(r.correspondences[static_cast<std::size_t>(i)].p_world.z(), -0.1);
  }
}

// 126 degrees across; most of the panoramas' views show less than it does.
TEST_F(LocalizerTest, FindsAFisheye) {
  CameraModel fisheye = TinyCity::camera();
  fisheye.width = 960;
  fisheye.height = 720;
  fisheye.cx = 479.5;
  fisheye.cy = 359.5;
  fisheye.fx = fisheye.fy = 450;
  fisheye.setDistortion("equidistant", {-0.02, 0.03, -0.02, 0.004});
  for (const Pose& T : {TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05), TinyCity::look({4, 0, 3}, 0.2, 0.1, -0.1)}) {
    const LocalizerResult r = localizer_->localize(city_->photograph(fisheye, T), fisheye);
    EXPECT_TRUE(r.accepted()) << T.translation().transpose() << ": " << r.reason;
    EXPECT_LT(error(r, T), 0.1) << T.translation().transpose();
    EXPECT_LT(turn(r, T), 0.01);
    // Matches are told as pixels of the fisheye's image.
    for (const int i : r.pose.inliers) {
      const Correspondence& c = r.correspondences[static_cast<std::size_t>(i)];
      const auto pixel = fisheye.project(T.inverse() * c.p_world);
      ASSERT_TRUE(pixel);
      EXPECT_LT((*pixel - c.pixel).norm(), 12) << c.pixel.transpose();
    }
  }
}

// What a camera of four times the resolution sees is found as surely and as quickly: as if it had been reduced before.
TEST_F(LocalizerTest, LargeImagesAreFoundAsSmallOnesAre) {
  const CameraModel large = TinyCity::camera().scaled(4);
  const double factor = 1.5 * database_->views[0].camera.fx / large.fx;
  for (const Pose& T : {TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05), TinyCity::look({4, 0, 3}, 0.2, 0.1, -0.1)}) {
    const cv::Mat image = city_->photograph(large, T);
    cv::Mat reduced;
    cv::cvtColor(image, reduced, cv::COLOR_BGR2GRAY);
    cv::resize(reduced, reduced, {}, factor, factor, cv::INTER_AREA);
    const LocalizerResult small = locate(T), by_hand = localizer_->localize(reduced, large.scaled(factor)),
                          r = localizer_->localize(image, large);
    EXPECT_EQ(r.status, small.status) << r.reason;
    EXPECT_EQ(r.features, by_hand.features);
    EXPECT_EQ(r.pose.T_world_camera.matrix(), by_hand.pose.T_world_camera.matrix());
    EXPECT_EQ(r.pose.covariance, by_hand.pose.covariance);
    const Eigen::Vector3d apart = r.pose.T_world_camera.translation() - small.pose.T_world_camera.translation();
    for (int axis = 0; axis < 3; ++axis) EXPECT_LT(std::abs(apart[axis]), std::sqrt(small.pose.covariance(axis, axis)));
    // Matches are told as pixels of the large image.
    for (const int i : r.pose.inliers) {
      const Correspondence& c = r.correspondences[static_cast<std::size_t>(i)];
      const auto pixel = large.project(T.inverse() * c.p_world);
      ASSERT_TRUE(pixel);
      EXPECT_LT((*pixel - c.pixel).norm(), 12 / factor) << c.pixel.transpose();
    }
  }
}

// Up to 1.9 times the views' focal length an image is searched as it is.
TEST_F(LocalizerTest, ImagesThatAreHardlyLargerStayAsTheyAre) {
  const Pose T = TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05);
  const CameraModel camera = TinyCity::camera().scaled(1.85 * database_->views[0].camera.fx / TinyCity::camera().fx);
  const cv::Mat image = city_->photograph(camera, T);
  const LocalizerResult r = localizer_->localize(image, camera);
  EXPECT_TRUE(r.accepted()) << r.reason;
  EXPECT_GE(r.features, static_cast<int>(extractFeatures(image).size()));
}

TEST_F(LocalizerTest, SameInSameOut) {
  const Pose T = TinyCity::look({-2, 0, 5}, M_PI / 2 + 0.1, -0.1);
  const LocalizerResult a = locate(T), b = locate(T);
  EXPECT_EQ(a.pose.inliers, b.pose.inliers);
  EXPECT_EQ(a.pose.T_world_camera.matrix(), b.pose.T_world_camera.matrix());
  EXPECT_EQ(a.pose.covariance, b.pose.covariance);
}

TEST_F(LocalizerTest, PriorNamesThePanoramasAndNotThePose) {
  StreetviewLocalizerSettings settings;
  settings.near_panoramas = 1;
  const StreetviewLocalizer near_only(database_, settings);
  const Pose T = TinyCity::look({5, 1, 4}, M_PI / 2, 0);
  const cv::Mat image = city_->photograph(TinyCity::camera(), T);
  PosePrior prior;
  prior.T_world_camera = T;
  prior.T_world_camera->translation() += Eigen::Vector3d(1.5, -1, 0.5);
  prior.covariance = Matrix6d::Identity() * 0.05;
  prior.covariance.topLeftCorner<3, 3>() = 4 * Eigen::Matrix3d::Identity();
  const LocalizerResult r = near_only.localize(image, TinyCity::camera(), prior);
  EXPECT_TRUE(r.accepted()) << r.reason;
  EXPECT_TRUE(r.used_prior);
  EXPECT_EQ(r.searched, std::vector<int>{2});
  EXPECT_LT(error(r, T), 0.1);  // not drawn towards the prediction

  prior.covariance.topLeftCorner<3, 3>() *= 1e4;  // knows nothing: the whole database is searched
  EXPECT_FALSE(near_only.localize(image, TinyCity::camera(), prior).used_prior);
}

TEST_F(LocalizerTest, PanoramasWithoutViewsTakeNoPlaces) {
  auto db = std::make_shared<StreetviewDatabase>(*database_);
  const Pose T = TinyCity::look({5, 1, 4}, M_PI / 2, 0);
  for (int i = 0; i < 5; ++i) {
    Panorama empty;
    empty.id = "not_placed_" + std::to_string(i);
    empty.T_world_panorama.translation() = Eigen::Vector3d(5 + 0.1 * i, 1, 2.5);
    db->panoramas.push_back(empty);
  }
  db->buildIndex();
  StreetviewLocalizerSettings settings;
  settings.near_panoramas = 1;
  settings.index.method = IndexMethod::kBruteForce;
  PosePrior prior;
  prior.T_world_camera = T;
  const LocalizerResult r =
      StreetviewLocalizer(db, settings).localize(city_->photograph(TinyCity::camera(), T), TinyCity::camera(), prior);
  EXPECT_TRUE(r.accepted()) << r.reason;
  EXPECT_EQ(r.searched, std::vector<int>{2});
}

// A ground surface of a building overhead is the underside of a bridge or an oriel; one of the terrain is the ground.
TEST_F(LocalizerTest, UndersidesAreNoGroundAbove) {
  const Pose T = TinyCity::look({5, 1, 4}, M_PI / 2, 0);
  const cv::Mat image = city_->photograph(TinyCity::camera(), T);
  StreetviewLocalizerSettings settings;
  settings.index.method = IndexMethod::kBruteForce;
  for (const bool bridge : {true, false}) {
    auto db = std::make_shared<StreetviewDatabase>(*database_);
    const int base = static_cast<int>(db->model.mesh.vertices.size());
    for (const auto& [x, y] : {std::make_pair(-0.7f, -0.7f), {1.4f, 0.f}, {0.f, 1.4f}})
      db->model.mesh.vertices.emplace_back(5 + x, 1 + y, 6.f);
    db->model.mesh.triangles.emplace_back(base, base + 1, base + 2);
    db->model.surface.push_back(Surface::kGround);
    db->model.building.push_back(bridge ? static_cast<int>(db->model.building_ids.size()) : -1);
    if (bridge) db->model.building_ids.push_back("bridge");
    const LocalizerResult r = StreetviewLocalizer(db, settings).localize(image, TinyCity::camera());
    EXPECT_EQ(r.accepted(), bridge) << r.reason;
    if (!bridge) {
      EXPECT_NE(r.reason.find("below the ground"), std::string::npos) << r.reason;
    }
  }
}

// Where the prediction looks at nothing, the reason says that the prediction chose.
TEST_F(LocalizerTest, WrongPredictionIsNamed) {
  const Pose T = TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05);
  PosePrior prior;
  prior.T_world_camera = TinyCity::look({-64, 1, 4}, -M_PI, 0);
  prior.covariance = 0.01 * Matrix6d::Identity();
  const LocalizerResult r = locate(T, prior);
  EXPECT_FALSE(r.accepted());
  EXPECT_TRUE(r.used_prior);
  EXPECT_NE(r.reason.find("predicted pose"), std::string::npos) << r.reason;
}

// Matches that k-VLD dropped lower the share of inliers that the decision is made from.
TEST_F(LocalizerTest, DroppedMatchesAreEvidence) {
  const Pose T = TinyCity::look({4, 0, 3}, 0.2, 0.1, -0.1);
  const LocalizerResult r = locate(T);
  ASSERT_TRUE(r.accepted()) << r.reason;
  ASSERT_EQ(r.views.size(), r.correspondences.size());
  const PoseEvidence kept =
      gatherEvidence(r.pose, r.correspondences, TinyCity::camera(), {}, localizer_->settings().pose);
  EXPECT_EQ(r.acceptance.evidence.inliers, kept.inliers);
  EXPECT_LT(r.acceptance.evidence.inlier_share, kept.inlier_share);
  EXPECT_GT(r.acceptance.evidence.inlier_share, 0.3);
}

TEST_F(LocalizerTest, PapersCovarianceOnRequest) {
  StreetviewLocalizerSettings settings;
  settings.index.method = IndexMethod::kBruteForce;
  settings.covariance = CovarianceKind::kMonteCarlo;
  EXPECT_THROW(StreetviewLocalizer(database_, settings), std::invalid_argument);  // of how many samples?
  settings.pose.monte_carlo_samples = 200;
  const Pose T = TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05);
  const LocalizerResult r =
      StreetviewLocalizer(database_, settings).localize(city_->photograph(TinyCity::camera(), T), TinyCity::camera());
  ASSERT_TRUE(r.accepted()) << r.reason;
  ASSERT_TRUE(r.pose.monte_carlo_covariance);
  EXPECT_EQ(r.pose.covariance, *r.pose.monte_carlo_covariance);
}

TEST_F(LocalizerTest, IndexOfAnotherMethodIsBuiltAgain) {
  const std::string file = ::testing::TempDir() + "localizer_test_" + std::to_string(getpid()) + ".index";
  StreetviewLocalizerSettings settings;
  settings.index_file = file;
  settings.index.method = IndexMethod::kBruteForce;
  const auto remark = [&] { return StreetviewLocalizer(database_, settings).indexRemark(); };
  const auto contains = [](const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
  };
  const std::string built = remark(), read = remark();
  EXPECT_TRUE(contains(built, "brute_force index") && contains(built, "built in")) << built;
  EXPECT_TRUE(contains(read, "brute_force index") && contains(read, "read from")) << read;
  settings.index.method = IndexMethod::kFlann;
  const std::string again = remark(), flann = remark();
  EXPECT_TRUE(contains(again, "flann index") && contains(again, "built in") && contains(again, "not flann")) << again;
  EXPECT_TRUE(contains(flann, "flann index") && contains(flann, "read from")) << flann;
  std::remove(file.c_str());
  std::remove((file + ".data").c_str());
}

TEST_F(LocalizerTest, WrongGravityIsNoticed) {
  const Pose T = TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05);
  PosePrior prior;
  prior.up_camera = T.linear().transpose() * Eigen::Vector3d::UnitZ();
  const LocalizerResult right = locate(T, prior);
  EXPECT_TRUE(right.accepted()) << right.reason;
  EXPECT_LT(error(right, T), 0.1);
  prior.up_camera = T.linear().transpose() * Eigen::Vector3d::UnitX();
  const LocalizerResult wrong = locate(T, prior);
  EXPECT_FALSE(wrong.accepted()) << "a pose that contradicts gravity was accepted";
  EXPECT_NE(wrong.reason.find("90 degrees off gravity"), std::string::npos) << wrong.reason;
}

TEST_F(LocalizerTest, RefusesWhatIsNotThere) {
  const CameraModel camera = TinyCity::camera();
  const Pose T = TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05);
  const cv::Mat image = city_->photograph(camera, T);
  cv::Mat mirrored, noise(camera.height, camera.width, CV_8UC1), upside_down;
  cv::flip(image, mirrored, 1);
  cv::randu(noise, 0, 255);
  const TinyCity other(77);
  const std::pair<const char*, cv::Mat> impossible[] = {
      {"black", cv::Mat::zeros(camera.height, camera.width, CV_8UC1)},
      {"blank wall", cv::Mat(camera.height, camera.width, CV_8UC3, cv::Scalar(180, 190, 200))},
      {"noise", noise},
      {"mirrored", mirrored},
      {"another street", other.photograph(camera, T)}};
  for (const auto& [name, query] : impossible) {
    const LocalizerResult r = localizer_->localize(query, camera);
    EXPECT_FALSE(r.accepted()) << name;
    EXPECT_FALSE(r.reason.empty()) << name;
    EXPECT_NO_THROW(drawMatch(query, localizer_->database(), r)) << name;
  }
}

// A panorama that stands 1.6 m off, which only the second attempt looks at: the pose of the first is no better known.
TEST_F(LocalizerTest, AContradictionIsFinal) {
  auto db = std::make_shared<StreetviewDatabase>(*database_);
  const Eigen::Vector3d shift(1.6, 0, 0);
  db->panoramas[2].T_world_panorama.translation() += shift;
  for (View& view : db->views) {
    if (view.panorama != 2) continue;
    view.T_world_camera.translation() += shift;
    for (auto& p : view.points) p += shift.cast<float>();
  }
  const cv::Mat image = city_->photograph(TinyCity::camera(), TinyCity::look({3, 0, 4}, M_PI / 2, 0.05));
  StreetviewLocalizerSettings settings;
  settings.index.method = IndexMethod::kBruteForce;
  settings.quick_inliers = 100000;  // whatever the first finds, the second is asked
  settings.quick_views = settings.max_views = 1;
  const LocalizerResult alone = StreetviewLocalizer(db, settings).localize(image, TinyCity::camera());
  EXPECT_TRUE(alone.accepted() && !alone.contradicted) << alone.reason;
  settings.max_views = 8;
  for (const int quick_views : {1, 8}) {
    settings.quick_views = quick_views;
    const LocalizerResult r = StreetviewLocalizer(db, settings).localize(image, TinyCity::camera());
    EXPECT_FALSE(r.accepted()) << quick_views;
    EXPECT_TRUE(r.contradicted && r.quick) << "something else was tried: " << r.reason;
    EXPECT_NE(r.reason.find("poses from two panoramas lie 1.6 m"), std::string::npos) << r.reason;
  }
}

// Walls that repeat themselves every 3 m, with a corner in sight to tell the periods apart: right, or silent.
TEST(Repetition, IsRightOrSilent) {
  const TinyCity city(5, 3.0);
  const StreetviewLocalizer localizer(city.database());
  int accepted = 0;
  for (const double x : {3.0, 6.0}) {
    const Pose T = TinyCity::look({x, 1, 4}, 0.7, 0.05);
    const cv::Mat image = city.photograph(TinyCity::camera(), T);
    PosePrior near;
    near.T_world_camera = T;
    near.covariance = 0.01 * Matrix6d::Identity();
    for (const PosePrior& prior : {PosePrior(), near}) {
      const LocalizerResult r = localizer.localize(image, TinyCity::camera(), prior);
      std::printf("x = %.0f%s: %s, share %.2f, rival %.2f; %s\n", x, prior.T_world_camera ? " with prior" : "",
                  nameOf(r.status), r.acceptance.evidence.inlier_share, r.acceptance.evidence.competitor_share,
                  r.reason.c_str());
      if (!r.accepted()) continue;
      ++accepted;
      EXPECT_LT((r.pose.T_world_camera.translation() - T.translation()).norm(), 0.3) << "x = " << x;
    }
  }
  EXPECT_GE(accepted, 3);
}

TEST_F(LocalizerTest, BadInputIsNamed) {
  const CameraModel camera = TinyCity::camera();
  EXPECT_THROW(localizer_->localize(cv::Mat(100, 100, CV_8UC1, cv::Scalar(0)), camera), std::invalid_argument);
  EXPECT_THROW(localizer_->localize(cv::Mat(), camera), std::invalid_argument);
  EXPECT_THROW(localizer_->localize(cv::Mat(480, 640, CV_32FC1, cv::Scalar(0)), camera), std::invalid_argument);
  CameraModel uncalibrated = camera;
  uncalibrated.fx = 0;
  EXPECT_THROW(localizer_->localize(cv::Mat(480, 640, CV_8UC1, cv::Scalar(0)), uncalibrated), std::invalid_argument);
  PosePrior prior;
  prior.T_world_camera = Pose::Identity();
  prior.T_world_camera->translation().x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(localizer_->localize(cv::Mat(480, 640, CV_8UC1, cv::Scalar(0)), camera, prior), std::invalid_argument);
  prior.T_world_camera = Pose::Identity();
  prior.covariance(0, 1) = prior.covariance(1, 0) = 2;  // indefinite
  EXPECT_THROW(localizer_->localize(cv::Mat(480, 640, CV_8UC1, cv::Scalar(0)), camera, prior), std::invalid_argument);
  EXPECT_THROW(StreetviewLocalizer(std::make_shared<StreetviewDatabase>()), std::invalid_argument);
  StreetviewLocalizerSettings settings;
  settings.max_views = 0;
  EXPECT_THROW(StreetviewLocalizer(database_, settings), std::invalid_argument);
}

// The synthesised view shows what the camera saw.
TEST_F(LocalizerTest, SynthesisedViewResemblesThePhotograph) {
  const ViewSynthesizer synthesizer(localizer_->database(), localizer_->projector());
  const CameraModel camera = TinyCity::camera().scaled(0.5);
  const Pose T = TinyCity::look({-1, 0, 4}, M_PI / 2, 0.05);
  const auto correlation = [&](const Pose& from) {
    cv::Mat a = city_->photograph(camera, T), b = synthesizer.render(camera, from), score;
    cv::cvtColor(a, a, cv::COLOR_BGR2GRAY);
    cv::cvtColor(b, b, cv::COLOR_BGR2GRAY);
    const cv::Rect middle(20, 20, a.cols - 40, a.rows - 40);
    cv::matchTemplate(a(middle), b(middle), score, cv::TM_CCOEFF_NORMED);
    return score.at<float>(0, 0);
  };
  EXPECT_GT(correlation(T), 0.8);
  Pose aside = T;
  aside.translation().x() += 2;
  EXPECT_LT(correlation(aside), correlation(T) - 0.3);
  const auto cloud = synthesizer.sampleModel(0.5, 100000);
  EXPECT_NEAR(static_cast<double>(cloud.size()), (24 + 16 + 24) * 9 / 0.25, 400);
}

// Needles, as careless triangulations of a city have them: a kilometre by a millimetre, and as long as no city is.
TEST(ViewSynthesizer, NeedlesTakeNoLongerThanTheirAreaDoes) {
  const StreetviewDatabase nothing;
  constexpr std::size_t kMost = 2000;
  const auto begin = std::chrono::steady_clock::now();
  for (const float length : {1e3F, 1e14F}) {
    CityModel needle;
    needle.mesh.vertices = {{0, 0, 0}, {0, 0, length}, {1e-3F, 0, 0}};
    needle.surface = {Surface::kWall};
    needle.building = {0};
    for (int first = 0; first < 3; ++first) {
      needle.mesh.triangles = {{first, (first + 1) % 3, (first + 2) % 3}};
      const BackProjector projector(needle);
      EXPECT_LE(ViewSynthesizer(nothing, projector).sampleModel(0.01, kMost).size(), 4 * kMost) << length << first;
    }
  }
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
}

}  // namespace
}  // namespace streetview_localizer
