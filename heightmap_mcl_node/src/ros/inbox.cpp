#include "inbox.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/map_correction.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/ros/vertical_message.h"

namespace heightmap_mcl {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground_common::Pose;
using air_ground_common::RobotMapSession;

Inbox::Inbox(const NodeSettings& settings, ros_utils::NodeHealth& health, std::function<void()> resubscribe_ground)
    : settings_(settings),
      health_(health),
      resubscribe_ground_(std::move(resubscribe_ground)),
      mav_("MAV", kMavStreams, RobotMapSession(settings.mav_map_frame, settings.visual_map_frame), health,
           [this] { forgetAerial(); }),
      ground_robot_(
          "ground robot", kGroundStreams, RobotMapSession(settings.ground_map_frame), health,
          [this] { forgetGround(); }, [this] { reviseGround(); }) {}

void Inbox::addAerial(const Cloud& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  // Twice the same cloud would count as evidence twice, and an older one's stamp as a jump of time.
  if (stamps_.has(msg->header.stamp)) return health_.count("aerial clouds repeated");
  if (!mav_.admitMap(kAerial, msg->header, "aerial clouds")) return;
  stamps_.add(msg->header.stamp);
  clouds_.push_back({msg, Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                             std::chrono::duration<double>(ros_utils::kTopicsInStep))});
  while (static_cast<int>(clouds_.size()) > settings_.cloud_queue) {
    passed_by_.push_back(clouds_.front().cloud);
    clouds_.pop_front();
    health_.count("aerial clouds not searched when they came: the queue is full");
  }
  // No more would be kept.
  while (passed_by_.size() > air_ground_common::kFollowedClouds) passed_by_.pop_front();
  wake_.notify_one();
}

void Inbox::addCorrections(const air_ground::CloudCorrectionsConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!mav_.admitMap(kCorrections, msg->header, "corrections of clouds")) return;
  try {
    corrections_ = ros_utils::fromMsg(*msg);
  } catch (const std::exception& e) {
    health_.count(std::string("corrections of clouds unreadable: ") + e.what());
  }
}

void Inbox::addGround(const Cloud& msg) {
  if (msg->width == 0 || msg->height == 0) {
    // Must not push out a good one that still waits.
    health_.count("ground clouds without a point");
    return;
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!ground_robot_.admitMap(kGround, msg->header, "ground clouds")) return;
  ground_stamp_ = msg->header.stamp;
  ground_ = msg;  // the newest replaces one that still waits
  wake_.notify_one();
}

void Inbox::addOdometry(const nav_msgs::OdometryConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!mav_.admit(kOdometry, msg->header.stamp)) return;
  if (mav_.map().ownUnit()) return;  // it is metric, if it comes at all: nothing that the clouds have to do with
  const std::string& mav_frame = mav_.map().frame();
  if (!mav_frame.empty() && !mav_.isFrame(msg->header.frame_id, mav_frame, "odometry")) return;
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
  // Once scaled, the MAV speaks of its metric map.
  if (!mav_.admitStatus(kMavStatus, *msg) || msg->state != air_ground::VoStatus::STATE_SCALING) return;
  if (const auto vertical = ros_utils::verticalFromMsg(*msg); vertical.stddev > 0) mav_vertical_ = vertical;
}

void Inbox::addGroundStatus(const air_ground::VoStatusConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  ground_robot_.admitStatus(kGroundStatus, *msg);
}

void Inbox::setInitialPose(const geometry_msgs::PoseWithCovarianceStampedConstPtr& msg) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const std::string& ground_frame = ground_robot_.map().expectedFrame();
  if (!ground_frame.empty() && !ground_robot_.isFrame(msg->header.frame_id, ground_frame, "initial poses")) return;
  if (mav_.map().ownUnit()) {
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
  mav_.restart();
  ground_robot_.restart();
  command_ = Command();
  command_.reset = true;
}

void Inbox::relocalize() {
  const std::lock_guard<std::mutex> lock(mutex_);
  command_.relocalize = true;
  command_.prior = settings_.prior;
  wake_.notify_one();
}

void Inbox::forgetAerial() {
  clouds_.clear();
  passed_by_.clear();
  stamps_.clear();
  odometry_.clear();
  corrections_.reset();
  mav_vertical_ = {};
  command_.forget_aerial = true;
  endSearch();
}

void Inbox::forgetGround() {
  ground_.reset();
  ground_corrected_ = false;
  command_.forget_ground = true;
  // A latched map that has come already comes again.
  resubscribe_ground_();
  endSearch();
}

/// The next ground cloud is searched, however little it differs.
void Inbox::reviseGround() {
  ground_corrected_ = true;
  if (ground_robot_.map().isStale(ground_stamp_.toSec())) {
    ground_.reset();
  } else if (!ground_) {
    // The corrected map came before the word of it, and the robot may stand.
    resubscribe_ground_();
  }
}

/// Pose and guesses refer to a map that is no more.
void Inbox::endSearch() {
  command_.prior.reset();
  T_ground_mav_.reset();
  wake_.notify_one();
}

std::optional<Work> Inbox::next(const std::optional<double>& patience, bool together) {
  std::optional<Clock::time_point> idle_at;
  if (patience)
    idle_at = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(*patience));
  std::unique_lock<std::mutex> lock(mutex_);
  while (true) {
    Work work;
    while (!stop_ && !pending() && !work.idle) {
      std::optional<Clock::time_point> until = idle_at;
      if (!clouds_.empty()) until = until ? std::min(*until, clouds_.front().until) : clouds_.front().until;
      until ? static_cast<void>(wake_.wait_until(lock, *until)) : wake_.wait(lock);
      work.idle = idle_at && Clock::now() >= *idle_at && !pending();
    }
    if (stop_) return std::nullopt;
    work.command = std::exchange(command_, {});
    work.ground = std::exchange(ground_, nullptr);
    if (work.ground) work.ground_corrected = std::exchange(ground_corrected_, false);
    for (const Cloud& cloud : std::exchange(passed_by_, {}))
      work.passed_by.push_back({cloud, referenceAt(cloud->header.stamp.toSec())});
    while (cloudReady() && (together || !work.aerial.cloud)) {
      AerialMessage next = popCloud();
      if (!next.cloud) continue;
      if (work.aerial.cloud) work.before.push_back(std::move(work.aerial));
      work.aerial = std::move(next);
    }
    if (!work.aerial.cloud && !work.ground && work.passed_by.empty() && !work.command.any() && !work.idle) continue;
    work.corrections = std::exchange(corrections_, std::nullopt);
    work.map_id = mav_.map().id().value_or(0);
    work.ground_map_id = ground_robot_.map().id().value_or(0);
    work.own_unit = mav_.map().ownUnit();
    work.vertical = mav_vertical_;
    work.ground_frame = ground_robot_.map().frame();
    work.mav_frame = mav_.map().frame();
    return work;
  }
}

/// None where its odometry has long gone on.
AerialMessage Inbox::popCloud() {
  const Cloud cloud = clouds_.front().cloud;
  clouds_.pop_front();
  if (mav_.map().ownUnit()) {
    // What came before its first cloud is metric: of another map.
    odometry_.clear();
    return {cloud, std::nullopt};
  }
  const double stamp = cloud->header.stamp.toSec();
  if (!odometry_.empty() && stamp > odometry_.back().stamp + 5) {
    health_.count("aerial clouds later than the odometry by more than 5 s dropped");
    return {};
  }
  return {cloud, referenceAt(stamp)};
}

std::optional<air_ground_common::StampedPose> Inbox::referenceAt(double stamp) const {
  if (mav_.map().ownUnit()) return std::nullopt;
  const auto pose = air_ground_common::poseAt(odometry_, stamp, settings_.odometry_gap);
  if (!pose) return std::nullopt;
  return air_ground_common::StampedPose{stamp, *pose};
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
  return mav_.map().ownUnit() || Clock::now() >= next.until ||
         (!odometry_.empty() && odometry_.back().stamp >= next.cloud->header.stamp.toSec());
}

bool Inbox::conclude(const std::optional<Pose>& T_ground_mav) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (command_.forgets()) return false;
  T_ground_mav_ = T_ground_mav;
  return true;
}

std::optional<ros_utils::AlignmentBroadcaster::Edge> Inbox::alignment() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!T_ground_mav_) return std::nullopt;
  return ros_utils::AlignmentBroadcaster::Edge{ground_robot_.map().frame(), mav_.map().frame(), *T_ground_mav_};
}

}  // namespace heightmap_mcl
