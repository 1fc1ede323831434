// Builds the Street View database: from images with geotags or poses and a city model to one GeoPackage.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/database.h"
#include "streetview_localizer/facade_consistency.h"
#include "streetview_localizer/features.h"
#include "streetview_localizer/geotags.h"
#include "streetview_localizer/neighbour_check.h"
#include "streetview_localizer/panorama_registration.h"
#include "streetview_localizer/panorama_views.h"
#include "streetview_localizer/textured_model.h"

namespace streetview_localizer {

struct BuildSettings {
  std::string model;                 ///< CityGML, CityJSON, OBJ, or a folder of them
  std::string images;                ///< folder; empty: the folder of the geotag file
  std::string geotags;               ///< CSV or GeoJSON; empty: EXIF of the images, unless `poses` is given
  std::string poses;                 ///< surveyed photographs (readSurveyedImages) instead of geotags
  double pose_stddev = 0.02;         ///< of a surveyed position, one axis: bundle adjustment of good photographs [m]
  double pose_angle_stddev = 0.001;  ///< of a surveyed attitude, one axis [rad]
  std::string output;                ///< .gpkg, or "PG:..."
  int take_every = 1;                ///< of the listed images ...
  int take_first = 0;                ///< ... beginning with this one

  CityModelOptions model_options;
  North north = North::kTrue;       ///< what the geotags' headings are counted from
  double geotag_height_offset = 0;  ///< added to their heights, into the model's vertical datum [m]
  std::optional<air_ground_common::CameraModel> camera;  ///< of geotagged photographs; of its size none is a sphere

  bool register_panoramas = true;  ///< correct geotagged panoramas and photographs against the model
  bool check_neighbours = true;    ///< compare corrected poses with what neighbouring images show
  bool keep_unregistered = false;  ///< use the geotag where that failed, instead of storing the image without views
  bool check_consistency = true;   ///< leave out what other images do not see on the facade
  int threads = 0;                 ///< 0: all cores
  std::string textured_model;      ///< .obj of the city model with facade textures, written at the end; empty: none
  TextureSettings texture;

  PanoramaViewSettings views;
  double photograph_focal = 900;  ///< photographs of more than 1.25 times this focal length are reduced to it [px]
  FeatureSettings features;
  BackProjectionSettings back_projection;
  RegistrationSettings registration;
  NeighbourSettings neighbours;
  ConsistencySettings consistency;

  /// One line that names all that shapes the contents, so that a build is only resumed with the same.
  /// `model_identity`: CityModel::identity.
  std::string fingerprint(const std::string& model_identity) const;
};

struct BuildReport {
  struct Refusal {
    std::string image, reason;
  };
  int stored = 0;   ///< panoramas and photographs with views, in this run
  int resumed = 0;  ///< stored by an earlier run
  int views = 0;
  BackProjectionCounts features;
  int inconsistent = 0;                    ///< features left out by the comparison of images
  std::vector<Refusal> refused;            ///< images that are not used
  std::vector<Refusal> uncorrected;        ///< images used with their geotag (keep_unregistered), and why
  std::vector<Refusal> doubtful;           ///< images used though a neighbour contradicts their pose
  std::vector<Refusal> corrected_anew;     ///< images whose pose neighbours contradicted, in this run
  int neighbour_pairs = 0;                 ///< of images whose relative pose was measured, in this run
  int gained = 0;                          ///< images that were corrected only where neighbours place them, in this run
  std::vector<std::string> remarks;        ///< of the city model
  std::vector<std::string> image_remarks;  ///< of the images as a whole

  /// True when the database holds an image that can be searched.
  bool useful() const { return stored + resumed > 0; }
};

/// `progress`: called with the stage, images done and images in all; from one thread at a time. Throws
/// std::runtime_error or std::invalid_argument with one line when nothing can be built.
BuildReport buildDatabase(const BuildSettings& settings,
                          const std::function<void(const std::string&, int, int)>& progress = {});

/// The same; what there is to be told is in `report` also when this throws.
void buildDatabase(const BuildSettings& settings, const std::function<void(const std::string&, int, int)>& progress,
                   BuildReport* report);

}  // namespace streetview_localizer
