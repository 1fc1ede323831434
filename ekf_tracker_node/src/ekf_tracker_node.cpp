// Wires the tracker to ROS: visual odometry in, street-level fixes in, pose in the city out. All work is microseconds,
// so everything runs in the callbacks of one thread, in the order of arrival.
#include <air_ground/SaveTrajectory.h>
#include <air_ground/VoIncrement.h>
#include <ros/ros.h>
#include <std_srvs/Trigger.h>

#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/parameters.h"
#include "attitude_input.h"
#include "ekf_tracker/increment_synchronizer.h"
#include "sensor_bridge.h"
#include "tracked_pose_publisher.h"
#include "tracker_state.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;
using Synchronizer = IncrementSynchronizer<air_ground::VoIncrement::ConstPtr>;

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

class EkfTrackerNode {
 public:
  EkfTrackerNode(ros::NodeHandle handle, ros::NodeHandle private_handle, const NodeSettings& settings)
      : settings_(settings),
        tracker_(settings_.tracker),
        frame_(frameOf(settings_)),
        bridge_(settings_, frame_ ? &*frame_ : nullptr),
        publisher_(handle, settings_, frame_ ? &*frame_ : nullptr),
        health_("ekf_tracker"),
        state_(health_),
        attitude_(
            handle, settings_, bridge_, health_, [this] { drain(); }, [this](const Measurement& m) { add(m); }) {
    increments_ = handle.subscribe("mav/vo_increment", 400, &EkfTrackerNode::onIncrement, this);
    fixes_ = handle.subscribe("streetview/pose", 100, &EkfTrackerNode::onFix, this);
    // Fixes come seconds apart: their absence is told by the state, not by a watch for silence.
    health_.expectInput(increments_.getTopic());
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
      attitude_.drainFields();
      state_.watch(increments_.getTopic());
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

  void drain() {
    while (const auto ready = synchronizer_.next(steadySeconds())) apply(*ready->message, ready->T_map_base);
  }

  void apply(const air_ground::VoIncrement& msg, const std::optional<Pose>& T_map_base) {
    const ros::WallTime started = ros::WallTime::now();
    const auto R_level_base = attitude_.tiltAt(msg.header.stamp.toSec(), T_map_base);
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
    state_.odometryUsed();
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
    state_.fixHeard();
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
    if (source == Source::kFix && isUsed(o.result)) state_.fixUsed(o.measurement.stamp);
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
    if (!estimate) return state_.unlocated(stamp, cause.metric != 0, fixes_);
    publisher_.publish(cause.header.stamp, *estimate, tracker_.rate(),
                       R_level_base.value_or(Eigen::Matrix3d::Identity()), T_map_base);
    state_.tracking(*estimate, stamp, tracker_.filter().strongestRival() > 1);
  }

  // All but the increments that wait: at a jump they are of the new time already.
  void forget() {
    state_.forget();
    attitude_.clear();
    tracker_.reset();
    bridge_.reset();
    publisher_.reset();
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
  ru::NodeHealth health_;
  TrackerState state_;
  AttitudeInput attitude_;
  Synchronizer synchronizer_{settings_.odometry_wait, attitude_.tilts()};
  ru::TimeJumpDetector clock_;
  ros::Subscriber increments_, fixes_, gps_, barometer_;
  ros::ServiceServer reset_, save_;
  ros::WallTimer timer_;

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
