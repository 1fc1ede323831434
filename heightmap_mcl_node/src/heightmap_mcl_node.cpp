// Global localization of the MAV in the ground robot's map (Forster 2013, VI): dense clouds and the ground map in,
// coarse alignment with its verdict out.
#include <air_ground/AlignmentEstimate.h>
#include <air_ground/HeightMap.h>
#include <air_ground/VoStatus.h>
#include <geometry_msgs/PoseArray.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <nav_msgs/OccupancyGrid.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/transform_broadcaster.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/renewable_subscriber.h"
#include "air_ground_common/trajectory.h"
#include "node_parameters.h"

namespace heightmap_mcl {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;
using air_ground_common::Pose;

air_ground::HeightMap toMsg(const HeightMap& map, const std_msgs::Header& header, std::uint32_t map_id) {
  air_ground::HeightMap msg;
  msg.header = header;
  msg.resolution = static_cast<float>(map.resolution);
  msg.origin_x = map.origin_x;
  msg.origin_y = map.origin_y;
  msg.width = static_cast<std::uint32_t>(map.width);
  msg.height = static_cast<std::uint32_t>(map.height);
  msg.heights = map.heights;
  msg.map_id = map_id;
  return msg;
}

std::uint8_t toMsg(Status status) {
  switch (status) {
    case Status::kSearching:
      return AlignmentEstimate::STATUS_SEARCHING;
    case Status::kAmbiguous:
      return AlignmentEstimate::STATUS_AMBIGUOUS;
    case Status::kDegenerate:
      return AlignmentEstimate::STATUS_DEGENERATE;
    case Status::kConverged:
      return AlignmentEstimate::STATUS_CONVERGED;
  }
  return AlignmentEstimate::STATUS_SEARCHING;
}

/// A cost as occupancy: 0 best, 100 worst, -1 too little overlap. The square root spreads the low end.
nav_msgs::OccupancyGrid toMsg(const CostMap& map, const Eigen::Vector2d& shift, const std_msgs::Header& header) {
  nav_msgs::OccupancyGrid msg;
  msg.header = header;
  msg.info.map_load_time = header.stamp;
  msg.info.resolution = static_cast<float>(map.resolution);
  msg.info.width = static_cast<std::uint32_t>(map.width);
  msg.info.height = static_cast<std::uint32_t>(map.height);
  msg.info.origin.position.x = map.x0 + shift.x() - 0.5 * map.resolution;
  msg.info.origin.position.y = map.y0 + shift.y() - 0.5 * map.resolution;
  msg.info.origin.orientation.w = 1;
  float low = std::numeric_limits<float>::infinity(), high = 0;
  for (float c : map.cost) {
    if (!std::isfinite(c)) continue;
    low = std::min(low, c);
    high = std::max(high, c);
  }
  msg.data.reserve(map.cost.size());
  for (float c : map.cost) {
    const float share = std::sqrt(std::max(c - low, 0.f) / std::max(high - low, 1e-9f));
    msg.data.push_back(std::isfinite(c) ? static_cast<std::int8_t>(std::lround(100 * std::min(share, 1.f))) : -1);
  }
  return msg;
}

std::vector<Eigen::Vector3f> positions(const std::vector<ros_utils::CloudPoint>& points) {
  std::vector<Eigen::Vector3f> result;
  result.reserve(points.size());
  for (const auto& p : points) result.push_back(p.position);
  return result;
}

}  // namespace

class HeightmapMclNode {
 public:
  HeightmapMclNode()
      : private_handle_("~"),
        settings_(read(private_handle_)),
        health_("heightmap_mcl"),
        localizer_(settings_.localizer) {
    localizer_.setPrior(settings_.prior);
    height_map_air_ = handle_.advertise<air_ground::HeightMap>("alignment/height_map_air", 5);
    height_map_ground_ = handle_.advertise<air_ground::HeightMap>("alignment/height_map_ground", 1, true);
    costmap_ = handle_.advertise<nav_msgs::OccupancyGrid>("alignment/costmap", 1, true);
    particles_ = handle_.advertise<geometry_msgs::PoseArray>("alignment/particles", 5);
    coarse_ = handle_.advertise<AlignmentEstimate>("alignment/coarse", 20, true);

    cloud_sub_ = handle_.subscribe("mav/dense_cloud", 50, &HeightmapMclNode::onAerialCloud, this);
    ground_sub_.emplace(
        [this] { return handle_.subscribe("ground/map_cloud", 5, &HeightmapMclNode::onGroundCloud, this); });
    ground_status_sub_ = handle_.subscribe("ground/slam_status", 100, &HeightmapMclNode::onGroundStatus, this);
    odometry_sub_ = handle_.subscribe("mav/odometry", 500, &HeightmapMclNode::onOdometry, this);
    status_sub_ = handle_.subscribe("mav/vo_status", 500, &HeightmapMclNode::onVoStatus, this);
    guess_sub_ = handle_.subscribe("initialpose", 1, &HeightmapMclNode::onInitialPose, this);
    health_.expectInput(cloud_sub_.getTopic(), false);
    health_.expectInput(ground_sub_->topic(), false);
    reset_ = private_handle_.advertiseService("reset", &HeightmapMclNode::onReset, this);
    relocalize_ = private_handle_.advertiseService("relocalize", &HeightmapMclNode::onRelocalize, this);
    if (settings_.publish_tf) {
      tf_timer_ =
          handle_.createTimer(ros::Duration(1 / settings_.tf_rate), [this](const ros::TimerEvent&) { publishTf(); });
    }
    worker_ = std::thread([this] { work(); });
  }

  ~HeightmapMclNode() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    worker_.join();
  }

 private:
  using Cloud = sensor_msgs::PointCloud2ConstPtr;
  using Clock = std::chrono::steady_clock;

  struct Command {
    bool reset = false;          // forget all
    bool forget_aerial = false;  // fresh map of the MAV
    bool relocalize = false;     // search again on the maps at hand
    bool forget_ground = false;
    std::optional<Prior> prior;
    bool forgets() const { return reset || forget_aerial || forget_ground; }
    bool any() const { return forgets() || relocalize; }
  };
  struct WaitingCloud {
    Cloud cloud;
    Clock::time_point until;  // the cloud waits for odometry up to its stamp
  };
  enum MavStream { kAerial, kOdometry, kMavStatus, kMavStreams };
  enum GroundStream { kGround, kGroundStatus, kGroundStreams };

  static NodeSettings read(const ros::NodeHandle& handle) {
    ros_utils::Parameters parameters(handle);
    return readParameters(parameters);
  }

  // ---- callbacks: one thread, ros::spin ----

  void onAerialCloud(const Cloud& msg) {
    health_.received(cloud_sub_.getTopic(), msg->header.stamp);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!mav_gate_.admit(kAerial, msg->header.stamp)) return;
    if (!frameFits(msg->header.frame_id, settings_.mav_map_frame, &mav_frame_, "aerial clouds")) return;
    if (msg->header.stamp < map_begin_) {
      health_.count("aerial clouds of an earlier map of the MAV dropped");
      return;
    }
    clouds_.push_back({msg, Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                               std::chrono::duration<double>(ros_utils::kTopicsInStep))});
    while (static_cast<int>(clouds_.size()) > settings_.cloud_queue) {
      clouds_.pop_front();
      health_.count("aerial clouds dropped: the queue is full");
    }
    wake_.notify_one();
  }

  void onGroundCloud(const Cloud& msg) {
    health_.received(ground_sub_->topic(), msg->header.stamp);
    if (msg->width == 0 || msg->height == 0) {
      // Must not push out a good one that still waits.
      health_.count("ground clouds without a point");
      return;
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!ground_gate_.admit(kGround, msg->header.stamp)) return;
    if (!frameFits(msg->header.frame_id, settings_.ground_map_frame, &ground_frame_, "ground clouds")) return;
    if (msg->header.stamp < ground_map_begin_) {
      health_.count("ground clouds of an earlier map dropped");
      return;
    }
    ground_ = msg;  // the newest replaces one that still waits
    wake_.notify_one();
  }

  void onOdometry(const nav_msgs::OdometryConstPtr& msg) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!mav_gate_.admit(kOdometry, msg->header.stamp)) return;
    if (!mav_frame_.empty() && msg->header.frame_id != mav_frame_) {
      health_.count("odometry in frame '" + msg->header.frame_id + "' ignored: aerial clouds are in '" + mav_frame_ +
                    "'");
      return;
    }
    try {
      const double stamp = msg->header.stamp.toSec();
      if (!odometry_.empty() && stamp <= odometry_.back().stamp) {
        health_.count("odometry out of order or repeated");
        return;
      }
      odometry_.push_back({stamp, ros_utils::fromMsg(msg->pose.pose)});
      if (!clouds_.empty()) wake_.notify_one();
      if (odometry_.size() > kOdometryKept) odometry_.erase(odometry_.begin(), odometry_.begin() + kOdometryKept / 4);
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("odometry not usable: ") + e.what());
    }
  }

  void onVoStatus(const air_ground::VoStatusConstPtr& msg) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!mav_gate_.admit(kMavStatus, msg->header.stamp)) return;
    if (map_id_ && msg->map_id != *map_id_) {
      ROS_INFO("The MAV has begun map %u: searching again", msg->map_id);
      forgetAerial();
      map_begin_ = msg->header.stamp;
    }
    map_id_ = msg->map_id;
  }

  void onGroundStatus(const air_ground::VoStatusConstPtr& msg) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!ground_gate_.admit(kGroundStatus, msg->header.stamp)) return;
    if (ground_map_id_ && msg->map_id != *ground_map_id_) {
      ROS_INFO("The ground robot has begun map %u: searching again", msg->map_id);
      forgetGround();
      ground_map_begin_ = msg->header.stamp;
    }
    ground_map_id_ = msg->map_id;
  }

  void onInitialPose(const geometry_msgs::PoseWithCovarianceStampedConstPtr& msg) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!ground_frame_.empty() && msg->header.frame_id != ground_frame_) {
      ROS_WARN("initialpose in frame '%s' ignored: the ground map is in '%s'", msg->header.frame_id.c_str(),
               ground_frame_.c_str());
      return;
    }
    if (odometry_.empty()) {
      ROS_WARN("initialpose ignored: no mav/odometry yet that says where the MAV is in its own map");
      return;
    }
    try {
      const Pose T_ground_base = ros_utils::fromMsg(msg->pose.pose);
      const Pose& T_mav_base = odometry_.back().T_map_body;
      const auto sigma = [&](double variance, double fallback, double least) {
        return variance > 0 && std::isfinite(variance) ? std::max(std::sqrt(variance), least) : fallback;
      };
      Prior prior;
      prior.position = T_ground_base.translation().head<2>();
      prior.position_reference = T_mav_base.translation().head<2>();
      prior.position_sigma = sigma(0.5 * (msg->pose.covariance[0] + msg->pose.covariance[7]), 0.5, 0.1);
      prior.yaw = air_ground_common::wrapAngle(air_ground_common::yawOf(T_ground_base.rotation()) -
                                               air_ground_common::yawOf(T_mav_base.rotation()));
      prior.yaw_sigma = sigma(msg->pose.covariance[35], 0.26, 0.02);
      command_.prior = prior;
      command_.relocalize = true;
      wake_.notify_one();
    } catch (const std::invalid_argument& e) {
      ROS_WARN("initialpose ignored: %s", e.what());
    }
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    const std::lock_guard<std::mutex> lock(mutex_);
    forgetAerial();
    forgetGround();
    command_ = Command();
    command_.reset = true;
    response.success = true;
    response.message = "both maps forgotten; waiting for new clouds";
    return true;
  }

  bool onRelocalize(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    const std::lock_guard<std::mutex> lock(mutex_);
    command_.relocalize = true;
    command_.prior = settings_.prior;
    wake_.notify_one();
    response.success = true;
    response.message = "searching again on the maps at hand";
    return true;
  }

  /// Empty `expected` accepts the first frame that comes; another one later is refused, and both are named.
  bool frameFits(const std::string& frame, const std::string& expected, std::string* known, const std::string& what) {
    if (known->empty()) *known = expected.empty() ? frame : expected;
    if (frame == *known && !frame.empty()) return true;
    health_.count(what + " in frame '" + frame + "' dropped: expected '" + *known + "'");
    return false;
  }

  // All below: mutex_ held.

  void onMavTimeJump() {
    ROS_WARN("The MAV's time jumped back: its map starts afresh");
    forgetAerial();
  }

  void onGroundTimeJump() {
    ROS_WARN("The ground robot's time jumped back: its map starts afresh");
    forgetGround();
  }

  void forgetAerial() {
    clouds_.clear();
    odometry_.clear();
    map_begin_ = ros::Time();
    map_id_.reset();
    command_.forget_aerial = true;
    endSearch();
  }

  void forgetGround() {
    ground_.reset();
    ground_map_begin_ = ros::Time();
    ground_map_id_.reset();
    command_.forget_ground = true;
    // A latched map that has come already comes again.
    ground_sub_->renew();
    endSearch();
  }

  /// Pose and guesses refer to a map that is no more.
  void endSearch() {
    command_.prior.reset();
    T_ground_mav_.reset();
    wake_.notify_one();
  }

  // ---- worker ----

  void work() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      while (!stop_ && !pending()) {
        if (clouds_.empty()) {
          wake_.wait(lock);
        } else {
          const Clock::time_point until = clouds_.front().until;
          wake_.wait_until(lock, until);
        }
      }
      if (stop_) return;
      const Command command = std::exchange(command_, {});
      const Cloud ground = std::exchange(ground_, nullptr);
      Cloud aerial;
      std::optional<air_ground_common::StampedPose> reference;
      if (cloudReady()) {
        aerial = clouds_.front().cloud;
        clouds_.pop_front();
        const double stamp = aerial->header.stamp.toSec();
        if (!odometry_.empty() && stamp > odometry_.back().stamp + 5) {
          health_.count("aerial clouds later than the odometry by more than 5 s dropped");
          aerial.reset();
          if (!ground && !command.any()) continue;
        } else if (const auto pose = air_ground_common::poseAt(odometry_, stamp, settings_.odometry_gap)) {
          reference = air_ground_common::StampedPose{stamp, *pose};
        }
      }
      const std::uint32_t map_id = map_id_.value_or(0);
      const std::string ground_frame = ground_frame_, mav_frame = mav_frame_;
      lock.unlock();
      try {
        obey(command);
        if (ground) takeGround(ground);
        if (aerial) takeAerial(aerial, reference);
        publish(ground_frame, mav_frame, map_id, aerial != nullptr, ground != nullptr);
      } catch (const std::exception& e) {
        health_.count(std::string("maps not usable: ") + e.what());
      }
      lock.lock();
    }
  }

  bool pending() const { return cloudReady() || ground_ || command_.any(); }

  /// The oldest cloud has odometry up to its stamp, or has waited long enough for it.
  bool cloudReady() const {
    if (clouds_.empty()) return false;
    const WaitingCloud& next = clouds_.front();
    return Clock::now() >= next.until ||
           (!odometry_.empty() && odometry_.back().stamp >= next.cloud->header.stamp.toSec());
  }

  void obey(const Command& command) {
    if (command.forgets()) localizer_.setPrior(settings_.prior);
    if (command.prior) localizer_.setPrior(*command.prior);
    if (command.reset || command.forget_ground) localizer_.forgetGround();
    if (command.reset || command.forget_aerial || command.relocalize)
      localizer_.restart(command.reset || command.forget_aerial);
    if (command.reset || command.forget_aerial) aerial_stamp_ = ros::Time();
  }

  void takeGround(const Cloud& msg) {
    const ros::WallTime start = ros::WallTime::now();
    std::size_t dropped = 0;
    std::vector<Eigen::Vector3f> points;
    try {
      points = positions(ros_utils::cloudFromMsg(*msg, &dropped));
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("ground clouds not usable: ") + e.what());
      return;
    }
    health_.count("ground points that are not finite", dropped);
    if (points.empty()) {
      health_.count("ground clouds without a finite point");
      return;
    }
    std::size_t cropped = 0;
    if (!localizer_.setGround(points, &cropped)) health_.count("ground clouds that define no cell");
    health_.count("ground points beyond ground/max_extent", cropped);
    ground_stamp_ = msg->header.stamp;
    health_.timing("ground map", (ros::WallTime::now() - start).toSec());
  }

  void takeAerial(const Cloud& msg, const std::optional<air_ground_common::StampedPose>& reference) {
    const ros::WallTime start = ros::WallTime::now();
    AerialCloud cloud;
    std::size_t dropped = 0;
    try {
      cloud.points = positions(ros_utils::cloudFromMsg(*msg, &dropped));
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("aerial clouds not usable: ") + e.what());
      return;
    }
    health_.count("aerial points that are not finite", dropped);
    if (cloud.points.empty()) {
      health_.count("aerial clouds without a finite point");
      return;
    }
    if (reference) {
      cloud.reference = reference->T_map_body.translation();
      heading_ = air_ground_common::yawOf(reference->T_map_body.rotation());
    } else {
      // Any point known in mav_map can carry the particles; only what "the MAV's position" means is lost.
      health_.count("aerial clouds without odometry at their stamp: the cloud's middle stands for the MAV");
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (const auto& p : cloud.points) sum += p.cast<double>();
      cloud.reference = sum / static_cast<double>(cloud.points.size());
      heading_ = 0;
    }
    reference_ = cloud.reference;
    std::size_t cropped = 0;
    const std::size_t far = localizer_.farMapsDropped();
    const bool added = localizer_.addAerial(cloud, &cropped);
    health_.count("aerial points beyond air/max_extent", cropped);
    health_.count("aerial maps dropped: farther than air/max_extent from the newest",
                  localizer_.farMapsDropped() - far);
    if (!added) {
      health_.count("aerial clouds that define no cell");
      return;
    }
    aerial_stamp_ = msg->header.stamp;
    health_.timing("aerial map", (ros::WallTime::now() - start).toSec());
  }

  void publish(const std::string& ground_frame, const std::string& mav_frame, std::uint32_t map_id, bool new_air,
               bool new_ground) {
    const Estimate& e = localizer_.estimate();
    std_msgs::Header header;
    header.frame_id = ground_frame;
    header.stamp = aerial_stamp_;
    if (new_ground && localizer_.hasGround()) {
      std_msgs::Header ground = header;
      ground.stamp = ground_stamp_;
      height_map_ground_.publish(toMsg(localizer_.groundMap(), ground, 0));
    }
    if (new_air && localizer_.hasAerial()) {
      std_msgs::Header air = header;
      air.frame_id = mav_frame;
      height_map_air_.publish(toMsg(localizer_.aerialMap(), air, map_id));
    }
    health_.state(e.status == Status::kConverged ? 0 : 1, std::string(toString(e.status)) + ": " + e.reason);
    if (e.status != last_status_) {
      ROS_INFO("Coarse alignment %s: %s", toString(e.status), e.reason.c_str());
      last_status_ = e.status;
    }
    // Without both frames there is nothing that a pose could refer to.
    if (ground_frame.empty() || mav_frame.empty()) return;

    AlignmentEstimate msg;
    msg.header = header;
    msg.child_frame_id = mav_frame;
    msg.pose.pose = ros_utils::toMsg(e.T_ground_mav);
    ros_utils::setCovariance(e.covariance, &msg.pose.covariance);
    msg.reference_point.x = e.reference_point.x();
    msg.reference_point.y = e.reference_point.y();
    msg.reference_point.z = e.reference_point.z();
    msg.status = toMsg(e.status);
    msg.scale = 1;
    msg.stage = AlignmentEstimate::STAGE_COARSE;
    msg.reason = e.reason;
    msg.particle_spread = e.particle_spread;
    msg.particle_spread_yaw = e.particle_spread_yaw;
    msg.overlap = e.overlap;
    msg.cost = e.cost;
    msg.iterations = static_cast<std::uint32_t>(e.maps);
    msg.map_id = map_id;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (command_.forgets()) return;  // it is about a map that has ended
      T_ground_mav_.reset();
      if (e.status == Status::kConverged) T_ground_mav_ = e.T_ground_mav;
    }
    coarse_.publish(msg);
    if (!e.has_pose) return;

    publishParticles(header);
    if (costmap_.getNumSubscribers() > 0) {
      Eigen::Vector2d pivot;
      const CostMap cost = localizer_.costMap(&pivot);
      // Cells stand for the MAV's position, as the particles do.
      const PlanarPose shift = changeReference({0, 0, cost.yaw}, pivot, reference_.head<2>());
      if (!cost.cost.empty()) costmap_.publish(toMsg(cost, {shift.x, shift.y}, header));
    }
  }

  void publishTf() {
    const std::lock_guard<std::mutex> lock(mutex_);
    const ros::Time now = ros::Time::now();
    // The clock stands still while a bag is paused: the same stamp is not sent again.
    if (!T_ground_mav_ || now.isZero() || now == last_tf_) return;
    last_tf_ = now;
    geometry_msgs::TransformStamped transform;
    transform.header.stamp = now;
    transform.header.frame_id = ground_frame_;
    transform.child_frame_id = mav_frame_;
    transform.transform = ros_utils::toTransformMsg(*T_ground_mav_);
    broadcaster_.sendTransform(transform);
  }

  void publishParticles(const std_msgs::Header& header) {
    geometry_msgs::PoseArray msg;
    msg.header = header;
    const double z = reference_.z() + localizer_.estimate().T_ground_mav.translation().z();
    for (const Particle& p : localizer_.filter().particles()) {
      msg.poses.push_back(ros_utils::toMsg(air_ground_common::yawPose(p.pose.yaw + heading_, {p.pose.x, p.pose.y, z})));
    }
    particles_.publish(msg);
  }

  static constexpr std::size_t kOdometryKept = 4000;

  ros::NodeHandle handle_, private_handle_;
  const NodeSettings settings_;
  ros_utils::NodeHealth health_;
  ros::Publisher height_map_air_, height_map_ground_, costmap_, particles_, coarse_;
  ros::Subscriber cloud_sub_, ground_status_sub_, odometry_sub_, status_sub_, guess_sub_;
  std::optional<ros_utils::RenewableSubscriber> ground_sub_;
  ros::ServiceServer reset_, relocalize_;
  ros::Timer tf_timer_;
  tf2_ros::TransformBroadcaster broadcaster_;

  // Shared with the worker, under mutex_.
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  Command command_;
  std::deque<WaitingCloud> clouds_;
  Cloud ground_;
  // The robots' clocks are watched apart: when the MAV's steps back, a ground robot that stands still does not send its
  // map again.
  ros_utils::StreamGate mav_gate_{kMavStreams, health_, [this] { onMavTimeJump(); }};
  ros_utils::StreamGate ground_gate_{kGroundStreams, health_, [this] { onGroundTimeJump(); }};
  ros::Time map_begin_, ground_map_begin_;  // clouds before belong to an earlier map
  air_ground_common::Trajectory odometry_;
  std::optional<std::uint32_t> map_id_, ground_map_id_;
  std::string ground_frame_, mav_frame_;
  std::optional<Pose> T_ground_mav_;  // what tf says: while CONVERGED
  ros::Time last_tf_;

  // The worker's own.
  Localizer localizer_;
  ros::Time aerial_stamp_, ground_stamp_;
  Eigen::Vector3d reference_ = Eigen::Vector3d::Zero();
  double heading_ = 0;
  std::optional<Status> last_status_;

  std::thread worker_;
};

}  // namespace heightmap_mcl

int main(int argc, char** argv) {
  ros::init(argc, argv, "heightmap_mcl");
  const ros::NodeHandle keep_alive;  // with the last handle roscpp ends, and the console with it
  try {
    heightmap_mcl::HeightmapMclNode node;
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("heightmap_mcl: %s", e.what());
    return 1;
  }
  return 0;
}
