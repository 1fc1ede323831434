// Magnetometers and odometry of both robots in, the heading that they give out: heading_mode compass.
#pragma once

#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/MagneticField.h>

#include <mutex>
#include <optional>
#include <string>

#include "air_ground_common/geometry.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/transform_buffer.h"
#include "heightmap_mcl/compass.h"

namespace heightmap_mcl {

/// Callbacks come from the node's own thread; the rest may be called from any.
class CompassInput {
 public:
  /// `sigma`: see headingPrior.
  CompassInput(ros::NodeHandle& handle, air_ground_common::ros_utils::NodeHealth& health, double sigma);

  std::optional<Prior> prior() const;
  /// A fresh map has another heading.
  void forgetMav();
  void forgetGround();

 private:
  struct Robot {
    std::string name;
    ros::Subscriber field, odometry;
    MagneticNorth north;
    std::optional<Eigen::Quaterniond> R_map_base;  // the newest
    ros::Time stamp;                               // of it
    std::string base_frame;
  };
  void onOdometry(Robot& robot, const nav_msgs::Odometry& msg);
  void onField(Robot& robot, const sensor_msgs::MagneticField& msg);

  air_ground_common::ros_utils::NodeHealth& health_;
  const double sigma_;
  air_ground_common::ros_utils::TransformBuffer transforms_;
  mutable std::mutex mutex_;
  Robot mav_{"mav", {}, {}, {}, {}, {}, {}}, ground_{"ground", {}, {}, {}, {}, {}, {}};
};

}  // namespace heightmap_mcl
