// Other nodes that say on tf where a robot's own frames are.
#pragma once

#include "air_ground_common/ros/estimator_shell.h"

namespace air_ground_common::ros_utils {

/// For the tf input of a node that publishes map -> odom -> base (with `odom_from_tf`: map -> odom): transforms of
/// other nodes to these frames are counted in `health`, which must outlive the listener, and said once. Empty without
/// `publish_tf`.
TransformBuffer::Listener countRivals(const EstimatorSettings& settings, NodeHealth& health);

}  // namespace air_ground_common::ros_utils
