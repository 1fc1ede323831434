#include "air_ground_common/followed_clouds.h"

#include <gtest/gtest.h>

#include <random>

namespace air_ground_common {
namespace {

constexpr std::int64_t kStep = 50000000;  // [ns]

/// Along a straight line of 4 m, looking down and swaying.
PosesByStamp straightFlight() {
  PosesByStamp poses;
  for (int i = 0; i <= 80; ++i) {
    Pose T = Pose::Identity();
    T.linear() = expSO3({M_PI + 0.1 * std::sin(0.3 * i), 0.05 * std::cos(0.2 * i), 0});
    T.translation() << 0.05 * i, 1, 2;
    poses[i * kStep] = T;
  }
  return poses;
}

Similarity someCorrection() { return {1.013, expSO3({0.01, -0.02, 0.03}), {0.1, -0.05, 0.02}}; }

PosesByStamp corrected(const PosesByStamp& poses, const Similarity& S) {
  PosesByStamp now;
  for (const auto& [stamp, T] : poses) {
    Pose moved = T;
    moved.linear() = S.R * T.linear();
    moved.translation() = S * T.translation();
    now[stamp] = moved;
  }
  return now;
}

double distance(const Similarity& a, const Similarity& b, const Eigen::Vector3d& p) { return (a * p - b * p).norm(); }

TEST(MapCorrection, IsTheSimilarityThatThePosesWentThrough) {
  const PosesByStamp then = straightFlight();
  const Similarity S = someCorrection();
  const auto [found, residual] = MapCorrection(then, corrected(then, S)).around({2, 1, 2}, 1.4);
  EXPECT_LT(residual, 2e-4);
  EXPECT_NEAR(found.scale, S.scale, 1e-4) << "a little less where the cameras' spread counts as small";
  EXPECT_LT(rotationAngle(found.R, S.R), 1e-9);
  // What was seen from there, 2 m below.
  EXPECT_LT(distance(found, S, {2, 1, 0}), 3e-4);
}

TEST(MapCorrection, CountsWhatIsNear) {
  const PosesByStamp then = straightFlight();
  PosesByStamp now = then;
  for (auto& [stamp, T] : now) T.translation().y() += 0.02 * T.translation().x();  // the flight has bent
  const Similarity begin = MapCorrection(then, now).around({0, 1, 2}, 0.3).T_now_then,
                   end = MapCorrection(then, now).around({4, 1, 2}, 0.3).T_now_then;
  EXPECT_NEAR((begin * Eigen::Vector3d(0, 1, 2)).y(), 1, 0.006);
  EXPECT_NEAR((end * Eigen::Vector3d(4, 1, 2)).y(), 1.08, 0.006);
}

// Half an hour of flight: by definition, over all cameras.
TEST(MapCorrection, LeavesOutOnlyWhatDoesNotCount) {
  std::mt19937 rng(3);
  std::normal_distribution<double> noise(0, 0.01);
  PosesByStamp then, now;
  for (int i = 0; i < 20000; ++i) {
    Pose T(Eigen::Translation3d(20 * std::cos(0.003 * i), 15 * std::sin(0.007 * i), 2));
    then[i * kStep] = T;
    T.translation() += Eigen::Vector3d(noise(rng), noise(rng), 0.01 * T.translation().x());
    T.linear() = expSO3({noise(rng), noise(rng), noise(rng)});
    now[i * kStep] = T;
  }
  const MapCorrection correction(then, now);
  for (const Eigen::Vector3d& centre : {Eigen::Vector3d(10, 3, 0), Eigen::Vector3d(-19, 0, 2)}) {
    constexpr double kRadius = 0.7;
    double sum = 0;
    Eigen::Vector3d shift = Eigen::Vector3d::Zero(), middle = Eigen::Vector3d::Zero();
    for (const auto& [stamp, T] : then) {
      const double w = std::exp(-(T.translation() - centre).squaredNorm() / (2 * kRadius * kRadius));
      sum += w;
      middle += w * T.translation();
      shift += w * (now[stamp].translation() - T.translation());
    }
    middle /= sum;
    EXPECT_LT((correction.around(centre, kRadius).T_now_then * middle - middle - shift / sum).norm(), 1e-5);
  }
}

TEST(MapCorrection, TellsHowFarTheMapHasBent) {
  const PosesByStamp then = straightFlight();
  PosesByStamp now = corrected(then, someCorrection());
  int i = 0;
  for (auto& [stamp, T] : now) T.translation().z() += ++i % 2 ? 0.005 : -0.005;
  EXPECT_NEAR(MapCorrection(then, now).around({2, 1, 2}, 0.7).residual, 0.005, 0.0003);
}

TEST(MapCorrection, AFactorOfTwoIsNoCorrection) {
  const PosesByStamp then = straightFlight();
  for (const double scale : {2.1, 0.4}) {
    const auto correction =
        MapCorrection(then, corrected(then, {scale, Eigen::Matrix3d::Identity(), {0, 0, 0}})).around({2, 1, 2}, 1.4);
    EXPECT_TRUE(std::isinf(correction.residual)) << scale;
    EXPECT_EQ(correction.T_now_then.scale, 1) << scale;
  }
}

TEST(MapCorrection, ACameraThatStoodTellsNoScale) {
  PosesByStamp then, now;
  std::mt19937 rng(1);
  std::normal_distribution<double> noise(0, 0.002);
  for (int i = 0; i < 20; ++i) {
    Pose T = Pose::Identity();
    T.translation() << noise(rng), noise(rng), noise(rng);
    then[i * kStep] = T;
    T.translation() *= 3;
    now[i * kStep] = T;
  }
  EXPECT_NEAR(MapCorrection(then, now).around(Eigen::Vector3d::Zero(), 1.4).T_now_then.scale, 1, 0.02);
}

TEST(MapCorrection, NothingInCommonChangesNothing) {
  const PosesByStamp then = straightFlight();
  PosesByStamp now;
  for (const auto& [stamp, T] : corrected(then, someCorrection())) now[stamp + kStep / 2] = T;
  for (const PosesByStamp& other : {PosesByStamp(), now}) {
    const Similarity S = MapCorrection(then, other).around({2, 1, 2}, 1.4).T_now_then;
    EXPECT_EQ(S.scale, 1);
    EXPECT_EQ(S.R, Eigen::Matrix3d::Identity());
    EXPECT_EQ(S.t, Eigen::Vector3d::Zero());
  }
}

TEST(MapCorrection, WhatCorrectionsAddMovesCloudsFromBeforeToNow) {
  const Similarity first = someCorrection(), second{0.98, expSO3({0, 0.1, 0}), {1, 2, 3}};
  const CloudCorrections before{{1, first}}, now{{1, compose(second, first)}, {2, second}};
  const CloudCorrections since = correctionsSince(before, now);
  const Eigen::Vector3d p(1, 2, 3);
  EXPECT_LT(distance(*since.at(1), second, p), 1e-12);
  EXPECT_LT(distance(*since.at(2), second, p), 1e-12) << "published since";
  EXPECT_FALSE(correctionsSince(before, {{1, std::nullopt}}).at(1)) << "has bent";
  EXPECT_FALSE(correctionsSince({{1, std::nullopt}}, now).at(1)) << "had bent before";
}

struct Point {
  Eigen::Vector3f position;
};

TEST(FollowedClouds, MoveUntilTheySettle) {
  FollowedClouds<Point> clouds(2);
  std::vector<Point> settled;
  const auto add = [&](std::int64_t stamp) {
    clouds.add(stamp, {{{1, 2, 3}}}, [&](const std::vector<Point>& points) { settled = points; });
  };
  add(1);
  add(2);
  EXPECT_TRUE(settled.empty());
  clouds.correct({{1, someCorrection()}, {7, someCorrection()}, {8, std::nullopt}});
  EXPECT_EQ(clouds.clouds()[1].second[0].position, Eigen::Vector3f(1, 2, 3));
  add(3);
  ASSERT_EQ(settled.size(), 1u);
  EXPECT_LT((settled[0].position.cast<double>() - someCorrection() * Eigen::Vector3d(1, 2, 3)).norm(), 1e-6)
      << "as it stood";
  ASSERT_EQ(clouds.clouds().size(), 2u);
  EXPECT_EQ(clouds.clouds()[0].first, 2);
  clouds.correct({{2, std::nullopt}});
  ASSERT_EQ(clouds.clouds().size(), 1u) << "where the map has bent";
  EXPECT_EQ(clouds.clouds()[0].first, 3);
}

TEST(MapCorrection, StampsThatWereSecondsAreFound) {
  PosesByStamp poses;
  const std::int64_t stamp = 1700000000123456789;
  poses[static_cast<std::int64_t>(1e9 * (1e-9 * static_cast<double>(stamp)))] = Pose::Identity();
  EXPECT_TRUE(poseOfImage(poses, stamp));
  EXPECT_FALSE(poseOfImage(poses, stamp + 1000000));
  EXPECT_FALSE(poseOfImage(poses, stamp - 1000000));
}

}  // namespace
}  // namespace air_ground_common
