#include "air_ground_common/ros/robot_map_input.h"

#include <ros/console.h>

#include "map_ids.h"

namespace air_ground_common::ros_utils {

std::optional<std::vector<CloudPoint>> readCloud(const sensor_msgs::PointCloud2& msg, const std::string& what,
                                                 NodeHealth& health) {
  try {
    std::size_t dropped = 0;
    auto points = cloudFromMsg(msg, &dropped);
    health.count("points of " + what + " that are not finite, or beyond 1000 km", dropped);
    if (!points.empty()) return points;
    health.count(what + " without a finite point");
  } catch (const std::exception& e) {
    health.count(what + " unreadable: " + e.what());
  }
  return std::nullopt;
}

RobotMapInput::RobotMapInput(const std::string& robot, std::size_t streams, RobotMapSession map, NodeHealth& health,
                             std::function<void()> forget, std::function<void()> revise)
    : robot_(robot),
      health_(health),
      map_(std::move(map)),
      forget_(std::move(forget)),
      revise_(std::move(revise)),
      gate_(streams, health, [this] {
        ROS_WARN_STREAM("the " << robot_ << "'s time jumped back (a looped bag?): its map starts afresh");
        health_.count("time jumps");
        restart();
      }) {}

bool RobotMapInput::admit(std::size_t stream, const ros::Time& stamp) {
  return stamp.isZero() || gate_.admit(stream, stamp);
}

bool RobotMapInput::admitMap(std::size_t stream, const std_msgs::Header& header, const std::string& what) {
  if (!map_.knows(header.frame_id)) return isFrame(header.frame_id, map_.expectedFrame(), what);
  if (!admit(stream, header.stamp)) return false;
  const RobotMapSession::Verdict verdict = map_.admit(header.frame_id, header.stamp.toSec());
  if (verdict == RobotMapSession::Verdict::kStale) health_.count(what + " of an earlier map dropped");
  if (verdict == RobotMapSession::Verdict::kNewMap) forget_();
  return verdict != RobotMapSession::Verdict::kStale;
}

bool RobotMapInput::admitStatus(std::size_t stream, const air_ground::VoStatus& msg) {
  if (!admit(stream, msg.header.stamp)) return false;
  observe(msg.map_id, msg.header.stamp, false);
  if (!revise_ || !map_.revise(msg.map_revision, msg.header.stamp.toSec())) return true;
  health_.value("corrections of the map of the " + robot_, ++corrections_);
  revise_();
  return true;
}

void RobotMapInput::observe(std::uint32_t id, const ros::Time& stamp, bool second_hand) {
  if (!map_.observe(id, stamp.toSec(), second_hand)) return;
  // The first one ends nothing.
  if (id % kMapsOfOneStart == 1 && map_.frame().empty()) {
    ROS_INFO_STREAM("the " << robot_ << " has begun its first map (" << id << ")");
  } else {
    ROS_WARN_STREAM("the " << robot_ << " has begun map " << id << ": what was made of the one before is forgotten");
    health_.count("new maps of the " + robot_);
  }
  forget_();
}

bool RobotMapInput::isFrame(const std::string& frame, const std::string& expected, const std::string& what) const {
  if (!frame.empty() && withoutSlash(frame) == withoutSlash(expected)) return true;
  health_.count(what + " in frame '" + frame + "' dropped: expected '" + expected + "'");
  return false;
}

void RobotMapInput::restart() {
  map_.restart();
  forget_();
}

}  // namespace air_ground_common::ros_utils
