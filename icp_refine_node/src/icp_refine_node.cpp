// Pose refinement and map augmentation (A-VII): ROS around icp_refine::AlignmentRefiner.
#include <air_ground/AlignmentEstimate.h>
#include <air_ground/SaveMap.h>
#include <air_ground/VoStatus.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/transform_broadcaster.h>
#include <yaml-cpp/yaml.h>

#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/parameters.h"
#include "icp_refine/alignment_refiner.h"
#include "icp_refine/augmented_map.h"
#include "refiner_parameters.h"

namespace icp_refine {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;
using Clock = std::chrono::steady_clock;

YAML::Node toYaml(XmlRpc::XmlRpcValue& value) {
  switch (value.getType()) {
    case XmlRpc::XmlRpcValue::TypeBoolean:
      return YAML::Node(static_cast<bool>(value));
    case XmlRpc::XmlRpcValue::TypeInt:
      return YAML::Node(static_cast<int>(value));
    case XmlRpc::XmlRpcValue::TypeDouble:
      return YAML::Node(static_cast<double>(value));
    case XmlRpc::XmlRpcValue::TypeString:
      return YAML::Node(static_cast<std::string>(value));
    case XmlRpc::XmlRpcValue::TypeArray: {
      YAML::Node out(YAML::NodeType::Sequence);
      for (int i = 0; i < value.size(); ++i) out.push_back(toYaml(value[i]));
      return out;
    }
    case XmlRpc::XmlRpcValue::TypeStruct: {
      YAML::Node out(YAML::NodeType::Map);
      for (auto& item : value) out[item.first] = toYaml(item.second);
      return out;
    }
    default:
      throw ConfigError("the parameter `chain` holds a value of a type that no stage takes");
  }
}

std::uint8_t statusOf(RefineStatus status) {
  switch (status) {
    case RefineStatus::kSearching:
      return AlignmentEstimate::STATUS_SEARCHING;
    case RefineStatus::kDegenerate:
      return AlignmentEstimate::STATUS_DEGENERATE;
    case RefineStatus::kConverged:
      return AlignmentEstimate::STATUS_CONVERGED;
    case RefineStatus::kRejected:
      return AlignmentEstimate::STATUS_REJECTED;
  }
  return AlignmentEstimate::STATUS_REJECTED;
}

struct Settings {
  std::string ground_map_frame, mav_map_frame, ground_color, chain_file;
  bool publish_tf = true, inverse_tf = false, fill_only = false;
  double tf_rate = 10, min_period = 0.5, map_period = 2, map_leaf = 0.02;
  int map_min_points = 1, map_max_points = 2000000;
  RefinerSettings refiner;
};

Settings readSettings(const ros::NodeHandle& handle) {
  ros_utils::Parameters p(handle);
  Settings s;
  s.ground_map_frame = p.text("ground_map_frame", "ground_map");
  s.mav_map_frame = p.text("mav_map_frame", "mav_map");
  s.publish_tf = p.flag("publish_tf", s.publish_tf);
  s.inverse_tf = p.flag("inverse_tf", s.inverse_tf);
  s.tf_rate = p.number("tf_rate", s.tf_rate, 0.1, 1000);
  s.min_period = p.number("min_period", s.min_period, 0, 3600);
  s.map_leaf = p.number("augmented_map/leaf", s.map_leaf, 0.001, 10);
  s.map_period = p.number("augmented_map/period", s.map_period, 0, 3600);
  s.map_min_points = p.integer("augmented_map/min_points", s.map_min_points, 1, 1000000);
  s.map_max_points = p.integer("augmented_map/max_points", s.map_max_points, 1000, 100000000);
  s.fill_only = p.flag("augmented_map/fill_only", s.fill_only);
  s.ground_color = p.choice("augmented_map/ground_color", "red", {"red", "original"});
  s.chain_file = p.text("chain_file", "");
  s.refiner = readRefinerSettings(p);
  p.finish({"chain/"});
  return s;
}

IcpChain readChain(const ros::NodeHandle& handle, const std::string& file) {
  if (!file.empty()) return IcpChain::fromFile(file);
  XmlRpc::XmlRpcValue value;
  if (!handle.getParam("chain", value)) {
    throw ConfigError("parameter " + handle.resolveName("chain") + " is missing: load config/icp_refine.yaml, or set chain_file");
  }
  return IcpChain(toYaml(value));
}

class IcpRefineNode {
 public:
  IcpRefineNode()
      : private_("~"),
        settings_(readSettings(private_)),
        health_("icp_refine"),
        refiner_(readChain(private_, settings_.chain_file), settings_.refiner),
        voxels_(settings_.map_leaf, static_cast<std::size_t>(settings_.map_max_points)) {
    refined_publisher_ = handle_.advertise<AlignmentEstimate>("alignment/refined", 10);
    map_publisher_ = handle_.advertise<sensor_msgs::PointCloud2>(
        "augmented_map", 1, [this](const ros::SingleSubscriberPublisher&) { onMapSubscriber(); }, {}, {}, true);
    coarse_subscriber_ = handle_.subscribe("alignment/coarse", 50, &IcpRefineNode::onCoarse, this);
    aerial_subscriber_ = handle_.subscribe("mav/dense_cloud", 50, &IcpRefineNode::onAerial, this);
    subscribeGround();
    ground_status_subscriber_ = handle_.subscribe("ground/slam_status", 100, &IcpRefineNode::onGroundStatus, this);
    odometry_subscriber_ = handle_.subscribe("mav/odometry", 100, &IcpRefineNode::onOdometry, this);
    status_subscriber_ = handle_.subscribe("mav/vo_status", 500, &IcpRefineNode::onVoStatus, this);
    guess_subscriber_ = handle_.subscribe("initialpose", 5, &IcpRefineNode::onGuess, this);
    save_service_ = private_.advertiseService("save_map", &IcpRefineNode::onSave, this);
    reset_service_ = private_.advertiseService("reset", &IcpRefineNode::onReset, this);
    refine_service_ = private_.advertiseService("refine", &IcpRefineNode::onRefine, this);
    for (const auto* s : {&aerial_subscriber_, &ground_subscriber_}) health_.expectInput(s->getTopic(), false);
    if (settings_.publish_tf) {
      tf_timer_ = handle_.createTimer(ros::Duration(1 / settings_.tf_rate), [this](const ros::TimerEvent&) { publishTf(); });
    }
    worker_ = std::thread([this] { work(); });
  }

  ~IcpRefineNode() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    worker_.join();
  }

 private:
  struct AerialCloud {
    ros::Time stamp;
    std::vector<ros_utils::CloudPoint> points;
  };
  struct Inbox {
    bool reset = false, new_map = false, new_ground = false, refine = false, map_subscriber = false;
    std::optional<std::vector<ros_utils::CloudPoint>> ground;
    std::deque<AerialCloud> aerial;
    std::optional<Pose> coarse, manual;
    bool any() const { 
      return forgets() || refine || map_subscriber || ground || !aerial.empty() || coarse || manual;
    }
    bool forgets() const { return reset || new_map || new_ground; }
  };
  enum MavStream { kAerial, kCoarse, kOdometry, kMavStatus, kMavStreams };
  enum GroundStream { kGround, kGroundStatus, kGroundStreams };

  // ---- Inputs: check, convert, hand to the worker ------------------------------------------------------------------

  // mutex_ held for the next seven.

  // A message without a stamp is taken as it comes.
  bool admitMav(MavStream stream, const ros::Time& stamp) { return stamp.isZero() || mav_gate_.admit(stream, stamp); }
  bool admitGround(GroundStream stream, const ros::Time& stamp) { return stamp.isZero() || ground_gate_.admit(stream, stamp); }

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
    inbox_.new_map = true;
    inbox_.aerial.clear();
    odometry_.reset();
    map_start_ = ros::Time();
    forgetPoses();
  }

  void startGround() {
    inbox_.new_ground = true;
    inbox_.ground.reset();
    ground_map_start_ = ros::Time();
    // A latched map that has come already comes again.
    ground_subscriber_.shutdown();
    subscribeGround();
    forgetPoses();
  }

  void forgetPoses() {
    inbox_.coarse.reset();
    inbox_.manual.reset();
    T_ground_mav_.reset();
    wake_.notify_all();
  }

  void subscribeGround() { ground_subscriber_ = handle_.subscribe("ground/map_cloud", 2, &IcpRefineNode::onGround, this); }

  void onMapSubscriber() {
    std::lock_guard<std::mutex> lock(mutex_);
    inbox_.map_subscriber = true;
    wake_.notify_all();
  }

  bool rightFrame(const std::string& topic, const std::string& frame, const std::string& expected) {
    const std::string bare = !frame.empty() && frame[0] == '/' ? frame.substr(1) : frame;
    if (bare == expected) return true;
    health_.count(topic + " in frame '" + frame + "' instead of '" + expected + "'");
    return false;
  }

  std::optional<std::vector<ros_utils::CloudPoint>> readCloud(const sensor_msgs::PointCloud2& msg, const std::string& topic) {
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
    if (!rightFrame("dense clouds", msg->header.frame_id, settings_.mav_map_frame)) return;
    auto points = readCloud(*msg, "dense cloud");
    if (!points) return;
    std::lock_guard<std::mutex> lock(mutex_);
    if (!admitMav(kAerial, msg->header.stamp)) return;
    if (msg->header.stamp < map_start_) {
      health_.count("dense clouds of an earlier map");
      return;
    }
    inbox_.aerial.push_back({msg->header.stamp, std::move(*points)});
    wake_.notify_all();
  }

  void onGround(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    health_.received(ground_subscriber_.getTopic(), msg->header.stamp);
    if (!rightFrame("ground maps", msg->header.frame_id, settings_.ground_map_frame)) return;
    auto points = readCloud(*msg, "ground map");
    if (!points) return;
    std::lock_guard<std::mutex> lock(mutex_);
    if (!admitGround(kGround, msg->header.stamp)) return;
    if (msg->header.stamp < ground_map_start_) {
      health_.count("ground maps of an earlier map");
      return;
    }
    inbox_.ground = std::move(*points);
    wake_.notify_all();
  }

  void onGroundStatus(const air_ground::VoStatus::ConstPtr& msg) {
    std::lock_guard<std::mutex> lock(mutex_);
    if (!admitGround(kGroundStatus, msg->header.stamp)) return;
    if (ground_map_id_ && *ground_map_id_ != msg->map_id) {
      ROS_WARN("the ground robot started map %u: starting afresh", msg->map_id);
      health_.count("new maps of the ground robot");
      startGround();
      ground_map_start_ = msg->header.stamp;
    }
    ground_map_id_ = msg->map_id;
  }

  void onOdometry(const nav_msgs::Odometry::ConstPtr& msg) {
    if (!rightFrame("odometry", msg->header.frame_id, settings_.mav_map_frame)) return;
    try {
      const Pose T = ros_utils::fromMsg(msg->pose.pose);
      std::lock_guard<std::mutex> lock(mutex_);
      if (admitMav(kOdometry, msg->header.stamp) && msg->header.stamp >= map_start_) odometry_ = T;
    } catch (const std::exception& e) {
      health_.count(std::string("odometry unreadable: ") + e.what());
    }
  }

  // mutex_ held. The VO's own status outranks the id that comes along with a coarse pose.
  void observeMapId(std::uint32_t id, const ros::Time& stamp, bool from_status) {
    if (map_id_ == id || (map_id_from_status_ && !from_status)) return;
    const bool changed = map_id_.has_value();
    map_id_ = id;
    map_id_from_status_ |= from_status;
    if (!changed) return;
    ROS_WARN("the MAV started map %u: starting afresh", id);
    health_.count("new maps of the MAV");
    startMap();
    map_start_ = stamp;
  }

  void onVoStatus(const air_ground::VoStatus::ConstPtr& msg) {
    std::lock_guard<std::mutex> lock(mutex_);
    if (!admitMav(kMavStatus, msg->header.stamp)) return;
    observeMapId(msg->map_id, msg->header.stamp, true);
  }

  void onCoarse(const AlignmentEstimate::ConstPtr& msg) {
    if (msg->status != AlignmentEstimate::STATUS_CONVERGED) return;
    if (!rightFrame("coarse alignments", msg->header.frame_id, settings_.ground_map_frame)) return;
    if (!rightFrame("coarse alignments' child", msg->child_frame_id, settings_.mav_map_frame)) return;
    try {
      const Pose T = ros_utils::fromMsg(msg->pose.pose);
      std::lock_guard<std::mutex> lock(mutex_);
      if (!admitMav(kCoarse, msg->header.stamp)) return;
      observeMapId(msg->map_id, msg->header.stamp, false);
      if (map_id_ != msg->map_id) {
        health_.count("coarse alignments of another map");
        return;
      }
      inbox_.coarse = T;
      wake_.notify_all();
    } catch (const std::exception& e) {
      health_.count(std::string("coarse alignment unreadable: ") + e.what());
    }
  }

  void onGuess(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& msg) {
    if (!rightFrame("initial poses", msg->header.frame_id, settings_.ground_map_frame)) return;
    try {
      const Pose T_ground_base = ros_utils::fromMsg(msg->pose.pose);
      std::lock_guard<std::mutex> lock(mutex_);
      if (!odometry_) {
        ROS_WARN("initialpose ignored: no mav/odometry yet that says where the MAV is in its own map");
        health_.count("initial poses without odometry");
        return;
      }
      // Both maps hang from gravity: heading and place of the base fix one map in the other.
      const double yaw = air_ground_common::yawOf(T_ground_base.linear()) - air_ground_common::yawOf(odometry_->linear());
      Pose T = air_ground_common::yawPose(yaw, Eigen::Vector3d::Zero());
      T.translation() = T_ground_base.translation() - T.linear() * odometry_->translation();
      inbox_.manual = T;
      wake_.notify_all();
    } catch (const std::exception& e) {
      health_.count(std::string("initial pose unreadable: ") + e.what());
    }
  }

  // ---- Worker ------------------------------------------------------------------------------------------------------

  void work() {
    auto next = Clock::now();
    bool pending = false;  // data came in since the last refinement
    while (true) {
      Inbox inbox;
      {
        std::unique_lock<std::mutex> lock(mutex_);
        const auto ready = [this] { return stop_ || inbox_.any(); };
        const bool publish = map_due_ && map_publisher_.getNumSubscribers() > 0;
        if (pending || publish) {
          wake_.wait_until(lock, pending ? next : map_time_, ready);
        } else {
          wake_.wait(lock, ready);
        }
        if (stop_) return;
        std::swap(inbox, inbox_);
      }
      try {
        pending |= take(inbox);
        publishMapWhenDue();
        if (!pending || Clock::now() < next) continue;
        pending = false;
        refine();
        next = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(settings_.min_period));
      } catch (const std::exception& e) {
        health_.count(std::string("failed refinements: ") + e.what());
        pending = false;
      }
    }
  }

  // True when there is something new to refine.
  bool take(Inbox& inbox) {
    std::lock_guard<std::mutex> lock(map_mutex_);
    if (inbox.reset || inbox.new_map) {
      refiner_.startMap();
      voxels_.clear();
    }
    if (inbox.reset || inbox.new_ground) {
      refiner_.startGround();
      ground_points_.clear();
    }
    if (inbox.forgets()) dropMapPose();
    if (inbox.ground) {
      ground_points_ = std::move(*inbox.ground);
      Cloud cloud;
      for (const auto& p : ground_points_) cloud.points.push_back(p.position);
      refiner_.setGround(std::move(cloud));
    }
    for (const auto& aerial : inbox.aerial) {
      Cloud cloud;
      for (const auto& p : aerial.points) {
        cloud.points.push_back(p.position);
        voxels_.add(p.position, p.rgb[0]);
      }
      refiner_.addAerial(static_cast<std::int64_t>(aerial.stamp.toNSec()), std::move(cloud));
    }
    if (inbox.coarse) refiner_.setCoarse(*inbox.coarse);
    if (inbox.manual) refiner_.setManual(*inbox.manual);
    map_due_ |= inbox.ground && map_pose_;
    // While tracking, the next aerial cloud is soon enough: a new ground map alone would only cost its normals.
    const bool wanted = (inbox.coarse || inbox.ground) && !refiner_.tracking();
    return inbox.refine || !inbox.aerial.empty() || inbox.manual || wanted;
  }

  void refine() {
    const auto start = Clock::now();
    const RefineOutcome out = refiner_.refine();
    health_.timing("refine", std::chrono::duration<double>(Clock::now() - start).count());
    std::uint32_t map_id;
    {
      std::lock_guard<std::mutex> lock(mutex_);
      if (inbox_.forgets()) return;  // it is about a map that has ended
      map_id = map_id_.value_or(0);
      if (out.status == RefineStatus::kConverged) {
        T_ground_mav_ = out.T_ground_map_mav_map;
      } else if (!refiner_.tracking()) {
        T_ground_mav_.reset();
      }
    }
    publishEstimate(out, map_id);
    if (out.status == RefineStatus::kConverged) {
      publishTf();
      std::lock_guard<std::mutex> lock(map_mutex_);
      map_pose_ = out.T_ground_map_mav_map;
      map_stamp_ = stampOf(out);
      map_due_ = true;
    } else if (!refiner_.tracking()) {
      std::lock_guard<std::mutex> lock(map_mutex_);
      dropMapPose();
    }
    publishMapWhenDue();
  }

  // map_mutex_ held. The map that stays is the ground robot's alone.
  void dropMapPose() {
    map_due_ |= map_pose_.has_value();
    map_pose_.reset();
  }

  static ros::Time stampOf(const RefineOutcome& out) { return ros::Time().fromNSec(static_cast<std::uint64_t>(out.stamp)); }

  // At most once a period, and once more after the last refinement. Without subscribers it stays due.
  void publishMapWhenDue() {
    if (!map_due_ || Clock::now() < map_time_ || map_publisher_.getNumSubscribers() == 0) return;
    std::lock_guard<std::mutex> lock(map_mutex_);
    std_msgs::Header header;
    header.stamp = map_stamp_;
    header.frame_id = settings_.ground_map_frame;
    map_publisher_.publish(ros_utils::toMsg(augmentedMap(), ros_utils::CloudFields::kXyzRgbSource, header));
    map_due_ = false;
    map_time_ = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(settings_.map_period));
  }

  void publishEstimate(const RefineOutcome& out, std::uint32_t map_id) {
    AlignmentEstimate msg;
    msg.header.stamp = out.stamp > 0 ? stampOf(out) : ros::Time::now();
    msg.header.frame_id = settings_.ground_map_frame;
    msg.child_frame_id = settings_.mav_map_frame;
    const bool finite = out.T_ground_map_mav_map.matrix().allFinite() && out.covariance.allFinite();
    msg.pose.pose = ros_utils::toMsg(finite ? out.T_ground_map_mav_map : Pose::Identity());
    ros_utils::setCovariance(finite ? out.covariance : Matrix6d(Matrix6d::Identity() * 1e6), &msg.pose.covariance);
    msg.reference_point.x = out.reference_point.x();
    msg.reference_point.y = out.reference_point.y();
    msg.reference_point.z = out.reference_point.z();
    msg.status = statusOf(finite ? out.status : RefineStatus::kRejected);
    msg.stage = AlignmentEstimate::STAGE_REFINED;
    msg.reason = out.reason;
    msg.overlap = out.overlap;
    msg.cost = out.residual_rms;
    msg.iterations = static_cast<std::uint32_t>(out.iterations);
    msg.map_id = map_id;
    refined_publisher_.publish(msg);
    static const char* kNames[] = {"SEARCHING", "AMBIGUOUS", "DEGENERATE", "CONVERGED", "REJECTED"};
    const bool good = msg.status == AlignmentEstimate::STATUS_CONVERGED;
    health_.state(good ? 0 : 1, std::string(kNames[msg.status]) + ": " + out.reason);
    if (msg.status == AlignmentEstimate::STATUS_DEGENERATE) health_.count("degenerate refinements");
    if (msg.status == AlignmentEstimate::STATUS_REJECTED) health_.count("rejected refinements");
    if (msg.status != last_status_) ROS_INFO_STREAM("alignment " << kNames[msg.status] << ": " << out.reason);
    last_status_ = msg.status;
  }

  void publishTf() {
    if (!settings_.publish_tf) return;
    std::lock_guard<std::mutex> lock(mutex_);
    const ros::Time now = ros::Time::now();
    // The clock stands still while a bag is paused: the same stamp is not sent again.
    if (!T_ground_mav_ || now.isZero() || now == last_tf_) return;
    last_tf_ = now;
    geometry_msgs::TransformStamped msg;
    msg.header.stamp = now;
    msg.header.frame_id = settings_.inverse_tf ? settings_.mav_map_frame : settings_.ground_map_frame;
    msg.child_frame_id = settings_.inverse_tf ? settings_.ground_map_frame : settings_.mav_map_frame;
    msg.transform = ros_utils::toTransformMsg(settings_.inverse_tf ? T_ground_mav_->inverse() : *T_ground_mav_);
    broadcaster_.sendTransform(msg);
  }

  // ---- Augmented map -----------------------------------------------------------------------------------------------

  // map_mutex_ held. Ground points first, then aerial ones in the ground map's frame.
  std::vector<ros_utils::CloudPoint> augmentedMap() const {
    std::vector<ros_utils::CloudPoint> out = ground_points_;
    for (auto& p : out) {
      p.source = 0;
      if (settings_.ground_color == "red") p.rgb = {220, 30, 30};
    }
    if (!map_pose_) return out;
    const Eigen::Matrix3f R = map_pose_->linear().cast<float>();
    const Eigen::Vector3f t = map_pose_->translation().cast<float>();
    const auto voxels = voxels_.points(settings_.map_min_points);
    std::vector<char> mask(voxels.size(), 1);
    if (settings_.fill_only) {
      std::vector<Eigen::Vector3f> aerial, ground;
      for (const auto& v : voxels) aerial.push_back(R * v.position + t);
      for (const auto& p : ground_points_) ground.push_back(p.position);
      mask = addedByAir(aerial, ground, settings_.map_leaf * 2);
    }
    for (std::size_t i = 0; i < voxels.size(); ++i) {
      if (mask[i]) out.push_back({R * voxels[i].position + t, {voxels[i].grey, voxels[i].grey, voxels[i].grey}, 1});
    }
    return out;
  }

  // ---- Services ----------------------------------------------------------------------------------------------------

  bool onSave(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
    return ros_utils::answer(response, [&]() -> std::string {
      std::vector<ros_utils::CloudPoint> points;
      bool aligned;
      {
        std::lock_guard<std::mutex> lock(map_mutex_);
        aligned = map_pose_.has_value();
        points = augmentedMap();
      }
      if (points.empty()) throw std::runtime_error("no map yet: neither a ground map nor an aligned aerial map has come");
      ros_utils::writeCloud(request.path, points, ros_utils::CloudFields::kXyzRgbSource);
      response.points = points.size();
      return aligned ? "wrote ground and aerial points" : "wrote the ground points alone: no alignment yet";
    });
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    std::lock_guard<std::mutex> lock(mutex_);
    inbox_ = Inbox();
    startMap();
    startGround();
    inbox_.reset = true;
    map_id_.reset();
    map_id_from_status_ = false;
    ground_map_id_.reset();
    response.success = true;
    response.message = "forgot all maps and poses";
    return true;
  }

  bool onRefine(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    std::lock_guard<std::mutex> lock(mutex_);
    inbox_.refine = true;
    wake_.notify_all();
    response.success = true;
    response.message = "refining; see " + refined_publisher_.getTopic();
    return true;
  }

  ros::NodeHandle handle_, private_;
  Settings settings_;
  ros_utils::NodeHealth health_;

  AlignmentRefiner refiner_;  // worker alone

  std::mutex mutex_;
  std::condition_variable wake_;
  Inbox inbox_;
  bool stop_ = false;
  std::optional<std::uint32_t> map_id_;
  bool map_id_from_status_ = false;
  std::optional<std::uint32_t> ground_map_id_;
  ros::Time map_start_, ground_map_start_;  // clouds before belong to an earlier map
  std::optional<Pose> odometry_;       // T_mav_map_base, the latest
  std::optional<Pose> T_ground_mav_;   // what tf says
  ros::Time last_tf_;
  // The robots' clocks are watched apart: when the MAV's steps back, a ground robot that stands still does not send its map again.
  ros_utils::StreamGate mav_gate_{kMavStreams, health_, [this] { onMavTimeJump(); }};
  ros_utils::StreamGate ground_gate_{kGroundStreams, health_, [this] { onGroundTimeJump(); }};

  std::mutex map_mutex_;
  std::vector<ros_utils::CloudPoint> ground_points_;
  AerialVoxels voxels_;
  std::optional<Pose> map_pose_;
  bool map_due_ = false;               // worker alone, as the next three
  Clock::time_point map_time_;
  ros::Time map_stamp_;
  std::uint8_t last_status_ = 255;

  ros::Publisher refined_publisher_, map_publisher_;
  ros::Subscriber coarse_subscriber_, aerial_subscriber_, ground_subscriber_, ground_status_subscriber_, odometry_subscriber_,
      status_subscriber_, guess_subscriber_;
  ros::ServiceServer save_service_, reset_service_, refine_service_;
  ros::Timer tf_timer_;
  tf2_ros::TransformBroadcaster broadcaster_;
  std::thread worker_;
};

}  // namespace
}  // namespace icp_refine

int main(int argc, char** argv) {
  ros::init(argc, argv, "icp_refine");
  try {
    icp_refine::IcpRefineNode node;
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("%s", e.what());
    return 1;
  }
  return 0;
}
