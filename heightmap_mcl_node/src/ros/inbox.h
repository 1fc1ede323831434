// What has come in and waits for the worker: the newest ground cloud, aerial clouds with the odometry at their stamps,
// commands. Decides which messages are of the maps that the robots have now.
#pragma once

#include <air_ground/CloudCorrections.h>
#include <air_ground/VoStatus.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <nav_msgs/Odometry.h>
#include <sensor_msgs/PointCloud2.h>

#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/map_correction.h"
#include "air_ground_common/ros/alignment_broadcaster.h"
#include "air_ground_common/ros/recent_stamps.h"
#include "air_ground_common/ros/robot_map_input.h"
#include "air_ground_common/trajectory.h"
#include "air_ground_common/vertical.h"
#include "node_parameters.h"

namespace heightmap_mcl {

struct Command {
  bool reset = false;          // forget all
  bool forget_aerial = false;  // fresh map of the MAV
  bool relocalize = false;     // search again on the maps at hand
  bool forget_ground = false;
  std::optional<Prior> prior;
  bool forgets() const { return reset || forget_aerial || forget_ground; }
  bool any() const { return forgets() || relocalize; }
};

struct AerialMessage {
  sensor_msgs::PointCloud2ConstPtr cloud;                   // null: none
  std::optional<air_ground_common::StampedPose> reference;  // of the MAV at its stamp
};

/// What is to be done next.
struct Work {
  Command command;
  sensor_msgs::PointCloud2ConstPtr ground;  // null: none
  bool ground_corrected = false;            // as a whole, since the ground cloud before
  AerialMessage aerial;
  std::vector<AerialMessage> before;     // older ones that have waited with it
  std::vector<AerialMessage> passed_by;  // older ones that came faster than they were searched
  bool own_unit = false;                 // the aerial clouds are of a map without scale
  air_ground_common::Vertical vertical;  // of that map
  std::uint32_t map_id = 0, ground_map_id = 0;
  std::string ground_frame, mav_frame;
  std::optional<air_ground_common::CloudCorrections> corrections;
  bool idle = false;  // nothing came: there is time for clouds of before
};

/// Thread-safe.
class Inbox {
 public:
  using Cloud = sensor_msgs::PointCloud2ConstPtr;

  /// `resubscribe_ground` must return at once; it is called when a latched ground map is wanted once more.
  Inbox(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health,
        std::function<void()> resubscribe_ground);

  void addAerial(const Cloud& msg);
  void addGround(const Cloud& msg);
  void addCorrections(const air_ground::CloudCorrectionsConstPtr& msg);
  void addOdometry(const nav_msgs::OdometryConstPtr& msg);
  void addMavStatus(const air_ground::VoStatusConstPtr& msg);
  void addGroundStatus(const air_ground::VoStatusConstPtr& msg);
  void setInitialPose(const geometry_msgs::PoseWithCovarianceStampedConstPtr& msg);
  void reset();
  void relocalize();

  /// Waits for something to do, not longer than `patience` [s] where that is given; empty after stop(). `together`: all
  /// clouds that wait, else the oldest alone.
  std::optional<Work> next(const std::optional<double>& patience, bool together);
  void stop();

  /// Keeps the alignment for tf, or none. False, and none, when it is about a map that has ended meanwhile.
  bool conclude(const std::optional<air_ground_common::Pose>& T_ground_mav);

  /// What tf says.
  std::optional<air_ground_common::ros_utils::AlignmentBroadcaster::Edge> alignment() const;

 private:
  using Clock = std::chrono::steady_clock;
  struct WaitingCloud {
    Cloud cloud;
    Clock::time_point until;  // the cloud waits for odometry up to its stamp
  };
  enum MavStream { kAerial, kCorrections, kOdometry, kMavStatus, kMavStreams };
  enum GroundStream { kGround, kGroundStatus, kGroundStreams };
  static constexpr std::size_t kOdometryKept = 4000;

  // mutex_ held.
  void forgetAerial();
  void forgetGround();
  void reviseGround();
  void endSearch();
  bool pending() const;
  bool cloudReady() const;
  AerialMessage popCloud();
  std::optional<air_ground_common::StampedPose> referenceAt(double stamp) const;

  const NodeSettings settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  const std::function<void()> resubscribe_ground_;

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  Command command_;
  std::deque<WaitingCloud> clouds_;
  std::deque<Cloud> passed_by_;                        // fell out of clouds_
  air_ground_common::ros_utils::RecentStamps stamps_;  // of clouds that came
  Cloud ground_;
  ros::Time ground_stamp_;  // of the last one that came
  bool ground_corrected_ = false;
  air_ground_common::Vertical mav_vertical_;  // of a map without scale
  std::optional<air_ground_common::CloudCorrections> corrections_;
  air_ground_common::ros_utils::RobotMapInput mav_, ground_robot_;
  air_ground_common::Trajectory odometry_;
  std::optional<air_ground_common::Pose> T_ground_mav_;  // what tf says: while CONVERGED
};

}  // namespace heightmap_mcl
