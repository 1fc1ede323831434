// What streetview_localizer_node says of an image: the match, the pose of the base, diagnostics, pictures.
#pragma once

#include <ros/node_handle.h>

#include <cstddef>
#include <optional>
#include <string>

#include "city_display.h"
#include "image_queue.h"

namespace streetview_localizer {

/// Of one thread.
class OutcomePublisher {
 public:
  OutcomePublisher(const NodeSettings& settings, air_ground_common::ros_utils::NodeHealth& health)
      : settings_(settings), health_(health) {}

  void advertise(ros::NodeHandle* handle);
  /// Reads what the pictures and markers need, seconds for a city, and publishes the city. `localizer` must live on.
  /// Without display, says why.
  void prepareDisplay(const StreetviewLocalizer& localizer);
  /// Without `T_base_camera` the pose of the base is not known, for the reason `lacking`. `image`: BGR.
  void publish(const Job& job, const cv::Mat& image, const std::optional<Pose>& T_base_camera,
               const std::string& lacking, const LocalizerResult& result, const StreetviewDatabase& database);

 private:
  void publishFix(const Job& job, const LocalizerResult& result, const Pose& T_base_camera);
  void tellState(const Job& job, const std::string& lacking, const LocalizerResult& result,
                 const StreetviewDatabase& database);
  void show(const Job& job, const cv::Mat& image, const LocalizerResult& result);

  const NodeSettings& settings_;
  air_ground_common::ros_utils::NodeHealth& health_;
  CityDisplay display_;
  bool displayed_ = false;
  ros::Publisher match_, pose_, match_image_, synthesized_view_;
  ros::Time last_fix_;
  std::size_t accepted_ = 0, refused_ = 0;
};

}  // namespace streetview_localizer
