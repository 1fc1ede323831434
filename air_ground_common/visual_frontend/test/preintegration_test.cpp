#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "air_ground_common/geometry.h"
#include "synthetic_flight.h"
#include "visual_frontend/imu_preintegration.h"

using namespace visual_frontend;
using air_ground_common::logSO3;

namespace {

std::vector<ImuSample> exactSamples(double begin, double end, double rate, const ImuBias& bias = {}) {
  std::mt19937 random(1);
  ImuNoise none{1e-12, 1e-12, 1e-12, 1e-12};
  return synthetic::Flight{}.imuSamples(begin, end, rate, none, bias, random);
}

Eigen::Matrix<double, 9, 1> difference(const Preintegration& a, const Preintegration& b) {
  Eigen::Matrix<double, 9, 1> d;
  d << logSO3(a.rotation().transpose() * b.rotation()), b.velocity() - a.velocity(), b.position() - a.position();
  return d;
}

TEST(Preintegration, PredictsTheTrueMotion) {
  const synthetic::Flight flight;
  const double t0 = 3.0, t1 = 3.5;
  Preintegration motion(ImuNoise{}, ImuBias{});
  motion.integrate(exactSamples(t0, t1, 200));
  const auto T0 = flight.T_world_imu(t0), T1 = flight.T_world_imu(t1);
  const Eigen::Vector3d g(0, 0, -kGravity);
  const double dt = t1 - t0;
  EXPECT_NEAR(motion.duration(), dt, 1e-9);
  EXPECT_LT((T0.translation() + flight.velocity(t0) * dt + 0.5 * dt * dt * g + T0.linear() * motion.position() -
             T1.translation())
                .norm(),
            2e-5);
  EXPECT_LT((flight.velocity(t0) + g * dt + T0.linear() * motion.velocity() - flight.velocity(t1)).norm(), 1e-4);
  EXPECT_LT(air_ground_common::rotationAngle(T0.linear() * motion.rotation(), T1.linear()), 1e-5);
}

TEST(Preintegration, AgreesWithTwentyTimesFinerIntegration) {
  Preintegration coarse(ImuNoise{}, ImuBias{}), fine(ImuNoise{}, ImuBias{});
  coarse.integrate(exactSamples(4.0, 5.0, 200));
  fine.integrate(exactSamples(4.0, 5.0, 4000));
  const auto d = difference(fine, coarse);
  EXPECT_LT(d.head<3>().norm(), 1e-5);
  EXPECT_LT(d.segment<3>(3).norm(), 1e-4);
  EXPECT_LT(d.tail<3>().norm(), 1e-4);
}

TEST(Preintegration, BiasJacobianMatchesNumericDerivative) {
  const ImuBias bias{{0.01, -0.02, 0.03}, {0.1, -0.05, 0.08}};
  const auto samples = exactSamples(2.5, 3.2, 200);
  Preintegration nominal(ImuNoise{}, bias);
  nominal.integrate(samples);
  const double h = 1e-5;
  for (int axis = 0; axis < 6; ++axis) {
    ImuBias plus = bias, minus = bias;
    (axis < 3 ? plus.gyro : plus.accel)[axis % 3] += h;
    (axis < 3 ? minus.gyro : minus.accel)[axis % 3] -= h;
    const Preintegration a = nominal.reintegrated(minus), b = nominal.reintegrated(plus);
    Eigen::Matrix<double, 9, 1> numeric = (difference(nominal, b) - difference(nominal, a)) / (2 * h);
    EXPECT_LT((numeric - nominal.biasJacobian().col(axis)).norm(), 1e-5 * (1 + numeric.norm())) << "column " << axis;
  }
}

TEST(Preintegration, FirstOrderBiasCorrectionAgreesWithReintegration) {
  const auto samples = exactSamples(2.5, 3.2, 200);
  Preintegration nominal(ImuNoise{}, ImuBias{});
  nominal.integrate(samples);
  const ImuBias bias{{2e-3, -1e-3, 3e-3}, {0.03, -0.02, 0.05}};
  const Preintegration exact = nominal.reintegrated(bias);
  EXPECT_LT(air_ground_common::rotationAngle(nominal.rotation(bias), exact.rotation()), 1e-5);
  EXPECT_LT((nominal.velocity(bias) - exact.velocity()).norm(), 1e-4);
  EXPECT_LT((nominal.position(bias) - exact.position()).norm(), 1e-4);
}

TEST(Preintegration, CovarianceMatchesMonteCarlo) {
  const ImuNoise noise{2e-3, 2e-2, 1e-9, 1e-9};
  const synthetic::Flight flight;
  Preintegration nominal(noise, ImuBias{});
  nominal.integrate(exactSamples(3.0, 3.5, 200));
  std::mt19937 random(7);
  Eigen::Matrix<double, 9, 9> sum = Eigen::Matrix<double, 9, 9>::Zero();
  const int runs = 600;
  for (int i = 0; i < runs; ++i) {
    Preintegration noisy(noise, ImuBias{});
    noisy.integrate(flight.imuSamples(3.0, 3.5, 200, noise, ImuBias{}, random));
    const auto d = difference(nominal, noisy);
    sum += d * d.transpose() / runs;
  }
  // Standard deviations agree to 12 % (their own relative error is 1 / sqrt(2 * 600) = 3 %).
  for (int i = 0; i < 9; ++i)
    EXPECT_NEAR(std::sqrt(sum(i, i) / nominal.covariance()(i, i)), 1.0, 0.12) << "state " << i;
  // And correlations of velocity and position.
  for (int i = 3; i < 6; ++i) {
    const auto correlation = [i](const Eigen::Matrix<double, 9, 9>& C) {
      return C(i, i + 3) / std::sqrt(C(i, i) * C(i + 3, i + 3));
    };
    EXPECT_NEAR(correlation(sum), correlation(nominal.covariance()), 0.06);
  }
}

TEST(Preintegration, RejectsSamplesThatDoNotAdvance) {
  Preintegration motion(ImuNoise{}, ImuBias{});
  ImuSample a, b;
  EXPECT_THROW(motion.integrate(a, b), std::invalid_argument);
  EXPECT_THROW((ImuNoise{-1, 1, 1, 1}.validate()), std::invalid_argument);
}

TEST(SamplesBetween, InterpolatesTheEndsAndRefusesGaps) {
  ImuBuffer buffer(100);
  for (int i = 0; i <= 20; ++i) {
    ImuSample s;
    s.stamp = 0.1 + 0.01 * i;
    s.angular_velocity = Eigen::Vector3d(i, 0, 0);
    buffer.add(s);
  }
  const auto cut = samplesBetween(buffer, 0.115, 0.148);
  ASSERT_EQ(cut.size(), 5u);
  EXPECT_NEAR(cut.front().angular_velocity.x(), 1.5, 1e-9);
  EXPECT_NEAR(cut.back().angular_velocity.x(), 4.8, 1e-9);
  EXPECT_DOUBLE_EQ(cut.front().stamp, 0.115);
  EXPECT_DOUBLE_EQ(cut.back().stamp, 0.148);
  EXPECT_TRUE(samplesBetween(buffer, 0.0, 0.15).empty());
  EXPECT_TRUE(samplesBetween(buffer, 0.2, 0.40).empty());
  const auto held = samplesBetween(buffer, 0.28, 0.32);
  ASSERT_FALSE(held.empty());
  EXPECT_DOUBLE_EQ(held.back().stamp, 0.32);
  EXPECT_NEAR(held.back().angular_velocity.x(), 20, 1e-9);
  EXPECT_TRUE(samplesBetween(buffer, 0.2, 0.2).empty());
  EXPECT_TRUE(samplesBetween(buffer, 0.12, 0.2, 0.005).empty());
}

// Real data: EuRoC V1_01 (Burri 2016), where present beside the project or in AIR_GROUND_TEST_DATA.
TEST(Preintegration, PredictsEurocOverHalfASecond) {
  const char* root = std::getenv("AIR_GROUND_TEST_DATA");
  const std::filesystem::path folder =
      std::filesystem::path(root ? root : AIR_GROUND_SOURCE_DIR "/../shared/data") / "euroc_v101";
  std::ifstream imu_file(folder / "imu0/data.csv"), truth_file(folder / "groundtruth_openvins.csv");
  if (!imu_file || !truth_file) GTEST_SKIP() << "EuRoC V1_01 not found in " << folder << "; set AIR_GROUND_TEST_DATA";
  const auto numbers = [](const std::string& line) {
    std::vector<double> values;
    std::stringstream stream(line);
    for (std::string cell; std::getline(stream, cell, ',');) values.push_back(std::stod(cell));
    return values;
  };
  std::string line;
  std::vector<std::vector<double>> truth;
  ImuBuffer buffer(1000);
  std::getline(imu_file, line);
  std::getline(truth_file, line);
  double t0 = 0;
  while (std::getline(truth_file, line)) truth.push_back(numbers(line));
  t0 = truth.front()[0];
  while (std::getline(imu_file, line)) {
    const auto v = numbers(line);
    ImuSample s;
    s.stamp = (v[0] - t0) * 1e-9;
    s.angular_velocity = {v[1], v[2], v[3]};
    s.specific_force = {v[4], v[5], v[6]};
    buffer.add(s);
  }
  std::vector<double> position_errors, rotation_errors;
  for (std::size_t i = 100; i + 10 < truth.size(); i += 10) {
    const auto& a = truth[i];
    const auto& b = truth[i + 10];
    const auto samples = samplesBetween(buffer, (a[0] - t0) * 1e-9, (b[0] - t0) * 1e-9);
    if (samples.empty()) continue;
    Preintegration motion(ImuNoise{}, ImuBias{{a[11], a[12], a[13]}, {a[14], a[15], a[16]}});
    motion.integrate(samples);
    const Eigen::Matrix3d Ra = Eigen::Quaterniond(a[4], a[5], a[6], a[7]).toRotationMatrix();
    const Eigen::Matrix3d Rb = Eigen::Quaterniond(b[4], b[5], b[6], b[7]).toRotationMatrix();
    const Eigen::Vector3d pa(a[1], a[2], a[3]), pb(b[1], b[2], b[3]), va(a[8], a[9], a[10]);
    const double dt = motion.duration();
    position_errors.push_back(
        (pa + va * dt + 0.5 * dt * dt * Eigen::Vector3d(0, 0, -kGravity) + Ra * motion.position() - pb).norm());
    rotation_errors.push_back(air_ground_common::rotationAngle(Ra * motion.rotation(), Rb));
  }
  ASSERT_GT(position_errors.size(), 150u);
  std::sort(position_errors.begin(), position_errors.end());
  std::sort(rotation_errors.begin(), rotation_errors.end());
  const double position = position_errors[position_errors.size() / 2],
               rotation = rotation_errors[rotation_errors.size() / 2];
  RecordProperty("median_position_error_mm", static_cast<int>(1000 * position));
  std::printf("EuRoC V1_01, 0.5 s ahead: median error %.1f mm, %.2f mrad over %zu intervals\n", 1e3 * position,
              1e3 * rotation, position_errors.size());
  EXPECT_LT(position, 0.02);
  EXPECT_LT(rotation, 0.004);
}

}  // namespace
