#include "air_ground_common/ros/map_correction.h"

#include <cmath>
#include <stdexcept>

#include "air_ground_common/ros/conversions.h"

namespace air_ground_common::ros_utils {

namespace {

Pose nearPose(const geometry_msgs::Pose& msg) {
  const Pose T = fromMsg(msg);
  if (T.translation().cwiseAbs().maxCoeff() > 1e6) throw std::invalid_argument("a pose beyond 1000 km");
  return T;
}

}  // namespace

nav_msgs::Path toMsg(const Trajectory& trajectory, const std_msgs::Header& header) {
  nav_msgs::Path path;
  path.header = header;
  path.poses.resize(trajectory.size());
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    path.poses[i].header.stamp.fromSec(trajectory[i].stamp);
    path.poses[i].header.frame_id = header.frame_id;
    path.poses[i].pose = toMsg(trajectory[i].T_map_body);
  }
  return path;
}

PosesByStamp fromMsg(const nav_msgs::Path& msg) {
  PosesByStamp poses;
  for (const auto& p : msg.poses) poses[static_cast<std::int64_t>(p.header.stamp.toNSec())] = nearPose(p.pose);
  return poses;
}

air_ground::CloudCorrections toMsg(const CloudCorrections& corrections, const std_msgs::Header& header,
                                   std::uint32_t map_id) {
  air_ground::CloudCorrections msg;
  msg.header = header;
  msg.map_id = map_id;
  for (const auto& [stamp, S] : corrections) {
    Pose T = Pose::Identity();
    if (S) {
      T.linear() = S->R;
      T.translation() = S->t;
    }
    msg.stamps.emplace_back().fromNSec(static_cast<std::uint64_t>(stamp));
    msg.poses.push_back(toMsg(T));
    msg.scales.push_back(S ? S->scale : 0);
  }
  return msg;
}

CloudCorrections fromMsg(const air_ground::CloudCorrections& msg) {
  if (msg.poses.size() != msg.stamps.size() || msg.scales.size() != msg.stamps.size())
    throw std::invalid_argument("corrections of clouds: stamps, poses and scales differ in number");
  CloudCorrections corrections;
  for (std::size_t i = 0; i < msg.stamps.size(); ++i) {
    const Pose T = nearPose(msg.poses[i]);
    const bool bent = msg.scales[i] == 0;
    if (!bent && !(msg.scales[i] > 0.1 && msg.scales[i] < 10))
      throw std::invalid_argument("corrections of clouds: a scale is neither 0 nor between 0.1 and 10");
    auto& S = corrections[static_cast<std::int64_t>(msg.stamps[i].toNSec())];
    if (!bent) S = Similarity{msg.scales[i], T.linear(), T.translation()};
  }
  return corrections;
}

}  // namespace air_ground_common::ros_utils
