#include "attitude_input.h"

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/text.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;

constexpr double kFieldTolerance = 0.2;    // between a magnetometer's reading and the pose that tells its tilt [s]
constexpr std::size_t kMostFields = 1000;  // readings that wait for the odometry

// Of a clock that nobody sets [s].
double steadySeconds() { return ros::SteadyTime::now().toSec(); }

}  // namespace

AttitudeInput::AttitudeInput(ros::NodeHandle handle, const NodeSettings& settings, SensorBridge& bridge,
                             ru::NodeHealth& health, std::function<void()> on_pose,
                             std::function<void(const Measurement&)> on_heading)
    : settings_(settings),
      bridge_(bridge),
      health_(health),
      on_pose_(std::move(on_pose)),
      on_heading_(std::move(on_heading)) {
  if (settings_.odometry_wait > 0) {
    vo_poses_ = handle.subscribe("mav/odometry", 400, &AttitudeInput::onVoPose, this);
    health_.expectInput(vo_poses_.getTopic());
  }
  if (settings_.magnetometer || settings_.odometry_wait > 0)
    accelerometer_ = settings_.accel_topic.empty()
                         ? handle.subscribe("mav/imu/data", 1000, &AttitudeInput::onAcceleration, this)
                         : handle.subscribe(settings_.accel_topic, 1000, &AttitudeInput::onAcceleration, this);
  if (settings_.magnetometer) {
    magnetometer_ = handle.subscribe("mav/imu/mag", 400, &AttitudeInput::onMagneticField, this);
    health_.expectInput(magnetometer_.getTopic());
  }
}

void AttitudeInput::onVoPose(const nav_msgs::Odometry::ConstPtr& msg) {
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
  on_pose_();
  drainFields();
}

void AttitudeInput::onAcceleration(const sensor_msgs::Imu::ConstPtr& msg) {
  const Eigen::Vector3d force(msg->linear_acceleration.x, msg->linear_acceleration.y, msg->linear_acceleration.z);
  // A gyro's own messages say so, or hold zeros.
  if (msg->linear_acceleration_covariance[0] == -1 || force == Eigen::Vector3d::Zero())
    return health_.count("accelerations on " + accelerometer_.getTopic() +
                         " ignored: not measured. Where the accelerometer has a topic of its own, name it by the "
                         "launch argument mav_imu_accel, or the parameter accel_topic");
  const auto R_base_sensor = rotationFrom(msg->header.frame_id);
  if (!force.allFinite() || !R_base_sensor) return;
  const Eigen::Vector3d force_base = *R_base_sensor * force;
  tilts_.addSpecificForce(msg->header.stamp.toSec(), force_base);
  filter_.addSpecificForce(msg->header.stamp.toSec(), force_base);
  if (tilts_.lacksGravity())
    health_.count("accelerations on " + accelerometer_.getTopic() +
                  " tell no tilt: they are not about 9.81 m/s^2. Is gravity removed, or are they in g? Have the driver "
                  "send specific force in m/s^2");
}

void AttitudeInput::onMagneticField(const sensor_msgs::MagneticField::ConstPtr& msg) {
  health_.received(magnetometer_.getTopic(), msg->header.stamp);
  if (!bridge_.isFieldDue(*msg)) return;
  pending_fields_.emplace_back(msg, steadySeconds());
  if (pending_fields_.size() > kMostFields) pending_fields_.pop_front();
  drainFields();
}

void AttitudeInput::drainFields() {
  while (!pending_fields_.empty()) {
    const auto [msg, received] = pending_fields_.front();
    const bool come = tilts_.newestPose() >= msg->header.stamp.toSec();
    if (!come && steadySeconds() - received <= settings_.odometry_wait) return;
    pending_fields_.pop_front();
    applyField(*msg);
  }
}

void AttitudeInput::applyField(const sensor_msgs::MagneticField& msg) {
  const auto R_base_sensor = rotationFrom(msg.header.frame_id);
  if (!R_base_sensor) return;
  const double stamp = msg.header.stamp.toSec();
  const auto T_map_base = tilts_.poseAt(stamp, kFieldTolerance);
  const auto tilt = tiltBy(T_map_base, stamp, kFieldTolerance);
  if (!tilt)
    return health_.count(
        "magnetometer readings ignored: no tilt from mav/odometry, fixes or the accelerometer at their time");
  try {
    on_heading_(bridge_.heading(msg, *R_base_sensor, tilt->R_level_body));
  } catch (const std::invalid_argument& e) {
    health_.count(std::string("magnetometer readings ignored: ") + e.what());
  }
}

void AttitudeInput::turned(const air_ground::VoIncrement& msg) {
  if (!settings_.level_increments) return;  // they hold no roll and pitch
  try {
    const Pose T_previous_current = ru::fromMsg(msg.relative_pose);
    filter_.turn(msg.previous_stamp.toSec(), msg.header.stamp.toSec(), T_previous_current.linear());
  } catch (const std::invalid_argument&) {  // an increment that is none turns nothing; the tracker says so
  }
}

void AttitudeInput::onFix(const geometry_msgs::PoseWithCovarianceStamped& msg) {
  if (const auto vertical = SensorBridge::vertical(msg)) filter_.addVertical(*vertical);
}

std::optional<Tilt> AttitudeInput::tiltAt(double stamp, const std::optional<Pose>& T_map_base) const {
  if (!T_map_base && settings_.odometry_wait <= 0) return std::nullopt;
  return tiltBy(T_map_base, stamp, TiltSource::kSameStamp);
}

std::optional<Tilt> AttitudeInput::tiltBy(const std::optional<Pose>& T_map_base, double stamp, double tolerance) const {
  if (T_map_base) return Tilt{tiltOf(T_map_base->linear()), 0};
  if (const auto tilt = filter_.at(stamp, tolerance)) return tilt;
  if (const auto R_level_base = tilts_.accelerometerTiltAt(stamp)) return Tilt{*R_level_base, TiltFilter::kForceStddev};
  return std::nullopt;
}

std::optional<Eigen::Matrix3d> AttitudeInput::rotationFrom(const std::string& message_frame) {
  const std::string frame = air_ground_common::withoutSlash(message_frame),
                    base = air_ground_common::withoutSlash(settings_.base_frame);
  if (frame.empty() || frame == base) return Eigen::Matrix3d::Identity();
  if (const auto T_base_sensor = transforms_.lookup(base, frame)) return T_base_sensor->linear();
  health_.count("readings ignored: no transform from " + frame + " to " + base);
  return std::nullopt;
}

void AttitudeInput::clear() {
  tilts_.clear();
  filter_.clear();
  transforms_.clear();
  pending_fields_.clear();
}

}  // namespace ekf_tracker
