#include <sstream>

#include "streetview_localizer/database_builder.h"

namespace streetview_localizer {

std::string BuildSettings::fingerprint(const std::string& model_identity) const {
  std::ostringstream out;
  out << "views " << views.width << "x" << views.height << " fov " << views.horizontal_fov << " step " << views.yaw_step
      << " pitch";
  for (const double p : views.pitches) out << " " << p;
  out << "; sift " << features.max_features << " " << features.contrast_threshold << " " << features.edge_threshold
      << " " << features.double_image;
  out << "; rays " << back_projection.max_incidence << " " << back_projection.min_depth << " "
      << back_projection.max_depth << " " << back_projection.edge_distance << " " << back_projection.discontinuity
      << " " << back_projection.walls_only;
  out << "; consistency " << (check_consistency ? consistency.min_correlation : -1) << "; registered "
      << register_panoramas << keep_unregistered << "; north " << (north == North::kGrid ? "grid" : "true")
      << " height " << geotag_height_offset;
  if (register_panoramas) {
    const RegistrationSettings& r = registration;
    out << "; registration";
    for (const double value :
         {r.search_radius, r.search_yaw, r.geotag_stddev, r.heading_stddev, r.tilt_stddev, r.height_stddev,
          r.camera_height, r.camera_height_stddev, r.model_radius, r.model_lateral_stddev, r.model_height_stddev,
          r.roof_overhang, r.roof_overhang_stddev, r.max_position_stddev, r.max_orientation_stddev})
      out << " " << value;
  }
  if (camera) {
    out << "; camera " << camera->width << "x" << camera->height;
    for (const double value :
         {camera->fx, camera->fy, camera->cx, camera->cy, camera->k1, camera->k2, camera->p1, camera->p2, camera->k3})
      out << " " << value;
  }
  // Behind "model" stands what databases did not tell before.
  out << "; model " << model_identity << "; geotags " << registration.geotag_stddev << " "
      << registration.heading_stddev << " " << registration.tilt_stddev << " " << registration.camera_height;
  const BuildSettings usual;  // of databases that do not tell
  if (pose_stddev != usual.pose_stddev || pose_angle_stddev != usual.pose_angle_stddev)
    out << "; poses " << pose_stddev << " " << pose_angle_stddev;
  if (!register_panoramas && registration.height_stddev != usual.registration.height_stddev)
    out << "; heights " << registration.height_stddev;
  const CityModelOptions& m = model_options;
  if (!poses.empty() && (m.y_up || !m.offset.isZero(0) || m.height_offset != 0)) out << "; poses as the model's file";
  if (photograph_focal != usual.photograph_focal) out << "; photographs " << photograph_focal;
  if (register_panoramas && !check_neighbours) out << "; neighbours not compared";
  return out.str();
}

}  // namespace streetview_localizer
