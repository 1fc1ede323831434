// Gyro bias and time offset from feature tracks, against the bias and the offset that made the samples.
#include <gtest/gtest.h>

#include <Eigen/LU>

#include "air_ground_common/geometry.h"
#include "air_ground_common/units.h"
#include "mav_vo/clock_search.h"
#include "mav_vo/gyro_alignment.h"
#include "synthetic_flight.h"
#include "visual_frontend/feature_tracker.h"

using namespace mav_vo;
using air_ground_common::expSO3;
using air_ground_common::kDegree;
using synthetic::Pose;

namespace {

constexpr double kPixelNoise = 0.2;     // [px]
constexpr double kBelievedNoise = 0.6;  // as the odometry has it [px]

struct Case {
  Eigen::Vector3d bias = Eigen::Vector3d::Zero();
  double offset = 0;   ///< t_imu - t_image [s]
  double readout = 0;  ///< of a rolling shutter [s]
  double readout_stddev = 0;
  double outliers = 0.05;      ///< share of the tracks
  double noise = kPixelNoise;  ///< of the others, each axis [px]
  double duration = 2.5;       ///< [s]
  bool turn_only = false;      ///< the camera stays at its place
  bool estimate_offset = true;
  Eigen::Vector3d mounting = Eigen::Vector3d::Zero();  ///< rotation vector of R_given_imu [rad]
  double mounting_stddev = 0;
  double wobble = 0.2;  ///< of roll and pitch [rad]
  double period = 9;    ///< of the loop [s]
  double margin = 0.3;  ///< of the samples around the images [s]
  double strange = 0;   ///< so long all tracks turn by another bias: a mirror, a passing lorry [s]
  unsigned seed = 1;
};

/// A bias, an offset and a readout time that are not known.
Case openCase(double duration, unsigned seed) {
  Case run;
  run.readout_stddev = 0.02;
  run.offset = 0.02;
  run.bias = {0.03, 0.08, -0.05};
  run.duration = duration;
  run.seed = seed;
  return run;
}

const Eigen::Vector3d kStrangeBias(-0.05, 0.09, 0.02);  // seen in the strange tracks [rad/s]

/// `samples`: takes those of the IMU.
GyroAlignment align(const Case& run, ImuBuffer* samples = nullptr) {
  synthetic::Flight flight;
  flight.wobble = run.wobble;
  flight.period = run.period;
  const auto camera = synthetic::camera();
  std::mt19937 random(run.seed);
  std::normal_distribution<double> normal(0, run.noise);
  std::uniform_real_distribution<double> unit(0, 1);
  const double begin = 5.0;
  const auto points = synthetic::pointCloud(1200, random);
  ImuBuffer buffer(100);
  for (ImuSample s : flight.imuSamples(begin - run.margin, begin + run.duration + run.margin, 200, ImuNoise{},
                                       {run.bias, Eigen::Vector3d::Zero()}, random)) {
    s.stamp += run.offset;
    buffer.add(visual_frontend::turned(expSO3(-run.mounting), s));
  }
  GyroAlignmentSettings settings;
  if (!run.estimate_offset) settings.time_offset_stddev = 0;
  settings.readout_time_stddev = run.readout_stddev;
  settings.mounting_stddev = run.mounting_stddev;
  GyroAlignment alignment(settings, ImuNoise{}, synthetic::T_imu_camera().linear().transpose(),
                          kBelievedNoise / camera.fx, camera.height);
  for (int i = 0; 0.05 * i < run.duration; ++i) {
    const double t = begin + 0.05 * i;
    Pose T = flight.T_world_imu(t) * synthetic::T_imu_camera();
    if (run.turn_only) T.translation() = Eigen::Vector3d(0, 0, 2.5);
    const Eigen::Matrix3d R_camera_imu = synthetic::T_imu_camera().linear().transpose();
    if (t - begin < run.strange) T.linear() *= expSO3(-R_camera_imu * kStrangeBias * (t - begin - run.strange));
    std::vector<visual_frontend::Feature> features;
    for (std::size_t k = 0; k < points.size(); ++k) {
      auto pixel = camera.project(T.inverse() * points[k]);
      for (int round = 0; pixel && run.readout != 0 && round < 3; ++round) {
        Pose T_row = flight.T_world_imu(t + ((pixel->y() + 0.5) / camera.height - 0.5) * run.readout) *
                     synthetic::T_imu_camera();
        if (run.turn_only) T_row.translation() = Eigen::Vector3d(0, 0, 2.5);
        pixel = camera.project(T_row.inverse() * points[k]);
      }
      if (!pixel || !camera.contains(*pixel, 5)) continue;
      visual_frontend::Feature f;
      f.id = static_cast<visual_frontend::TrackId>(k);
      f.pixel = *pixel + Eigen::Vector2d(normal(random), normal(random));
      if (unit(random) < run.outliers) f.pixel += Eigen::Vector2d(20 * unit(random), -20 * unit(random));
      f.normalized = camera.unproject(f.pixel);
      features.push_back(f);
    }
    alignment.add(t, features, buffer);
  }
  if (samples) *samples = buffer;
  return alignment;
}

std::optional<double> otherTime(const GyroAlignment& alignment, const ImuBuffer& samples) {
  auto search = ClockSearch::begin(alignment, samples);
  if (!search) return std::nullopt;
  while (!search->advance(7)) EXPECT_FALSE(search->found()) << "before all are tried";
  return search->found();
}

TEST(GyroAlignment, FindsLargeBiasesWhileMoving) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    Case run;
    run.seed = seed;
    run.bias = 0.2 * Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
    const GyroAlignment a = align(run);
    EXPECT_LT((a.bias() - run.bias).norm(), 0.005) << "seed " << seed << ", +- " << a.biasStddev();
    EXPECT_LT((a.bias() - run.bias).norm(), 5 * a.biasStddev()) << "seed " << seed;
    EXPECT_LT(a.misfit(), 2.0);
  }
}

// The first pairs are all wrong, and alike: what they said must not stay.
TEST(GyroAlignment, LeavesAWrongBeginning) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    Case run;
    run.seed = seed;
    run.strange = 2.5;
    run.duration = 6.5;
    run.bias = {0.01, -0.02, 0.01};
    const GyroAlignment a = align(run);
    EXPECT_LT((a.bias() - run.bias).norm(), 0.008) << "seed " << seed << ", +- " << a.biasStddev();
  }
}

TEST(GyroAlignment, FindsTheBiasWithoutParallax) {
  Case run;
  run.turn_only = true;
  run.bias = {0.1, -0.15, 0.05};
  const GyroAlignment a = align(run);
  EXPECT_LT((a.bias() - run.bias).norm(), 0.005) << a.biasStddev();
}

TEST(GyroAlignment, FindsTheTimeOffset) {
  for (const double offset : {-0.05, -0.02, 0.0, 0.01, 0.05}) {
    Case run;
    run.offset = offset;
    run.bias = {0.03, 0.08, -0.05};
    run.duration = 4;
    const GyroAlignment a = align(run);
    EXPECT_NEAR(a.timeOffset(), offset, 0.003) << "+- " << a.timeOffsetStddev();
    EXPECT_LT(a.timeOffsetStddev(), 0.004);
    EXPECT_LT(std::abs(a.timeOffset() - offset), 5 * a.timeOffsetStddev() + 2e-4);
    EXPECT_LT((a.bias() - run.bias).norm(), 0.005) << "offset " << offset;
  }
}

TEST(GyroAlignment, FindsClocksThatAreFarApart) {
  for (const double offset : {-0.85, -0.3, -0.14, 0.2, 0.6}) {
    Case run;
    run.offset = offset;
    run.bias = {0.03, 0.08, -0.05};
    run.duration = 4;
    run.margin = 2.5;
    ImuBuffer samples;
    const auto found = otherTime(align(run, &samples), samples);
    ASSERT_TRUE(found) << offset;
    EXPECT_NEAR(*found, offset, 0.01);
  }
}

TEST(GyroAlignment, FindsNoOtherTimeWhereNoneAgreesOrAllDo) {
  Case run;
  run.duration = 4;
  run.margin = 2.5;
  run.offset = 0.3;
  run.mounting = {0, 0, 90 * kDegree};
  ImuBuffer samples;
  EXPECT_FALSE(otherTime(align(run, &samples), samples)) << "other axes";
  run.mounting.setZero();
  run.wobble = 0;
  EXPECT_FALSE(otherTime(align(run, &samples), samples)) << "a steady turn";
  EXPECT_FALSE(ClockSearch::begin(align(run), ImuBuffer(12.0))) << "no samples";
}

TEST(GyroAlignment, FindsTheReadoutTime) {
  for (const double readout : {-0.02, 0.0, 0.01, 0.03}) {
    for (unsigned seed = 1; seed <= 3; ++seed) {
      Case run = openCase(4, seed);
      run.readout = readout;
      const GyroAlignment a = align(run);
      std::printf("readout %5.1f ms: %5.2f +- %.2f ms, offset %5.2f +- %.2f ms\n", 1e3 * readout, 1e3 * a.readoutTime(),
                  1e3 * a.readoutTimeStddev(), 1e3 * a.timeOffset(), 1e3 * a.timeOffsetStddev());
      EXPECT_NEAR(a.readoutTime(), readout, 0.003);
      EXPECT_LT(a.readoutTimeStddev(), 0.004);
      EXPECT_LT(std::abs(a.readoutTime() - readout), 4 * a.readoutTimeStddev());
      EXPECT_NEAR(a.timeOffset(), run.offset, 0.003);
      EXPECT_LT((a.bias() - run.bias).norm(), 0.005);
    }
  }
}

// 7.6 m/s^2 change the flow of every track by several pixels from one image to the next.
TEST(GyroAlignment, FindsTheReadoutTimeInAgileFlight) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    Case run = openCase(4, seed);
    run.readout = 0.02;
    run.period = 2.5;
    const GyroAlignment a = align(run);
    std::printf("readout %5.2f +- %.2f ms\n", 1e3 * a.readoutTime(), 1e3 * a.readoutTimeStddev());
    EXPECT_NEAR(a.readoutTime(), run.readout, 0.004) << "seed " << seed;
    EXPECT_LT(a.readoutTimeStddev(), 0.005);
  }
}

// A short look at blurred tracks leaves the bias open.
TEST(GyroAlignment, TakesABiasThatIsHardlySeenForAUsualOne) {
  double worst = 0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Case run;
    run.seed = seed;
    run.bias = {0.004, -0.006, 0.003};
    run.noise = 1.2;
    run.duration = 1.4;
    const GyroAlignment a = align(run);
    worst = std::max(worst, (a.bias() - run.bias).norm());
  }
  EXPECT_LT(worst, 0.009);  // 0.013 if large ones were as likely
}

// With bias, offset and readout time open as well.
TEST(GyroAlignment, FindsHowTheImuIsTurned) {
  for (const Eigen::Vector3d& degrees :
       {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(1.7, 1.7, 1.7), Eigen::Vector3d(5, 0, 0), Eigen::Vector3d(0, 0, 5),
        Eigen::Vector3d(-4, 5, 3)}) {
    for (unsigned seed = 1; seed <= 3; ++seed) {
      Case run = openCase(5, seed);
      run.readout = 0.01;
      run.mounting = kDegree * degrees;
      run.mounting_stddev = 0.03;
      const GyroAlignment a = align(run);
      const Eigen::Vector3d off = a.mounting() - run.mounting;
      const double sigmas = std::sqrt(off.dot(a.mountingCovariance().inverse() * off));
      std::printf("mounting %4.1f %4.1f %4.1f: off by %.2f degrees, %.1f sigmas\n", degrees.x(), degrees.y(),
                  degrees.z(), off.norm() / kDegree, sigmas);
      EXPECT_LT(off.norm(), 0.8 * kDegree);
      EXPECT_LT(sigmas, 4.0);  // three degrees of freedom, 99.9 %
    }
  }
}

TEST(GyroAlignment, ASteadyTurnDoesNotTellMountingFromBias) {
  Case run;
  run.mounting_stddev = 0.03;
  run.mounting = {0.04, 0.04, 0.04};
  run.wobble = 0;
  const GyroAlignment a = align(run);
  EXPECT_LT(a.mounting().norm(), 0.02);
  EXPECT_GT(std::sqrt(a.mountingCovariance().diagonal().minCoeff()), 0.02);
}

TEST(GyroAlignment, LeavesAGivenOffsetAlone) {
  Case run;
  run.offset = 0.02;
  run.estimate_offset = false;
  const GyroAlignment a = align(run);
  EXPECT_NEAR(a.timeOffset(), 0.0, 1e-6);
}

TEST(GyroAlignment, KnowsNothingWithoutTracks) {
  GyroAlignment a(GyroAlignmentSettings{}, ImuNoise{}, Eigen::Matrix3d::Identity(), 1e-3, 480);
  ImuBuffer buffer(10);
  for (int i = 0; i < 400; ++i) buffer.add({0.005 * i, Eigen::Vector3d::Zero(), Eigen::Vector3d(0, 0, kGravity)});
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(a.add(0.1 * i, {}, buffer));
  EXPECT_GT(a.biasStddev(), 0.1);
}

}  // namespace
