// Messages of a fused map: depth map, cloud, and figures of the distance field.
#pragma once

#include <air_ground/CloudCorrections.h>
#include <ros/ros.h>

#include <cstdint>
#include <string>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "cloud_publisher.h"
#include "dense_fusion/dense_mapper.h"

namespace dense_fusion {

/// The points that are finite, as the MAV's.
std::vector<air_ground_common::ros_utils::CloudPoint> messagePoints(const std::vector<SurfacePoint>& points);

/// mav/depth_map, mav/dense_cloud, mav/distance_field, mav/cloud_corrections.
class FusedMapPublisher {
 public:
  FusedMapPublisher(ros::NodeHandle handle, const MapStore& map, WorkQueue& queue,
                    air_ground_common::ros_utils::NodeHealth& health);

  /// The map has ended: who subscribes from now on gets nothing of it.
  void startMap() { clouds_.startMap(); }

  /// Somebody subscribes to them.
  bool depthMapsWanted() const { return depth_map_.getNumSubscribers() > 0; }

  // Both are called within WorkQueue::unlessReset().

  /// Poses and points are in map_frame, depth maps in camera_frame. The map has the points already.
  void publish(const FusedMap& fused, const std::string& map_frame, const std::string& camera_frame,
               std::uint32_t map_id);
  /// What has become of the clouds published so far; header: of the correction.
  void publish(const air_ground_common::CloudCorrections& corrections, const std_msgs::Header& header,
               std::uint32_t map_id);

 private:
  ros::Publisher depth_map_, field_;
  CloudPublisher clouds_;
};

}  // namespace dense_fusion
