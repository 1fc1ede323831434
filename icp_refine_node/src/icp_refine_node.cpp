// Pose refinement and map augmentation (A-VII): ROS around icp_refine::AlignmentRefiner. Callbacks check and convert
// what comes; RefineWorker works on it; AlignmentOutput publishes.
#include <air_ground/SaveMap.h>
#include <air_ground/VoStatus.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <nav_msgs/Odometry.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <std_srvs/Trigger.h>

#include <cmath>

#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/parameters.h"
#include "chain_parameter.h"
#include "ground_camera.h"
#include "refine_worker.h"

namespace icp_refine {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;

class IcpRefineNode {
 public:
  explicit IcpRefineNode(const NodeSettings& settings)
      : private_("~"),
        settings_(settings),
        health_("icp_refine"),
        output_(settings_, health_),
        worker_(settings_, readChain(private_, settings_.chain_file), output_, health_) {
    coarse_subscriber_ = handle_.subscribe("alignment/coarse", 50, &IcpRefineNode::onCoarse, this);
    aerial_subscriber_ = handle_.subscribe("mav/dense_cloud", 50, &IcpRefineNode::onAerial, this);
    ground_subscriber_ = handle_.subscribe("ground/map_cloud", 2, &IcpRefineNode::onGround, this);
    ground_status_subscriber_ = handle_.subscribe("ground/slam_status", 100, &IcpRefineNode::onGroundStatus, this);
    odometry_subscriber_ = handle_.subscribe("mav/odometry", 100, &IcpRefineNode::onOdometry, this);
    status_subscriber_ = handle_.subscribe("mav/vo_status", 500, &IcpRefineNode::onVoStatus, this);
    scale_subscriber_ = handle_.subscribe("mav/map_scale", 5, &IcpRefineNode::onMapScale, this);
    guess_subscriber_ = handle_.subscribe("initialpose", 5, &IcpRefineNode::onGuess, this);
    reset_service_ = private_.advertiseService("reset", &IcpRefineNode::onReset, this);
    refine_service_ = private_.advertiseService("refine", &IcpRefineNode::onRefine, this);
    // Writing a large map takes seconds, in which tf must go on: a thread of its own.
    file_handle_.setCallbackQueue(&file_queue_);
    save_service_ = file_handle_.advertiseService("save_map", &IcpRefineNode::onSave, this);
    file_spinner_.start();
    for (const auto* s : {&aerial_subscriber_, &ground_subscriber_}) health_.expectInput(s->getTopic(), false);
    if (settings_.publish_tf) {
      tf_timer_ = handle_.createTimer(ros::Duration(1 / settings_.tf_rate),
                                      [this](const ros::TimerEvent&) { output_.publishTf(); });
    }
  }

  ~IcpRefineNode() {
    file_spinner_.stop();
    autosave_.save("augmented_map.ply", [this](const std::string& path) { write(path); });
  }

 private:
  enum MavStream { kAerial, kCoarse, kOdometry, kMavStatus, kMavStreams };
  enum GroundStream { kGround, kGroundStatus, kGroundStreams };

  // All but onSave run in the one thread that spins: what they alone use needs no lock.

  // A message without a stamp is taken as it comes.
  bool admitMav(MavStream stream, const ros::Time& stamp) { return stamp.isZero() || mav_gate_.admit(stream, stamp); }
  bool admitGround(GroundStream stream, const ros::Time& stamp) {
    return stamp.isZero() || ground_gate_.admit(stream, stamp);
  }

  void onMavTimeJump() {
    ROS_WARN("the MAV's time jumped back: its map starts afresh");
    health_.count("time jumps");
    startMap();
    map_id_.reset();
    map_id_from_status_ = false;
  }

  void onGroundTimeJump() {
    ROS_WARN("the ground robot's time jumped back: its map starts afresh");
    health_.count("time jumps");
    startGround();
    ground_map_id_.reset();
  }

  void startMap() {
    odometry_.reset();
    output_.setPosition(std::nullopt);
    output_.setMapScale(std::nullopt);
    map_start_ = ros::Time();
    worker_.post([this](Inbox& inbox) {
      inbox.new_map = true;
      inbox.own_unit = own_unit_;
      inbox.aerial.clear();
      inbox.scale_deviation.reset();
      forgetPoses(inbox);
    });
  }

  void startGround() {
    ground_map_start_ = ros::Time();
    ground_camera_.forget();
    worker_.post([this](Inbox& inbox) {
      inbox.new_ground = true;
      inbox.ground.reset();
      inbox.ground_camera.reset();
      forgetPoses(inbox);
    });
  }

  void forgetPoses(Inbox& inbox) {
    inbox.coarse.reset();
    inbox.manual.reset();
    output_.drop();
  }

  bool rightFrame(const std::string& topic, const std::string& frame, const std::string& expected) {
    const std::string bare = !frame.empty() && frame[0] == '/' ? frame.substr(1) : frame;
    if (bare == expected) return true;
    health_.count(topic + " in frame '" + frame + "' instead of '" + expected + "'");
    return false;
  }

  std::optional<std::vector<ros_utils::CloudPoint>> readCloud(const sensor_msgs::PointCloud2& msg,
                                                              const std::string& topic) {
    try {
      std::size_t dropped = 0;
      auto points = ros_utils::cloudFromMsg(msg, &dropped);
      if (dropped) health_.count("points that are not finite", dropped);
      if (!points.empty()) return points;
      health_.count(topic + " without a finite point");
    } catch (const std::exception& e) {
      health_.count(topic + " unreadable: " + e.what());
    }
    return std::nullopt;
  }

  void onAerial(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    health_.received(aerial_subscriber_.getTopic(), msg->header.stamp);
    const bool own_unit = msg->header.frame_id == settings_.visual_map_frame;
    if (!own_unit && !rightFrame("dense clouds", msg->header.frame_id, settings_.mav_map_frame)) return;
    auto points = readCloud(*msg, "dense cloud");
    if (!points || !admitMav(kAerial, msg->header.stamp)) return;
    if (msg->header.stamp < map_start_) {
      health_.count("dense clouds of an earlier map");
      return;
    }
    if (own_unit != own_unit_) {
      own_unit_ = own_unit;
      startMap();
    }
    worker_.post([&](Inbox& inbox) { inbox.aerial.push_back({msg->header.stamp, std::move(*points)}); });
  }

  void onGround(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    health_.received(ground_subscriber_.getTopic(), msg->header.stamp);
    ground_map_ = msg;
    useGround(*msg);
  }

  void useGround(const sensor_msgs::PointCloud2& msg) {
    if (!rightFrame("ground maps", msg.header.frame_id, settings_.ground_map_frame)) return;
    auto points = readCloud(msg, "ground map");
    if (!points || !admitGround(kGround, msg.header.stamp)) return;
    if (msg.header.stamp < ground_map_start_) {
      health_.count("ground maps of an earlier map");
      return;
    }
    worker_.post([&](Inbox& inbox) { inbox.ground = std::move(*points); });
  }

  // A latched map comes only once: the last one is kept for a start afresh. (To subscribe again would ask the master.)
  void useLastGround() {
    if (ground_map_ && ground_subscriber_.getNumPublishers() > 0) useGround(*ground_map_);
  }

  void onGroundStatus(const air_ground::VoStatus::ConstPtr& msg) {
    const bool known = ground_map_id_.has_value();
    if (!admitGround(kGroundStatus, msg->header.stamp)) return;
    bool afresh = known && !ground_map_id_;  // a jump of time
    if (ground_map_id_ && *ground_map_id_ != msg->map_id) {
      ROS_WARN("the ground robot started map %u: starting afresh", msg->map_id);
      health_.count("new maps of the ground robot");
      startGround();
      ground_map_start_ = msg->header.stamp;
      afresh = true;
    }
    ground_map_id_ = msg->map_id;
    if (afresh) useLastGround();
  }

  void onOdometry(const nav_msgs::Odometry::ConstPtr& msg) {
    if (!rightFrame("odometry", msg->header.frame_id, settings_.mav_map_frame)) return;
    try {
      const Pose T = ros_utils::fromMsg(msg->pose.pose);
      if (!admitMav(kOdometry, msg->header.stamp) || msg->header.stamp < map_start_) return;
      odometry_ = T;
      output_.setPosition(T.translation());
    } catch (const std::exception& e) {
      health_.count(std::string("odometry unreadable: ") + e.what());
    }
  }

  // The VO's own status outranks the id that comes along with a coarse pose.
  void observeMapId(std::uint32_t id, const ros::Time& stamp, bool from_status) {
    if (map_id_from_status_ && !from_status) return;
    map_id_from_status_ |= from_status;
    if (map_id_ == id) return;
    const bool changed = map_id_.has_value();
    map_id_ = id;
    worker_.setMapId(id);
    if (!changed) return;
    ROS_WARN("the MAV started map %u: starting afresh", id);
    health_.count("new maps of the MAV");
    startMap();
    map_start_ = stamp;
  }

  void onVoStatus(const air_ground::VoStatus::ConstPtr& msg) {
    if (!admitMav(kMavStatus, msg->header.stamp)) return;
    observeMapId(msg->map_id, msg->header.stamp, true);
    if (own_unit_ || msg->state != air_ground::VoStatus::STATE_TRACKING || !(msg->scale > 0) ||
        !(msg->scale_stddev >= 0))
      return;
    // The map is metric; what the odometry believes by now that it is off counts as uncertainty.
    const double deviation = std::hypot(msg->scale_stddev / msg->scale, msg->scale - 1);
    worker_.post([&](Inbox& inbox) { inbox.scale_deviation = deviation; });
  }

  void onCoarse(const AlignmentEstimate::ConstPtr& msg) {
    if (msg->status != AlignmentEstimate::STATUS_CONVERGED) return;
    if (!rightFrame("coarse alignments", msg->header.frame_id, settings_.ground_map_frame)) return;
    const std::string& child = own_unit_ ? settings_.visual_map_frame : settings_.mav_map_frame;
    if (!rightFrame("coarse alignments' child", msg->child_frame_id, child)) return;
    try {
      const Pose T = ros_utils::fromMsg(msg->pose.pose);
      if (!admitMav(kCoarse, msg->header.stamp)) return;
      observeMapId(msg->map_id, msg->header.stamp, false);
      if (map_id_ != msg->map_id) {
        health_.count("coarse alignments of another map");
        return;
      }
      CoarseAlignment coarse{similarity(T), 0};
      if (own_unit_) {
        if (!(msg->scale > 0) || !std::isfinite(msg->scale)) throw std::invalid_argument("the scale is not positive");
        coarse = {similarity(T, msg->scale), msg->scale_stddev / msg->scale};
      }
      worker_.post([&](Inbox& inbox) { inbox.coarse = coarse; });
    } catch (const std::exception& e) {
      health_.count(std::string("coarse alignment unreadable: ") + e.what());
    }
  }

  void onMapScale(const AlignmentEstimate::ConstPtr& msg) {
    if (msg->child_frame_id != settings_.visual_map_frame || (map_id_ && msg->map_id != *map_id_)) return;
    try {
      const Similarity T = similarity(ros_utils::fromMsg(msg->pose.pose), msg->scale);
      if (!isValid(T)) throw std::invalid_argument("it is not a similarity");
      output_.setMapScale(T);
    } catch (const std::exception& e) {
      health_.count(std::string("scale of the visual map unreadable: ") + e.what());
    }
  }

  void onGuess(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& msg) {
    if (!rightFrame("initial poses", msg->header.frame_id, settings_.ground_map_frame)) return;
    if (own_unit_) {
      ROS_WARN("initialpose ignored: a map without scale needs the coarse alignment");
      health_.count("initial poses for a map without scale");
      return;
    }
    try {
      const Pose T_ground_base = ros_utils::fromMsg(msg->pose.pose);
      if (!odometry_) {
        ROS_WARN("initialpose ignored: no mav/odometry yet that says where the MAV is in its own map");
        health_.count("initial poses without odometry");
        return;
      }
      // Both maps hang from gravity: heading and place of the base fix one map in the other.
      const double yaw =
          air_ground_common::yawOf(T_ground_base.linear()) - air_ground_common::yawOf(odometry_->linear());
      Pose T = air_ground_common::yawPose(yaw, Eigen::Vector3d::Zero());
      T.translation() = T_ground_base.translation() - T.linear() * odometry_->translation();
      worker_.post([&](Inbox& inbox) { inbox.manual = T; });
    } catch (const std::exception& e) {
      health_.count(std::string("initial pose unreadable: ") + e.what());
    }
  }

  bool onSave(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
    return ros_utils::answer(response, [&]() -> std::string {
      const auto [points, aligned] = write(request.path);
      response.points = points;
      return aligned ? "wrote ground and aerial points" : "wrote the ground points alone: no alignment yet";
    });
  }

  /// Number of points; whether the aerial ones are among them.
  std::pair<std::size_t, bool> write(const std::string& path) {
    const auto [points, aligned] = worker_.map();
    if (points.empty()) throw std::runtime_error("no map yet: neither a ground map nor an aligned aerial map has come");
    ros_utils::writeCloud(path, points, ros_utils::CloudFields::kXyzRgbSource);
    return {points.size(), aligned};
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    startMap();
    startGround();
    worker_.post([this](Inbox& inbox) {
      inbox = Inbox();
      inbox.own_unit = own_unit_;
      inbox.reset = true;
    });
    map_id_.reset();
    map_id_from_status_ = false;
    ground_map_id_.reset();
    useLastGround();
    response.success = true;
    response.message = "forgot all maps and poses";
    return true;
  }

  bool onRefine(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    worker_.post([](Inbox& inbox) { inbox.refine = true; });
    response.success = true;
    response.message = "refining; see " + output_.topic();
    return true;
  }

  ros::CallbackQueue file_queue_;
  ros::NodeHandle handle_, private_, file_handle_{"~"};
  const NodeSettings settings_;
  const ros_utils::Autosave autosave_{settings_.autosave};
  ros_utils::NodeHealth health_;
  AlignmentOutput output_;
  RefineWorker worker_;
  GroundCamera ground_camera_{handle_, settings_.ground_map_frame,
                              [this](double z) { worker_.post([z](Inbox& inbox) { inbox.ground_camera = z; }); }};

  bool own_unit_ = false;  // the MAV's clouds are in the visual map
  std::optional<std::uint32_t> map_id_;
  bool map_id_from_status_ = false;
  std::optional<std::uint32_t> ground_map_id_;
  ros::Time map_start_, ground_map_start_;  // clouds before belong to an earlier map
  std::optional<Pose> odometry_;            // T_mav_map_base, the latest
  sensor_msgs::PointCloud2::ConstPtr ground_map_;
  // The robots' clocks are watched apart: when the MAV's steps back, a ground robot that stands still does not send its
  // map again.
  ros_utils::StreamGate mav_gate_{kMavStreams, health_, [this] { onMavTimeJump(); }};
  ros_utils::StreamGate ground_gate_{kGroundStreams, health_, [this] { onGroundTimeJump(); }};

  ros::Subscriber coarse_subscriber_, aerial_subscriber_, ground_subscriber_, ground_status_subscriber_,
      odometry_subscriber_, status_subscriber_, guess_subscriber_, scale_subscriber_;
  ros::ServiceServer save_service_, reset_service_, refine_service_;
  ros::Timer tf_timer_;
  ros::AsyncSpinner file_spinner_{1, &file_queue_};
};

}  // namespace
}  // namespace icp_refine

int main(int argc, char** argv) {
  return air_ground_common::ros_utils::runNode<icp_refine::NodeSettings>(argc, argv, "icp_refine",
                                                                         [](const auto& settings) {
                                                                           icp_refine::IcpRefineNode node(settings);
                                                                           ros::spin();
                                                                         });
}
