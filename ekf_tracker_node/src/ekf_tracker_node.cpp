// Wires the tracker to ROS: visual odometry in, street-level fixes in, pose in the city out. All work is microseconds,
// so everything runs in the callbacks of one thread, in the order of arrival.
#include <air_ground/SaveTrajectory.h>
#include <air_ground/TrackerInnovation.h>
#include <air_ground/VoIncrement.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/FluidPressure.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/MagneticField.h>
#include <sensor_msgs/NavSatFix.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_broadcaster.h>
#include <tf2_ros/transform_listener.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <deque>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "air_ground_common/geodesy.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/pose_publisher.h"
#include "air_ground_common/trajectory.h"
#include "ekf_tracker/sensors.h"
#include "ekf_tracker/tracker.h"
#include "ekf_tracker_parameters.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;

constexpr double kOdometryKept = 30;                          // [s]
constexpr double kSameStamp = 1e-3;                           // [s]
constexpr double kTiltInterval = 0.02, kTiltTolerance = 0.2;  // of the accelerometer's tilts kept [s]
constexpr double kSilence = 1.0;                              // without odometry that could be used: it is lost [s]
constexpr std::size_t kJump = 3;                              // increments in a row from the past: time ran back

// [s]; the difference of two ros::Time throws where they lie more than 2^31 s apart.
double since(const ros::Time& earlier, const ros::Time& later) { return later.toSec() - earlier.toSec(); }

// Roll and pitch alone.
Eigen::Matrix3d tiltOf(const Eigen::Matrix3d& R_level_body) {
  return Eigen::AngleAxisd(-air_ground_common::yawOf(R_level_body), Eigen::Vector3d::UnitZ()).toRotationMatrix() *
         R_level_body;
}

const char* nameOf(Source source) {
  switch (source) {
    case Source::kFix:
      return "fix";
    case Source::kHeading:
      return "magnetometer reading";
    case Source::kGps:
      return "GPS position";
    case Source::kBarometer:
      return "barometer reading";
  }
  return "";
}

class EkfTrackerNode {
 public:
  EkfTrackerNode(ros::NodeHandle handle, ros::NodeHandle private_handle)
      : settings_(readParameters(private_handle)),
        tracker_(settings_.tracker),
        health_("ekf_tracker"),
        listener_(tf_),
        bounded_path_(settings_.world_frame, settings_.path_step) {
    if (!settings_.origin_crs.empty()) {
      frame_.emplace(settings_.origin_crs,
                     Eigen::Vector3d(settings_.origin[0], settings_.origin[1], settings_.origin[2]));
      const auto& o = frame_->origin();
      ROS_INFO(
          "the world's origin is at latitude %.7f, longitude %.7f; grid north lies %.4f deg clockwise of its y axis%s",
          o.latitude, o.longitude, frame_->meridianConvergence() * 180 / M_PI,
          frame_->usesGrid() ? "; by a grid file" : "");
      geodetic_ = handle.advertise<sensor_msgs::NavSatFix>("tracked/geodetic", 100);
    }
    odometry_ = handle.advertise<nav_msgs::Odometry>("tracked/odometry", 100);
    path_ = handle.advertise<nav_msgs::Path>("tracked/path", 5, true);
    innovation_ = handle.advertise<air_ground::TrackerInnovation>("tracked/innovation", 100);

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
    timer_ = handle.createWallTimer(ros::WallDuration(0.1),
                                    [this](const ros::WallTimerEvent&) { drain(), drainFields(), watch(); });
    health_.state(1, "waiting for visual odometry");
  }

 private:
  struct VoPose {
    ros::Time stamp;
    Pose T_map_base;
  };
  struct Up {
    ros::Time stamp;
    Eigen::Vector3d up_base;  // specific force, smoothed
  };

  // ---- Visual odometry
  // ------------------------------------------------------------------------------------------------

  void onIncrement(const air_ground::VoIncrement::ConstPtr& msg) {
    health_.received(increments_.getTopic(), msg->header.stamp);
    const ros::Time now = ros::Time::now();
    if (ros::Time::isSimTime() && clock_.jumped(now)) startAfresh();
    // One from the future would push the history out, and all good ones behind it would be late.
    if (!now.isZero() && since(now, msg->header.stamp) > settings_.clock_tolerance)
      return health_.count("increments ignored: stamped ahead of the clock");
    std::vector<air_ground::VoIncrement::ConstPtr> taken{msg};
    if (since(msg->header.stamp, newest_increment_) > 1.0 && !newest_increment_.isZero()) {
      // A single one is a stray, a run of them in order is a looped bag.
      if (!from_the_past_.empty() && msg->header.stamp <= from_the_past_.back()->header.stamp) from_the_past_.clear();
      from_the_past_.push_back(msg);
      if (from_the_past_.size() < kJump)
        return health_.count("increments set aside: more than a second older than the newest");
      taken.swap(from_the_past_);
      startAfresh();
    } else {
      from_the_past_.clear();
    }
    newest_increment_ = std::max(newest_increment_, taken.back()->header.stamp);
    for (const auto& increment : taken) pending_.emplace_back(increment, ros::WallTime::now());
    drain();
  }

  void startAfresh() {
    health_.count("time jumped back: started afresh");
    ROS_WARN("time jumped back (a looped bag?): starting afresh");
    reset();
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
      const Pose T = ru::fromMsg(msg->pose.pose);
      if (!vo_buffer_.empty() && since(msg->header.stamp, vo_buffer_.back().stamp) > 1.0) vo_buffer_.clear();
      vo_buffer_.push_back({msg->header.stamp, T});
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("mav/odometry ignored: ") + e.what());
      return;
    }
    while (since(vo_buffer_.front().stamp, vo_buffer_.back().stamp) > kOdometryKept) vo_buffer_.pop_front();
    drain();
    drainFields();
  }

  std::optional<Pose> voPoseAt(const ros::Time& stamp, double tolerance = kSameStamp) const {
    const VoPose* best = nullptr;
    for (auto it = vo_buffer_.rbegin(); it != vo_buffer_.rend(); ++it) {
      if (!best || std::abs(since(stamp, it->stamp)) < std::abs(since(stamp, best->stamp))) best = &*it;
      if (since(it->stamp, stamp) > 1.0) break;
    }
    if (!best || std::abs(since(stamp, best->stamp)) > tolerance) return std::nullopt;
    return best->T_map_base;
  }

  // Two topics carry one instant: an increment waits for the pose of its stamp, which tells tilt and tf, until a later
  // pose shows that it was left out or the wait is over. Wall time: a bag may be replayed at any rate. While the
  // odometry is not metric it has no such pose to give (mav_vo): it is waited for only if it gave one at the
  // increment's begin.
  void drain() {
    while (!pending_.empty()) {
      const auto [msg, received] = pending_.front();
      std::optional<Pose> T_map_base;
      if (settings_.odometry_wait > 0) {
        T_map_base = voPoseAt(msg->header.stamp);
        const bool passed = !vo_buffer_.empty() && vo_buffer_.back().stamp > msg->header.stamp;
        const bool expected = msg->metric || voPoseAt(msg->previous_stamp);
        if (!T_map_base && !passed && expected && (ros::WallTime::now() - received).toSec() <= settings_.odometry_wait)
          return;
      }
      pending_.pop_front();
      use(*msg, T_map_base);
    }
  }

  void use(const air_ground::VoIncrement& msg, const std::optional<Pose>& T_map_base) {
    const ros::WallTime started = ros::WallTime::now();
    Increment increment;
    try {
      const Pose T_previous_current = ru::fromMsg(msg.relative_pose);
      const auto now = tiltAt(msg.header.stamp, T_map_base);
      if (settings_.odometry_wait > 0 && !T_map_base)
        health_.count(
            now ? "increments without mav/odometry of their stamp: tilt from mav/imu/data, no tf"
                : "increments without mav/odometry of their stamp, nor mav/imu/data: roll and pitch neglected, no tf");
      const Eigen::Matrix3d tilt = settings_.level_increments && now
                                       ? tiltOf(*now * T_previous_current.linear().transpose())
                                       : Eigen::Matrix3d::Identity();
      increment =
          levelIncrement(T_previous_current,
                         Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(msg.covariance.data()), tilt);
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("increments ignored: ") + e.what());
      return;
    }
    increment.previous_stamp = msg.previous_stamp.toSec();
    increment.stamp = msg.header.stamp.toSec();
    increment.metric = msg.metric;
    increment.map_id = msg.map_id;
    if (msg.metric && std::isfinite(msg.scale_variance) && msg.scale_variance > 0)
      increment.scale_stddev = std::sqrt(msg.scale_variance);
    bool replaced = false;
    const IncrementResult result = tracker_.addIncrement(increment, &replaced);
    if (replaced) health_.count("increments whose covariance is not one: the default stands in");
    switch (result) {
      case IncrementResult::kUsed:
        break;
      case IncrementResult::kUsedAfterGap:
        health_.count("gaps in the odometry, bridged");
        break;
      case IncrementResult::kNewUnit:
        health_.count(
            "odometry began a new map in an unknown unit: only its turns are used until two fixes give the scale");
        break;
      case IncrementResult::kOutOfOrder:
        health_.count("increments ignored: out of order or repeated");
        return;
      case IncrementResult::kInvalid:
        health_.count("increments ignored: not finite");
        return;
    }
    used_ = seconds();
    lost_ = false;
    health_.timing("odometry step", (ros::WallTime::now() - started).toSec());
    tellOutcomes();
    publish(msg, increment, T_map_base);
  }

  // ---- Measurements
  // ---------------------------------------------------------------------------------------------------

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
      tell(out);
      return;
    }
    tracker_.addMeasurement(m);
    health_.timing("measurement with replay", (ros::WallTime::now() - started).toSec());
    tellOutcomes();
  }

  void onFix(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& msg) {
    ++fixes_heard_;
    if (msg->header.frame_id != settings_.world_frame) {
      health_.count("fixes ignored: in frame '" + msg->header.frame_id + "', expected '" + settings_.world_frame + "'");
      return;
    }
    Measurement m;
    m.stamp = msg->header.stamp.toSec();
    try {
      const Pose T = ru::fromMsg(msg->pose.pose);
      m.value << T.translation(), air_ground_common::yawOf(T.linear());
    } catch (const std::invalid_argument&) {
      m.value.setConstant(std::numeric_limits<double>::quiet_NaN());  // the tracker refuses and reports it
    }
    const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> c(msg->pose.covariance.data());
    const int rows[4] = {0, 1, 2, 5};
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j) m.covariance(i, j) = c(rows[i], rows[j]);
    add(m);
  }

  // R_level_body from the odometry or, without, the accelerometer; empty where neither says anything.
  std::optional<Eigen::Matrix3d> tiltAt(const ros::Time& stamp, const std::optional<Pose>& T_map_base) const {
    if (T_map_base) return tiltOf(T_map_base->linear());
    if (settings_.odometry_wait <= 0) return std::nullopt;
    return accelerometerTiltAt(stamp);
  }

  std::optional<Eigen::Matrix3d> accelerometerTiltAt(const ros::Time& stamp) const {
    const Up* best = nullptr;
    for (auto it = ups_.rbegin(); it != ups_.rend(); ++it) {
      if (!best || std::abs(since(stamp, it->stamp)) < std::abs(since(stamp, best->stamp))) best = &*it;
      if (it->stamp < stamp) break;
    }
    if (!best || std::abs(since(stamp, best->stamp)) > kTiltTolerance || best->up_base.norm() < 1) return std::nullopt;
    return tiltOf(air_ground_common::levelingRotation(best->up_base));
  }

  void onImu(const sensor_msgs::Imu::ConstPtr& msg) {
    const Eigen::Vector3d force(msg->linear_acceleration.x, msg->linear_acceleration.y, msg->linear_acceleration.z);
    const auto R_base_sensor = rotationFrom(msg->header.frame_id);
    if (!force.allFinite() || !R_base_sensor) return;
    const double dt = up_stamp_.isZero() ? 0 : since(up_stamp_, msg->header.stamp);
    up_stamp_ = msg->header.stamp;
    // Low-pass of one second: flight accelerations average out.
    const double share = dt > 0 && dt < 1 ? dt : 1;
    up_base_ = share >= 1 ? Eigen::Vector3d(*R_base_sensor * force)
                          : Eigen::Vector3d(up_base_ + share * (*R_base_sensor * force - up_base_));
    if (!ups_.empty() && msg->header.stamp < ups_.back().stamp) ups_.clear();
    if (ups_.empty() || since(ups_.back().stamp, msg->header.stamp) >= kTiltInterval)
      ups_.push_back({msg->header.stamp, up_base_});
    while (since(ups_.front().stamp, ups_.back().stamp) > kOdometryKept) ups_.pop_front();
  }

  void onMagneticField(const sensor_msgs::MagneticField::ConstPtr& msg) {
    health_.received(magnetometer_.getTopic(), msg->header.stamp);
    if (tooSoon(msg->header.stamp, settings_.magnetometer_interval, &last_magnetometer_)) return;
    last_magnetometer_ = msg->header.stamp;
    pending_fields_.emplace_back(msg, ros::WallTime::now());
    drainFields();
  }

  // A reading waits, like an increment, for the odometry of its time, whose tilt is better than the accelerometer's.
  void drainFields() {
    while (!pending_fields_.empty()) {
      const auto [msg, received] = pending_fields_.front();
      const bool come = !vo_buffer_.empty() && vo_buffer_.back().stamp >= msg->header.stamp;
      if (!come && (ros::WallTime::now() - received).toSec() <= settings_.odometry_wait) return;
      pending_fields_.pop_front();
      useField(*msg);
    }
  }

  void useField(const sensor_msgs::MagneticField& msg) {
    const auto R_base_sensor = rotationFrom(msg.header.frame_id);
    if (!R_base_sensor) return;
    const auto T_map_base = voPoseAt(msg.header.stamp, 0.2);
    const auto tilt = T_map_base ? std::optional<Eigen::Matrix3d>(tiltOf(T_map_base->linear()))
                                 : accelerometerTiltAt(msg.header.stamp);
    if (!tilt)
      return health_.count("magnetometer readings ignored: no tilt from mav/odometry or mav/imu/data at their time");
    const Eigen::Vector3d field(msg.magnetic_field.x, msg.magnetic_field.y, msg.magnetic_field.z);
    const auto yaw = yawFromMagneticField(*R_base_sensor * field, *tilt, settings_.declination);
    if (!yaw) return health_.count("magnetometer readings ignored: no usable horizontal field");
    Measurement m;
    m.source = Source::kHeading;
    m.stamp = msg.header.stamp.toSec();
    m.value[0] = *yaw;
    m.covariance(0, 0) = std::pow(settings_.magnetometer_stddev, 2);
    add(m);
  }

  void onGps(const sensor_msgs::NavSatFix::ConstPtr& msg) {
    health_.received(gps_.getTopic(), msg->header.stamp);
    if (msg->status.status < sensor_msgs::NavSatStatus::STATUS_FIX)
      return health_.count("GPS positions ignored: the receiver has no fix");
    if (tooSoon(msg->header.stamp, settings_.gps_interval, &last_gps_)) return;
    Measurement m;
    m.source = Source::kGps;
    m.stamp = msg->header.stamp.toSec();
    try {
      m.value.head<3>() =
          frame_->fromGeodetic({msg->latitude, msg->longitude, msg->altitude - settings_.geoid_undulation});
    } catch (const std::invalid_argument& e) {
      return health_.count(std::string("GPS positions ignored: ") + e.what());
    }
    const bool stated = msg->position_covariance_type != sensor_msgs::NavSatFix::COVARIANCE_TYPE_UNKNOWN;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j)
        m.covariance(i, j) = stated ? std::pow(settings_.gps_inflation, 2) *
                                          msg->position_covariance[static_cast<std::size_t>(3 * i + j)]
                                    : 0;
      m.covariance(i, i) = std::max(m.covariance(i, i), std::pow(settings_.gps_stddev[static_cast<std::size_t>(i)], 2));
    }
    last_gps_ = msg->header.stamp;
    add(m);
  }

  void onPressure(const sensor_msgs::FluidPressure::ConstPtr& msg) {
    health_.received(barometer_.getTopic(), msg->header.stamp);
    if (tooSoon(msg->header.stamp, settings_.barometer_interval, &last_barometer_)) return;
    const auto height = heightFromPressure(msg->fluid_pressure);
    if (!height) return health_.count("barometer readings ignored: not between 20 and 120 kPa (the unit is Pa)");
    Measurement m;
    m.source = Source::kBarometer;
    m.stamp = msg->header.stamp.toSec();
    m.value[0] = *height;
    m.covariance(0, 0) = std::pow(settings_.barometer_stddev, 2);
    last_barometer_ = msg->header.stamp;
    add(m);
  }

  // Slowly changing errors are not new information: readings closer than the interval are dropped. Time that ran back
  // passes.
  static bool tooSoon(const ros::Time& stamp, double interval, const ros::Time* last) {
    const double passed = since(*last, stamp);
    return !last->isZero() && passed >= 0 && passed < interval - kSameStamp;
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

  // ---- Output
  // ---------------------------------------------------------------------------------------------------------

  void tellOutcomes() {
    for (const Outcome& o : tracker_.takeOutcomes()) tell(o);
    if (tracker_.filter().recoveries() > recoveries_) {
      ROS_WARN("fixes that agree with each other contradicted the tracked pose: it was wrong and has been replaced");
      health_.count("recoveries from a wrong pose");
    }
    recoveries_ = tracker_.filter().recoveries();
  }

  void tell(const Outcome& o) {
    const Source source = o.measurement.source;
    if (source == Source::kFix && isUsed(o.result)) last_fix_ = std::max(last_fix_, o.measurement.stamp);
    // Refusals are counted by name; waiting for a partner is none.
    if (o.revised)
      health_.count("results of earlier measurements revised by later ones");
    else if (o.result == Result::kRecovered ||
             (!isUsed(o.result) && o.result != Result::kWaiting && o.result != Result::kNotStarted))
      health_.count(std::string(nameOf(source)) + ": " + describe(o.result));
    if (o.result == Result::kInitialised) ROS_INFO("fixes that agree start the tracker");
    if (!std::isfinite(o.measurement.stamp) || o.measurement.stamp < 0) return;
    air_ground::TrackerInnovation msg;
    msg.header.stamp.fromSec(o.measurement.stamp);
    msg.header.frame_id = settings_.world_frame;
    msg.source = static_cast<std::uint8_t>(source);
    msg.result = static_cast<std::uint8_t>(o.result);
    msg.reason = describe(o.result);
    msg.dof = static_cast<std::uint8_t>(o.dof);
    msg.revised = o.revised;
    msg.predicted = std::isfinite(o.nis);
    msg.innovation.assign(static_cast<std::size_t>(o.dof), 0);
    msg.stddev.assign(static_cast<std::size_t>(o.dof), 0);
    if (msg.predicted) {
      for (int i = 0; i < o.dof; ++i) {
        msg.innovation[static_cast<std::size_t>(i)] = o.innovation[i];
        msg.stddev[static_cast<std::size_t>(i)] = o.innovation_stddev[i];
      }
      msg.nis = o.nis;
    }
    msg.gate = o.gate;
    msg.delay = o.delay;
    msg.rivals = static_cast<std::uint32_t>(tracker_.filter().strongestRival());
    if (const auto estimate = tracker_.latest()) {
      msg.support = static_cast<std::uint32_t>(estimate->support);
      msg.scale = estimate->scale_known ? estimate->scale : 0;
      msg.scale_stddev = estimate->scale_known ? estimate->scale_stddev : 0;
    }
    innovation_.publish(msg);
  }

  void publish(const air_ground::VoIncrement& cause, const Increment& increment,
               const std::optional<Pose>& T_map_base) {
    const auto estimate = tracker_.latest();
    if (!estimate) {
      std::string line =
          cause.metric ? "waiting for two fixes that agree"
                       : "waiting for fixes that agree, two of them far enough apart to give the odometry's scale";
      line += "; " + std::to_string(fixes_heard_) + " came on " + fixes_.getTopic() + ", which has " +
              std::to_string(fixes_.getNumPublishers()) + " publishers";
      health_.state(1, line);
      if (fixes_heard_ == 0) {
        if (unlocated_since_ == 0 || increment.stamp < unlocated_since_) unlocated_since_ = increment.stamp;
        if (increment.stamp > unlocated_since_ + 10)
          ROS_WARN_STREAM_ONCE("odometry has come for 10 s, but no fix: " << line);
      }
      return;
    }
    const ros::Time stamp = cause.header.stamp;
    const Eigen::Matrix3d tilt = tiltAt(stamp, T_map_base).value_or(Eigen::Matrix3d::Identity());
    Pose T_world_base = air_ground_common::yawPose(estimate->pose[3], estimate->pose.head<3>());
    T_world_base.linear() = T_world_base.linear() * tilt;

    nav_msgs::Odometry odometry;
    odometry.header.stamp = stamp;
    odometry.header.frame_id = settings_.world_frame;
    odometry.child_frame_id = settings_.base_frame;
    odometry.pose.pose = ru::toMsg(T_world_base);
    air_ground_common::Matrix6d covariance = air_ground_common::Matrix6d::Zero();
    const int rows[4] = {0, 1, 2, 5};
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j) covariance(rows[i], rows[j]) = estimate->covariance(i, j);
    covariance(3, 3) = covariance(4, 4) = std::pow(settings_.tilt_stddev, 2);
    ru::setCovariance(covariance, &odometry.pose.covariance);
    setTwist(tilt, &odometry.twist);
    odometry_.publish(odometry);

    if (settings_.publish_tf && T_map_base) {
      // Both frames are level: only a heading and a shift lie between them.
      const double yaw = estimate->pose[3] - air_ground_common::yawOf(T_map_base->linear());
      Pose T_world_map = air_ground_common::yawPose(yaw, Eigen::Vector3d::Zero());
      T_world_map.translation() = estimate->pose.head<3>() - T_world_map.linear() * T_map_base->translation();
      geometry_msgs::TransformStamped edge;
      edge.header = odometry.header;
      edge.child_frame_id = settings_.map_frame;
      edge.transform = ru::toTransformMsg(T_world_map);
      broadcaster_.sendTransform(edge);
    }
    if (frame_) {
      const auto g = frame_->toGeodetic(estimate->pose.head<3>());
      sensor_msgs::NavSatFix fix;
      fix.header.stamp = stamp;
      fix.header.frame_id = settings_.base_frame;
      fix.status.status = sensor_msgs::NavSatStatus::STATUS_FIX;
      fix.latitude = g.latitude;
      fix.longitude = g.longitude;
      fix.altitude = g.height + settings_.geoid_undulation;
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
          fix.position_covariance[static_cast<std::size_t>(3 * i + j)] = estimate->covariance(i, j);
      fix.position_covariance_type = sensor_msgs::NavSatFix::COVARIANCE_TYPE_KNOWN;
      geodetic_.publish(fix);
    }
    trajectory_.push_back({increment.stamp, T_world_base});
    geometry_msgs::PoseStamped pose;
    pose.header = odometry.header;
    pose.pose = odometry.pose.pose;
    if (bounded_path_.add(pose)) path_.publish(bounded_path_.message());
    const Vector4d stddev = estimate->covariance.diagonal().cwiseSqrt();
    char line[200];
    std::snprintf(
        line, sizeof line,
        "tracking: %.1f %.1f %.1f m, %.1f deg (1 sigma); odometry scale %.3f +- %.3f; %d fixes; last fused %.1f s ago",
        stddev[0], stddev[1], stddev[2], stddev[3] * 180 / M_PI, estimate->scale, estimate->scale_stddev,
        estimate->support, increment.stamp - last_fix_);
    if (!estimate->scale_known)
      health_.state(1, std::string("the odometry's scale is not known: position is held by fixes alone; ") + line);
    else if (tracker_.filter().strongestRival() > 1)
      health_.state(1, std::string("doubtful, refused fixes agree; ") + line);
    else
      health_.state(0, line);
  }

  // Velocity of the body over the last step, in the body frame; the variance is huge where nothing is known.
  void setTwist(const Eigen::Matrix3d& tilt, geometry_msgs::TwistWithCovariance* twist) const {
    air_ground_common::Matrix6d covariance = kUnknownVariance * air_ground_common::Matrix6d::Identity();
    if (const auto rate = tracker_.rate()) {
      Matrix4d turn = Matrix4d::Identity();
      turn.topLeftCorner<3, 3>() = tilt.transpose();
      const Vector4d value = turn * rate->value;
      const Matrix4d turned = turn * rate->covariance * turn.transpose();
      twist->twist.linear.x = value.x();
      twist->twist.linear.y = value.y();
      twist->twist.linear.z = value.z();
      twist->twist.angular.z = value[3];
      const int rows[4] = {0, 1, 2, 5};
      for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) covariance(rows[i], rows[j]) = turned(i, j);
    }
    ru::setCovariance(covariance, &twist->covariance);
  }

  // By the clock that the messages follow, so that a paused replay is no silence; else by one that nobody sets.
  static double seconds() { return ros::Time::isSimTime() ? ros::Time::now().toSec() : ros::SteadyTime::now().toSec(); }

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

  void reset() {
    used_.reset();
    lost_ = false;
    health_.state(1, "forgot the pose; waiting for visual odometry");
    newest_increment_ = ros::Time();
    from_the_past_.clear();
    ups_.clear();
    tracker_.reset();
    tf_.clear();  // of moving edges; fixed ones stay
    pending_.clear();
    pending_fields_.clear();
    vo_buffer_.clear();
    trajectory_.clear();
    bounded_path_.clear();
    last_magnetometer_ = last_gps_ = last_barometer_ = up_stamp_ = ros::Time();
    up_base_.setZero();
    last_fix_ = 0;
    recoveries_ = 0;
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    reset();
    response.success = true;
    response.message = "forgot the pose; waiting for fixes";
    return true;
  }

  bool onSave(air_ground::SaveTrajectory::Request& request, air_ground::SaveTrajectory::Response& response) {
    return ru::answer(response, [&] {
      air_ground_common::writeTum(request.path, trajectory_);
      response.poses = trajectory_.size();
      return "wrote " + std::to_string(trajectory_.size()) + " poses of " + settings_.base_frame + " in " +
             settings_.world_frame + " to " + request.path;
    });
  }

  const NodeSettings settings_;
  Tracker tracker_;
  std::optional<air_ground_common::LocalFrame> frame_;
  ru::NodeHealth health_;
  ru::TimeJumpDetector clock_;
  tf2_ros::Buffer tf_;
  tf2_ros::TransformListener listener_;
  tf2_ros::TransformBroadcaster broadcaster_;
  ros::Subscriber increments_, fixes_, vo_poses_, imu_, magnetometer_, gps_, barometer_;
  ros::Publisher odometry_, path_, innovation_, geodetic_;
  ros::ServiceServer reset_, save_;
  ros::WallTimer timer_;

  std::deque<std::pair<air_ground::VoIncrement::ConstPtr, ros::WallTime>> pending_;
  std::deque<std::pair<sensor_msgs::MagneticField::ConstPtr, ros::WallTime>> pending_fields_;
  std::deque<VoPose> vo_buffer_;
  std::deque<Up> ups_;
  ros::Time newest_increment_;
  std::vector<air_ground::VoIncrement::ConstPtr> from_the_past_;
  std::optional<double> used_;  // when an increment was, by seconds()
  bool lost_ = false;
  air_ground_common::Trajectory trajectory_;  // for ~save_trajectory: 10 MB an hour at 20 Hz
  ru::BoundedPath bounded_path_;
  ros::Time last_magnetometer_, last_gps_, last_barometer_, up_stamp_;
  Eigen::Vector3d up_base_ = Eigen::Vector3d::Zero();
  double last_fix_ = 0, unlocated_since_ = 0;
  std::size_t fixes_heard_ = 0;
  int recoveries_ = 0;
};

}  // namespace
}  // namespace ekf_tracker

int main(int argc, char** argv) {
  ros::init(argc, argv, "ekf_tracker");
  const ros::NodeHandle keep_alive;  // with the last handle roscpp ends, and the console with it
  try {
    ekf_tracker::EkfTrackerNode node{ros::NodeHandle(), ros::NodeHandle("~")};
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("%s", e.what());
    return 1;
  }
  return 0;
}
