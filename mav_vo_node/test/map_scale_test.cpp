#include "../src/map_scale.h"

#include <gtest/gtest.h>

#include "synthetic_flight.h"

namespace mav_vo {
namespace {

constexpr double kFrame = 0.05;  // [s]
constexpr double kScale = 2.5;   // metres a unit of the map

/// A flight seen without noise in a map of another unit, with two keyframes; the IMU shows it from `begin` on, but for
/// an image's interval in every `gap_every` [s].
class Flight {
 public:
  explicit Flight(double duration, double gap_every = 0) : gap_every_(gap_every) {
    std::mt19937 random(1);
    for (const auto& s : flight_.imuSamples(kBegin - 0.1, kBegin + duration + 0.1, 200, ImuNoise{}, ImuBias{}, random))
      buffer_.add(s);
    for (const double t : {kBegin, kBegin + 1}) {
      visual_frontend::Keyframe keyframe;
      keyframe.T_map_camera = seen(t);
      map.addKeyframe(keyframe);
    }
    scale.begin(0.01);
    for (int i = 0; i * kFrame < duration; ++i) add(kBegin + i * kFrame);
  }

  visual_frontend::Map map;
  FrameTrajectory frames;
  MapScale scale{OdometrySettings{}, synthetic::T_imu_camera().inverse()};

  static constexpr double kBegin = 2.5;

 private:
  Pose seen(double t) const {
    Pose T = flight_.T_world_imu(t) * synthetic::T_imu_camera();
    T.translation() /= kScale;
    return T;
  }
  void add(double t) {
    std::optional<Preintegration> motion;
    if (!frames.empty()) {
      motion.emplace(ImuNoise{}, ImuBias{});
      motion->integrate(samplesBetween(buffer_, frames.lastStamp(), t));
      if (gap_every_ > 0 && std::fmod(t, gap_every_) < 0.05) motion.reset();
    }
    frames.add(t, seen(t), t < kBegin + 1 ? 0 : 1, map);
    scale.add(frames, map, 1 / kScale, 1e-8 * Eigen::Matrix3d::Identity(), motion);
  }
  double gap_every_;
  synthetic::Flight flight_;
  ImuBuffer buffer_{1000};
};

TEST(MapScale, ImagesMoveWithTheMap) {
  Flight flight(12);
  ASSERT_TRUE(flight.scale.known(0)) << flight.scale.reason(0);
  EXPECT_NEAR(flight.scale.filter().scale(), kScale, 0.02 * kScale);
  const air_ground_common::Similarity S{kScale, Eigen::Matrix3d::Identity(), Eigen::Vector3d(1, 2, 0)};
  flight.map.transform(S);
  flight.frames.rescale(S.scale);
  flight.scale.transform(S);
  EXPECT_NEAR(flight.scale.filter().scale(), 1, 0.02);
  flight.scale.estimateAnew(flight.frames, flight.map);
  EXPECT_NEAR(flight.scale.filter().scale(), 1, 0.02);
}

TEST(MapScale, JudgesTheMapAsItIsNow) {
  Flight flight(12);
  const air_ground_common::Similarity S{kScale * 1.1, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()};
  flight.map.transform(S);
  flight.frames.rescale(S.scale);
  visual_frontend::InertialMap inertial;
  inertial.states[0].velocity = synthetic::Flight{}.velocity(Flight::kBegin);
  inertial.states[1].velocity = synthetic::Flight{}.velocity(Flight::kBegin + 1);
  flight.scale.judgeAnew(flight.frames, flight.map, inertial, Flight::kBegin + 3);
  EXPECT_NEAR(flight.scale.filter().scale(), 1 / 1.1, 0.02);
}

// A second of motion never comes: "it needs a second of motion" would send the pilot, not the mechanic.
TEST(MapScale, NamesGapsOfTheImu) {
  Flight flight(12, 0.9);
  EXPECT_FALSE(flight.scale.known(60));
  EXPECT_NE(flight.scale.reason(60).find("gaps"), std::string::npos) << flight.scale.reason(60);
}

TEST(MapScale, AsksForLessOfAMapThatWaits) {
  Flight flight(0.2);
  EXPECT_FALSE(flight.scale.known(100));
  EXPECT_EQ(flight.scale.reason(0), "metric scale is not known yet: it needs a second of motion");
  flight.scale.begin(0.01);
  EXPECT_FALSE(flight.scale.filter().initialized());
}

}  // namespace
}  // namespace mav_vo
