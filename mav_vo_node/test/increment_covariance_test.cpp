#include "mav_vo/increment_covariance.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <opengv/relative_pose/CentralRelativeAdapter.hpp>
#include <opengv/relative_pose/methods.hpp>
#include <random>

#include "air_ground_common/linear_algebra.h"

using namespace mav_vo;

namespace {

constexpr double kSigma = 0.001;  // 0.5 px at 500 px

struct Views {
  explicit Views(unsigned seed, double noise, int count = 120, double step = 0.12) : random(seed) {
    std::uniform_real_distribution<double> unit(-1, 1);
    T.linear() = air_ground_common::expSO3({0.04 * unit(random), 0.04 * unit(random), 0.04 * unit(random)});
    T.translation() = step * Eigen::Vector3d(unit(random), unit(random), 0.6 * unit(random)).normalized();
    std::normal_distribution<double> gauss(0, noise);
    while (static_cast<int>(pairs.size()) < count) {
      const double z = 2.5 + unit(random);
      const Eigen::Vector3d p(0.6 * z * unit(random), 0.45 * z * unit(random), z), q = T.inverse() * p;
      RayPair pair;
      pair.previous = p.head<2>() / p.z();
      pair.current = q.head<2>() / q.z();
      if (noise > 0) {
        for (int k = 0; k < 2; ++k) {
          pair.previous[k] += gauss(random);
          pair.current[k] += gauss(random);
        }
      }
      pairs.push_back(pair);
    }
  }
  std::vector<int> samples(int problems) {
    std::vector<int> s(5 * problems);
    for (auto it = s.begin(); it != s.end(); it += 5) {
      for (auto at = it; at != it + 5; ++at) {
        do *at = static_cast<int>(random() % pairs.size());
        while (std::find(it, at, *at) != at);
      }
    }
    return s;
  }
  std::mt19937 random;
  Pose T = Pose::Identity();  // previous from current
  std::vector<RayPair> pairs;
};

Eigen::Matrix3d essential(const Eigen::Matrix3d& R, const Eigen::Vector3d& t) {
  const Eigen::Matrix3d E = air_ground_common::skew(t.normalized()) * R;
  return E / E.norm();
}

/// Nister's essential matrices p' E c = 0 of a problem.
std::vector<Eigen::Matrix3d> nister(const std::vector<RayPair>& pairs, const int* sample) {
  opengv::bearingVectors_t previous, current;
  for (int i = 0; i < 5; ++i) {
    previous.push_back(pairs[sample[i]].previous.homogeneous().normalized());
    current.push_back(pairs[sample[i]].current.homogeneous().normalized());
  }
  opengv::relative_pose::CentralRelativeAdapter adapter(current, previous);  // theirs is first' E second
  std::vector<Eigen::Matrix3d> all;
  for (const auto& E : opengv::relative_pose::fivept_nister(adapter)) all.push_back(E.transpose() / E.norm());
  return all;
}

double distance(const Eigen::Matrix3d& A, const Eigen::Matrix3d& B) { return std::min((A - B).norm(), (A + B).norm()); }

TEST(FivePoint, RecoversTheMotionFromARoughStart) {
  int solved = 0, tried = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Views v(seed, 0);
    Pose start = v.T;
    start.linear() = v.T.linear() * air_ground_common::expSO3({0.01, -0.015, 0.01});
    start.translation() += Eigen::Vector3d(0.01, -0.01, 0.008);
    const auto samples = v.samples(101);  // not a multiple of the block
    const FivePointSolutions s = solveFivePoint(v.pairs, samples, start);
    ASSERT_EQ(s.converged.size(), 101u);
    for (std::size_t k = 0; k < 101; ++k) {
      ++tried;
      solved += s.converged[k] && (s.t_previous_current[k] - v.T.translation().normalized()).norm() < 1e-4 &&
                air_ground_common::rotationAngle(s.R_previous_current[k], v.T.linear()) < 1e-4;
    }
  }
  EXPECT_GT(solved, 0.85 * tried);
}

TEST(FivePoint, EveryRootIsOneOfNisters) {
  int converged = 0, known = 0, nearest = 0, tried = 0;
  for (unsigned seed = 30; seed < 50; ++seed) {
    Views v(seed, kSigma);
    const auto samples = v.samples(50);
    const FivePointSolutions s = solveFivePoint(v.pairs, samples, v.T);
    for (int k = 0; k < 50; ++k) {
      ++tried;
      if (!s.converged[k]) continue;
      ++converged;
      const Eigen::Matrix3d E = essential(s.R_previous_current[k], s.t_previous_current[k]),
                            E0 = essential(v.T.linear(), v.T.translation());
      for (int i = 0; i < 5; ++i) {
        const RayPair& pair = v.pairs[samples[5 * k + i]];
        EXPECT_NEAR(pair.previous.homogeneous().dot(E * pair.current.homogeneous()), 0, 1e-8);
      }
      double best = 1e9, best_to_start = 1e9;
      for (const auto& root : nister(v.pairs, &samples[5 * k])) {
        best = std::min(best, distance(root, E));
        best_to_start = std::min(best_to_start, distance(root, E0));
      }
      known += best < 1e-3;
      nearest += distance(E, E0) < best_to_start + 1e-3;
    }
  }
  std::printf("of %d problems %d converged, %d to one of Nister's roots, %d to the one nearest the start\n", tried,
              converged, known, nearest);
  EXPECT_GT(converged, 0.7 * tried);
  EXPECT_GT(known, 0.94 * converged);  // OpenGV's misses some: each of ours is checked against the constraints below
  EXPECT_GT(nearest, 0.85 * converged);
}

TEST(FivePoint, RefusesBadCalls) {
  Views v(1, 0);
  EXPECT_THROW(solveFivePoint(v.pairs, {0, 1, 2, 3}, v.T), std::invalid_argument);
  EXPECT_THROW(solveFivePoint(v.pairs, {0, 1, 2, 3, 500}, v.T), std::invalid_argument);
  Pose still = v.T;
  still.translation().setZero();
  EXPECT_THROW(solveFivePoint(v.pairs, {0, 1, 2, 3, 4}, still), std::invalid_argument);
}

TEST(MonteCarloIncrement, AgreesWithALoopOverNister) {
  // The same from OpenGV's roots, each time the one nearest the odometry's motion. It is larger: where no root is near,
  // theirs is far.
  for (const unsigned seed : {60u, 61u, 62u}) {
    Views v(seed, 0.3 * kSigma);
    MonteCarloSettings settings;
    const auto ours =
        monteCarloIncrement(v.pairs, v.T, Pose::Identity(), Eigen::Matrix3d::Identity(), 0, 0.3 * kSigma, settings);
    ASSERT_TRUE(ours.success) << ours.reason;
    const auto samples = v.samples(1000);
    const double length = v.T.translation().norm();
    const Eigen::Matrix3d E0 = essential(v.T.linear(), v.T.translation());
    std::vector<Eigen::Vector3d> all;
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (int k = 0; k < 1000; ++k) {
      Eigen::Matrix3d nearest;
      double best = 1e9;
      for (const auto& root : nister(v.pairs, &samples[5 * k])) {
        if (distance(root, E0) >= best) continue;
        best = distance(root, E0);
        nearest = root;
      }
      if (best > 1e8) continue;
      // t' E = 0; the sign is that of the motion.
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(nearest * nearest.transpose());
      Eigen::Vector3d t = eigen.eigenvectors().col(0);
      if (t.dot(v.T.translation()) < 0) t = -t;
      all.push_back(length * t);
      mean += length * t;
    }
    mean /= static_cast<double>(all.size());
    Eigen::Matrix3d C = Eigen::Matrix3d::Zero();
    for (const auto& t : all) C += (t - mean) * (t - mean).transpose() / (all.size() - 1.0);
    const double ratio = std::sqrt(ours.covariance.topLeftCorner<3, 3>().trace() / C.trace());
    EXPECT_GT(ratio, 0.35);
    EXPECT_LT(ratio, 1.3);
  }
}

TEST(MonteCarloIncrement, LengthLeverArmAndYawAreInTheRightAxes) {
  Views v(70, 0.2 * kSigma);
  const auto camera =
      monteCarloIncrement(v.pairs, v.T, Pose::Identity(), Eigen::Matrix3d::Identity(), 1e-4, 0.2 * kSigma, {});
  ASSERT_TRUE(camera.success) << camera.reason;
  // Five points leave the length open: along the motion there is only what was given.
  const Eigen::Vector3d along = v.T.translation().normalized();
  const Eigen::Matrix3d C = camera.covariance.topLeftCorner<3, 3>();
  EXPECT_NEAR(std::sqrt(along.dot(C * along)), 0.01, 0.005);
  EXPECT_GT(air_ground_common::symmetricEigen(camera.covariance).values[0], 0);
  // A turned camera: the same covariance in turned axes, with yaw about the map's vertical.
  Pose T_base_camera = Pose::Identity();
  T_base_camera.linear() = air_ground_common::opticalFromForwardBody().transpose();
  if ((T_base_camera.linear() * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitX()).norm() > 1e-9)
    T_base_camera.linear().transposeInPlace();
  const Pose T_base = T_base_camera * v.T * T_base_camera.inverse();
  const auto base =
      monteCarloIncrement(v.pairs, T_base, T_base_camera, Eigen::Matrix3d::Identity(), 1e-4, 0.2 * kSigma, {});
  ASSERT_TRUE(base.success);
  EXPECT_NEAR(
      (base.covariance.topLeftCorner<3, 3>() - T_base_camera.linear() * C * T_base_camera.linear().transpose()).norm(),
      0, 1e-9);
  Eigen::Matrix3d upright = T_base_camera.linear();  // the optical frame's yaw axis is then the body's
  const auto same = monteCarloIncrement(v.pairs, v.T, Pose::Identity(), upright, 1e-4, 0.2 * kSigma, {});
  EXPECT_NEAR(same.covariance(3, 3), base.covariance(3, 3), 1e-12);
}

TEST(MonteCarloIncrement, ScatterShrinksWithTheNoise) {
  double previous = 1e9;
  for (const double noise : {1e-3, 3e-4, 1e-4, 3e-5}) {
    const Views v(80, noise);
    const auto r = monteCarloIncrement(v.pairs, v.T, Pose::Identity(), Eigen::Matrix3d::Identity(), 0, noise, {});
    ASSERT_TRUE(r.success) << r.reason;
    EXPECT_LT(r.covariance(3, 3), previous);
    previous = r.covariance(3, 3);
  }
}

TEST(MonteCarloIncrement, RefusesWhatFivePointsCannotTell) {
  Views turning(90, kSigma, 120, 1e-5), few(91, kSigma, 6);
  const auto still =
      monteCarloIncrement(turning.pairs, turning.T, Pose::Identity(), Eigen::Matrix3d::Identity(), 1e-6, kSigma, {});
  EXPECT_FALSE(still.success);
  EXPECT_NE(still.reason.find("no parallax"), std::string::npos);
  EXPECT_FALSE(
      monteCarloIncrement(few.pairs, few.T, Pose::Identity(), Eigen::Matrix3d::Identity(), 1e-6, kSigma, {}).success);
  EXPECT_FALSE(
      monteCarloIncrement({}, Pose::Identity(), Pose::Identity(), Eigen::Matrix3d::Identity(), 1e-6, kSigma, {})
          .success);
  Views same(92, kSigma);
  std::vector<RayPair> spot(50, same.pairs[0]);
  EXPECT_FALSE(
      monteCarloIncrement(spot, same.T, Pose::Identity(), Eigen::Matrix3d::Identity(), 1e-6, kSigma, {}).success);
}

}  // namespace
