#include "../src/frame_records.h"

#include <gtest/gtest.h>

#include "air_ground_common/geometry.h"

namespace mav_vo {
namespace {

using air_ground_common::Pose;
using visual_frontend::KeyframeId;

struct Flight {
  Flight() {
    for (int i = 0; i < 2; ++i) {
      visual_frontend::Keyframe keyframe;
      keyframe.T_map_camera = air_ground_common::yawPose(0.4 * i, {1.0 * i, 2, 3});
      ids.push_back(map.addKeyframe(keyframe));
    }
  }
  void add(double stamp, KeyframeId reference, bool motion = true) {
    FrameRecord record;
    record.stamp = stamp;
    record.reference = reference;
    record.T_reference_camera = air_ground_common::yawPose(0.1, {0.01 * stamp, 0.2, 0});
    record.position_covariance = Eigen::Vector3d(1, 4, 9).asDiagonal();
    if (motion) record.motion = std::make_unique<const Preintegration>(ImuNoise(), ImuBias());
    records.add(std::move(record));
  }
  visual_frontend::Map map;
  std::vector<KeyframeId> ids;
  FrameRecords records;
};

TEST(FrameRecords, StayWhereTheyAreWhenTheirKeyframeGoes) {
  Flight flight;
  flight.add(1, flight.ids[0]);
  flight.add(2, flight.ids[1]);
  const Pose before = flight.records.lastPose(flight.map);
  const Pose T_to_from =
      flight.map.keyframe(flight.ids[0]).T_map_camera.inverse() * flight.map.keyframe(flight.ids[1]).T_map_camera;
  flight.records.rebase(flight.ids[1], flight.ids[0], T_to_from);
  EXPECT_EQ(flight.records.back().reference, flight.ids[0]);
  EXPECT_TRUE(flight.records.lastPose(flight.map).isApprox(before, 1e-12));
  flight.records.lastIsKeyframe(flight.ids[1]);
  EXPECT_TRUE(flight.records.lastPose(flight.map).isApprox(flight.map.keyframe(flight.ids[1]).T_map_camera, 1e-12));
}

TEST(FrameRecords, MoveWithTheMap) {
  Flight flight;
  flight.add(1, flight.ids[0]);
  flight.add(2, flight.ids[1]);
  const auto before = flight.records.poses(flight.map);
  const Eigen::Matrix3d R = air_ground_common::expSO3({0.1, -0.2, 0.5});
  const air_ground_common::Similarity S{2.5, R, Eigen::Vector3d(1, -1, 4)};
  flight.map.transform(S);
  flight.records.transform(S);
  const auto after = flight.records.poses(flight.map);
  for (std::size_t i = 0; i < after.size(); ++i) {
    EXPECT_TRUE(after[i].T_map_body.translation().isApprox(S * before[i].T_map_body.translation(), 1e-12));
    EXPECT_TRUE(after[i].T_map_body.linear().isApprox(R * before[i].T_map_body.linear(), 1e-12));
  }
  const Eigen::Matrix3d expected = 6.25 * R * Eigen::Vector3d(1, 4, 9).asDiagonal() * R.transpose();
  EXPECT_TRUE(flight.records[0].position_covariance.isApprox(expected, 1e-12));
}

TEST(FrameRecords, AreBoundedOnALongFlight) {
  Flight flight;
  for (int i = 0; i < 2000; ++i) flight.add(0.05 * i, flight.ids[0]);
  EXPECT_EQ(flight.records[0].motion, nullptr);
  EXPECT_EQ(flight.records[1199].motion, nullptr);
  EXPECT_NE(flight.records[1200].motion, nullptr);
  for (int i = 2000; i <= 40000; ++i) flight.add(0.05 * i, flight.ids[0], false);
  EXPECT_EQ(flight.records.size(), 30001u);
  EXPECT_EQ(flight.records.back().stamp, 0.05 * 40000);
  EXPECT_EQ(flight.records[1].stamp, 0.05 * 2);
}

}  // namespace
}  // namespace mav_vo
