#include <gtest/gtest.h>

#include <functional>

#include "air_ground_common/linear_algebra.h"
#include "mav_vo/scale_filter.h"
#include "synthetic_flight.h"

using namespace mav_vo;

namespace {

// The camera in a map of its own origin, attitude and unit; `error` in that unit.
ScaleMeasurement seenAt(const synthetic::Flight& flight, double t, const Eigen::Matrix3d& R_map_world,
                        const Eigen::Vector3d& origin, double true_scale, const Eigen::Vector3d& error) {
  ScaleMeasurement m;
  m.p_imu_camera = synthetic::T_imu_camera().translation();
  m.p_map_camera = R_map_world * (flight.T_world_imu(t) * m.p_imu_camera - origin) / true_scale + error;
  m.R_map_imu = R_map_world * flight.T_world_imu(t).linear();
  m.scene_distance = 1.0 / true_scale;
  return m;
}

Preintegration motionBetween(double from, double to, const ImuBuffer& buffer, const ImuNoise& noise = {},
                             const ImuBias& bias = {}) {
  Preintegration motion(noise, bias);
  motion.integrate(samplesBetween(buffer, from, to));
  return motion;
}

struct Outcome {
  double start_time = -1;  ///< when the filter started [s after the first frame]
  double ratio = 0;        ///< estimated over true scale at the end
  double relative_stddev = 0;
  double nees = 0;        ///< squared error of the log scale over its variance
  double nees_full = 0;   ///< of position, velocity, accel bias and scale (10 degrees of freedom)
  double early_nees = 0;  ///< of the log scale one second after the start
};

/// `wind`: a constant velocity in the world, of which no IMU knows [m/s].
Outcome simulate(unsigned seed, double true_scale, double duration, double visual_stddev = 0.002,
                 const Eigen::Vector3d& wind = Eigen::Vector3d::Zero()) {
  const synthetic::Flight flight;
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const auto vector = [&] { return Eigen::Vector3d(normal(random), normal(random), normal(random)); };
  const ImuNoise noise;
  const ImuBias bias{1e-3 * vector(), 0.05 * vector()};
  const double begin = 2.5, frame = 0.05;
  ScaleFilterSettings settings;
  settings.position_stddev = visual_stddev;
  settings.position_drift = 1e-5;
  settings.scale_drift = 1e-5;
  settings.rotation_walk = 1e-6;
  settings.accel_bias_stddev = 0.05;
  const double tilt = 0.01;
  // A map tilted against gravity, as the attitude filter would leave it.
  const Eigen::Matrix3d R_map_world =
      air_ground_common::expSO3(tilt * Eigen::Vector3d(normal(random), normal(random), 0));
  ScaleFilter filter(settings, noise, tilt);
  ImuBuffer buffer(1000);
  for (const auto& s : flight.imuSamples(begin - 0.1, begin + duration + 0.1, 200, noise, bias, random)) buffer.add(s);
  const Eigen::Vector3d origin = flight.T_world_imu(begin).translation();
  Outcome run;
  for (int i = 0; i * frame < duration; ++i) {
    const double t = begin + i * frame;
    std::optional<Preintegration> motion;
    if (i > 0) motion = motionBetween(t - frame, t, buffer, noise, {bias.gyro, Eigen::Vector3d::Zero()});
    const Eigen::Vector3d carried = R_map_world * wind * (i * frame) / true_scale;
    const Eigen::Vector3d noise_now = visual_stddev / true_scale * vector();
    filter.add(seenAt(flight, t, R_map_world, origin, true_scale, carried + noise_now), motion);
    if (filter.initialized() && run.start_time < 0) run.start_time = i * frame;
    const double log_error = filter.initialized() ? std::log(filter.scale() / true_scale) : 0;
    if (run.start_time >= 0 && std::abs(i * frame - run.start_time - 1.0) < 0.5 * frame)
      run.early_nees = log_error * log_error / std::pow(filter.relativeStddev(), 2);
  }
  const double t = begin + (std::ceil(duration / frame) - 1) * frame;
  run.ratio = filter.scale() / true_scale;
  run.relative_stddev = filter.relativeStddev();
  Eigen::Matrix<double, 10, 1> error;
  const Eigen::Matrix3d R_visual_world = R_map_world / true_scale;
  error << filter.state().p - R_visual_world * (flight.T_world_imu(t).translation() - origin + wind * (t - begin)),
      filter.state().v - R_visual_world * (flight.velocity(t) + wind), filter.state().accel_bias - bias.accel,
      std::log(run.ratio);
  Eigen::Matrix<double, 10, 10> C;
  const auto& P = filter.covariance();
  C << P.topLeftCorner<9, 9>(), P.block<9, 1>(0, 11), P.block<1, 9>(11, 0), P(11, 11);
  run.nees = error(9) * error(9) / C(9, 9);
  run.nees_full = air_ground_common::squaredMahalanobis(error, C);
  return run;
}

TEST(ScaleFilter, FindsTheScaleWhateverTheVisualUnit) {
  for (const double scale : {0.2, 1.0, 3.7}) {
    const Outcome run = simulate(3, scale, 15.0);
    ASSERT_GE(run.start_time, 0.0) << "scale " << scale;
    EXPECT_LT(run.start_time, 4.5);
    EXPECT_NEAR(run.ratio, 1.0, 0.01) << "scale " << scale;
    EXPECT_LT(run.relative_stddev, 0.01);
  }
}

TEST(ScaleFilter, IsConsistentOverManyRuns) {
  const int runs = 60;
  double nees = 0, nees_full = 0, early = 0;
  for (int i = 0; i < runs; ++i) {
    const Outcome run = simulate(100 + i, 1.7, 8.0);
    nees += run.nees / runs;
    nees_full += run.nees_full / runs;
    early += run.early_nees / runs;
  }
  std::printf("mean NEES over %d runs: log scale %.2f (1), 1 s after start %.2f (1), state %.2f (10)\n", runs, nees,
              early, nees_full);
  // Chi-squared means over 60 runs, 99.9 % two-sided: 1 dof in [0.5, 1.7], 10 dof in [8.2, 12.0].
  EXPECT_GT(nees, 0.45);
  EXPECT_LT(nees, 1.7);
  EXPECT_GT(nees_full, 8.2);
  EXPECT_LT(nees_full, 12.0);
  EXPECT_LT(early, 2.5);
}

// A map that begins in fast flight: what is expected of the velocity must not bend the scale. Of 10 m distance.
TEST(ScaleFilter, IsConsistentAtAnySpeed) {
  for (const double speed : {0.0, 5.0, 12.0, 20.0}) {
    const int runs = 30;
    double nees = 0, early = 0, mean = 0;
    for (int i = 0; i < runs; ++i) {
      const Outcome run = simulate(500 + i, 1.7, 10.0, 0.02, speed * Eigen::Vector3d(0.8, -0.6, 0));
      ASSERT_GE(run.start_time, 0.0) << "speed " << speed << " run " << i;
      nees += run.nees / runs;
      early += run.early_nees / runs;
      mean += std::log(run.ratio) / runs;
    }
    std::printf("%.0f m/s: log scale %+.4f in the mean, NEES %.2f (1), 1 s after start %.2f (1)\n", speed, mean, nees,
                early);
    EXPECT_LT(nees, 2.1) << speed;  // chi-squared mean over 30 runs, 99.9 %
    EXPECT_LT(early, 2.5) << speed;
    EXPECT_LT(std::abs(mean), 0.02) << speed;
  }
}

/// What a wrong IMU makes of a sample.
using Spoil = std::function<ImuSample(ImuSample)>;

struct Believed {
  bool metric = false;    ///< at any time what the odometry takes for certain
  double metric_at = -1;  ///< [s]
  double ratio = 0;       ///< then: estimated over true scale
  bool contradicted = false, inverted = false;
  double mean_nis = 0;
};

/// Flies with the default settings, as the odometry uses the filter: the map is levelled by what the IMU calls up at
/// the start.
Believed believe(unsigned seed, const Spoil& spoil, double frame = 0.05, const synthetic::Flight& flight = {}) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const auto vector = [&] { return Eigen::Vector3d(normal(random), normal(random), normal(random)); };
  const ImuNoise noise;
  const ImuBias bias{1e-3 * vector(), 0.05 * vector()};
  const double begin = 1.5, duration = 12.0, true_scale = 1.7;
  ImuBuffer buffer(1000);
  for (const auto& s : flight.imuSamples(begin - 0.1, begin + duration + 0.1, 200, noise, bias, random))
    buffer.add(spoil(s));
  const Eigen::Vector3d up = spoil(flight.imu(0.5)).specific_force;
  const Eigen::Matrix3d R_map_world =
      air_ground_common::expSO3(0.01 * Eigen::Vector3d(normal(random), normal(random), 0)) *
      (up.norm() > 0.5 ? air_ground_common::levelingRotation(flight.T_world_imu(0.5).linear() * up)
                       : Eigen::Matrix3d::Identity());
  const Eigen::Vector3d origin = flight.T_world_imu(begin).translation();
  ScaleFilter filter(ScaleFilterSettings{}, noise, 0.012);
  Believed result;
  for (int i = 0; i * frame < duration; ++i) {
    const double t = begin + i * frame;
    std::optional<Preintegration> motion;
    if (i > 0) motion = motionBetween(t - frame, t, buffer, noise, {bias.gyro, Eigen::Vector3d::Zero()});
    filter.add(seenAt(flight, t, R_map_world, origin, true_scale, 0.002 / true_scale * vector()), motion);
    result.contradicted = result.contradicted || filter.contradicted();
    result.inverted = result.inverted || filter.inverted();
    if (filter.certain(0.02) && !result.metric) {
      result.metric = true;
      result.metric_at = i * frame;
      result.ratio = filter.scale() / true_scale;
      result.mean_nis = filter.meanNis();
    }
  }
  return result;
}

TEST(ScaleFilter, IsNotCertainWithAWrongImu) {
  const auto rotated = [](const Eigen::Vector3d& axis) {
    const Eigen::Matrix3d R = Eigen::AngleAxisd(M_PI / 2, axis).toRotationMatrix();
    return [R](ImuSample s) {
      s.angular_velocity = (R * s.angular_velocity).eval();
      s.specific_force = (R * s.specific_force).eval();
      return s;
    };
  };
  const auto in_g = [](ImuSample s) {
    s.specific_force /= 9.81;
    return s;
  };
  const synthetic::Flight flight;
  const auto gravity_removed = [&](ImuSample s) {
    s.specific_force -= flight.T_world_imu(s.stamp).linear().transpose() * Eigen::Vector3d(0, 0, kGravity);
    return s;
  };
  const std::vector<std::pair<const char*, Spoil>> cases = {{"in g", in_g},
                                                            {"gravity removed", gravity_removed},
                                                            {"turned about x", rotated(Eigen::Vector3d::UnitX())},
                                                            {"turned about y", rotated(Eigen::Vector3d::UnitY())},
                                                            {"turned about z", rotated(Eigen::Vector3d::UnitZ())}};
  for (const auto& [name, spoil] : cases) {
    for (unsigned seed = 1; seed <= 3; ++seed) {
      const Believed b = believe(seed, spoil);
      EXPECT_FALSE(b.metric) << name << ", seed " << seed << ": after " << b.metric_at << " s, " << b.ratio
                             << " of the true scale, mean NIS " << b.mean_nis;
    }
  }
}

// Of a body that stays level gravity that was removed is a constant bias, and one term among many in a long window.
TEST(ScaleFilter, GravityIsNoBias) {
  synthetic::Flight level;
  level.wobble = 0;
  for (const double frame : {0.05, 0.02})
    for (unsigned seed = 1; seed <= 3; ++seed) {
      const Believed b = believe(
          seed,
          [](ImuSample s) {
            s.specific_force.z() -= kGravity;
            return s;
          },
          frame, level);
      EXPECT_FALSE(b.metric) << 1 / frame << " Hz: after " << b.metric_at << " s, " << b.ratio << " of the true scale";
      EXPECT_TRUE(b.contradicted);
    }
}

TEST(ScaleFilter, NamesAccelerationsOfTheWrongSign) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    const Believed b = believe(seed, [](ImuSample s) {
      s.specific_force *= -1;
      return s;
    });
    EXPECT_TRUE(b.inverted) << seed;
    EXPECT_FALSE(b.metric) << seed;
  }
}

TEST(ScaleFilter, IsCertainWithAGoodImu) {
  double latest = 0;
  for (unsigned seed = 1; seed <= 8; ++seed) {
    const Believed b = believe(seed, [](ImuSample s) { return s; });
    ASSERT_TRUE(b.metric) << seed;
    EXPECT_FALSE(b.inverted) << seed;
    EXPECT_NEAR(b.ratio, 1.0, 0.05) << seed;
    latest = std::max(latest, b.metric_at);
  }
  std::printf("certain after %.2f s at the latest\n", latest);
  EXPECT_LT(latest, 6.0);
}

// A map that began in flight: its z axis is off by far more than a rest would leave, the accelerometer's bias is large.
TEST(ScaleFilter, FindsGravityWithoutARest) {
  synthetic::Flight flight;
  flight.wobble = 0.2;
  for (unsigned seed = 1; seed <= 4; ++seed) {
    std::mt19937 random(seed);
    const ImuNoise noise;
    const ImuBias bias{Eigen::Vector3d::Zero(), {0.35, -0.3, 0.2}};
    ImuBuffer buffer(1000);
    for (const auto& s : flight.imuSamples(2.9, 13.1, 200, noise, bias, random)) buffer.add(s);
    const double heading = seed;
    const Eigen::Matrix3d R_map_world =
        air_ground_common::expSO3(0.3 * Eigen::Vector3d(std::cos(heading), std::sin(heading), 0));
    std::normal_distribution<double> normal;
    ScaleFilterSettings settings;
    settings.accel_bias_stddev = 0.3;
    ScaleFilter filter(settings, noise, 0.3);
    for (int i = 0; i < 200; ++i) {
      const double t = 3.0 + 0.05 * i;
      std::optional<Preintegration> motion;
      if (i > 0) motion = motionBetween(t - 0.05, t, buffer, noise);
      const Eigen::Vector3d error = 0.002 * Eigen::Vector3d(normal(random), normal(random), normal(random));
      filter.add(seenAt(flight, t, R_map_world, flight.T_world_imu(3.0).translation(), 1.7, error / 1.7), motion);
    }
    ASSERT_TRUE(filter.initialized()) << "seed " << seed;
    EXPECT_NEAR(filter.scale() / 1.7, 1.0, 0.03) << "seed " << seed << ", +- " << filter.relativeStddev();
    const Eigen::Vector3d truth = R_map_world * Eigen::Vector3d(0, 0, -kGravity);
    EXPECT_LT(std::acos(std::min(1.0, truth.normalized().dot(filter.state().gravity().normalized()))), 0.5 * M_PI / 180)
        << "seed " << seed;
  }
}

// Straight and steady: the accelerometer shows gravity alone, and any scale fits.
TEST(ScaleFilter, DoesNotStartInSteadyFlight) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const ImuNoise noise;
  ImuBuffer buffer(1000);
  for (int i = -20; i < 1700; ++i) {
    ImuSample s;
    s.stamp = 0.005 * i;
    const double spread = noise.accel_density * std::sqrt(200.0);
    s.specific_force =
        Eigen::Vector3d(0, 0, kGravity) + spread * Eigen::Vector3d(normal(random), normal(random), normal(random));
    buffer.add(s);
  }
  ScaleFilter filter(ScaleFilterSettings{}, noise, 0.3);
  for (int i = 0; i < 160; ++i) {
    ScaleMeasurement m;
    m.p_map_camera =
        Eigen::Vector3d(0.4 * 0.05 * i, 0, 0) + 0.001 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    std::optional<Preintegration> motion;
    if (i > 0) motion = motionBetween(0.05 * (i - 1), 0.05 * i, buffer, noise);
    filter.add(m, motion);
    EXPECT_FALSE(filter.certain(0.1)) << "image " << i;
  }
  EXPECT_GT(filter.startStddev(), 0.1);
}

TEST(ScaleFilter, DoesNotStartWhileHovering) {
  // At rest the accelerometer says nothing about the scale.
  ScaleFilter filter(ScaleFilterSettings{}, ImuNoise{}, 0.01);
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  const synthetic::Flight flight{1e6};
  ImuBuffer buffer(1000);
  for (const auto& s : flight.imuSamples(0, 12, 200, ImuNoise{}, ImuBias{}, random)) buffer.add(s);
  for (int i = 0; i < 200; ++i) {
    ScaleMeasurement m;
    m.p_map_camera = 0.003 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    std::optional<Preintegration> motion;
    if (i > 0) motion = motionBetween(0.05 * (i - 1), 0.05 * i, buffer);
    filter.add(m, motion);
  }
  EXPECT_FALSE(filter.initialized() && filter.relativeStddev() < 0.1)
      << filter.scale() << " +- " << filter.scaleStddev();
}

TEST(ScaleFilter, TransformRescalesAndLevels) {
  const synthetic::Flight flight;
  std::mt19937 random(9);
  const ImuNoise noise;
  ImuBuffer buffer(1000);
  for (const auto& s : flight.imuSamples(2.0, 20.0, 200, noise, ImuBias{}, random)) buffer.add(s);
  ScaleFilter filter(ScaleFilterSettings{}, noise, 0.01);
  const double unit = 2.5;
  air_ground_common::Similarity S;
  double worst = 0;
  for (int i = 0; i < 280; ++i) {
    const double t = 2.5 + 0.05 * i;
    ScaleMeasurement m;
    m.p_map_camera = S * Eigen::Vector3d(flight.T_world_imu(t).translation() / unit);
    m.R_map_imu = S.R * flight.T_world_imu(t).linear();
    m.scene_distance = 0.5;
    std::optional<Preintegration> motion;
    if (i > 0) motion = motionBetween(t - 0.05, t, buffer, noise);
    filter.add(m, motion);
    if (i == 150) {
      ASSERT_TRUE(filter.initialized());
      const double before = filter.relativeStddev();
      air_ground_common::Similarity change;
      change.scale = filter.scale();
      change.R = air_ground_common::expSO3(Eigen::Vector3d(0, 0, 0.3));
      change.t = Eigen::Vector3d(1, 2, 3);
      filter.transform(change);
      S = change;
      EXPECT_NEAR(filter.scale(), 1.0, 1e-9);
      EXPECT_NEAR(filter.relativeStddev(), before, 1e-12);
    }
    if (i > 150) worst = std::max(worst, std::abs(filter.scale() * S.scale / unit - 1));
  }
  EXPECT_EQ(filter.rejected(), 0);
  EXPECT_LT(worst, 0.03);
}

}  // namespace
