// Pose refinement and map augmentation (A-VII): ROS around icp_refine::AlignmentRefiner. Callbacks check and convert
// what comes; RefineWorker works on it; AlignmentOutput publishes.
#include <air_ground/VoStatus.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <std_srvs/Trigger.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/recent_stamps.h"
#include "air_ground_common/ros/robot_map_input.h"
#include "alignment_input.h"
#include "chain_parameter.h"
#include "ground_camera.h"
#include "map_file.h"
#include "refine_worker.h"

namespace icp_refine {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;
using air_ground_common::RobotMapSession;

class IcpRefineNode {
 public:
  explicit IcpRefineNode(const NodeSettings& settings)
      : private_("~"),
        settings_(settings),
        health_("icp_refine"),
        output_(settings_, health_),
        worker_(settings_, readChain(private_, settings_.chain_file), output_, health_),
        mav_(
            "MAV", kMavStreams, RobotMapSession(settings_.mav_map_frame, settings_.visual_map_frame), health_,
            [this] { startMap(); }, [this] { worker_.post(&Inbox::reviseMap); }),
        ground_(
            "ground robot", kGroundStreams, RobotMapSession(settings_.ground_map_frame), health_,
            [this] { startGround(); }, [this] { reviseGround(); }) {
    coarse_subscriber_ = handle_.subscribe("alignment/coarse", 50, &IcpRefineNode::onCoarse, this);
    views_subscriber_ = handle_.subscribe("alignment/views", 50, &IcpRefineNode::onViews, this);
    aerial_subscriber_ = handle_.subscribe("mav/dense_cloud", 50, &IcpRefineNode::onAerial, this);
    corrections_subscriber_ = handle_.subscribe("mav/cloud_corrections", 20, &IcpRefineNode::onCorrections, this);
    ground_subscriber_ = handle_.subscribe("ground/map_cloud", 2, &IcpRefineNode::onGround, this);
    keyframes_subscriber_ = handle_.subscribe("ground/map_keyframes", 5, &IcpRefineNode::onKeyframes, this);
    ground_status_subscriber_ = handle_.subscribe("ground/slam_status", 100, &IcpRefineNode::onGroundStatus, this);
    odometry_subscriber_ = handle_.subscribe("mav/odometry", 100, &IcpRefineNode::onOdometry, this);
    status_subscriber_ = handle_.subscribe("mav/vo_status", 500, &IcpRefineNode::onVoStatus, this);
    scale_subscriber_ = handle_.subscribe("mav/map_scale", 5, &IcpRefineNode::onMapScale, this);
    guess_subscriber_ = handle_.subscribe("initialpose", 5, &IcpRefineNode::onGuess, this);
    reset_service_ = private_.advertiseService("reset", &IcpRefineNode::onReset, this);
    refine_service_ = private_.advertiseService("refine", &IcpRefineNode::onRefine, this);
    for (const auto* s : {&aerial_subscriber_, &ground_subscriber_}) health_.expectInput(s->getTopic(), false);
  }

 private:
  enum MavStream { kAerial, kCorrections, kCoarse, kViews, kOdometry, kMavStatus, kMavStreams };
  enum GroundStream { kGround, kKeyframes, kGroundStatus, kGroundStreams };

  // All callbacks run in the one thread that spins: what they alone use needs no lock.

  void startMap() {
    odometry_.reset();
    output_.forgetMav();
    aerial_stamps_.clear();
    newest_coarse_ = ros::Time();
    const auto& id = mav_.map().id();
    if (id) worker_.setMapId(*id);
    worker_.forget(id ? "the MAV began another map" : "the MAV's map starts afresh",
                   [this](Inbox& inbox) { inbox.startMap(mav_.map().ownUnit()); });
  }

  void startGround() {
    ground_forgotten_ = true;
    ground_stamp_ = ros::Time();
    ground_camera_.forget();
    const auto& id = ground_.map().id();
    if (id) worker_.setGroundMapId(*id);
    worker_.forget(id ? "the ground robot began another map" : "the ground robot's map starts afresh",
                   [](Inbox& inbox) { inbox.startGround(); });
  }

  void reviseGround() {
    ground_camera_.revise();
    const bool at_hand = !ground_.map().isStale(ground_stamp_.toSec());
    worker_.post([at_hand](Inbox& inbox) { inbox.reviseGround(at_hand); });
  }

  /// The first part of the first map tells the map's unit, without a change of map.
  template <typename Change>
  void postOfMav(const Change& change) {
    worker_.post([&](Inbox& inbox) {
      inbox.own_unit = mav_.map().ownUnit();
      change(inbox);
    });
  }

  void onAerial(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    health_.received(aerial_subscriber_.getTopic(), msg->header.stamp);
    // Before their stamps, which lie in the past, are taken for a jump of time.
    if (aerial_stamps_.has(msg->header.stamp)) return health_.count("dense clouds repeated");
    if (!mav_.admitMap(kAerial, msg->header, "dense clouds")) return;
    aerial_stamps_.add(msg->header.stamp);
    auto points = ros_utils::readCloud(*msg, "dense clouds", health_);
    if (!points) return;
    postOfMav([&](Inbox& inbox) { inbox.aerial.push_back({msg->header.stamp, std::move(*points)}); });
  }

  void onCorrections(const air_ground::CloudCorrections::ConstPtr& msg) {
    if (!mav_.admitMap(kCorrections, msg->header, "corrections of clouds")) return;
    try {
      worker_.post([corrections = ros_utils::fromMsg(*msg)](Inbox& inbox) { inbox.corrections = corrections; });
    } catch (const std::exception& e) {
      health_.count(std::string("corrections of clouds unreadable: ") + e.what());
    }
  }

  void onGround(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    health_.received(ground_subscriber_.getTopic(), msg->header.stamp);
    ground_map_ = msg;
    useGround(*msg);
  }

  void useGround(const sensor_msgs::PointCloud2& msg) {
    if (!ground_.admitMap(kGround, msg.header, "ground maps")) return;
    auto points = ros_utils::readCloud(msg, "ground maps", health_);
    if (!points) return;
    ground_forgotten_ = false;
    ground_stamp_ = msg.header.stamp;
    worker_.post([&](Inbox& inbox) { inbox.setGround(std::move(*points)); });
  }

  // A latched map comes only once: the last one is kept for a start afresh. (To subscribe again would ask the master.)
  void useLastGround() {
    ground_forgotten_ = false;
    if (ground_map_ && ground_subscriber_.getNumPublishers() > 0) useGround(*ground_map_);
  }

  void onKeyframes(const air_ground::MapKeyframes::ConstPtr& msg) {
    if (!ground_.isFrame(msg->header.frame_id, settings_.ground_map_frame, "keyframes")) return;
    if (!ground_.admit(kKeyframes, msg->header.stamp)) return;
    // Of a map that ended, or has just begun: then they come again.
    if (ground_.map().id() && *ground_.map().id() != msg->map_id) return health_.count("keyframes of another map");
    ground_camera_.use(*msg);
  }

  void onGroundStatus(const air_ground::VoStatus::ConstPtr& msg) {
    if (!ground_.admitStatus(kGroundStatus, *msg)) return;
    worker_.setGroundMapId(msg->map_id);
    if (msg->state == air_ground::VoStatus::STATE_TRACKING)
      worker_.post([&](Inbox& inbox) { inbox.ground_vertical = verticalFrom(*msg); });
    if (ground_forgotten_) useLastGround();
  }

  void onOdometry(const nav_msgs::Odometry::ConstPtr& msg) {
    if (!mav_.isFrame(msg->header.frame_id, settings_.mav_map_frame, "odometry")) return;
    try {
      const Pose T = ros_utils::fromMsg(msg->pose.pose);
      if (!mav_.admit(kOdometry, msg->header.stamp) || mav_.map().isStale(msg->header.stamp.toSec())) return;
      odometry_ = T;
      output_.follow(*msg, T);
    } catch (const std::exception& e) {
      health_.count(std::string("odometry unreadable: ") + e.what());
    }
  }

  void onVoStatus(const air_ground::VoStatus::ConstPtr& msg) {
    if (!mav_.admitStatus(kMavStatus, *msg)) return;
    worker_.setMapId(msg->map_id);
    if (mav_.map().ownUnit() || msg->state != air_ground::VoStatus::STATE_TRACKING || !(msg->scale > 0) ||
        !(msg->scale_stddev >= 0))
      return;
    // The map is metric; what the odometry believes by now that it is off counts as uncertainty.
    const double deviation = std::hypot(msg->scale_stddev / msg->scale, msg->scale - 1);
    worker_.post([&](Inbox& inbox) {
      inbox.scale_deviation = deviation;
      inbox.aerial_vertical = verticalFrom(*msg);
    });
  }

  void onCoarse(const AlignmentEstimate::ConstPtr& msg) {
    const ros::Time newest = std::exchange(newest_coarse_, std::max(newest_coarse_, msg->header.stamp));
    // Elsewhere it is not known, or the MAV has flown off: that says nothing against what was CONVERGED.
    if (msg->status == AlignmentEstimate::STATUS_AMBIGUOUS && !msg->guess) {
      const bool of_other_clouds = coarse_left_behind_ && msg->header.stamp >= newest;
      if (of_other_clouds) return;
      return useAlignment(*msg, kCoarse, "coarse alignments", [](Inbox& inbox) { inbox.withdrawCoarse(); });
    }
    if (!isUsable(*msg)) return;
    useAlignment(*msg, kCoarse, "coarse alignments", [&](Inbox& inbox) {
      inbox.coarse = coarseAlignmentFrom(*msg, inbox.own_unit);
      coarse_left_behind_ = msg->header.stamp < newest;
    });
  }

  void onViews(const AlignmentEstimate::ConstPtr& msg) {
    if (isWithdrawal(*msg))
      return useAlignment(*msg, kViews, "alignments by views", [](Inbox& inbox) { inbox.withdrawViews(); });
    if (!isUsable(*msg)) return;
    useAlignment(*msg, kViews, "alignments by views",
                 [&](Inbox& inbox) { inbox.views = viewAlignmentFrom(*msg, inbox.own_unit); });
  }

  /// When it is of the maps that both robots have now.
  template <typename Use>
  void useAlignment(const AlignmentEstimate& msg, MavStream stream, const std::string& what, const Use& use) {
    if (!ground_.isFrame(msg.header.frame_id, settings_.ground_map_frame, what)) return;
    if (mav_.map().frame().empty() && !mav_.admitMap(stream, childHeader(msg), what + "' child")) return;
    if (!mav_.isFrame(msg.child_frame_id, mav_.map().expectedFrame(), what + "' child")) return;
    // Not taken for a jump of time: a stage that was started again begins with old clouds.
    if (mav_.map().isStale(msg.header.stamp.toSec())) return health_.count(what + " of an earlier map dropped");
    mav_.observe(msg.map_id, msg.header.stamp, true);
    if (mav_.map().id() != msg.map_id) return health_.count(what + " of another map");
    const auto& ground_id = ground_.map().id();
    if (msg.ground_map_id != 0 && ground_id && *ground_id != msg.ground_map_id)
      return health_.count(what + " of another ground map");
    try {
      postOfMav(use);
      worker_.setMapId(msg.map_id);
    } catch (const std::exception& e) {
      health_.count(what + " unreadable: " + e.what());
    }
  }

  void onMapScale(const AlignmentEstimate::ConstPtr& msg) {
    map_scale_ = msg;
    useMapScale();
  }

  // Latched, too.
  void useMapScale() {
    const auto& msg = map_scale_;
    if (!msg) return;
    if (msg->child_frame_id != settings_.visual_map_frame || (mav_.map().id() && msg->map_id != *mav_.map().id()))
      return;
    try {
      output_.setMapScale(similarityFrom(*msg));
    } catch (const std::exception& e) {
      health_.count(std::string("scale of the visual map unreadable: ") + e.what());
    }
  }

  void onGuess(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& msg) {
    if (!ground_.isFrame(msg->header.frame_id, settings_.ground_map_frame, "initial poses")) return;
    const auto ignored = [this](const char* why, const char* event) {
      ROS_WARN("initialpose ignored: %s", why);
      health_.count(std::string("initial poses ") + event);
    };
    if (mav_.map().ownUnit())
      return ignored("a map without scale needs the coarse alignment", "for a map without scale");
    try {
      const Pose T_ground_base = ros_utils::fromMsg(msg->pose.pose);
      if (!odometry_)
        return ignored("no mav/odometry yet that says where the MAV is in its own map", "without odometry");
      const Pose T = alignmentFrom(T_ground_base, *odometry_);
      worker_.post([&](Inbox& inbox) { inbox.manual = T; });
    } catch (const std::exception& e) {
      health_.count(std::string("initial pose unreadable: ") + e.what());
    }
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    mav_.restart();
    ground_.restart();
    worker_.forget("reset", [this](Inbox& inbox) {
      inbox = Inbox();
      inbox.own_unit = mav_.map().ownUnit();
      inbox.reset = true;
    });
    useLastGround();
    useMapScale();
    return ros_utils::answer(response, [] { return "forgot all maps and poses"; });
  }

  bool onRefine(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    worker_.post([](Inbox& inbox) { inbox.refine = true; });
    return ros_utils::answer(response, [this] { return "refining; see " + output_.topic(); });
  }

  ros::NodeHandle handle_, private_;
  const NodeSettings settings_;
  ros_utils::NodeHealth health_;
  AlignmentOutput output_;
  RefineWorker worker_;
  MapFile map_file_{settings_.autosave, worker_};
  GroundCamera ground_camera_{handle_, settings_.ground_map_frame,
                              [this](double z) { worker_.post([z](Inbox& inbox) { inbox.ground_camera = z; }); }};

  std::optional<Pose> odometry_;  // T_mav_map_base, the latest
  ros_utils::RecentStamps aerial_stamps_;
  sensor_msgs::PointCloud2::ConstPtr ground_map_;
  ros::Time ground_stamp_;           // of the last one that was used; 0: none
  ros::Time newest_coarse_;          // of what the coarse stage has said of the MAV's map
  bool coarse_left_behind_ = false;  // its last pose is of clouds before that
  AlignmentEstimate::ConstPtr map_scale_;
  bool ground_forgotten_ = false;  // and none has come since
  ros_utils::RobotMapInput mav_, ground_;

  ros::Subscriber coarse_subscriber_, views_subscriber_, aerial_subscriber_, corrections_subscriber_,
      ground_subscriber_, keyframes_subscriber_, ground_status_subscriber_, odometry_subscriber_, status_subscriber_,
      guess_subscriber_, scale_subscriber_;
  ros::ServiceServer reset_service_, refine_service_;
};

}  // namespace
}  // namespace icp_refine

int main(int argc, char** argv) {
  using namespace icp_refine;
  return air_ground_common::ros_utils::runNode<NodeSettings, IcpRefineNode>(argc, argv, "icp_refine");
}
