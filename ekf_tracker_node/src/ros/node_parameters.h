// Parameters of ekf_tracker_node.
#pragma once

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "ekf_tracker/tracker.h"

namespace ekf_tracker {

struct NodeSettings {
  NodeSettings() { tracker.filter.covariance_factor = 0.1; }

  std::string world_frame = "world", map_frame = "mav_map", base_frame = "mav_base_link", origin_crs;
  std::string accel_topic;  ///< of an accelerometer whose samples are not in the IMU's messages; empty: they are
  bool publish_tf = true, level_increments = true, magnetometer = false, gps = false, barometer = false;
  std::string autosave;  ///< folder for the trajectory at the end; empty: none
  double path_step = 0.2, tilt_stddev = 0.05, odometry_wait = 0.5, clock_tolerance = 0.5;  ///< [m], [rad], [s], [s]
  std::optional<double> geoid_undulation;  ///< of `origin`'s heights [m]; empty: not known
  std::optional<double> declination;       ///< of magnetic from true north, east positive [rad]; empty: not known
  double magnetometer_stddev = 10 * M_PI / 180, magnetometer_interval = 1;  ///< [rad], [s]
  double gps_inflation = 2, gps_interval = 10;                              ///< [1], [s]
  double barometer_stddev = 0.5, barometer_interval = 1;                    ///< [m], [s]
  std::vector<double> origin{0, 0, 0}, gps_stddev{8, 8, 12};
  TrackerSettings tracker;

  /// Throws ParameterError.
  void validate() const;
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace ekf_tracker
