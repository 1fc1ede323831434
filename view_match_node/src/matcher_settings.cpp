#include <stdexcept>
#include <string>

#include "air_ground_common/parameters.h"
#include "view_match/view_matcher.h"

namespace view_match {

void describe(air_ground_common::ParameterVisitor& v, MatcherSettings& m) {
  v.section("Recognition");
  v("features", m.place.orb_features, {50, 20000}, "", "ORB features of an image of the MAV");
  v("min_matches", m.place.min_matches, {8, 10000}, "", "mutual matches with a keyframe, for a place to be verified");
  v("min_inliers", m.place.min_inliers, {8, 10000}, "", "of them that agree on a pose of the camera");
  v("min_lead", m.min_lead, {1, 100}, "", "of these, over those at the best place elsewhere");
  v("max_elevation", m.max_elevation, {0, 3.2}, "rad",
    "images of a level map are compared with keyframes whose optical axes are as far above or below the horizon as "
    "theirs, within this; ORB bears half of it");
  v("pixel_sigma", m.place.pixel_sigma, {0.1, 50}, "px", "of ORB positions at full resolution");
  v("systematic_error", m.systematic, {0, 1}, "",
    "of a recognised camera's position over the distance of what it sees: calibration, depth, rolling shutter");
  v("systematic_angle", m.systematic_angle, {0, 1}, "rad", "and of its attitude");
  v("systematic_scale", m.systematic_scale, {0, 1}, "",
    "relative, and of the scale that the depths in one image tell where the MAV's map has none");
  v("new_view", m.new_view, {0, 10}, "", "images from closer to a recognised one, over the distance, are left out ...");
  v("new_view_angle", m.new_view_angle, {0, 4}, "rad", "... unless turned by this");
  v("max_images", m.max_images, {2, 1000}, "", "recognised images kept, the newest");
  v("max_waiting", m.max_waiting, {0, 10000}, "",
    "images not recognised that are kept, of views that differ: the ground robot may come to see the same later");
  v("scale_stddev", m.scale_stddev, {1e-4, 1}, "", "relative, of a metric map; that of a MAV without IMU is estimated");

  v.section("Acceptance: CONVERGED only when all of these hold");
  v("accept/min_images", m.min_images, {2, 1000}, "", "recognised images that agree");
  v("accept/min_share", m.min_share, {0, 1}, "", "of all that were recognised, else AMBIGUOUS");
  v("accept/min_baseline", m.min_baseline, {0, 10}, "",
    "greatest distance between their cameras, over the distance of what they see, else DEGENERATE");
  v("accept/max_sigma", m.max_sigma, {0, 100}, "m",
    "largest standard deviation of the position in any direction, else DEGENERATE");
  v("accept/max_sigma_angle", m.max_sigma_angle, {0, 4}, "rad", "and of the rotation about any axis");
  v("accept/max_sigma_scale", m.max_sigma_scale, {0, 1}, "", "and of the scale, relative");
}

void MatcherSettings::validate() const {
  if (max_images < min_images)
    throw std::invalid_argument("max_images: " + std::to_string(max_images) + " is less than accept/min_images, " +
                                std::to_string(min_images) + ", so that nothing is ever accepted");
}

}  // namespace view_match
