// The ICP chain from the ROS parameter server.
#pragma once

#include <ros/node_handle.h>

#include <string>

#include "icp_refine/icp.h"

namespace icp_refine {

/// From `file` or, when that is empty, from the parameter `chain`. Throws ConfigError.
IcpChain readChain(const ros::NodeHandle& private_handle, const std::string& file);

}  // namespace icp_refine
