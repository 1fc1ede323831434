// The running node with heading_mode compass.
#include <sensor_msgs/MagneticField.h>

#include "node_fixture.h"

namespace {

class CompassNodeTest : public NodeTest {
 protected:
  CompassNodeTest() : NodeTest("with_compass") {}

  void SetUp() override {
    NodeTest::SetUp();
    mav_field_ = node_.advertise<sensor_msgs::MagneticField>("mav/imu/mag", 100);
    ground_field_ = node_.advertise<sensor_msgs::MagneticField>("ground/imu/mag", 100);
    ground_odometry_ = node_.advertise<nav_msgs::Odometry>("ground/odometry", 100);
    mounting_ = node_.advertise<tf2_msgs::TFMessage>("/tf_static", 1, true);
    ASSERT_TRUE(spinUntil([&] {
      return mav_field_.getNumSubscribers() > 0 && ground_field_.getNumSubscribers() > 0 &&
             ground_odometry_.getNumSubscribers() > 0 && mounting_.getNumSubscribers() > 0;
    }));
    // The ground robot's magnetometer is turned by 0.7 rad in its base.
    tf2_msgs::TFMessage all;
    all.transforms.resize(1);
    all.transforms[0].header.frame_id = "ground_base_link";
    all.transforms[0].child_frame_id = "ground_mag";
    all.transforms[0].transform.rotation = ros_utils::toMsg(air_ground_common::yawPose(0.7, {})).orientation;
    mounting_.publish(all);
  }

  static sensor_msgs::MagneticField field(double direction, const std::string& frame, const ros::Time& stamp) {
    sensor_msgs::MagneticField msg;
    msg.header.frame_id = frame;
    msg.header.stamp = stamp;
    msg.magnetic_field.x = 2e-5 * std::cos(direction);
    msg.magnetic_field.y = 2e-5 * std::sin(direction);
    msg.magnetic_field.z = -4e-5;
    return msg;
  }

  // What both robots read where north is along x of the MAV's map, whose heading in the ground map is `yaw`, and the
  // ground robot's heading 1.1 rad.
  void sendReadings(double yaw) {
    nav_msgs::Odometry odometry;
    odometry.header.frame_id = "ground_map";
    odometry.header.stamp = stamp_;
    odometry.child_frame_id = "ground_base_link";
    odometry.pose.pose = ros_utils::toMsg(air_ground_common::yawPose(1.1, {1, 2, 0}));
    ground_odometry_.publish(odometry);
    sendOdometry({0, 0, 2}, stamp_);
    for (int k = 0; k < 30; ++k) {
      mav_field_.publish(field(0, "mav_base_link", stamp_));
      ground_field_.publish(field(yaw - 1.1 - 0.7, "/ground_mag", stamp_));  // as old drivers name frames
    }
  }

  double heading() const { return air_ground_common::yawOf(ros_utils::fromMsg(last().pose.pose).rotation()); }

  // Readings come until the estimate's heading is that of the compasses; which topic is read first nobody knows.
  bool followsTheCompass(double yaw) {
    return spinUntil([&] {
      sendReadings(yaw);
      const std::size_t before = coarse_.messages.size();
      if (!call("heightmap_mcl/relocalize") || !spinUntil([&] { return coarse_.messages.size() > before; }))
        return false;
      return std::abs(air_ground_common::wrapAngle(heading() - yaw)) < 0.6;  // +-3 sigma of 0.17 rad are searched
    });
  }

  ros::Publisher mav_field_, ground_field_, ground_odometry_, mounting_;
};

TEST_F(CompassNodeTest, TheHeadingIsSoughtWhereBothCompassesSay) {
  const auto run = world(601, 4);
  const double truth = air_ground_common::yawOf(run.T_ground_mav[0].rotation());
  ASSERT_TRUE(sendGround(run));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  // All headings as long as nothing is known: the maps tell.
  EXPECT_LT(std::abs(air_ground_common::wrapAngle(heading() - truth)), 0.1);
  // Iron beside a compass: what it says is looked at alone, and cannot be verified.
  const double wrong = air_ground_common::wrapAngle(truth + 1.8);
  ASSERT_TRUE(followsTheCompass(wrong)) << heading() << " instead of " << wrong;
  EXPECT_NE(last().status, AlignmentEstimate::STATUS_CONVERGED);

  ASSERT_TRUE(call("heightmap_mcl/reset"));
  ground_map_.messages.clear();
  coarse_.messages.clear();
  stamp_ += ros::Duration(2);
  ASSERT_TRUE(sendGround(run));
  ASSERT_TRUE(sendAerial(run.aerial[0]));
  ASSERT_TRUE(followsTheCompass(truth));
  for (int k = 1; k < 4; ++k) ASSERT_TRUE(sendAerial(run.aerial[k]));
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
  const auto error = syn::errorOf(ros_utils::fromMsg(last().pose.pose), run.T_ground_mav[3], run.aerial[3].reference);
  EXPECT_LT(error.position, 0.25);
  EXPECT_LT(error.yaw, 0.09);
}

}  // namespace
