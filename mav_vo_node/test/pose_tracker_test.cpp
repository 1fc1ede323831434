// PoseTracker and Relocalizer above a textured floor, in a map whose landmarks are where they are.
#include "../src/pose_tracker.h"

#include <gtest/gtest.h>

#include "../src/relocalizer.h"
#include "air_ground_common/statistics.h"
#include "synthetic_camera.h"

namespace mav_vo {
namespace {

using visual_frontend::Feature;
using visual_frontend::Keyframe;
using visual_frontend::LandmarkId;

constexpr double kHeight = 2;  // [m]

Pose above(double x, double y, double yaw = 0) {
  Pose T = Pose::Identity();
  T.linear() = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) * synthetic::T_imu_camera().linear();
  T.translation() = Eigen::Vector3d(x, y, kHeight);
  return T;
}

/// One keyframe at above(0, 0), the first image, with a landmark for each feature.
struct Floor : ::testing::Test {
  Floor() {
    settings.readout_time_stddev = 0;
    const cv::Mat first = image(above(0, 0));
    pose.track(-1, 0, first, false);
    pose.tracker().replenish();
    pose.beginMap(above(0, 0), Eigen::Vector3d::Zero());
    Keyframe keyframe;
    keyframe.T_map_camera = above(0, 0);
    keyframe.pyramid = pose.tracker().pyramid();
    for (const Feature& f : pose.tracker().features()) {
      const Eigen::Vector3d ray = keyframe.T_map_camera.linear() * f.normalized.homogeneous();
      const LandmarkId id = map.addLandmark(keyframe.T_map_camera.translation() - kHeight / ray.z() * ray);
      tracks.assign(f.id, id);
    }
    keyframe.observations = pose.observations();
    visual_frontend::describeKeyframe(first, camera, settings.place, keyframe);
    map.addKeyframe(std::move(keyframe));
    pose.settle(0, std::nullopt);
  }
  cv::Mat image(const Pose& T) const { return world.render(camera, T); }
  /// The image of this stamp, 0.1 s after the one before. Without `predicted` features are sought where they were.
  bool see(const Pose& T, double stamp, bool predicted = true) {
    pose.track(stamp - 0.1, stamp, image(T), predicted);
    return pose.locate(std::nullopt);
  }
  double error(const Pose& T) const { return (pose.pose().translation() - T.translation()).norm(); }
  /// Leaves so many of the tracks.
  void keepTracks(std::size_t count) {
    std::vector<TrackId> ids;
    for (const Feature& f : pose.tracker().features()) ids.push_back(f.id);
    ids.erase(ids.begin(), ids.begin() + static_cast<std::ptrdiff_t>(count));
    pose.tracker().remove(ids);
  }

  /// So many of a hundred landmarks go ways of their own.
  void scatter(int share) {
    const std::vector<LandmarkId> ids = map.landmarkIds();
    for (std::size_t i = 0; i < ids.size(); ++i) {
      const double k = static_cast<double>(i);
      if (static_cast<int>(i * 37 % 100) < share)
        map.landmark(ids[i]).position += 0.6 * Eigen::Vector3d(std::sin(1.7 * k), std::sin(2.9 * k), 0);
    }
  }

  synthetic::PlateWorld world{3, false};
  CameraModel camera = synthetic::camera();
  OdometrySettings settings;
  visual_frontend::Map map;
  visual_frontend::LandmarkTracks tracks;
  std::optional<GyroRotation> gyro;  // what it says of any two images
  PoseTracker pose{camera, settings, map, tracks, [this](double, double) { return gyro; }};
  Relocalizer relocalizer{camera, settings};
};

TEST_F(Floor, LandmarksTellWhereTheCameraIs) {
  const Pose T = above(0.06, -0.04, 0.03);
  ASSERT_TRUE(see(T, 0.1)) << pose.result().reason;
  EXPECT_LT(error(T), 0.004);
  EXPECT_LT(air_ground_common::rotationAngle(pose.pose().linear(), T.linear()), 0.002);
  for (const double depth : {pose.sceneDistance(), pose.depthMin(), pose.depthMax()}) EXPECT_NEAR(depth, kHeight, 0.05);
  const double variance = pose.result().covariance.diagonal().head<3>().maxCoeff();
  pose.transform({2.0, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()});
  EXPECT_NEAR(pose.sceneDistance(), 2 * kHeight, 0.1);
  EXPECT_NEAR(pose.result().covariance.diagonal().head<3>().maxCoeff(), 4 * variance, 1e-3 * variance);
}

TEST_F(Floor, TheNextImageIsWhereTheMotionLeads) {
  const Pose T = above(0.05, 0);
  ASSERT_TRUE(see(T, 0.1));
  pose.settle(0.1, above(0, 0));
  pose.track(0.1, 0.2, image(above(0.1, 0)), true);
  EXPECT_LT(error(above(0.1, 0)), 0.006) << "before the landmarks are asked";
  gyro = GyroRotation{Eigen::AngleAxisd(0.02, Eigen::Vector3d::UnitZ()).toRotationMatrix(), 0.001};
  ASSERT_TRUE(pose.locate(std::nullopt));
  pose.settle(0.2, T);
  pose.track(0.2, 0.3, image(above(0.15, 0, -0.02)), true);
  EXPECT_LT(air_ground_common::rotationAngle(pose.pose().linear(), above(0, 0, -0.02).linear()), 0.003);
}

TEST_F(Floor, TwoImagesAMillisecondApartTellOfNoVelocity) {
  const auto see = [this](const Pose& before, const Pose& now, double last, double stamp) {
    pose.track(last, stamp, image(now), true);
    ASSERT_TRUE(pose.locate(std::nullopt)) << pose.result().reason;
    pose.settle(stamp, before);
  };
  see(above(0, 0), above(0.05, 0), 0, 0.1);
  see(above(0.05, 0), above(0.1, 0), 0.1, 0.2);
  see(above(0.1, 0), above(0.103, 0.002), 0.2, 0.201);
  pose.track(0.201, 0.3, image(above(0.15, 0)), true);
  EXPECT_LT(error(above(0.15, 0)), 0.01) << "before the landmarks are asked";
}

TEST_F(Floor, KeyframesKeepTheTracksFromDrifting) {
  const auto drift = [this](const Pose& T) {  // median [px]
    std::vector<double> pixels;
    for (const Feature& f : pose.tracker().features())
      pixels.push_back(
          (*camera.project(T.inverse() * map.landmark(tracks.landmarkOf(f.id)).position) - f.pixel).norm());
    return air_ground_common::median(pixels);
  };
  std::vector<std::optional<Eigen::Vector2d>> drifted;
  for (const Feature& f : pose.tracker().features()) drifted.emplace_back(f.pixel + Eigen::Vector2d(0.6, 0));
  pose.tracker().move(drifted);
  const Pose T = above(0.04, -0.03, 0.03);
  pose.track(0, 0.1, image(T), true);
  EXPECT_GT(drift(T), 0.4);
  pose.realign();
  EXPECT_LT(drift(T), 0.2);
}

// Without a gyro the camera goes on turning as it did, and each feature is sought where that leads.
TEST_F(Floor, WithoutAGyroTheTurnGoesOn) {
  constexpr double kTurn = 0.12;  // between two images [rad]
  ASSERT_TRUE(see(above(0, 0, kTurn), 0.1)) << pose.result().reason;
  pose.settle(0.1, above(0, 0));
  const Pose T = above(0, 0, 2 * kTurn);
  pose.track(0.1, 0.2, image(T), true);
  EXPECT_LT(air_ground_common::rotationAngle(pose.pose().linear(), T.linear()), 0.005)
      << "before the landmarks are asked";
  ASSERT_TRUE(pose.locate(std::nullopt)) << pose.result().reason;
  EXPECT_LT(error(T), 0.01);
}

TEST_F(Floor, LandmarksThatDisagreeLoseTheirTracks) {
  const std::size_t before = pose.tracker().features().size();
  std::vector<LandmarkId> wrong = map.landmarkIds();
  wrong.resize(wrong.size() / 5);
  for (const LandmarkId id : wrong) map.landmark(id).position += Eigen::Vector3d(0.3, 0.1, 0);
  const Pose T = above(0.01, 0.01);
  ASSERT_TRUE(see(T, 0.1, false));
  EXPECT_GT(pose.result().inliers.size(), before - wrong.size()) << "they were tracked";
  EXPECT_LT(error(T), 0.004);
  EXPECT_LE(pose.tracker().features().size(), before - wrong.size());
  for (const Feature& f : pose.tracker().features())
    EXPECT_EQ(std::count(wrong.begin(), wrong.end(), tracks.landmarkIn(map, f.id)), 0);
}

TEST_F(Floor, TooFewLandmarksAreNoPose) {
  keepTracks(static_cast<std::size_t>(settings.min_inliers) - 1);
  EXPECT_FALSE(see(above(0.01, 0), 0.1));
  EXPECT_NE(pose.result().reason.find("known landmarks in view"), std::string::npos);
  EXPECT_LT(error(above(0, 0)), 1e-12) << "the pose is as before";
  // The gyro's turn leaves half as many unknowns.
  EXPECT_TRUE(pose.locate(0.01)) << pose.result().reason;
  EXPECT_LT(error(above(0.01, 0)), 0.004);
}

TEST_F(Floor, AThirdOfTheLandmarksIsNotBelieved) {
  scatter(66);
  EXPECT_FALSE(see(above(0.01, 0), 0.1, false));
  EXPECT_NE(pose.result().reason.find("landmarks agree on a pose"), std::string::npos) << pose.result().reason;
  EXPECT_LT(error(above(0, 0)), 1e-12);
}

TEST_F(Floor, HalfOfThemIs) {
  scatter(50);
  ASSERT_TRUE(see(above(0.01, 0), 0.1, false)) << pose.result().reason;
  EXPECT_LT(error(above(0.01, 0)), 0.004);
}

/// A bus with 55 of a hundred landmarks on it, which has moved by `step` in the image of above(0.01, 0).
struct Bus : Floor {
  void drive(const Eigen::Vector3d& step) {
    const std::vector<LandmarkId> ids = map.landmarkIds();
    for (std::size_t i = 0; i < ids.size(); ++i)
      if (i * 37 % 100 < 55) map.landmark(ids[i]).position -= step;
  }
};

TEST_F(Bus, OfTwoMotionsTheOneIsTheCamerasThatThePredictionKnows) {
  ASSERT_TRUE(see(above(0, 0), 0.1)) << pose.result().reason;
  pose.settle(0.1, above(0, 0));
  drive({0, 0.06, 0});
  ASSERT_TRUE(see(above(0.01, 0), 0.2)) << pose.result().reason;
  EXPECT_LT(error(above(0.01, 0)), 0.004);
  // The bus is not followed any more.
  pose.settle(0.2, above(0, 0));
  ASSERT_TRUE(see(above(0.02, 0), 0.3)) << pose.result().reason;
  EXPECT_GT(pose.result().inlier_count, 0.9 * tracks.count());
  EXPECT_LT(error(above(0.02, 0)), 0.004);
}

TEST_F(Bus, WithoutAPredictionNeitherIsBelieved) {
  drive({0, 0.06, 0});
  EXPECT_FALSE(see(above(0.01, 0), 0.1, false));
  EXPECT_NE(pose.result().reason.find("two motions"), std::string::npos) << pose.result().reason;
  EXPECT_LT(error(above(0, 0)), 1e-12);
}

TEST_F(Floor, LandmarksWithoutATrackAreFoundAgain) {
  keepTracks(30);
  const Pose T = above(0.02, 0.01);
  ASSERT_TRUE(see(T, 0.1));
  const std::size_t before = pose.tracker().features().size();
  pose.reobserve(settings.reobservation);
  EXPECT_GT(pose.tracker().features().size(), before + 30);
  ASSERT_TRUE(pose.locate(std::nullopt));
  EXPECT_GT(pose.result().inlier_count, static_cast<int>(before) + 30) << "they tell the pose, too";
  EXPECT_LT(error(T), 0.004);
}

/// Lost at 0.1 s, with no track left.
struct Lost : Floor {
  bool find(const Pose& T, double stamp, double max_distance = 100) {
    pose.track(stamp - 0.1, stamp, image(T), false);
    visual_frontend::RelocalizationGate gate;
    gate.T_map_last = above(0, 0);
    gate.max_distance = max_distance;
    return relocalizer.find(stamp, image(T), map, gate, std::nullopt, pose);
  }
  void lose() {
    pose.tracker().reset();
    relocalizer.begin(0.1);
  }
};

TEST_F(Lost, NearItsLastPoseTheCameraIsFoundByTheLandmarksPatches) {
  lose();
  EXPECT_EQ(relocalizer.lostSince(), 0.1);
  const Pose T = above(0.04, -0.02);
  ASSERT_TRUE(find(T, 0.1));
  EXPECT_LT(error(T), 0.006);
  EXPECT_EQ(relocalizer.reason(), "") << "no place was sought";
}

TEST_F(Lost, MeanwhileTheGyroTurnsIt) {
  lose();
  const cv::Mat black(camera.height, camera.width, CV_8U, cv::Scalar(0));
  visual_frontend::RelocalizationGate gate;
  for (int i = 1; i <= 3; ++i) {
    gyro = GyroRotation{Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()).toRotationMatrix(), 0.001};
    pose.track(0.1 * i, 0.1 * i + 0.1, black, false);
    EXPECT_FALSE(relocalizer.find(0.1 * i + 0.1, black, map, gate, std::nullopt, pose));
  }
  // The image in which it was lost had its turn already.
  EXPECT_LT(air_ground_common::rotationAngle(pose.pose().linear(), above(0, 0, -0.2).linear()), 1e-9);
}

TEST_F(Lost, FarAwayItIsFoundByRecognisingThePlaceEveryFifthImage) {
  lose();
  const Pose T = above(0.3, 0.2, 1.5);
  const cv::Mat black(camera.height, camera.width, CV_8U, cv::Scalar(0));
  EXPECT_FALSE(relocalizer.find(2, black, map, {}, std::nullopt, pose));
  EXPECT_NE(relocalizer.reason().find("no known place recognised"), std::string::npos);
  for (int i = 1; i < 5; ++i) EXPECT_FALSE(find(T, 2 + 0.1 * i)) << i;
  EXPECT_NE(relocalizer.reason(), "");
  ASSERT_TRUE(find(T, 2.5)) << relocalizer.reason();
  EXPECT_EQ(relocalizer.reason(), "") << "of an earlier image";
  EXPECT_LT(error(T), 0.01);
  EXPECT_LT(air_ground_common::rotationAngle(pose.pose().linear(), T.linear()), 0.005);
}

TEST_F(Lost, NotWhereItCannotHaveCome) {
  lose();
  EXPECT_FALSE(find(above(0.3, 0.2, 1.5), 2, 0.2));
  EXPECT_NE(relocalizer.reason(), "");
  relocalizer.reset();
  EXPECT_EQ(relocalizer.reason(), "") << "of another map";
  relocalizer.begin(2);
  EXPECT_EQ(relocalizer.reason(), "");
  EXPECT_TRUE(find(above(0.3, 0.2, 1.5), 2.1, 0.5)) << relocalizer.reason();
}

}  // namespace
}  // namespace mav_vo
