// The images of a build: which there are, where they were taken, through which lens, and why others are not used.
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "streetview_localizer/database_builder.h"

namespace streetview_localizer {

struct BuildItem {
  std::string path;
  Panorama panorama;
  air_ground_common::CameraModel camera;  ///< of a photograph
  bool heading_known = true;              ///< false: the geotag's yaw means nothing
  bool readable = true;                   ///< as far as is known: pose correction reads it first
  bool known = false;                     ///< to the database, from an earlier run
};

/// The images that `settings` name and that have a place in the model, with their geotags or surveyed poses in world.
/// Others go to report->refused; remarks on the images are replaced. `axis_order`: of the model's file, for messages.
/// Throws std::runtime_error or std::invalid_argument with one line for a list that is broken.
std::vector<BuildItem> listBuildItems(const BuildSettings& settings, const CityModel& model,
                                      const std::string& axis_order, BuildReport* report);

/// Back to where the geotag has it, with the deviations that the settings state of that.
void placeAtGeotag(const BuildSettings& settings, BuildItem* item);

/// The image of a file as it is stored, not turned by its EXIF orientation; empty where it cannot be read.
cv::Mat readStored(const std::string& path, bool grey = false);

/// The settings of the pose correction with the threads of the build.
RegistrationSettings registrationOf(const BuildSettings& settings);

}  // namespace streetview_localizer
