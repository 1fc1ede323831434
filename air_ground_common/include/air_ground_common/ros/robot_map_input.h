// What a node takes of another robot's map: its clock watched for jumps, its id and frame for another map.
#pragma once

#include <air_ground/VoStatus.h>
#include <std_msgs/Header.h>

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/robot_map_session.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"

namespace air_ground_common::ros_utils {

/// The finite points of a cloud; none, and counted, where it has none or cannot be read. `what`: "dense clouds".
std::optional<std::vector<CloudPoint>> readCloud(const sensor_msgs::PointCloud2& msg, const std::string& what,
                                                 NodeHealth& health);

/// Not thread-safe. Robots are watched apart: when the clock of one steps back, another that stands still does not send
/// its map again.
class RobotMapInput {
 public:
  /// `robot`: "MAV", for messages. `forget`: called when its map has ended, before what shows it is used; `revise`,
  /// unless null, when it was corrected as a whole: the parts that came before are dropped, and those that still come.
  RobotMapInput(const std::string& robot, std::size_t streams, RobotMapSession map, NodeHealth& health,
                std::function<void()> forget, std::function<void()> revise = nullptr);
  RobotMapInput(const RobotMapInput&) = delete;

  // Each returns false, and counts, where the message is to be dropped. One without a stamp is taken as it comes.

  /// By its stamp alone.
  bool admit(std::size_t stream, const ros::Time& stamp);
  /// A part of the map. `what`: "dense clouds".
  bool admitMap(std::size_t stream, const std_msgs::Header& header, const std::string& what);
  /// The robot's status, which names its map.
  bool admitStatus(std::size_t stream, const air_ground::VoStatus& msg);

  /// The map's id comes along with something else.
  void observe(std::uint32_t id, const ros::Time& stamp, bool second_hand);
  /// True where the frame is the expected one; else it is counted.
  bool isFrame(const std::string& frame, const std::string& expected, const std::string& what) const;
  /// All is to be forgotten; `forget` is called.
  void restart();
  const RobotMapSession& map() const { return map_; }

 private:
  const std::string robot_;
  NodeHealth& health_;
  RobotMapSession map_;
  const std::function<void()> forget_, revise_;
  StreamGate gate_;
  int corrections_ = 0;
};

}  // namespace air_ground_common::ros_utils
