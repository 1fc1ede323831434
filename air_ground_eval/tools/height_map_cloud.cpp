// Shows height maps in rviz: every defined cell becomes a point (intensity = height).
#include <air_ground/HeightMap.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>

#include <cmath>
#include <string>

#include "air_ground_common/ros/conversions.h"

namespace {

namespace ros_utils = air_ground_common::ros_utils;

sensor_msgs::PointCloud2 toCloud(const air_ground::HeightMap& map) {
  std::vector<ros_utils::CloudPoint> points;
  float lowest = 0, highest = 0;
  for (std::uint32_t row = 0; row < map.height; ++row) {
    for (std::uint32_t column = 0; column < map.width; ++column) {
      const float z = map.heights[static_cast<std::size_t>(row) * map.width + column];
      if (!std::isfinite(z)) continue;
      lowest = points.empty() ? z : std::min(lowest, z);
      highest = points.empty() ? z : std::max(highest, z);
      ros_utils::CloudPoint point;
      point.position = {static_cast<float>(map.origin_x + (column + 0.5) * map.resolution),
                        static_cast<float>(map.origin_y + (row + 0.5) * map.resolution), z};
      points.push_back(point);
    }
  }
  for (ros_utils::CloudPoint& point : points) {
    const float share = highest > lowest ? (point.position.z() - lowest) / (highest - lowest) : 0.f;
    point.rgb.setConstant(static_cast<std::uint8_t>(std::lround(255 * share)));
  }
  return ros_utils::toMsg(points, ros_utils::CloudFields::kXyzIntensity, map.header);
}

void relay(ros::NodeHandle* node, const std::string& topic, std::vector<ros::Subscriber>* subscribers) {
  ros::Publisher publisher = node->advertise<sensor_msgs::PointCloud2>(topic + "_cloud", 1, true);
  subscribers->push_back(
      node->subscribe<air_ground::HeightMap>(topic, 5, [publisher](const air_ground::HeightMap::ConstPtr& map) {
        if (map->heights.size() != static_cast<std::size_t>(map->width) * map->height) {
          ROS_WARN_THROTTLE(
              10, "a height map of %u x %u cells holds %zu heights, and is not shown: its publisher is at fault",
              map->width, map->height, map->heights.size());
          return;
        }
        publisher.publish(toCloud(*map));
      }));
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "height_map_cloud");
  ros::NodeHandle node;
  std::vector<ros::Subscriber> subscribers;
  relay(&node, "alignment/height_map_air", &subscribers);
  relay(&node, "alignment/height_map_ground", &subscribers);
  ros::spin();
  return 0;
}
