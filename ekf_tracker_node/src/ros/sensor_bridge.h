// Messages of the sensors to measurements of the tracker.
#pragma once

#include <air_ground/VoIncrement.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <sensor_msgs/FluidPressure.h>
#include <sensor_msgs/MagneticField.h>
#include <sensor_msgs/NavSatFix.h>

#include <optional>
#include <string>

#include "air_ground_common/geodesy.h"
#include "ekf_tracker/tilt_filter.h"
#include "ekf_tracker/tracker.h"
#include "node_parameters.h"

namespace ekf_tracker {

const char* nameOf(Source source);

/// Of the world, where the settings give its origin; said on the console.
std::optional<air_ground_common::LocalFrame> frameOf(const NodeSettings& settings);

/// Reads messages; what it cannot use it throws as std::invalid_argument, with the kind of the reason. Readings closer
/// than a sensor's interval are no new information and give nothing. Not thread-safe.
class SensorBridge {
 public:
  /// `frame`: of the world, null without; must outlive this.
  SensorBridge(const NodeSettings& settings, const air_ground_common::LocalFrame* frame)
      : settings_(settings), frame_(frame) {}

  /// A pose that is none becomes NaN: the tracker refuses and reports it.
  Measurement fix(const geometry_msgs::PoseWithCovarianceStamped& msg) const;
  std::optional<Measurement> gps(const sensor_msgs::NavSatFix& msg);
  std::optional<Measurement> pressure(const sensor_msgs::FluidPressure& msg);
  /// False: too soon after the last one.
  bool isFieldDue(const sensor_msgs::MagneticField& msg);
  Measurement heading(const sensor_msgs::MagneticField& msg, const Eigen::Matrix3d& R_base_sensor,
                      const Eigen::Matrix3d& R_level_base) const;
  /// What a fix tells by its roll and pitch; empty where it states none.
  static std::optional<TiltFilter::Vertical> vertical(const geometry_msgs::PoseWithCovarianceStamped& msg);
  /// `tilt`: at the increment's end, or empty to take the increment as level.
  Increment increment(const air_ground::VoIncrement& msg, const std::optional<Tilt>& tilt) const;

  void reset() { last_magnetometer_ = last_gps_ = last_barometer_ = std::nullopt; }

 private:
  const NodeSettings& settings_;
  const air_ground_common::LocalFrame* frame_;
  std::optional<double> last_magnetometer_, last_gps_, last_barometer_;  ///< stamps taken [s]
};

}  // namespace ekf_tracker
