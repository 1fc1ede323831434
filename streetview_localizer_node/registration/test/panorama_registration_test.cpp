// The whole correction on synthetic streets with exact truth. Tuned on seeds 1 to 6; these are others.
#include "streetview_localizer/panorama_registration.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "air_ground_common/linear_algebra.h"
#include "synthetic_street.h"

namespace streetview_localizer {
namespace {

using air_ground_common::Pose;

SyntheticStreetSettings streetOf(int seed) {
  SyntheticStreetSettings settings;
  settings.seed = seed;
  return settings;
}

double horizontalError(const Pose& a, const Pose& b) { return (a.translation() - b.translation()).head<2>().norm(); }

TEST(PanoramaRegistration, CorrectsRawGeotagsAndKnowsHowWell) {
  std::vector<double> position, orientation, raw;
  double nees = 0;
  int accepted = 0, count = 0;
  for (int seed = 201; seed <= 203; ++seed) {
    const SyntheticStreet street(streetOf(seed));
    const PanoramaRegistrar registrar(street.model());
    std::mt19937_64 random(seed);
    for (const double along : {20.0, 60.0, 100.0}) {
      const Pose truth = street.panoramaPose(along, &random), geotag = drawGeotag(truth, &random);
      const RegistrationResult result = registrar.registerPanorama(street.render(truth), geotag);
      raw.push_back((geotag.translation() - truth.translation()).norm());
      ++count;
      if (!result.accepted) {
        EXPECT_FALSE(result.reason.empty());
        EXPECT_TRUE(result.T_world_panorama.isApprox(geotag));
        continue;
      }
      ++accepted;
      EXPECT_EQ(result.reason, "");
      position.push_back((result.T_world_panorama.translation() - truth.translation()).norm());
      orientation.push_back(air_ground_common::rotationAngle(result.T_world_panorama.linear(), truth.linear()));
      air_ground_common::Vector6d error;
      error.head<3>() = truth.translation() - result.T_world_panorama.translation();
      error.tail<3>() = air_ground_common::logSO3(truth.linear() * result.T_world_panorama.linear().transpose());
      nees += air_ground_common::squaredMahalanobis(error, result.covariance);
      EXPECT_NEAR(result.position_stddev, std::sqrt(result.covariance.topLeftCorner<3, 3>().trace() / 3), 1e-12);
      EXPECT_LT(position.back(), 0.6) << "seed " << seed << " at " << along;
      EXPECT_LT(orientation.back(), 0.0175) << "seed " << seed << " at " << along;
    }
  }
  EXPECT_GE(accepted, count - 1);
  std::sort(position.begin(), position.end());
  std::sort(orientation.begin(), orientation.end());
  std::sort(raw.begin(), raw.end());
  EXPECT_GT(raw[raw.size() / 2], 2.0);
  EXPECT_LT(position[position.size() / 2], 0.2);
  EXPECT_LT(orientation[orientation.size() / 2], 0.25 * M_PI / 180);
  // Six degrees of freedom; panoramas of one street share its model's errors, so that the mean of 9 scatters widely.
  EXPECT_GT(nees / accepted, 1.0);
  EXPECT_LT(nees / accepted, 11.0);
}

TEST(PanoramaRegistration, AHeadingOfTenDegreesIsFoundWithItsSign) {
  const SyntheticStreet street(streetOf(211));
  const PanoramaRegistrar registrar(street.model());
  std::mt19937_64 random(1);
  Pose truth = street.panoramaPose(60, &random);
  truth.linear() = Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()).matrix();  // level: columns are azimuths
  const cv::Mat image = street.render(truth);
  // Turned left by a sixteenth of a circle, the camera sees all of it a sixteenth of the columns farther right.
  const int columns = image.cols / 16;
  cv::Mat turned(image.size(), image.type());
  image.colRange(0, image.cols - columns).copyTo(turned.colRange(columns, image.cols));
  image.colRange(image.cols - columns, image.cols).copyTo(turned.colRange(0, columns));
  const double angle = 2 * M_PI / 16;
  Pose geotag = truth;
  geotag.translation() += Eigen::Vector3d(1.5, -2, 0.4);
  geotag.linear() = Eigen::AngleAxisd(0.4 + angle - 0.04, Eigen::Vector3d::UnitZ()).matrix();
  Pose straight_geotag = geotag;
  straight_geotag.linear() = truth.linear();
  const RegistrationResult straight = registrar.registerPanorama(image, straight_geotag);
  const RegistrationResult result = registrar.registerPanorama(turned, geotag);
  ASSERT_TRUE(straight.accepted) << straight.reason;
  ASSERT_TRUE(result.accepted) << result.reason;
  EXPECT_NEAR(air_ground_common::yawOf(straight.T_world_panorama.linear()), 0.4, 0.006);
  EXPECT_NEAR(air_ground_common::yawOf(result.T_world_panorama.linear()), 0.4 + angle, 0.006);
  EXPECT_LT(horizontalError(result.T_world_panorama, truth), 0.25);
}

TEST(PanoramaRegistration, ATiltIsFoundWithItsSign) {
  const SyntheticStreet street(streetOf(212));
  const PanoramaRegistrar registrar(street.model());
  std::mt19937_64 random(1);
  const Pose level = street.panoramaPose(60, &random);
  for (const Eigen::Vector3d& tilt : {Eigen::Vector3d(0.05, 0, 0), Eigen::Vector3d(0, -0.05, 0)}) {
    Pose truth = level;
    truth.linear() = level.linear() * air_ground_common::expSO3(tilt);
    Pose geotag = level;  // does not know the tilt
    geotag.translation() += Eigen::Vector3d(-2, 1, 0);
    const RegistrationResult result = registrar.registerPanorama(street.render(truth), geotag);
    ASSERT_TRUE(result.accepted) << result.reason;
    EXPECT_LT(air_ground_common::rotationAngle(result.T_world_panorama.linear(), truth.linear()), 0.007);
    EXPECT_LT(horizontalError(result.T_world_panorama, truth), 0.3);
  }
}

// Compasses of telephones and action cameras are off by tens of degrees, their places by 10 to 15 m.
TEST(PanoramaRegistration, GeotagsAreBelievedAsFarAsTheSettingsSay) {
  const SyntheticStreet street(streetOf(213));
  std::mt19937_64 random(3);
  const Pose truth = street.panoramaPose(60, &random);
  const cv::Mat image = street.render(truth);
  const auto turnedBy = [&](double degrees, double along) {
    Pose geotag = truth;
    geotag.translation() += along * truth.linear().col(0);
    geotag.linear() = Eigen::AngleAxisd(degrees * M_PI / 180, Eigen::Vector3d::UnitZ()) * truth.linear();
    return geotag;
  };
  const auto settingsOf = [](double yaw, double yaw_stddev, double radius) {
    RegistrationSettings settings;
    settings.search_yaw = yaw, settings.heading_stddev = yaw_stddev;
    settings.search_radius = radius, settings.geotag_stddev = radius / 3;
    return settings;
  };
  const auto expectRight = [&](const RegistrationResult& result, const char* what) {
    ASSERT_TRUE(result.accepted) << what << ": " << result.reason;
    EXPECT_LT(horizontalError(result.T_world_panorama, truth), 0.4) << what;
    EXPECT_LT(air_ground_common::rotationAngle(result.T_world_panorama.linear(), truth.linear()), 0.01) << what;
  };
  const PanoramaRegistrar usual(street.model());
  const RegistrationResult refused = usual.registerPanorama(image, turnedBy(15, 2));
  EXPECT_FALSE(refused.accepted);
  EXPECT_NE(
      refused.reason.find("may be wrong by more than the search: --search-radius (now 9 m), --search-yaw (now 6.88"),
      std::string::npos)
      << refused.reason;
  expectRight(PanoramaRegistrar(street.model(), settingsOf(0.5, 0.15, 9)).registerPanorama(image, turnedBy(15, 2)),
              "15");
  expectRight(PanoramaRegistrar(street.model(), settingsOf(0.12, 0.035, 18)).registerPanorama(image, turnedBy(1, 13)),
              "far");
  const PanoramaRegistrar all_around(street.model(), settingsOf(M_PI, 0.9, 9));
  expectRight(all_around.registerPanorama(image, turnedBy(90, -3)), "90");
  expectRight(usual.registerPanorama(image, turnedBy(170, 2), /*heading_known=*/false), "no heading");
  // What is left of a geotag is as good as was said.
  const cv::Mat blank(image.size(), image.type(), cv::Scalar(200, 200, 200));
  EXPECT_GT(all_around.registerPanorama(blank, truth).orientation_stddev, 0.5);
  EXPECT_NEAR(usual.registerPanorama(blank, truth, false).covariance(5, 5), M_PI * M_PI / 3, 1e-9);
}

TEST(PanoramaRegistration, CorrectsPhotographsOrRefusesThem) {
  air_ground_common::CameraModel camera;
  camera.width = 1024, camera.height = 768;
  camera.fx = camera.fy = 512 / std::tan(0.5 * 75 * M_PI / 180);
  camera.cx = 511.5, camera.cy = 383.5, camera.k1 = -0.02;
  int accepted = 0;
  for (int seed = 251; seed <= 252; ++seed) {
    const SyntheticStreet street(streetOf(seed));
    const PanoramaRegistrar registrar(street.model());
    std::mt19937_64 random(seed);
    for (const double yaw : {0.0, M_PI / 4}) {
      Pose truth = street.panoramaPose(60, &random);
      truth.linear() = truth.linear() * air_ground_common::yawPose(yaw, Eigen::Vector3d::Zero()).linear() *
                       air_ground_common::expSO3({0, -0.2, 0});  // a little upwards
      const Pose geotag = drawGeotag(truth, &random);
      const cv::Mat image = street.photograph(camera, truth);
      const RegistrationResult result = registrar.registerPhotograph(image, camera, geotag);
      if (accepted == 0) {
        cv::Mat mirrored;
        cv::flip(image, mirrored, 1);
        EXPECT_FALSE(registrar.registerPhotograph(mirrored, camera, geotag).accepted) << seed;
      }
      if (!result.accepted) {
        EXPECT_FALSE(result.reason.empty());
        EXPECT_TRUE(result.T_world_panorama.isApprox(geotag));
        continue;
      }
      ++accepted;
      EXPECT_LT((result.T_world_panorama.translation() - truth.translation()).norm(), 1.0) << seed << " " << yaw;
      EXPECT_LT(air_ground_common::rotationAngle(result.T_world_panorama.linear(), truth.linear()), 0.026)
          << seed << " " << yaw;
      EXPECT_LT(result.position_stddev, 0.5);
    }
  }
  EXPECT_GE(accepted, 2);
}

TEST(PanoramaRegistration, RefusesWhatIsNotThere) {
  const SyntheticStreet street(streetOf(221)), other(streetOf(222));
  const PanoramaRegistrar registrar(street.model());
  std::mt19937_64 random(5);
  const Pose truth = street.panoramaPose(60, &random), geotag = drawGeotag(truth, &random);
  const cv::Mat image = street.render(truth);
  cv::Mat mirrored, noise(image.size(), image.type());
  cv::flip(image, mirrored, 1);
  cv::randu(noise, 0, 255);
  const cv::Mat blank(image.size(), image.type(), cv::Scalar(200, 200, 200)),
      black(image.size(), image.type(), cv::Scalar::all(0));
  Pose far = geotag;
  far.translation() += Eigen::Vector3d(5000, 0, 0);
  Pose displaced = truth;  // beyond the search
  displaced.translation() += 30 * truth.linear().col(0);
  const std::pair<const char*, RegistrationResult> results[] = {
      {"other street", registrar.registerPanorama(other.render(other.panoramaPose(60, &random)), geotag)},
      {"mirrored", registrar.registerPanorama(mirrored, geotag)},
      {"noise", registrar.registerPanorama(noise, geotag)},
      {"blank", registrar.registerPanorama(blank, geotag)},
      {"black", registrar.registerPanorama(black, geotag)},
      {"far away", registrar.registerPanorama(image, far)},
      {"displaced", registrar.registerPanorama(image, displaced)},
  };
  for (const auto& [name, result] : results) {
    EXPECT_FALSE(result.accepted) << name;
    EXPECT_FALSE(result.reason.empty()) << name;
    EXPECT_EQ(result.reason.find('\n'), std::string::npos) << name;
    EXPECT_GT(result.position_stddev, 1) << name;
  }
  EXPECT_TRUE(results[0].second.T_world_panorama.isApprox(geotag));
  EXPECT_TRUE(registrar.registerPanorama(image, geotag).accepted);
}

// Whoever searches wider meets more that looks alike.
TEST(PanoramaRegistration, AWideSearchRefusesWhatIsNotThereToo) {
  RegistrationSettings settings;
  settings.search_yaw = M_PI, settings.heading_stddev = 0.9;
  settings.search_radius = 15, settings.geotag_stddev = 5;
  const SyntheticStreet street(streetOf(221));
  const PanoramaRegistrar registrar(street.model(), settings);
  std::mt19937_64 random(5);
  const Pose truth = street.panoramaPose(60, &random), geotag = drawGeotag(truth, &random);
  cv::Mat mirrored;
  cv::flip(street.render(truth), mirrored, 1);
  EXPECT_FALSE(registrar.registerPanorama(mirrored, geotag).accepted);
  for (int seed = 222; seed <= 225; ++seed) {
    const SyntheticStreet other(streetOf(seed));
    EXPECT_FALSE(registrar.registerPanorama(other.render(other.panoramaPose(60, &random)), geotag).accepted) << seed;
  }
  const RegistrationResult right = registrar.registerPanorama(street.render(truth), geotag);
  ASSERT_TRUE(right.accepted) << right.reason;
  EXPECT_LT(horizontalError(right.T_world_panorama, truth), 0.4);
}

TEST(PanoramaRegistration, AListKeepsItsOrderAndSurvivesAMissingFile) {
  const SyntheticStreet street(streetOf(231));
  const PanoramaRegistrar registrar(street.model());
  std::mt19937_64 random(7);
  std::vector<RegistrationInput> inputs(3);
  std::vector<Pose> truths;
  for (int i = 0; i < 3; ++i) {
    truths.push_back(street.panoramaPose(40 + 12 * i, &random));
    inputs[i].T_world_geotag = drawGeotag(truths[i], &random);
    inputs[i].load = [image = street.render(truths[i])] { return image; };
  }
  inputs[1].load = []() -> cv::Mat { throw std::runtime_error("pano_1.jpg: no such file"); };
  std::size_t calls = 0;
  const auto results = registrar.registerPanoramas(inputs, [&](std::size_t) { ++calls; });
  ASSERT_EQ(results.size(), 3u);
  EXPECT_EQ(calls, 3u);
  EXPECT_FALSE(results[1].accepted);
  EXPECT_EQ(results[1].reason, "pano_1.jpg: no such file");
  for (const int i : {0, 2}) {
    ASSERT_TRUE(results[i].accepted) << results[i].reason;
    EXPECT_LT(horizontalError(results[i].T_world_panorama, truths[i]), 0.4);
  }
}

TEST(PanoramaRegistration, BadInputIsNamed) {
  const SyntheticStreet street(streetOf(241));
  const PanoramaRegistrar registrar(street.model());
  EXPECT_THROW(registrar.registerPanorama(cv::Mat(), Pose::Identity()), std::invalid_argument);
  EXPECT_THROW(registrar.registerPanorama(cv::Mat(500, 500, CV_8UC3), Pose::Identity()), std::invalid_argument);
  EXPECT_THROW(registrar.registerPanorama(cv::Mat(256, 512, CV_8U), Pose::Identity()), std::invalid_argument);
  Pose broken = Pose::Identity();
  broken.translation().x() = std::nan("");
  EXPECT_THROW(registrar.registerPanorama(cv::Mat(256, 512, CV_8UC3, cv::Scalar::all(9)), broken),
               std::invalid_argument);
  EXPECT_THROW(PanoramaRegistrar(CityModel{}), std::invalid_argument);
  CityModel uneven = street.model();
  uneven.surface.pop_back();
  EXPECT_THROW(PanoramaRegistrar{uneven}, std::invalid_argument);
  RegistrationSettings settings;
  settings.model_lateral_stddev = -1;
  try {
    PanoramaRegistrar(street.model(), settings);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("model_lateral_stddev"), std::string::npos);
  }
}

}  // namespace
}  // namespace streetview_localizer
