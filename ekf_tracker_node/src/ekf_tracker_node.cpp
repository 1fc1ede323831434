// Wires the tracker to ROS: visual odometry in, street-level fixes in, pose in the city out. All work is microseconds,
// so everything runs in the callbacks of one thread, in the order of arrival.
#include <air_ground/SaveTrajectory.h>
#include <air_ground/VoIncrement.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/Imu.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>

#include <cmath>
#include <deque>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/text.h"
#include "ekf_tracker/increment_synchronizer.h"
#include "sensor_bridge.h"
#include "tracked_pose_publisher.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;
using Synchronizer = IncrementSynchronizer<air_ground::VoIncrement::ConstPtr>;

constexpr double kSilence = 1.0;           // without odometry that could be used: it is lost [s]
constexpr double kFieldTolerance = 0.2;    // between a magnetometer's reading and the pose that tells its tilt [s]
constexpr double kUnlocated = 10;          // odometry without any fix: said on the console [s]
constexpr std::size_t kMostFields = 1000;  // readings that wait for the odometry

std::optional<air_ground_common::LocalFrame> frameOf(const NodeSettings& settings) {
  if (settings.origin_crs.empty()) return std::nullopt;
  air_ground_common::LocalFrame frame(settings.origin_crs, Eigen::Vector3d(settings.origin.data()));
  const auto& o = frame.origin();
  ROS_INFO("the world's origin is at latitude %.7f, longitude %.7f; grid north lies %.4f deg clockwise of its y axis%s",
           o.latitude, o.longitude, frame.meridianConvergence() * 180 / M_PI,
           frame.usesGrid() ? "; by a grid file" : "");
  return frame;
}

// Of a clock that nobody sets [s].
double steadySeconds() { return ros::SteadyTime::now().toSec(); }
// By the clock that the messages follow, so that a paused replay is no silence; else by one that nobody sets.
double seconds() { return ros::Time::isSimTime() ? ros::Time::now().toSec() : steadySeconds(); }

class EkfTrackerNode {
 public:
  EkfTrackerNode(ros::NodeHandle handle, ros::NodeHandle private_handle, const NodeSettings& settings)
      : settings_(settings),
        tracker_(settings_.tracker),
        frame_(frameOf(settings_)),
        bridge_(settings_, frame_ ? &*frame_ : nullptr),
        publisher_(handle, settings_, frame_ ? &*frame_ : nullptr),
        health_("ekf_tracker"),
        listener_(tf_) {
    increments_ = handle.subscribe("mav/vo_increment", 400, &EkfTrackerNode::onIncrement, this);
    fixes_ = handle.subscribe("streetview/pose", 100, &EkfTrackerNode::onFix, this);
    // Fixes come seconds apart: their absence is told by the state, not by a watch for silence.
    health_.expectInput(increments_.getTopic());
    if (settings_.odometry_wait > 0) {
      vo_poses_ = handle.subscribe("mav/odometry", 400, &EkfTrackerNode::onVoPose, this);
      health_.expectInput(vo_poses_.getTopic());
    }
    if (settings_.magnetometer || settings_.odometry_wait > 0)
      imu_ = handle.subscribe("mav/imu/data", 1000, &EkfTrackerNode::onImu, this);
    if (settings_.magnetometer) {
      magnetometer_ = handle.subscribe("mav/imu/mag", 400, &EkfTrackerNode::onMagneticField, this);
      health_.expectInput(magnetometer_.getTopic());
    }
    if (settings_.gps) {
      gps_ = handle.subscribe("gps/fix", 100, &EkfTrackerNode::onGps, this);
      health_.expectInput(gps_.getTopic());
    }
    if (settings_.barometer) {
      barometer_ = handle.subscribe("barometer", 200, &EkfTrackerNode::onPressure, this);
      health_.expectInput(barometer_.getTopic());
    }
    reset_ = private_handle.advertiseService("reset", &EkfTrackerNode::onReset, this);
    save_ = private_handle.advertiseService("save_trajectory", &EkfTrackerNode::onSave, this);
    timer_ = handle.createWallTimer(ros::WallDuration(0.1), [this](const ros::WallTimerEvent&) {
      drain();
      drainFields();
      watch();
    });
    health_.state(1, "waiting for visual odometry");
  }

  ~EkfTrackerNode() {
    autosave_.save("trajectory.txt", [this](const std::string& path) {
      if (publisher_.trajectory().empty()) throw std::runtime_error("no pose was tracked");
      air_ground_common::writeTum(path, publisher_.trajectory());
    });
  }

 private:
  // ---- Visual odometry ----------------------------------------------------------------------------------------------

  void onIncrement(const air_ground::VoIncrement::ConstPtr& msg) {
    health_.received(increments_.getTopic(), msg->header.stamp);
    const ros::Time now = ros::Time::now();
    if (ros::Time::isSimTime() && clock_.jumped(now)) {
      synchronizer_.clear();
      onTimeJump();
    }
    // One from the future would push the history out, and all good ones behind it would be late.
    if (!now.isZero() && msg->header.stamp.toSec() > now.toSec() + settings_.clock_tolerance)
      return health_.count("increments ignored: stamped ahead of the clock");
    const Synchronizer::Arrival arrival{msg->previous_stamp.toSec(), msg->header.stamp.toSec(), msg->metric != 0, msg};
    switch (synchronizer_.admit(arrival, steadySeconds())) {
      case Synchronizer::Admission::kSetAside:
        return health_.count("increments set aside: more than a second older than the newest");
      case Synchronizer::Admission::kJump:
        onTimeJump();
        break;
      case Synchronizer::Admission::kTaken:
        break;
    }
    drain();
  }

  void onTimeJump() {
    health_.count("time jumped back: started afresh");
    ROS_WARN("time jumped back (a looped bag?): starting afresh");
    forget();
  }

  void onVoPose(const nav_msgs::Odometry::ConstPtr& msg) {
    health_.received(vo_poses_.getTopic(), msg->header.stamp);
    // Of a frame that is not the one named here nothing is known, not even that it is level: no tilt and no tf from it.
    if (msg->header.frame_id != settings_.map_frame)
      return health_.count("mav/odometry ignored: in frame '" + msg->header.frame_id + "', expected map_frame '" +
                           settings_.map_frame + "'");
    if (!msg->child_frame_id.empty() && msg->child_frame_id != settings_.base_frame)
      return health_.count("mav/odometry ignored: of frame '" + msg->child_frame_id + "', expected base_frame '" +
                           settings_.base_frame + "'");
    try {
      tilts_.addPose(msg->header.stamp.toSec(), ru::fromMsg(msg->pose.pose));
    } catch (const std::invalid_argument& e) {
      return health_.count(std::string("mav/odometry ignored: ") + e.what());
    }
    drain();
    drainFields();
  }

  void drain() {
    while (const auto ready = synchronizer_.next(steadySeconds())) apply(*ready->message, ready->T_map_base);
  }

  void apply(const air_ground::VoIncrement& msg, const std::optional<Pose>& T_map_base) {
    const ros::WallTime started = ros::WallTime::now();
    const auto R_level_base = tiltAt(msg.header.stamp.toSec(), T_map_base);
    if (settings_.odometry_wait > 0 && !T_map_base)
      health_.count(
          R_level_base
              ? "increments without mav/odometry of their stamp: tilt from mav/imu/data, no tf"
              : "increments without mav/odometry of their stamp, nor mav/imu/data: roll and pitch neglected, no tf");
    bool replaced = false;
    IncrementResult result = IncrementResult::kInvalid;
    try {
      result = tracker_.addIncrement(bridge_.increment(msg, R_level_base), &replaced);
    } catch (const std::invalid_argument& e) {
      return health_.count(std::string("increments ignored: ") + e.what());
    }
    if (replaced) health_.count("increments whose covariance is not one: the default stands in");
    if (!countResult(result)) return;
    used_ = seconds();
    lost_ = false;
    health_.timing("odometry step", (ros::WallTime::now() - started).toSec());
    publishOutcomes();
    publishPose(msg, R_level_base, T_map_base);
  }

  // False: the increment was not used.
  bool countResult(IncrementResult result) {
    switch (result) {
      case IncrementResult::kUsed:
        return true;
      case IncrementResult::kUsedAfterGap:
        health_.count("gaps in the odometry, bridged");
        return true;
      case IncrementResult::kNewUnit:
        health_.count(
            "odometry began a new map in an unknown unit: only its turns are used until two fixes give the scale");
        return true;
      case IncrementResult::kOutOfOrder:
        health_.count("increments ignored: out of order or repeated");
        return false;
      case IncrementResult::kInvalid:
        health_.count("increments ignored: not finite");
        return false;
    }
    return false;
  }

  // ---- Measurements -------------------------------------------------------------------------------------------------

  void add(const Measurement& m) {
    const ros::WallTime started = ros::WallTime::now();
    const ros::Time now = ros::Time::now();
    if (!now.isZero() && std::isfinite(m.stamp) && m.stamp > now.toSec() + settings_.clock_tolerance) {
      Outcome out;
      out.measurement = m;
      out.result = Result::kFromFuture;
      out.dof = m.size();
      out.nis = std::numeric_limits<double>::quiet_NaN();
      out.delay = now.toSec() - m.stamp;
      return publishOutcome(out);
    }
    tracker_.addMeasurement(m);
    health_.timing("measurement with replay", (ros::WallTime::now() - started).toSec());
    publishOutcomes();
  }

  void onFix(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& msg) {
    ++fixes_heard_;
    if (msg->header.frame_id != settings_.world_frame)
      return health_.count("fixes ignored: in frame '" + msg->header.frame_id + "', expected '" +
                           settings_.world_frame + "'");
    add(bridge_.fix(*msg));
  }

  void onGps(const sensor_msgs::NavSatFix::ConstPtr& msg) {
    health_.received(gps_.getTopic(), msg->header.stamp);
    try {
      if (const auto m = bridge_.gps(*msg)) add(*m);
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("GPS positions ignored: ") + e.what());
    }
  }

  void onPressure(const sensor_msgs::FluidPressure::ConstPtr& msg) {
    health_.received(barometer_.getTopic(), msg->header.stamp);
    try {
      if (const auto m = bridge_.pressure(*msg)) add(*m);
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("barometer readings ignored: ") + e.what());
    }
  }

  void onImu(const sensor_msgs::Imu::ConstPtr& msg) {
    const Eigen::Vector3d force(msg->linear_acceleration.x, msg->linear_acceleration.y, msg->linear_acceleration.z);
    const auto R_base_sensor = rotationFrom(msg->header.frame_id);
    if (force.allFinite() && R_base_sensor) tilts_.addSpecificForce(msg->header.stamp.toSec(), *R_base_sensor * force);
  }

  void onMagneticField(const sensor_msgs::MagneticField::ConstPtr& msg) {
    health_.received(magnetometer_.getTopic(), msg->header.stamp);
    if (!bridge_.takesField(*msg)) return;
    pending_fields_.emplace_back(msg, steadySeconds());
    if (pending_fields_.size() > kMostFields) pending_fields_.pop_front();
    drainFields();
  }

  // A reading waits, like an increment, for the odometry of its time, whose tilt is better than the accelerometer's.
  void drainFields() {
    while (!pending_fields_.empty()) {
      const auto [msg, received] = pending_fields_.front();
      const bool come = tilts_.newestPose() >= msg->header.stamp.toSec();
      if (!come && steadySeconds() - received <= settings_.odometry_wait) return;
      pending_fields_.pop_front();
      applyField(*msg);
    }
  }

  void applyField(const sensor_msgs::MagneticField& msg) {
    const auto R_base_sensor = rotationFrom(msg.header.frame_id);
    if (!R_base_sensor) return;
    const double stamp = msg.header.stamp.toSec();
    const auto T_map_base = tilts_.poseAt(stamp, kFieldTolerance);
    const auto R_level_base = T_map_base ? tiltOf(T_map_base->linear()) : tilts_.accelerometerTiltAt(stamp);
    if (!R_level_base)
      return health_.count("magnetometer readings ignored: no tilt from mav/odometry or mav/imu/data at their time");
    try {
      add(bridge_.heading(msg, *R_base_sensor, *R_level_base));
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("magnetometer readings ignored: ") + e.what());
    }
  }

  // From the odometry or, without, the accelerometer; empty where neither says anything.
  std::optional<Eigen::Matrix3d> tiltAt(double stamp, const std::optional<Pose>& T_map_base) const {
    if (T_map_base) return tiltOf(T_map_base->linear());
    if (settings_.odometry_wait <= 0) return std::nullopt;
    return tilts_.accelerometerTiltAt(stamp);
  }

  std::optional<Eigen::Matrix3d> rotationFrom(const std::string& frame) {
    if (frame.empty() || frame == settings_.base_frame) return Eigen::Matrix3d::Identity();
    try {
      return ru::fromMsg(tf_.lookupTransform(settings_.base_frame, frame, ros::Time(0)).transform).linear();
    } catch (const std::exception&) {
      health_.count("readings ignored: no transform from " + frame + " to " + settings_.base_frame);
      return std::nullopt;
    }
  }

  // ---- Output -------------------------------------------------------------------------------------------------------

  void publishOutcomes() {
    for (const Outcome& o : tracker_.takeOutcomes()) publishOutcome(o);
    if (tracker_.filter().recoveries() > recoveries_) {
      ROS_WARN("fixes that agree with each other contradicted the tracked pose: it was wrong and has been replaced");
      health_.count("recoveries from a wrong pose");
    }
    recoveries_ = tracker_.filter().recoveries();
  }

  void publishOutcome(const Outcome& o) {
    const Source source = o.measurement.source;
    if (source == Source::kFix && isUsed(o.result)) last_fix_ = std::max(last_fix_, o.measurement.stamp);
    // Refusals are counted by name; waiting for a partner is none.
    const bool waits = o.result == Result::kWaiting || o.result == Result::kNotStarted;
    if (o.revised)
      health_.count("results of earlier measurements revised by later ones");
    else if (o.result == Result::kRecovered || (!isUsed(o.result) && !waits))
      health_.count(std::string(nameOf(source)) + ": " + describe(o.result));
    if (o.result == Result::kInitialised) ROS_INFO("fixes that agree start the tracker");
    publisher_.publish(o, tracker_);
  }

  void publishPose(const air_ground::VoIncrement& cause, const std::optional<Eigen::Matrix3d>& R_level_base,
                   const std::optional<Pose>& T_map_base) {
    const double stamp = cause.header.stamp.toSec();
    const auto estimate = tracker_.latest();
    if (!estimate) return sayUnlocated(stamp, cause.metric != 0);
    publisher_.publish(cause.header.stamp, *estimate, tracker_.rate(),
                       R_level_base.value_or(Eigen::Matrix3d::Identity()), T_map_base);
    sayTracking(*estimate, stamp);
  }

  void sayUnlocated(double stamp, bool metric) {
    std::string line = metric
                           ? "waiting for two fixes that agree"
                           : "waiting for fixes that agree, two of them far enough apart to give the odometry's scale";
    line += "; " + std::to_string(fixes_heard_) + " came on " + fixes_.getTopic() + ", which has " +
            std::to_string(fixes_.getNumPublishers()) + " publishers";
    health_.state(1, line);
    if (fixes_heard_ > 0) return;
    if (!unlocated_since_ || stamp < *unlocated_since_) unlocated_since_ = stamp;
    if (stamp > *unlocated_since_ + kUnlocated)
      ROS_WARN_STREAM_ONCE("odometry has come for 10 s, but no fix: " << line);
  }

  void sayTracking(const Estimate& estimate, double stamp) {
    const Vector4d stddev = estimate.covariance.diagonal().cwiseSqrt();
    const std::string line = air_ground_common::formatted(
        "tracking: %.1f %.1f %.1f m, %.1f deg (1 sigma); odometry scale %.3f +- %.3f; %d fixes; last fused %.1f s ago",
        stddev[0], stddev[1], stddev[2], stddev[3] * 180 / M_PI, estimate.scale, estimate.scale_stddev,
        estimate.support, stamp - last_fix_);
    if (!estimate.scale_known)
      health_.state(1, "the odometry's scale is not known: position is held by fixes alone; " + line);
    else if (tracker_.filter().strongestRival() > 1)
      health_.state(1, "doubtful, refused fixes agree; " + line);
    else
      health_.state(0, line);
  }

  // What was said last must not stand when the odometry has died.
  void watch() {
    if (!used_ || lost_) return;
    const double silent = seconds() - *used_;
    if (silent < 0) used_ = seconds();  // the clock ran back
    if (silent < kSilence) return;
    lost_ = true;
    health_.count("visual odometry was lost");
    health_.state(
        2, "no usable visual odometry on " + increments_.getTopic() + " for more than a second: no pose is published");
  }

  // All but the increments that wait: at a jump they are of the new time already.
  void forget() {
    used_.reset();
    lost_ = false;
    health_.state(1, "forgot the pose; waiting for visual odometry");
    tilts_.clear();
    tracker_.reset();
    bridge_.reset();
    publisher_.reset();
    tf_.clear();  // of moving edges; fixed ones stay
    pending_fields_.clear();
    last_fix_ = 0;
    recoveries_ = 0;
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    synchronizer_.clear();
    forget();
    response.success = true;
    response.message = "forgot the pose; waiting for fixes";
    return true;
  }

  bool onSave(air_ground::SaveTrajectory::Request& request, air_ground::SaveTrajectory::Response& response) {
    return ru::answer(response, [&] {
      const auto& trajectory = publisher_.trajectory();
      air_ground_common::writeTum(request.path, trajectory);
      response.poses = trajectory.size();
      return "wrote " + std::to_string(trajectory.size()) + " poses of " + settings_.base_frame + " in " +
             settings_.world_frame + " to " + request.path;
    });
  }

  const NodeSettings settings_;
  const ru::Autosave autosave_{settings_.autosave};
  Tracker tracker_;
  const std::optional<air_ground_common::LocalFrame> frame_;
  SensorBridge bridge_;
  TrackedPosePublisher publisher_;
  TiltSource tilts_;
  Synchronizer synchronizer_{settings_.odometry_wait, tilts_};
  ru::NodeHealth health_;
  ru::TimeJumpDetector clock_;
  tf2_ros::Buffer tf_;
  tf2_ros::TransformListener listener_;
  ros::Subscriber increments_, fixes_, vo_poses_, imu_, magnetometer_, gps_, barometer_;
  ros::ServiceServer reset_, save_;
  ros::WallTimer timer_;

  std::deque<std::pair<sensor_msgs::MagneticField::ConstPtr, double>> pending_fields_;  ///< with their arrival [s]
  std::optional<double> used_;  ///< when an increment was, by seconds()
  bool lost_ = false;
  std::optional<double> unlocated_since_;  ///< [s]
  double last_fix_ = 0;                    ///< stamp of the last one fused [s]
  std::size_t fixes_heard_ = 0;
  int recoveries_ = 0;
};

}  // namespace
}  // namespace ekf_tracker

int main(int argc, char** argv) {
  return air_ground_common::ros_utils::runNode<ekf_tracker::NodeSettings>(
      argc, argv, "ekf_tracker", [](const auto& settings) {
        ekf_tracker::EkfTrackerNode node{ros::NodeHandle(), ros::NodeHandle("~"), settings};
        ros::spin();
      });
}
