// The photographs of castle-P30 and other Strecha sets, as database and as queries. Tests skip where they are absent.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/database.h"
#include "streetview_localizer/features.h"
#include "streetview_localizer/geotags.h"

namespace streetview_localizer::test {

inline std::string sharedFolder() {
  const char* shared = std::getenv("AIR_GROUND_SHARED");
  return shared && *shared ? shared : std::string(AIR_GROUND_SOURCE_DIR) + "/../shared";
}

inline std::string strechaFolder() { return sharedFolder() + "/data/strecha_960"; }
inline bool castleAvailable() { return std::filesystem::exists(strechaFolder() + "/castle-P30/poses_zup.txt"); }

inline air_ground_common::CameraModel cameraOf(const SurveyedImage& photo, const cv::Mat& image) {
  air_ground_common::CameraModel camera;
  camera.width = image.cols;
  camera.height = image.rows;
  camera.fx = photo.fx;
  camera.fy = photo.fy;
  camera.cx = photo.cx;
  camera.cy = photo.cy;
  return camera;
}

struct Castle {
  std::vector<SurveyedImage> photos;
  std::shared_ptr<StreetviewDatabase> database;  ///< of the photographs first, first + 2, ...

  cv::Mat image(std::size_t i) const { return cv::imread(strechaFolder() + "/castle-P30/images/" + photos[i].image); }
};

inline Castle makeCastle(int first) {
  Castle castle;
  castle.photos = readSurveyedImages(strechaFolder() + "/castle-P30/poses_zup.txt");
  castle.database = std::make_shared<StreetviewDatabase>();
  StreetviewDatabase& db = *castle.database;
  db.model = readCityModel(strechaFolder() + "/castle_walls.obj");
  db.origin = db.model.origin;
  const BackProjector projector(db.model);
  for (std::size_t i = static_cast<std::size_t>(first); i < castle.photos.size(); i += 2) {
    const SurveyedImage& photo = castle.photos[i];
    Panorama place;
    place.id = photo.image;
    place.equirectangular = false;
    place.T_world_panorama = photo.T_crs_camera;
    place.T_world_panorama.translation() = db.model.worldFromCrs(photo.T_crs_camera.translation());
    View view;
    view.T_world_camera = place.T_world_panorama;
    place.T_world_panorama.linear() = view.T_world_camera.linear() * air_ground_common::opticalFromForwardBody();
    place.T_world_geotag = place.T_world_panorama;
    place.registered = true;
    place.position_stddev = 0.02;
    place.orientation_stddev = 0.001;
    view.id = view.panorama = static_cast<int>(db.panoramas.size());
    view.image = castle.image(i);
    view.camera = cameraOf(photo, view.image);
    view.features = extractFeatures(view.image);
    projector.apply(&view);
    db.panoramas.push_back(place);
    db.views.push_back(view);
  }
  db.buildIndex();
  return castle;
}

/// True pose of a photograph in the database's world.
inline air_ground_common::Pose truth(const Castle& castle, std::size_t i) {
  air_ground_common::Pose T = castle.photos[i].T_crs_camera;
  T.translation() = castle.database->model.worldFromCrs(T.translation());
  return T;
}

}  // namespace streetview_localizer::test
