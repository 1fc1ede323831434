#include "node_parameters.h"

#include "air_ground_common/niceness.h"
#include "air_ground_common/parameters.h"

namespace streetview_localizer {

void describe(air_ground_common::ParameterVisitor& v, NodeSettings& s) {
  v.about("streetview_localizer_node: where in the city was this image taken?");
  v.section("Frames");
  v("database", s.database, "the file that build_streetview_db made (launch argument)");
  v("world_frame", s.world_frame, "local east-north-up frame of the database");
  v("base_frame", s.base_frame, "streetview/pose is its pose; the transform to the camera comes from tf");
  v("camera_frame", s.camera_frame, "empty: as camera_info says or, where it names none, as the images do");
  v("image_transport", s.image_transport,
    "compressed: CompressedImage on <topic>/compressed (launch argument mav_image_transport)", {"raw", "compressed"});
  v("niceness", s.niceness, {0, 19}, "", air_ground_common::kNiceness);
  v("min_period", s.min_period, {0, 3600}, "s",
    "images closer than this to the last one worked on are passed over; 0: as many as it can");

  v.section("Region, index",
            "region/radius > 0: of a city too large for the memory only panoramas so near to a place are loaded.");
  Eigen::Vector2d centre = s.load.centre.value_or(Eigen::Vector2d::Zero());
  double radius = s.load.centre ? s.load.radius : 0;
  v("region/easting", centre.x(), {-1e8, 1e8}, "", "or longitude, in the database's system");
  v("region/northing", centre.y(), {-1e8, 1e8}, "", "or latitude");
  v("region/radius", radius, {0, 1e6}, "m", "0: the whole city");
  if (radius > 0) s.load.centre = centre, s.load.radius = radius;
  v("keep_index", s.keep_index,
    "the index over the descriptors is built once and kept beside the database, as <database>.index; built again for "
    "another `index`");
  s.localizer.index_file = s.keep_index ? indexFileOf(s.database, s.load) : "";

  v.section("What is known beforehand");
  v("use_prior", s.use_prior,
    "tracked/odometry: only panoramas near the predicted pose are searched. The prediction enters neither the pose nor "
    "its covariance, since the tracker fuses the result with it");
  v("prior_max_age", s.prior_max_age, {0.01, 60}, "s", "between prediction and image");
  v("prior_speed", s.prior_speed, {0, 100}, "m/s", "how fast it may fly meanwhile: widens the prediction");
  v("prior_misses", s.prior_misses, {1, 1000000}, "",
    "after so many images in a row without a pose near the prediction, one is searched for in the whole database: a "
    "tracker may be sure of a wrong place");
  v("use_gravity", s.use_gravity, "mav/odometry: roll and pitch of the body at the time of the image");
  v("gravity_max_age", s.gravity_max_age, {0.001, 10}, "s", "between its stamp and the image's");
  v("gravity_wait", s.gravity_wait, {0, 10}, "s",
    "an image waits so long for it, and for the transform of a camera that moves (wall time)");
  v.degrees("gravity_stddev", s.gravity_stddev, {0.01, 45}, "of the direction");
  describe(v, s.localizer);

  v.section("For rviz");
  v("display", s.display, "textured model, panoramas, cameras, pictures of matches");
  v("display_width", s.display_width, {64, 4096}, "px", "of the pictures' halves");
  v("model_spacing", s.model_spacing, {0.01, 100}, "m", "of the points of the textured model");
  v("model_max_points", s.model_max_points, {1000, 100000000}, "", "the spacing grows until they suffice");
  v("cameras_shown", s.cameras_shown, {1, 100000}, "", "");
}

void NodeSettings::validate() const {
  localizer.validate();
  if (database.empty())
    throw air_ground_common::ParameterError(
        "parameter database is empty: name the file that build_streetview_db made (database:=city.gpkg)");
}

}  // namespace streetview_localizer
