#include "fused_map_publisher.h"

#include <air_ground/PosedDepthMap.h>
#include <diagnostic_msgs/DiagnosticArray.h>
#include <sensor_msgs/PointCloud2.h>

#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/text.h"

namespace dense_fusion {

namespace ros_utils = air_ground_common::ros_utils;

namespace {

diagnostic_msgs::KeyValue entry(const std::string& key, const std::string& value) {
  diagnostic_msgs::KeyValue pair;
  pair.key = key;
  pair.value = value;
  return pair;
}

diagnostic_msgs::DiagnosticArray fieldMessage(const FusedMap& fused, const std_msgs::Header& header) {
  diagnostic_msgs::DiagnosticArray array;
  array.header = header;
  array.status.resize(1);
  diagnostic_msgs::DiagnosticStatus& status = array.status[0];
  status.name = "dense_fusion: distance field";
  status.hardware_id = "dense_fusion";
  status.message = "fused " + std::to_string(fused.depth_maps) + " depth maps";
  const VoxelGrid& g = fused.grid;
  ros::Time newest;
  newest.fromNSec(static_cast<std::uint64_t>(fused.newest_image));
  status.values = {entry("newest image [s]", air_ground_common::formatted("%.9f", newest.toSec())),
                   entry("depth maps", std::to_string(fused.depth_maps)),
                   entry("voxels x", std::to_string(g.nx)),
                   entry("voxels y", std::to_string(g.ny)),
                   entry("voxels z", std::to_string(g.nz)),
                   entry("voxel size [m]", std::to_string(g.voxel_size)),
                   entry("origin x [m]", std::to_string(g.origin.x())),
                   entry("origin y [m]", std::to_string(g.origin.y())),
                   entry("origin z [m]", std::to_string(g.origin.z())),
                   entry("points", std::to_string(fused.points.size())),
                   entry("mean support [depth maps]", std::to_string(fused.mean_support)),
                   entry("votes [s]", std::to_string(fused.timings.votes)),
                   entry("minimisation [s]", std::to_string(fused.timings.minimisation)),
                   entry("surface [s]", std::to_string(fused.timings.surface))};
  return array;
}

}  // namespace

std::vector<ros_utils::CloudPoint> messagePoints(const std::vector<SurfacePoint>& points) {
  std::vector<ros_utils::CloudPoint> cloud;
  cloud.reserve(points.size());
  for (const SurfacePoint& p : points) {
    if (!p.position.allFinite()) continue;
    ros_utils::CloudPoint point;
    point.position = p.position;
    point.rgb.setConstant(p.intensity);
    point.source = 1;
    cloud.push_back(point);
  }
  return cloud;
}

FusedMapPublisher::FusedMapPublisher(ros::NodeHandle handle, const MapStore& map, WorkQueue& queue,
                                     ros_utils::NodeHealth& health)
    : depth_map_(handle.advertise<air_ground::PosedDepthMap>("mav/depth_map", 20)),
      field_(handle.advertise<diagnostic_msgs::DiagnosticArray>("mav/distance_field", 20)),
      clouds_(handle, map, queue, health) {}

void FusedMapPublisher::publish(const FusedMap& fused, const std::string& map_frame, const std::string& camera_frame,
                                std::uint32_t map_id) {
  std_msgs::Header header;
  header.stamp.fromNSec(static_cast<std::uint64_t>(fused.depth_map.stamp));
  header.frame_id = map_frame;
  clouds_.publish(boost::make_shared<sensor_msgs::PointCloud2>(
      ros_utils::toMsg(messagePoints(fused.points), ros_utils::CloudFields::kXyzIntensity, header)));
  field_.publish(fieldMessage(fused, header));
  if (fused.depth_map.depth.empty()) return;  // nobody subscribed
  std_msgs::Header optical = header;
  optical.frame_id = camera_frame;

  air_ground::PosedDepthMap depth;
  depth.header = header;
  depth.depth = ros_utils::toMsg(fused.depth_map.depth, "32FC1", optical);
  depth.confidence = ros_utils::toMsg(fused.depth_map.confidence, "32FC1", optical);
  depth.intensity = ros_utils::toMsg(fused.depth_map.intensity, "mono8", optical);
  depth.camera_info = ros_utils::toMsg(fused.depth_map.camera, optical);
  depth.pose = ros_utils::toMsg(fused.depth_map.T_map_camera);
  depth.frames = static_cast<std::uint32_t>(fused.depth_map.frames);
  depth.map_id = map_id;

  depth_map_.publish(depth);
}

void FusedMapPublisher::publish(const air_ground_common::CloudCorrections& corrections, const std_msgs::Header& header,
                                std::uint32_t map_id) {
  clouds_.publish(ros_utils::toMsg(corrections, header, map_id));
}

}  // namespace dense_fusion
