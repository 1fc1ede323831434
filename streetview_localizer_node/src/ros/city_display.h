// What rviz shows of the city: the textured model, the panoramas, the cameras located so far, pictures of matches.
#pragma once

#include <ros/node_handle.h>
#include <visualization_msgs/Marker.h>

#include <deque>
#include <memory>
#include <opencv2/core.hpp>
#include <string>

#include "streetview_localizer/localizer.h"
#include "streetview_localizer/view_synthesis.h"

namespace streetview_localizer {

class CityDisplay {
 public:
  void advertise(ros::NodeHandle* handle);

  /// Reads the depth of all views and colours the model: seconds for a city. Call before the others; keeps a reference.
  void prepare(const StreetviewLocalizer& localizer, double spacing, std::size_t max_points, int cameras_shown);
  /// Textured model and panoramas, latched.
  void publishCity(const std::string& world_frame);
  /// Adds a camera to those shown; the oldest go.
  void addCamera(const CameraModel& camera, const Pose& T_world_camera, const ros::Time& stamp,
                 const std::string& world_frame);

  /// BGR, each half `width` pixels wide at most.
  cv::Mat matchImage(const cv::Mat& image, const LocalizerResult& result, int width) const;
  cv::Mat besideModel(const cv::Mat& image, const CameraModel& camera, const LocalizerResult& result, int width) const;

 private:
  const StreetviewLocalizer* localizer_ = nullptr;
  std::unique_ptr<ViewSynthesizer> synthesizer_;
  ros::Publisher model_, panoramas_, cameras_;
  double spacing_ = 0.2;
  std::size_t max_points_ = 0, cameras_shown_ = 0;
  visualization_msgs::Marker frusta_;
};

}  // namespace streetview_localizer
