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
#include "fix_input.h"
#include "outcome_report.h"
#include "sensor_bridge.h"
#include "tracked_pose_publisher.h"
#include "tracker_state.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;
using Synchronizer = IncrementSynchronizer<air_ground::VoIncrement::ConstPtr>;

// Of a clock that nobody sets [s].
double steadySeconds() { return ros::SteadyTime::now().toSec(); }

class EkfTrackerNode {
 public:
  explicit EkfTrackerNode(const NodeSettings& settings)
      : settings_(settings),
        tracker_(settings_.tracker),
        frame_(frameOf(settings_)),
        bridge_(settings_, frame_ ? &*frame_ : nullptr),
        publisher_(handle_, settings_, frame_ ? &*frame_ : nullptr),
        health_("ekf_tracker"),
        state_(health_),
        attitude_(
            handle_, settings_, bridge_, health_, [this] { drain(); }, [this](const Measurement& m) { add(m); }),
        fixes_(
            handle_, settings_, bridge_, health_, [this] { state_.fixHeard(); },
            [this](const FixInput::Message& fix) { attitude_.onFix(fix); }, [this](const Measurement& m) { add(m); }) {
    increments_ = handle_.subscribe("mav/vo_increment", 400, &EkfTrackerNode::onIncrement, this);
    // Fixes come seconds apart: their absence is told by the state, not by a watch for silence.
    health_.expectInput(increments_.getTopic());
    if (settings_.gps) {
      gps_ = handle_.subscribe("gps/fix", 100, &EkfTrackerNode::onGps, this);
      health_.expectInput(gps_.getTopic());
      if (!settings_.geoid_undulation)
        health_.count(
            "GPS positions are used in plan only, without their height: set the parameter geoid_undulation "
            "(ellipsoidal height minus the height used in origin; city_parameters prints it; 0 where origin is above "
            "the ellipsoid)");
    }
    if (settings_.barometer) {
      barometer_ = handle_.subscribe("barometer", 200, &EkfTrackerNode::onPressure, this);
      health_.expectInput(barometer_.getTopic());
    }
    reset_ = private_handle_.advertiseService("reset", &EkfTrackerNode::onReset, this);
    save_ = private_handle_.advertiseService("save_trajectory", &EkfTrackerNode::onSave, this);
    timer_ = handle_.createWallTimer(ros::WallDuration(0.1), [this](const ros::WallTimerEvent&) {
      drain();
      fixes_.drain();
      attitude_.drainFields();
      state_.watch(increments_.getTopic());
    });
    health_.state(health_.kWarn, "waiting for visual odometry");
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
    const double ahead = msg->header.stamp.toSec() - now.toSec();
    if (!now.isZero() && ahead > settings_.clock_tolerance) return state_.odometryAhead(ahead);
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
    attitude_.turned(msg);
    auto tilt = attitude_.tiltAt(msg.header.stamp.toSec(), T_map_base);
    if (settings_.odometry_wait > 0 && !T_map_base)
      health_.count(tilt
                        ? "increments without mav/odometry of their stamp: tilt from fixes and accelerometer, no tf"
                        : "increments without mav/odometry of their stamp, nor fixes or usable accelerations: roll and "
                          "pitch neglected, no tf");
    constexpr double kNeglected = 0.15;  // of the roll and pitch of a MAV in flight [rad]
    if (settings_.odometry_wait > 0 && !tilt) tilt = Tilt{Eigen::Matrix3d::Identity(), kNeglected};
    bool replaced = false;
    IncrementResult result = IncrementResult::kInvalid;
    try {
      result = tracker_.addIncrement(bridge_.increment(msg, tilt), &replaced);
    } catch (const std::invalid_argument& e) {
      return health_.count(std::string("increments ignored: ") + e.what());
    }
    if (replaced) health_.count("increments whose covariance is not one: the default stands in");
    if (!report_.count(result)) return;
    state_.odometryUsed();
    health_.timing("odometry step", (ros::WallTime::now() - started).toSec());
    report_.publishPending();
    publishPose(msg, tilt, T_map_base);
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
      return report_.publish(out);
    }
    tracker_.addMeasurement(m);
    health_.timing("measurement with replay", (ros::WallTime::now() - started).toSec());
    report_.publishPending();
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

  void publishPose(const air_ground::VoIncrement& cause, const std::optional<Tilt>& tilt,
                   const std::optional<Pose>& T_map_base) {
    const double stamp = cause.header.stamp.toSec();
    const auto estimate = tracker_.latest();
    if (!estimate) return state_.unlocated(stamp, cause.metric != 0, fixes_.subscriber());
    publisher_.publish(cause.header.stamp, *estimate, tracker_.rate(), tilt.value_or(Tilt()), T_map_base);
    state_.tracking(*estimate, stamp, tracker_.filter().strongestHypothesis() > 1);
  }

  // All but the increments that wait: at a jump they are of the new time already.
  void forget() {
    state_.forget();
    attitude_.clear();
    fixes_.clear();
    tracker_.reset();
    bridge_.reset();
    if (!publisher_.trajectory().empty())
      autosave_.save("trajectory_" + std::to_string(++ended_trajectories_) + ".txt",
                     [this](const std::string& path) { air_ground_common::writeTum(path, publisher_.trajectory()); });
    publisher_.reset();
    report_.reset();
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
      const std::string path = ru::absolutePath(request.path);
      air_ground_common::writeTum(path, trajectory);
      response.poses = trajectory.size();
      return "wrote " + std::to_string(trajectory.size()) + " poses of " + settings_.base_frame + " in " +
             settings_.world_frame + " to " + path;
    });
  }

  ros::NodeHandle handle_, private_handle_{"~"};
  const NodeSettings settings_;
  const ru::Autosave autosave_{settings_.autosave};
  Tracker tracker_;
  const std::optional<air_ground_common::LocalFrame> frame_;
  SensorBridge bridge_;
  TrackedPosePublisher publisher_;
  ru::NodeHealth health_;
  TrackerState state_;
  OutcomeReport report_{tracker_, publisher_, state_, health_};
  AttitudeInput attitude_;
  FixInput fixes_;
  Synchronizer synchronizer_{settings_.odometry_wait, attitude_.tilts()};
  ru::TimeJumpDetector clock_;
  int ended_trajectories_ = 0;  // kept
  ros::Subscriber increments_, gps_, barometer_;
  ros::ServiceServer reset_, save_;
  ros::WallTimer timer_;
};

}  // namespace
}  // namespace ekf_tracker

int main(int argc, char** argv) {
  using namespace ekf_tracker;
  return air_ground_common::ros_utils::runNode<NodeSettings, EkfTrackerNode>(argc, argv, "ekf_tracker");
}
