#include "inbox.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/ros/conversions.h"

namespace heightmap_mcl {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground_common::Pose;

void Inbox::addAerial(const Cloud& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!mav_gate_.admit(kAerial, msg->header.stamp)) return;
  // A map without scale, or one that has got an IMU, is another map.
  const bool own_unit = msg->header.frame_id == settings_.visual_map_frame;
  if (!mav_frame_.empty() && own_unit != ownUnit()) {
    forgetAerial();
    mav_frame_.clear();
  }
  if (!frameFits(msg->header.frame_id, own_unit ? settings_.visual_map_frame : settings_.mav_map_frame, &mav_frame_,
                 "aerial clouds"))
    return;
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

void Inbox::addGround(const Cloud& msg) {
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

void Inbox::addOdometry(const nav_msgs::OdometryConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!mav_gate_.admit(kOdometry, msg->header.stamp)) return;
  if (ownUnit()) return;  // it is metric, if it comes at all: nothing that the clouds have to do with
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

void Inbox::addMavStatus(const air_ground::VoStatusConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!mav_gate_.admit(kMavStatus, msg->header.stamp)) return;
  if (map_id_ && msg->map_id != *map_id_) {
    ROS_INFO("The MAV has begun map %u: searching again", msg->map_id);
    forgetAerial();
    map_begin_ = msg->header.stamp;
  }
  map_id_ = msg->map_id;
}

void Inbox::addGroundStatus(const air_ground::VoStatusConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!ground_gate_.admit(kGroundStatus, msg->header.stamp)) return;
  if (ground_map_id_ && msg->map_id != *ground_map_id_) {
    ROS_INFO("The ground robot has begun map %u: searching again", msg->map_id);
    forgetGround();
    ground_map_begin_ = msg->header.stamp;
  }
  ground_map_id_ = msg->map_id;
}

void Inbox::setInitialPose(const geometry_msgs::PoseWithCovarianceStampedConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!ground_frame_.empty() && msg->header.frame_id != ground_frame_) {
    ROS_WARN("initialpose in frame '%s' ignored: the ground map is in '%s'", msg->header.frame_id.c_str(),
             ground_frame_.c_str());
    return;
  }
  if (ownUnit()) {
    ROS_WARN("initialpose ignored: the MAV's map has no scale, so that its place in it says nothing");
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
    if (settings_.localizer.mode == Mode::kPaper) prior.position_radius = settings_.search_radius;
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

void Inbox::reset() {
  const std::lock_guard<std::mutex> lock(mutex_);
  forgetAerial();
  forgetGround();
  command_ = Command();
  command_.reset = true;
}

void Inbox::relocalize() {
  const std::lock_guard<std::mutex> lock(mutex_);
  command_.relocalize = true;
  command_.prior = settings_.prior;
  wake_.notify_one();
}

/// Empty `expected` accepts the first frame that comes; another one later is refused, and both are named.
bool Inbox::frameFits(const std::string& frame, const std::string& expected, std::string* known,
                      const std::string& what) {
  if (known->empty()) *known = expected.empty() ? frame : expected;
  if (frame == *known && !frame.empty()) return true;
  health_.count(what + " in frame '" + frame + "' dropped: expected '" + *known + "'");
  return false;
}

void Inbox::onMavTimeJump() {
  ROS_WARN("The MAV's time jumped back: its map starts afresh");
  forgetAerial();
}

void Inbox::onGroundTimeJump() {
  ROS_WARN("The ground robot's time jumped back: its map starts afresh");
  forgetGround();
}

void Inbox::forgetAerial() {
  clouds_.clear();
  odometry_.clear();
  map_begin_ = ros::Time();
  map_id_.reset();
  command_.forget_aerial = true;
  endSearch();
}

void Inbox::forgetGround() {
  ground_.reset();
  ground_map_begin_ = ros::Time();
  ground_map_id_.reset();
  command_.forget_ground = true;
  // A latched map that has come already comes again.
  resubscribe_ground_();
  endSearch();
}

/// Pose and guesses refer to a map that is no more.
void Inbox::endSearch() {
  command_.prior.reset();
  T_ground_mav_.reset();
  wake_.notify_one();
}

std::optional<Work> Inbox::next() {
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
    if (stop_) return std::nullopt;
    Work work;
    work.command = std::exchange(command_, {});
    work.ground = std::exchange(ground_, nullptr);
    if (cloudReady()) takeCloud(work);
    if (!work.aerial && !work.ground && !work.command.any()) continue;
    work.map_id = map_id_.value_or(0);
    work.own_unit = ownUnit();
    work.ground_frame = ground_frame_;
    work.mav_frame = mav_frame_;
    return work;
  }
}

void Inbox::takeCloud(Work& work) {
  work.aerial = clouds_.front().cloud;
  clouds_.pop_front();
  const double stamp = work.aerial->header.stamp.toSec();
  if (!odometry_.empty() && stamp > odometry_.back().stamp + 5) {
    health_.count("aerial clouds later than the odometry by more than 5 s dropped");
    work.aerial.reset();
  } else if (const auto pose = air_ground_common::poseAt(odometry_, stamp, settings_.odometry_gap)) {
    work.reference = air_ground_common::StampedPose{stamp, *pose};
  }
}

void Inbox::stop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
}

bool Inbox::pending() const { return cloudReady() || ground_ || command_.any(); }

/// The oldest cloud has odometry up to its stamp, or has waited long enough for it.
bool Inbox::cloudReady() const {
  if (clouds_.empty()) return false;
  const WaitingCloud& next = clouds_.front();
  return ownUnit() || Clock::now() >= next.until ||
         (!odometry_.empty() && odometry_.back().stamp >= next.cloud->header.stamp.toSec());
}

bool Inbox::conclude(const std::optional<Pose>& T_ground_mav) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (command_.forgets()) return false;
  T_ground_mav_ = T_ground_mav;
  return true;
}

std::optional<Inbox::Alignment> Inbox::alignment() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!T_ground_mav_) return std::nullopt;
  return Alignment{*T_ground_mav_, ground_frame_, mav_frame_};
}

}  // namespace heightmap_mcl
