// What IMU and tracks tell of each other without a map, against the bias, offset and readout time that made them.
#include "../src/imu_alignment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "synthetic_flight.h"
#include "visual_frontend/feature_tracker.h"

namespace mav_vo {
namespace {

using air_ground_common::expSO3;
using air_ground_common::rotationAngle;
using visual_frontend::Feature;

const Eigen::Matrix3d kCameraImu = synthetic::T_imu_camera().linear().transpose();  // R_camera_imu
/// Another R_camera_imu: the flight's is its own inverse.
const Eigen::Matrix3d kAskew = expSO3({0.4, -0.7, 1.1});
const Eigen::Vector3d kRate(0.2, -0.1, 0.4);     // of the IMU, own axes [rad/s]
const Eigen::Vector3d kBias(0.02, -0.01, 0.03);  // of its gyro [rad/s]

ImuAlignment make(const Eigen::Matrix3d& R_camera_imu = kCameraImu, const OdometrySettings& settings = {}) {
  const auto camera = synthetic::camera();
  return {settings, R_camera_imu, settings.pixel_sigma / camera.fx, camera.height};
}

/// An IMU that turns at a rate, or rests, leaning by 0.1 rad, from 0 to `end` [s].
void turn(ImuAlignment& imu, const Eigen::Vector3d& rate, double end) {
  for (int i = 0; i <= 200 * end; ++i)
    imu.add({0.005 * i, rate + kBias, kGravity * Eigen::Vector3d(std::sin(0.1), 0, std::cos(0.1))});
}

/// Tracks that have moved by (dx, 0) [px] since the image before.
std::vector<Feature> tracks(double dx) {
  std::vector<Feature> features(30);
  for (std::size_t i = 0; i < features.size(); ++i) {
    features[i].id = static_cast<visual_frontend::TrackId>(i);
    features[i].pixel = features[i].previous_pixel = {20.0 * static_cast<double>(i), 200};
    features[i].pixel.x() += dx;
    features[i].age = 1;
  }
  return features;
}

bool rests(ImuAlignment& imu, double dx, bool metric) {
  bool any = false;
  for (int i = 0; i <= 20; ++i) any = imu.detectStandstill(0.05 * i, tracks(dx), metric) || any;
  return any;
}

TEST(ImuAlignment, TurnsAsTheCameraDoes) {
  ImuAlignment imu = make(kAskew);
  turn(imu, kRate, 1);
  const auto turned = imu.cameraTurn(0.2, 0.7, kBias);
  ASSERT_TRUE(turned);
  const Eigen::Matrix3d R_a_b = expSO3(Eigen::Vector3d(0.5 * kAskew * kRate));
  EXPECT_LT(rotationAngle(turned->R_a_b, R_a_b), 1e-6);
  EXPECT_GT(rotationAngle(turned->R_a_b, R_a_b.transpose()), 0.2);
  EXPECT_FALSE(imu.cameraTurn(0.8, 1.2, kBias)) << "there are no samples";
}

TEST(ImuAlignment, FoldedVibrationIsNoiseOfTheMotion) {
  const auto stddev = [](double rate) {  // of the velocity after a second [m/s]
    ImuAlignment imu = make();
    for (int i = 0; i <= 3 * rate; ++i) {
      const double t = i / rate, phase = 2 * M_PI * (75 * t + 7.5 * std::sin(2 * t));  // 60 to 90 Hz
      imu.add({t, kBias, Eigen::Vector3d(1.4 * std::sin(phase), 1.4 * std::cos(phase), kGravity)});
    }
    const auto motion = imu.motion(1.5, 2.5, ImuBias{kBias, Eigen::Vector3d::Zero()});
    return motion ? std::sqrt(motion->covariance()(3, 3)) : -1.0;
  };
  const double given = OdometrySettings{}.imu_noise.accel_density;
  EXPECT_NEAR(stddev(500), given, 0.2 * given) << "what is sampled well averages out";
  EXPECT_GT(stddev(66), 3 * given);
  EXPECT_LT(stddev(66), 20 * given);
}

TEST(ImuAlignment, ARestTellsBiasAndUp) {
  ImuAlignment imu = make();
  turn(imu, Eigen::Vector3d::Zero(), 1);
  EXPECT_FALSE(rests(imu, 2, false)) << "the image moves";
  EXPECT_FALSE(imu.up());
  EXPECT_FALSE(rests(imu, 0, true)) << "the metric map knows it better";
  EXPECT_LT(imu.gyroBias().norm(), 1e-9);
  ASSERT_TRUE(rests(imu, 0, false));
  EXPECT_LT((imu.gyroBias() - kBias).norm(), 1e-6);
  EXPECT_LT(imu.gyroBiasStddev(), 0.0011);
  ASSERT_TRUE(imu.up());
  EXPECT_LT((imu.up()->up_imu - Eigen::Vector3d(std::sin(0.1), 0, std::cos(0.1))).norm(), 1e-9);
  imu.reset();
  EXPECT_FALSE(imu.up());
  EXPECT_LT(imu.gyroBias().norm(), 1e-9);
}

TEST(ImuAlignment, UpTurnsWithTheCameraUntilAGap) {
  ImuAlignment imu = make(kAskew);
  imu.setUp(Eigen::Vector3d::UnitZ());
  const double sigma = imu.up()->sigma;
  imu.carryUp(kAskew * expSO3({0.3, 0, 0}) * kAskew.transpose(), 0.1);
  // The body's left side rises: up is seen farther to the left.
  EXPECT_LT((imu.up()->up_imu - Eigen::Vector3d(0, std::sin(0.3), std::cos(0.3))).norm(), 1e-9);
  EXPECT_NEAR(imu.up()->sigma, sigma + 0.1 * imu.gyroBiasStddev(), 1e-9);
  imu.carryUp(std::nullopt, 0.1);
  EXPECT_FALSE(imu.up());
}

TEST(ImuAlignment, AnImuThatHasFallenSilentHasNoAttitude) {
  ImuAlignment imu = make();
  EXPECT_FALSE(imu.attitude(0));
  turn(imu, Eigen::Vector3d::Zero(), 1);
  ASSERT_TRUE(imu.attitude(1.4));
  EXPECT_LT((imu.attitude(1.4)->up_imu - Eigen::Vector3d(std::sin(0.1), 0, std::cos(0.1))).norm(), 1e-6);
  EXPECT_FALSE(imu.attitude(1.6));
}

TEST(ImuAlignment, KeepsOnlyABetterBias) {
  ImuAlignment imu = make();
  imu.keepBias({0, 0, 0.1}, 2 * imu.gyroBiasStddev());
  EXPECT_LT(imu.gyroBias().norm(), 1e-9);
  imu.keepBias(kBias, 0.01);
  EXPECT_LT((imu.gyroBias() - kBias).norm(), 1e-6);
  EXPECT_NEAR(imu.gyroBiasStddev(), 0.01, 1e-4);
}

/// What a swinging flight shows of the floor, each row where the camera is when it is read.
struct Swing {
  /// `R_given_imu`: of the IMU's axes.
  explicit Swing(double offset = 0, double readout = 0,
                 const Eigen::Matrix3d& R_given_imu = Eigen::Matrix3d::Identity(), double wobble = 0.2)
      : readout_time(readout) {
    flight.wobble = wobble;
    for (ImuSample s : flight.imuSamples(kBegin - 0.3, kBegin + kLong + 0.3, 200, ImuNoise{}, {kBias, {}}, random)) {
      s.stamp += offset;
      samples.push_back(visual_frontend::turned(R_given_imu.transpose(), s));
    }
    points = synthetic::pointCloud(600, random);
  }
  std::vector<Feature> at(double t) const {
    const auto camera = synthetic::camera();
    std::vector<Feature> features;
    for (std::size_t k = 0; k < points.size(); ++k) {
      std::optional<Eigen::Vector2d> pixel(Eigen::Vector2d(camera.cx, camera.cy));
      for (int round = 0; pixel && round < 4; ++round) {
        const double row = t + ((pixel->y() + 0.5) / camera.height - 0.5) * readout_time;
        pixel = camera.project((flight.T_world_imu(row) * synthetic::T_imu_camera()).inverse() * points[k]);
      }
      if (!pixel || !camera.contains(*pixel, 5)) continue;
      Feature f;
      f.id = static_cast<visual_frontend::TrackId>(k);
      f.pixel = *pixel;
      f.normalized = camera.unproject(*pixel);
      features.push_back(f);
    }
    return features;
  }
  /// Feeds `imu` with it as the odometry does; `each` image in between.
  template <class Each>
  void show(ImuAlignment& imu, const Each& each) const {
    for (const ImuSample& s : samples) imu.add(s);
    for (double t = kBegin; t < kBegin + kLong; t += 0.05) each(t, at(t));
  }

  static constexpr double kBegin = 5, kLong = 6;  // [s]
  synthetic::Flight flight;
  double readout_time;
  std::mt19937 random{1};
  std::vector<ImuSample> samples;
  std::vector<Eigen::Vector3d> points;
};

TEST(ImuAlignment, AdoptsASureTimeOffset) {
  ImuAlignment imu = make();
  int adopted = 0;
  Swing(0.02).show(imu, [&](double t, const std::vector<Feature>& features) {
    if (imu.alignGyro(t, features, false)) adopted += imu.adoptTimeOffset();
  });
  EXPECT_GT(adopted, 0);
  EXPECT_NEAR(imu.timeOffset(), 0.02, 0.002);
  EXPECT_NEAR(imu.imuStamp(7), 7.02, 0.002);
  EXPECT_LT((imu.gyroBias() - kBias).norm(), 0.005);
  EXPECT_EQ(imu.problem() + imu.clockProblem(), "");
  EXPECT_FALSE(imu.adoptTimeOffset()) << "it is in use";
}

/// A camera and an IMU at rest before take-off: tracks with the noise of pixels, a gyro with that of idling rotors, per
/// axis [rad/s].
void standStill(ImuAlignment& imu, double duration, double gyro_noise) {
  const auto camera = synthetic::camera();
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  const auto vector = [&](double sigma) {
    return Eigen::Vector3d(sigma * normal(random), sigma * normal(random), sigma * normal(random));
  };
  std::vector<Feature> features(120);
  std::vector<Eigen::Vector2d> places;
  for (std::size_t i = 0; i < features.size(); ++i)
    places.emplace_back(30.0 + camera.width / 13.0 * (i % 12), 30.0 + camera.height / 11.0 * (i / 12));
  int samples = 0;
  for (int image = 0; 0.05 * image < duration; ++image) {
    const double t = 0.05 * image;
    for (; 0.005 * samples < t + 0.1; ++samples)
      imu.add({0.005 * samples, kBias + vector(gyro_noise), Eigen::Vector3d(0, 0, kGravity) + vector(0.05)});
    for (std::size_t i = 0; i < features.size(); ++i) {
      Feature& f = features[i];
      f.id = static_cast<visual_frontend::TrackId>(i);
      f.previous_pixel = image > 0 ? f.pixel : places[i];
      f.pixel = places[i] + vector(0.1).head<2>();
      f.normalized = camera.unproject(f.pixel);
      f.age = image;
    }
    imu.detectStandstill(t, features, false);
    imu.alignShutter(t, features, 0);
    imu.alignMounting(t, features);
    if (imu.alignGyro(t, features, false)) imu.adoptTimeOffset();
  }
}

// What neither turns nor moves tells neither how far the clocks are apart nor when which row is read, however long.
TEST(ImuAlignment, RestTellsNothingOfClocksShutterAndMounting) {
  const OdometrySettings settings;
  for (const double gyro_noise : {0.001, 0.008, 0.03}) {  // the last one does not count as rest
    ImuAlignment imu = make();
    standStill(imu, 25, gyro_noise);
    EXPECT_GT(imu.timeOffsetStddev(), 0.4 * settings.gyro_alignment.time_offset_stddev) << gyro_noise;
    EXPECT_LT((imu.gyroBias() - kBias).norm(), 0.004) << gyro_noise;
    if (gyro_noise > 0.01) continue;
    EXPECT_GT(imu.readoutTimeStddev(), 0.7 * settings.readout_time_stddev) << gyro_noise;
    EXPECT_GT(imu.mountingStddev(), 0.9 * settings.imu_rotation_stddev) << gyro_noise;
  }
}

// Images stamped on arrival, by radio: none of the offsets that are looked for explains them.
TEST(ImuAlignment, ClocksTooFarApartTellNoScale) {
  for (const double offset : {0.25, -0.3}) {
    ImuAlignment imu = make();
    EXPECT_NE(imu.clockProblem(), "") << "nothing is known at first";
    Swing(offset).show(imu, [&](double t, const std::vector<Feature>& features) {
      if (imu.alignGyro(t, features, false)) imu.adoptTimeOffset();
    });
    EXPECT_NE(imu.problem() + imu.clockProblem(), "")
        << offset << ": " << imu.timeOffset() << " +- " << imu.timeOffsetStddev();
  }
}

TEST(ImuAlignment, FindsAReadoutTime) {
  ImuAlignment imu = make();
  double in_use = 0;
  std::optional<double> first;
  Swing(0, 0.025).show(imu, [&](double t, const std::vector<Feature>& features) {
    const auto found = imu.alignShutter(t, features, in_use);
    if (!found) return;
    if (!first) first = found;
    in_use = *found;
  });
  ASSERT_TRUE(first);
  EXPECT_NEAR(*first, 0.025, 0.01) << "even a first one, not known well, is better than none";
  EXPECT_NEAR(in_use, 0.025, 0.003);
}

// Outside, all is in the axes that were given.
TEST(ImuAlignment, AdoptsAMountingThatIsOff) {
  const Eigen::Matrix3d R_given_imu = expSO3({0.05, -0.03, 0.04});
  ImuAlignment imu = make();
  Eigen::Matrix3d turned = Eigen::Matrix3d::Identity();
  const Swing swing(0.01, 0, R_given_imu);
  swing.show(imu, [&](double t, const std::vector<Feature>& features) {
    imu.alignShutter(t, features, 0);
    if (const auto turn = imu.alignMounting(t, features)) turned = *turn * turned;
    if (imu.alignGyro(t, features, false)) imu.adoptTimeOffset();
  });
  EXPECT_LT(rotationAngle(imu.mounting(), R_given_imu), 3 * imu.mountingStddev());
  EXPECT_LT(imu.mountingStddev(), 0.01);
  EXPECT_LT(rotationAngle(imu.mounting(), turned), 1e-9);
  EXPECT_EQ(imu.problem(), "");
  EXPECT_LT((imu.gyroBias() - kBias).norm(), 0.006);
  const double t = Swing::kBegin + 4;
  const auto camera = [&](double at) { return swing.flight.T_world_imu(at) * synthetic::T_imu_camera(); };
  const auto turn = imu.cameraTurn(t, t + 0.4, imu.gyroBias());
  ASSERT_TRUE(turn);
  EXPECT_LT(rotationAngle(turn->R_a_b, camera(t).linear().transpose() * camera(t + 0.4).linear()), 0.004);
  ImuAlignment exact = make();
  for (const ImuSample& s : Swing().samples) exact.add(s);
  const ImuBias bias{kBias, Eigen::Vector3d::Zero()};
  const auto motion = imu.motion(t, t + 0.4, bias), truth = exact.motion(t, t + 0.4, bias);
  ASSERT_TRUE(motion && truth);
  EXPECT_LT((motion->velocity() - truth->velocity()).norm(), 0.012 * kGravity * 0.4 + 0.05);
  imu.reset();
  EXPECT_TRUE(imu.mounting().isIdentity());
}

// Turns about other axes than the IMU's look late, too.
TEST(ImuAlignment, AMountingThatIsOffSetsNoClockWrong) {
  for (const Eigen::Vector3d& turn :
       {Eigen::Vector3d(0.03, 0, 0), Eigen::Vector3d(0, 0.03, 0), Eigen::Vector3d(0.02, -0.02, 0.02)}) {
    ImuAlignment imu = make();
    double worst = 0, adopted = -1;
    Swing(0.01, 0, expSO3(turn)).show(imu, [&](double t, const std::vector<Feature>& features) {
      imu.alignShutter(t, features, 0);
      if (imu.alignMounting(t, features) && adopted < 0) adopted = t - Swing::kBegin;
      if (imu.alignGyro(t, features, false) && imu.adoptTimeOffset())
        worst = std::max(worst, std::abs(imu.timeOffset() - 0.01));
    });
    std::printf("mounting adopted after %.1f s, offset wrong by %.1f ms at most\n", adopted, 1e3 * worst);
    EXPECT_LT(worst, 0.001);
    EXPECT_GT(adopted, 2) << "a first figure wanders";
  }
}

TEST(ImuAlignment, FoldedVibrationTellsNoMounting) {
  Swing swing(0, 0, expSO3({0.05, -0.03, 0.04}));
  std::normal_distribution<double> vibration(0, 1);  // white: of any frequency [m/s^2]
  for (ImuSample& s : swing.samples)
    for (int axis = 0; axis < 3; ++axis) s.specific_force(axis) += vibration(swing.random);
  ImuAlignment imu = make();
  swing.show(imu, [&](double t, const std::vector<Feature>& features) {
    EXPECT_FALSE(imu.alignMounting(t, features));
    imu.alignGyro(t, features, false);
  });
  EXPECT_TRUE(imu.mounting().isIdentity());
}

TEST(ImuAlignment, KeepsARightMounting) {
  ImuAlignment imu = make();
  Swing().show(imu, [&](double t, const std::vector<Feature>& features) {
    imu.alignShutter(t, features, 0);
    EXPECT_FALSE(imu.alignMounting(t, features)) << t;
    imu.alignGyro(t, features, false);
  });
  EXPECT_LT(imu.mountingStddev(), 0.01);
}

TEST(ImuAlignment, AGyroThatTurnsOtherwiseIsAProblem) {
  ImuAlignment imu = make(Eigen::Matrix3d::Identity());
  Swing().show(imu, [&](double t, const std::vector<Feature>& features) { imu.alignGyro(t, features, false); });
  EXPECT_NE(imu.problem(), "");
}

// A quarter turn is no error of some degrees: named, not believed.
TEST(ImuAlignment, NamesAxesThatWereTakenForEachOther) {
  Eigen::Matrix3d R_given_imu;
  R_given_imu << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  ImuAlignment imu = make();
  Swing(0, 0, R_given_imu, 0.5).show(imu, [&](double t, const std::vector<Feature>& features) {
    imu.alignShutter(t, features, 0);
    EXPECT_FALSE(imu.alignMounting(t, features)) << t;
    imu.alignGyro(t, features, false);
  });
  EXPECT_NE(imu.problem().find("seem to be y, -x and z of its frame"), std::string::npos)
      << "'" << imu.problem() << "', bias " << imu.gyroBias().transpose();
}

// What a driver that flips its images looks like to the gyro.
TEST(ImuAlignment, NamesImagesThatMayBeFlipped) {
  const std::pair<Eigen::Vector3d, const char*> turned[] = {
      {{1, -1, -1}, "mirrored left to right"}, {{-1, 1, -1}, "mirrored top to bottom"}, {{-1, -1, 1}, ""}};
  for (const auto& [half_turn, said] : turned) {
    const Eigen::Matrix3d R_given_imu = kCameraImu.transpose() * half_turn.asDiagonal() * kCameraImu;
    ImuAlignment imu = make();
    Swing(0, 0, R_given_imu, 0.5).show(imu, [&](double t, const std::vector<Feature>& features) {
      imu.alignShutter(t, features, 0);
      imu.alignMounting(t, features);
      imu.alignGyro(t, features, false);
    });
    EXPECT_NE(imu.problem().find("seem to be"), std::string::npos) << imu.problem();
    EXPECT_EQ(imu.problem().find("mirrored") != std::string::npos, *said != 0) << imu.problem();
    EXPECT_NE(imu.problem().find(said), std::string::npos) << imu.problem();
  }
}

}  // namespace
}  // namespace mav_vo
