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

#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/renewable_subscriber.h"
#include "node_parameters.h"

namespace icp_refine {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;
using Clock = std::chrono::steady_clock;

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

Cloud positionsOf(const std::vector<ros_utils::CloudPoint>& points) {
  Cloud cloud;
  cloud.points.reserve(points.size());
  for (const auto& p : points) cloud.points.push_back(p.position);
  return cloud;
}

class IcpRefineNode {
 public:
  IcpRefineNode()
      : private_("~"),
        settings_(readParameters(private_)),
        health_("icp_refine"),
        refiner_(readChain(private_, settings_.chain_file), settings_.refiner),
        map_(settings_.map) {
    refined_publisher_ = handle_.advertise<AlignmentEstimate>("alignment/refined", 10);
    map_publisher_ = handle_.advertise<sensor_msgs::PointCloud2>(
        "augmented_map", 1, [this](const ros::SingleSubscriberPublisher&) { onMapSubscriber(); }, {}, {}, true);
    coarse_subscriber_ = handle_.subscribe("alignment/coarse", 50, &IcpRefineNode::onCoarse, this);
    aerial_subscriber_ = handle_.subscribe("mav/dense_cloud", 50, &IcpRefineNode::onAerial, this);
    ground_subscriber_.emplace(
        [this] { return handle_.subscribe("ground/map_cloud", 2, &IcpRefineNode::onGround, this); });
    ground_status_subscriber_ = handle_.subscribe("ground/slam_status", 100, &IcpRefineNode::onGroundStatus, this);
    odometry_subscriber_ = handle_.subscribe("mav/odometry", 100, &IcpRefineNode::onOdometry, this);
    status_subscriber_ = handle_.subscribe("mav/vo_status", 500, &IcpRefineNode::onVoStatus, this);
    guess_subscriber_ = handle_.subscribe("initialpose", 5, &IcpRefineNode::onGuess, this);
    save_service_ = private_.advertiseService("save_map", &IcpRefineNode::onSave, this);
    reset_service_ = private_.advertiseService("reset", &IcpRefineNode::onReset, this);
    refine_service_ = private_.advertiseService("refine", &IcpRefineNode::onRefine, this);
    for (const std::string& topic : {aerial_subscriber_.getTopic(), ground_subscriber_->topic()})
      health_.expectInput(topic, false);
    if (settings_.publish_tf) {
      tf_timer_ =
          handle_.createTimer(ros::Duration(1 / settings_.tf_rate), [this](const ros::TimerEvent&) { publishTf(); });
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
    bool any() const { return forgets() || refine || map_subscriber || ground || !aerial.empty() || coarse || manual; }
    bool forgets() const { return reset || new_map || new_ground; }
  };
  enum MavStream { kAerial, kCoarse, kOdometry, kMavStatus, kMavStreams };
  enum GroundStream { kGround, kGroundStatus, kGroundStreams };

  // ---- Inputs: check, convert, hand to the worker ------------------------------------------------------------------

  // mutex_ held for the next seven.

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
    ground_subscriber_->renew();
    forgetPoses();
  }

  void forgetPoses() {
    inbox_.coarse.reset();
    inbox_.manual.reset();
    T_ground_mav_.reset();
    wake_.notify_all();
  }

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
    health_.received(ground_subscriber_->topic(), msg->header.stamp);
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
    if (map_id_from_status_ && !from_status) return;
    map_id_from_status_ |= from_status;
    if (map_id_ == id) return;
    const bool changed = map_id_.has_value();
    map_id_ = id;
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
      const double yaw =
          air_ground_common::yawOf(T_ground_base.linear()) - air_ground_common::yawOf(odometry_->linear());
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
        next = Clock::now() +
               std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(settings_.min_period));
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
      map_.clearAerial();
    }
    if (inbox.reset || inbox.new_ground) {
      refiner_.startGround();
      map_.clearGround();
    }
    if (inbox.forgets()) dropMapPose();
    if (inbox.ground) {
      refiner_.setGround(positionsOf(*inbox.ground));
      map_.setGround(std::move(*inbox.ground));
    }
    for (const auto& aerial : inbox.aerial) {
      map_.addAerial(aerial.points);
      refiner_.addAerial(static_cast<std::int64_t>(aerial.stamp.toNSec()), positionsOf(aerial.points));
    }
    if (inbox.coarse) refiner_.setCoarse(*inbox.coarse);
    if (inbox.manual) refiner_.setManual(*inbox.manual);
    map_due_ |= inbox.ground && map_.aligned();
    // While tracking, the next aerial cloud is soon enough: a new ground map alone would only cost its normals.
    const bool wanted = (inbox.coarse || inbox.ground) && !refiner_.tracking();
    return inbox.refine || !inbox.aerial.empty() || inbox.manual || wanted;
  }

  void refine() {
    const auto start = Clock::now();
    const RefineOutcome out = refiner_.refine();
    health_.timing("refine", std::chrono::duration<double>(Clock::now() - start).count());
    {
      std::lock_guard<std::mutex> lock(mutex_);
      if (inbox_.forgets()) return;  // it is about a map that has ended
      if (out.status == RefineStatus::kConverged) {
        T_ground_mav_ = out.T_ground_map_mav_map;
      } else if (!refiner_.tracking()) {
        T_ground_mav_.reset();
      }
      // Locked: nothing of the time before a reset goes out after it.
      publishEstimate(out, map_id_.value_or(0));
    }
    if (out.status == RefineStatus::kConverged) {
      publishTf();
      std::lock_guard<std::mutex> lock(map_mutex_);
      map_.align(out.T_ground_map_mav_map);
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
    map_due_ |= map_.aligned();
    map_.align(std::nullopt);
  }

  static ros::Time stampOf(const RefineOutcome& out) {
    return ros::Time().fromNSec(static_cast<std::uint64_t>(out.stamp));
  }

  // At most once a period, and once more after the last refinement. Without subscribers it stays due.
  void publishMapWhenDue() {
    if (!map_due_ || Clock::now() < map_time_ || map_publisher_.getNumSubscribers() == 0) return;
    std::lock_guard<std::mutex> lock(map_mutex_);
    std_msgs::Header header;
    header.stamp = map_stamp_;
    header.frame_id = settings_.ground_map_frame;
    map_publisher_.publish(ros_utils::toMsg(map_.points(), ros_utils::CloudFields::kXyzRgbSource, header));
    map_due_ = false;
    map_time_ =
        Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(settings_.map_period));
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

  // ---- Services ----------------------------------------------------------------------------------------------------

  bool onSave(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
    return ros_utils::answer(response, [&]() -> std::string {
      std::vector<ros_utils::CloudPoint> points;
      bool aligned;
      {
        std::lock_guard<std::mutex> lock(map_mutex_);
        aligned = map_.aligned();
        points = map_.points();
      }
      if (points.empty())
        throw std::runtime_error("no map yet: neither a ground map nor an aligned aerial map has come");
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
  const NodeSettings settings_;
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
  std::optional<Pose> odometry_;            // T_mav_map_base, the latest
  std::optional<Pose> T_ground_mav_;        // what tf says
  ros::Time last_tf_;
  // The robots' clocks are watched apart: when the MAV's steps back, a ground robot that stands still does not send its
  // map again.
  ros_utils::StreamGate mav_gate_{kMavStreams, health_, [this] { onMavTimeJump(); }};
  ros_utils::StreamGate ground_gate_{kGroundStreams, health_, [this] { onGroundTimeJump(); }};

  std::mutex map_mutex_;
  AugmentedMap map_;
  bool map_due_ = false;  // worker alone, as the next three
  Clock::time_point map_time_;
  ros::Time map_stamp_;
  std::uint8_t last_status_ = 255;

  ros::Publisher refined_publisher_, map_publisher_;
  std::optional<ros_utils::RenewableSubscriber> ground_subscriber_;
  ros::Subscriber coarse_subscriber_, aerial_subscriber_, ground_status_subscriber_, odometry_subscriber_,
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
  const ros::NodeHandle keep_alive;  // with the last handle roscpp ends, and the console with it
  try {
    icp_refine::IcpRefineNode node;
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("%s", e.what());
    return 1;
  }
  return 0;
}
