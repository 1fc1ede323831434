// Wires the tracker to ROS: visual odometry in, street-level fixes in, pose in the city out. All work is microseconds, so
// everything runs in the callbacks of one thread, in the order of arrival.
#include <air_ground/SaveTrajectory.h>
#include <air_ground/TrackerInnovation.h>
#include <air_ground/VoIncrement.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <nav_msgs/Odometry.h>
#include <nav_msgs/Path.h>
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

#include "air_ground_common/geodesy.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/trajectory.h"
#include "ekf_tracker/sensors.h"
#include "ekf_tracker/tracker.h"
#include "ekf_tracker_parameters.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;

constexpr double kOdometryKept = 30;  // [s]
constexpr double kSameStamp = 1e-3;   // [s]

// Roll and pitch alone.
Eigen::Matrix3d tiltOf(const Eigen::Matrix3d& R_level_body) {
  return Eigen::AngleAxisd(-air_ground_common::yawOf(R_level_body), Eigen::Vector3d::UnitZ()).toRotationMatrix() * R_level_body;
}

const char* nameOf(Source source) {
  switch (source) {
    case Source::kFix: return "fix";
    case Source::kHeading: return "magnetometer reading";
    case Source::kGps: return "GPS position";
    case Source::kBarometer: return "barometer reading";
  }
  return "";
}

class EkfTrackerNode {
 public:
  EkfTrackerNode(ros::NodeHandle handle, ros::NodeHandle private_handle)
      : settings_(readParameters(private_handle)), tracker_(settings_.tracker), health_("ekf_tracker"), listener_(tf_) {
    if (!settings_.origin_crs.empty()) {
      frame_.emplace(settings_.origin_crs, Eigen::Vector3d(settings_.origin[0], settings_.origin[1], settings_.origin[2]));
      const auto& o = frame_->origin();
      ROS_INFO("the world's origin is at latitude %.7f, longitude %.7f; grid north lies %.4f deg clockwise of its y axis%s", o.latitude, o.longitude,
               frame_->meridianConvergence() * 180 / M_PI, frame_->usesGrid() ? "; by a grid file" : "");
      geodetic_ = handle.advertise<sensor_msgs::NavSatFix>("tracked/geodetic", 100);
    }
    path_msg_.header.frame_id = settings_.world_frame;
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
    if (settings_.magnetometer) {
      imu_ = handle.subscribe("mav/imu/data", 1000, &EkfTrackerNode::onImu, this);
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
    timer_ = handle.createWallTimer(ros::WallDuration(0.1), [this](const ros::WallTimerEvent&) { drain(), drainFields(); });
    health_.state(1, "waiting for visual odometry");
  }

 private:
  struct VoPose {
    ros::Time stamp;
    Pose T_map_base;
  };

  // ---- Visual odometry ------------------------------------------------------------------------------------------------

  void onIncrement(const air_ground::VoIncrement::ConstPtr& msg) {
    health_.received(increments_.getTopic(), msg->header.stamp);
    if (jumps_.jumped(msg->header.stamp)) {
      health_.count("time jumped back: started afresh");
      ROS_WARN("the odometry's time jumped back (a looped bag?): starting afresh");
      reset();
    }
    pending_.emplace_back(msg, ros::WallTime::now());
    drain();
  }

  void onVoPose(const nav_msgs::Odometry::ConstPtr& msg) {
    health_.received(vo_poses_.getTopic(), msg->header.stamp);
    try {
      const Pose T = ru::fromMsg(msg->pose.pose);
      if (!map_frame_checked_ && msg->header.frame_id != settings_.map_frame)
        ROS_WARN("mav/odometry is in the frame '%s', but map_frame is '%s'", msg->header.frame_id.c_str(), settings_.map_frame.c_str());
      map_frame_checked_ = true;
      if (!vo_buffer_.empty() && msg->header.stamp + ros::Duration(1.0) < vo_buffer_.back().stamp) vo_buffer_.clear();
      vo_buffer_.push_back({msg->header.stamp, T});
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("mav/odometry ignored: ") + e.what());
      return;
    }
    while ((vo_buffer_.back().stamp - vo_buffer_.front().stamp).toSec() > kOdometryKept) vo_buffer_.pop_front();
    drain();
    drainFields();
  }

  std::optional<Pose> voPoseAt(const ros::Time& stamp, double tolerance = kSameStamp) const {
    const VoPose* best = nullptr;
    for (auto it = vo_buffer_.rbegin(); it != vo_buffer_.rend(); ++it) {
      if (!best || std::abs((it->stamp - stamp).toSec()) < std::abs((best->stamp - stamp).toSec())) best = &*it;
      if (it->stamp + ros::Duration(1.0) < stamp) break;
    }
    if (!best || std::abs((best->stamp - stamp).toSec()) > tolerance) return std::nullopt;
    return best->T_map_base;
  }

  // Two topics carry one instant: an increment waits for the pose of its stamp, which tells tilt and tf, until a later pose
  // shows that it was left out or the wait is over. Wall time: a bag may be replayed at any rate.
  void drain() {
    while (!pending_.empty()) {
      const auto [msg, received] = pending_.front();
      std::optional<Pose> T_map_base;
      if (settings_.odometry_wait > 0) {
        T_map_base = voPoseAt(msg->header.stamp);
        const bool passed = !vo_buffer_.empty() && vo_buffer_.back().stamp > msg->header.stamp;
        if (!T_map_base && !passed && (ros::WallTime::now() - received).toSec() <= settings_.odometry_wait) return;
        if (!T_map_base) health_.count("increments without mav/odometry of their stamp: roll and pitch neglected, no tf");
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
      const bool tilted = settings_.level_increments && T_map_base;
      const Eigen::Matrix3d tilt = tilted ? tiltOf(T_map_base->linear() * T_previous_current.linear().transpose()) : Eigen::Matrix3d::Identity();
      increment = levelIncrement(T_previous_current, Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(msg.covariance.data()), tilt);
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("increments ignored: ") + e.what());
      return;
    }
    increment.previous_stamp = msg.previous_stamp.toSec();
    increment.stamp = msg.header.stamp.toSec();
    increment.metric = msg.metric;
    increment.map_id = msg.map_id;
    if (msg.metric && std::isfinite(msg.scale_variance) && msg.scale_variance > 0) increment.scale_stddev = std::sqrt(msg.scale_variance);
    bool replaced = false;
    const IncrementResult result = tracker_.addIncrement(increment, &replaced);
    if (replaced) health_.count("increments whose covariance is not one: the default stands in");
    switch (result) {
      case IncrementResult::kUsed: break;
      case IncrementResult::kUsedAfterGap: health_.count("gaps in the odometry, bridged"); break;
      case IncrementResult::kNewUnit: health_.count("odometry began a new map in an unknown unit: only its turns are used until two fixes give the scale"); break;
      case IncrementResult::kOutOfOrder: health_.count("increments ignored: out of order or repeated"); return;
      case IncrementResult::kInvalid: health_.count("increments ignored: not finite"); return;
    }
    health_.timing("odometry step", (ros::WallTime::now() - started).toSec());
    tellOutcomes();
    publish(msg, increment, T_map_base);
  }

  // ---- Measurements ---------------------------------------------------------------------------------------------------

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

  void onImu(const sensor_msgs::Imu::ConstPtr& msg) {
    const Eigen::Vector3d force(msg->linear_acceleration.x, msg->linear_acceleration.y, msg->linear_acceleration.z);
    const auto R_base_sensor = rotationFrom(msg->header.frame_id);
    if (!force.allFinite() || !R_base_sensor) return;
    const double dt = up_stamp_.isZero() ? 0 : (msg->header.stamp - up_stamp_).toSec();
    up_stamp_ = msg->header.stamp;
    // Low-pass of one second: flight accelerations average out.
    const double share = dt > 0 && dt < 1 ? dt : 1;
    up_base_ = share >= 1 ? Eigen::Vector3d(*R_base_sensor * force) : Eigen::Vector3d(up_base_ + share * (*R_base_sensor * force - up_base_));
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
    std::optional<Eigen::Matrix3d> tilt;
    if (const auto T_map_base = voPoseAt(msg.header.stamp, 0.2)) tilt = tiltOf(T_map_base->linear());
    else if (up_base_.norm() > 1) tilt = tiltOf(air_ground_common::levelingRotation(up_base_));
    if (!tilt) return health_.count("magnetometer readings ignored: no tilt from mav/odometry or mav/imu/data yet");
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
    if (msg->status.status < sensor_msgs::NavSatStatus::STATUS_FIX) return health_.count("GPS positions ignored: the receiver has no fix");
    if (tooSoon(msg->header.stamp, settings_.gps_interval, &last_gps_)) return;
    Measurement m;
    m.source = Source::kGps;
    m.stamp = msg->header.stamp.toSec();
    try {
      m.value.head<3>() = frame_->fromGeodetic({msg->latitude, msg->longitude, msg->altitude - settings_.geoid_undulation});
    } catch (const std::invalid_argument& e) {
      return health_.count(std::string("GPS positions ignored: ") + e.what());
    }
    const bool stated = msg->position_covariance_type != sensor_msgs::NavSatFix::COVARIANCE_TYPE_UNKNOWN;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) m.covariance(i, j) = stated ? std::pow(settings_.gps_inflation, 2) * msg->position_covariance[static_cast<std::size_t>(3 * i + j)] : 0;
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

  // Slowly changing errors are not new information: readings closer than the interval are dropped. Time that ran back passes.
  static bool tooSoon(const ros::Time& stamp, double interval, const ros::Time* last) {
    const double since = (stamp - *last).toSec();
    return !last->isZero() && since >= 0 && since < interval - kSameStamp;
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

  // ---- Output ---------------------------------------------------------------------------------------------------------

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
    if (source == Source::kFix && (o.result == Result::kFused || o.result == Result::kInitialised || o.result == Result::kRecovered))
      last_fix_ = std::max(last_fix_, o.measurement.stamp);
    // Refusals are counted by name; waiting for a partner is none.
    if (o.result != Result::kFused && o.result != Result::kInitialised && o.result != Result::kWaiting && o.result != Result::kNotStarted)
      health_.count(std::string(nameOf(source)) + ": " + describe(o.result));
    if (o.result == Result::kInitialised) ROS_INFO("the first fixes start the tracker");
    if (!std::isfinite(o.measurement.stamp) || o.measurement.stamp < 0) return;
    air_ground::TrackerInnovation msg;
    msg.header.stamp.fromSec(o.measurement.stamp);
    msg.header.frame_id = settings_.world_frame;
    msg.source = static_cast<std::uint8_t>(source);
    msg.result = static_cast<std::uint8_t>(o.result);
    msg.reason = describe(o.result);
    msg.dof = static_cast<std::uint8_t>(o.dof);
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

  void publish(const air_ground::VoIncrement& cause, const Increment& increment, const std::optional<Pose>& T_map_base) {
    const auto estimate = tracker_.latest();
    if (!estimate) {
      std::string line = cause.metric ? "waiting for a first fix" : "waiting for two fixes far enough apart to give the odometry's scale";
      line += "; " + std::to_string(fixes_heard_) + " came on " + fixes_.getTopic() + ", which has " + std::to_string(fixes_.getNumPublishers()) + " publishers";
      health_.state(1, line);
      if (fixes_heard_ == 0) {
        if (unlocated_since_ == 0 || increment.stamp < unlocated_since_) unlocated_since_ = increment.stamp;
        if (increment.stamp > unlocated_since_ + 10) ROS_WARN_STREAM_ONCE("odometry has come for 10 s, but no fix: " << line);
      }
      return;
    }
    const ros::Time stamp = cause.header.stamp;
    const Eigen::Matrix3d tilt = T_map_base ? tiltOf(T_map_base->linear()) : Eigen::Matrix3d::Identity();
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
    const double dt = increment.stamp - increment.previous_stamp;
    // Zero where the odometry's unit is not known.
    const Eigen::Vector3d velocity = (estimate->scale_known ? 1 : 0) * tilt.transpose() * increment.motion.head<3>() * estimate->scale / dt;
    odometry.twist.twist.linear.x = velocity.x();
    odometry.twist.twist.linear.y = velocity.y();
    odometry.twist.twist.linear.z = velocity.z();
    odometry.twist.twist.angular.z = increment.motion[3] / dt;
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
        for (int j = 0; j < 3; ++j) fix.position_covariance[static_cast<std::size_t>(3 * i + j)] = estimate->covariance(i, j);
      fix.position_covariance_type = sensor_msgs::NavSatFix::COVARIANCE_TYPE_KNOWN;
      geodetic_.publish(fix);
    }
    trajectory_.push_back({increment.stamp, T_world_base});
    if (!last_path_ || (*last_path_ - T_world_base.translation()).norm() >= settings_.path_step) {
      last_path_ = T_world_base.translation();
      geometry_msgs::PoseStamped pose;
      pose.header = odometry.header;
      pose.pose = odometry.pose.pose;
      path_msg_.header.stamp = stamp;
      path_msg_.poses.push_back(pose);
      path_.publish(path_msg_);
    }
    const Vector4d stddev = estimate->covariance.diagonal().cwiseSqrt();
    char line[200];
    std::snprintf(line, sizeof line, "tracking: %.1f %.1f %.1f m, %.1f deg (1 sigma); odometry scale %.3f +- %.3f; %d fixes; last fused %.1f s ago", stddev[0],
                  stddev[1], stddev[2], stddev[3] * 180 / M_PI, estimate->scale, estimate->scale_stddev, estimate->support, increment.stamp - last_fix_);
    if (!estimate->scale_known) health_.state(1, std::string("the odometry's scale is not known: position is held by fixes alone; ") + line);
    else if (tracker_.filter().strongestRival() > 1) health_.state(1, std::string("doubtful, refused fixes agree; ") + line);
    else health_.state(0, line);
  }

  void reset() {
    tracker_.reset();
    tf_.clear();  // of moving edges; fixed ones stay
    pending_.clear();
    pending_fields_.clear();
    vo_buffer_.clear();
    trajectory_.clear();
    path_msg_.poses.clear();
    last_path_.reset();
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
    try {
      air_ground_common::writeTum(request.path, trajectory_);
      response.success = true;
      response.poses = trajectory_.size();
      response.message = "wrote " + std::to_string(trajectory_.size()) + " poses of " + settings_.base_frame + " in " + settings_.world_frame + " to " + request.path;
    } catch (const std::exception& e) {
      response.success = false;
      response.message = e.what();
    }
    return true;
  }

  const NodeSettings settings_;
  Tracker tracker_;
  std::optional<air_ground_common::LocalFrame> frame_;
  ru::NodeHealth health_;
  ru::TimeJumpDetector jumps_;
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
  bool map_frame_checked_ = false;
  air_ground_common::Trajectory trajectory_;
  nav_msgs::Path path_msg_;
  std::optional<Eigen::Vector3d> last_path_;
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
  try {
    ekf_tracker::EkfTrackerNode node{ros::NodeHandle(), ros::NodeHandle("~")};
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("%s", e.what());
    return 1;
  }
  return 0;
}
