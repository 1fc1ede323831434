// Recordings in the EuRoC MAV layout (mav0/cam0, mav0/imu0, and mav0/state_groundtruth_estimate0 or, as of TUM-VI,
// mav0/mocap0), read without ROS.
#pragma once

#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/trajectory.h"
#include "mav_vo/imu_preintegration.h"

namespace mav_vo {

struct EurocFolder {
  air_ground_common::CameraModel camera;
  air_ground_common::Pose T_base_camera = air_ground_common::Pose::Identity();
  air_ground_common::Pose T_base_imu = air_ground_common::Pose::Identity();
  struct Image {
    double stamp = 0;  ///< [s]
    std::string path;
  };
  std::vector<Image> images;
  std::vector<ImuSample> imu;
  air_ground_common::Trajectory truth;  ///< of the body; empty without ground truth
  std::vector<ImuBias> truth_bias;      ///< one a pose of `truth`; empty where they are not known
};

/// Throws std::runtime_error, naming the file, when something needed is missing, or the lens is of a model that
/// CameraModel does not know.
EurocFolder readEurocFolder(const std::string& path);

}  // namespace mav_vo
