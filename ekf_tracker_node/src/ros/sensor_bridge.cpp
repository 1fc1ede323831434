#include "sensor_bridge.h"

#include <ros/console.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "air_ground_common/ros/conversions.h"
#include "ekf_tracker/sensors.h"
#include "ekf_tracker/tilt_source.h"

namespace ekf_tracker {
namespace {

using air_ground_common::Pose;
namespace ru = air_ground_common::ros_utils;

// Time that ran back passes.
bool tooSoon(double stamp, double interval, const std::optional<double>& last) {
  return last && stamp >= *last && stamp - *last < interval - TiltSource::kSameStamp;
}

}  // namespace

std::optional<air_ground_common::LocalFrame> frameOf(const NodeSettings& settings) {
  if (settings.origin_crs.empty()) return std::nullopt;
  air_ground_common::LocalFrame frame(settings.origin_crs, Eigen::Vector3d(settings.origin.data()));
  const auto& o = frame.origin();
  if (!settings.geoid_undulation)
    ROS_INFO("tracked/geodetic: heights as in origin, not above the ellipsoid: geoid_undulation is not set");
  ROS_INFO("the world's origin is at latitude %.7f, longitude %.7f; grid north lies %.4f deg clockwise of its y axis%s",
           o.latitude, o.longitude, frame.meridianConvergence() * 180 / M_PI,
           frame.usesGrid() ? "; by a grid file" : "");
  return frame;
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

Measurement SensorBridge::fix(const geometry_msgs::PoseWithCovarianceStamped& msg) const {
  Measurement m;
  m.stamp = msg.header.stamp.toSec();
  try {
    const Pose T = ru::fromMsg(msg.pose.pose);
    m.value << T.translation(), air_ground_common::yawOf(T.linear());
  } catch (const std::invalid_argument&) {
    m.value.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> c(msg.pose.covariance.data());
  const int rows[4] = {0, 1, 2, 5};
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j) m.covariance(i, j) = c(rows[i], rows[j]);
  return m;
}

std::optional<Measurement> SensorBridge::gps(const sensor_msgs::NavSatFix& msg) {
  if (msg.status.status < sensor_msgs::NavSatStatus::STATUS_FIX) throw std::invalid_argument("the receiver has no fix");
  Measurement m;
  m.source = Source::kGps;
  m.stamp = msg.header.stamp.toSec();
  if (tooSoon(m.stamp, settings_.gps_interval, last_gps_)) return std::nullopt;
  // Metres above the ellipsoid say nothing of those above the origin; and a fix in two dimensions has none (NaN).
  m.plan_only = !settings_.geoid_undulation || !std::isfinite(msg.altitude);
  const double height = m.plan_only ? 0 : msg.altitude - *settings_.geoid_undulation;
  m.value.head<3>() = frame_->fromGeodetic({msg.latitude, msg.longitude, height});
  const bool stated = msg.position_covariance_type != sensor_msgs::NavSatFix::COVARIANCE_TYPE_UNKNOWN;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const double variance = msg.position_covariance[static_cast<std::size_t>(3 * i + j)];
      m.covariance(i, j) = stated ? std::pow(settings_.gps_inflation, 2) * variance : 0;
    }
    m.covariance(i, i) = std::max(m.covariance(i, i), std::pow(settings_.gps_stddev[static_cast<std::size_t>(i)], 2));
  }
  last_gps_ = m.stamp;
  return m;
}

std::optional<Measurement> SensorBridge::pressure(const sensor_msgs::FluidPressure& msg) {
  Measurement m;
  m.source = Source::kBarometer;
  m.stamp = msg.header.stamp.toSec();
  if (tooSoon(m.stamp, settings_.barometer_interval, last_barometer_)) return std::nullopt;
  const auto height = heightFromPressure(msg.fluid_pressure);
  if (!height) throw std::invalid_argument("not between 20 and 120 kPa (the unit is Pa)");
  m.value[0] = *height;
  m.covariance(0, 0) = std::pow(settings_.barometer_stddev, 2);
  last_barometer_ = m.stamp;
  return m;
}

bool SensorBridge::isFieldDue(const sensor_msgs::MagneticField& msg) {
  const double stamp = msg.header.stamp.toSec();
  if (tooSoon(stamp, settings_.magnetometer_interval, last_magnetometer_)) return false;
  last_magnetometer_ = stamp;
  return true;
}

Measurement SensorBridge::heading(const sensor_msgs::MagneticField& msg, const Eigen::Matrix3d& R_base_sensor,
                                  const Eigen::Matrix3d& R_level_base) const {
  if (!settings_.declination)
    throw std::invalid_argument(
        "the declination is not known: set the parameter declination (of magnetic from true north, east positive, in "
        "degrees; city_parameters prints the one that its --city file names)");
  const Eigen::Vector3d field(msg.magnetic_field.x, msg.magnetic_field.y, msg.magnetic_field.z);
  const auto yaw = yawFromMagneticField(R_base_sensor * field, R_level_base, *settings_.declination);
  if (!yaw) throw std::invalid_argument("no usable horizontal field");
  Measurement m;
  m.source = Source::kHeading;
  m.stamp = msg.header.stamp.toSec();
  m.value[0] = *yaw;
  m.covariance(0, 0) = std::pow(settings_.magnetometer_stddev, 2);
  return m;
}

std::optional<TiltFilter::Vertical> SensorBridge::vertical(const geometry_msgs::PoseWithCovarianceStamped& msg) {
  constexpr double kMost = 0.1;  // [rad]
  const auto& c = msg.pose.covariance;
  if (!(c[21] > 0) || !(c[28] > 0) || !std::isfinite(c[22])) return std::nullopt;
  const double stddev = std::sqrt((c[21] + c[28]) / 2 + std::hypot((c[21] - c[28]) / 2, c[22]));  // the largest
  if (!(stddev < kMost)) return std::nullopt;
  try {
    const Pose T_world_base = ru::fromMsg(msg.pose.pose);
    return TiltFilter::Vertical{msg.header.stamp.toSec(), T_world_base.linear().row(2).transpose(), stddev};
  } catch (const std::invalid_argument&) {
    return std::nullopt;
  }
}

Increment SensorBridge::increment(const air_ground::VoIncrement& msg, const std::optional<Tilt>& tilt) const {
  const Pose T_previous_current = ru::fromMsg(msg.relative_pose);
  const bool levelled = settings_.level_increments && tilt;
  const Eigen::Matrix3d R_level_previous =
      levelled ? tiltOf(tilt->R_level_body * T_previous_current.linear().transpose()) : Eigen::Matrix3d::Identity();
  const Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> covariance(msg.covariance.data());
  Increment increment = levelIncrement(T_previous_current, covariance, R_level_previous);
  increment.previous_stamp = msg.previous_stamp.toSec();
  increment.stamp = msg.header.stamp.toSec();
  if (levelled) increment.tilt_stddev = tilt->stddev;
  increment.metric = msg.metric;
  increment.map_id = msg.map_id;
  if (msg.metric && std::isfinite(msg.scale_variance) && msg.scale_variance > 0)
    increment.scale_stddev = std::sqrt(msg.scale_variance);
  return increment;
}

}  // namespace ekf_tracker
