#include "match_message.h"

#include "air_ground_common/ros/conversions.h"

namespace streetview_localizer {

namespace ru = air_ground_common::ros_utils;
using air_ground::StreetviewMatch;

namespace {

// One order in both.
static_assert(static_cast<int>(LocalizerStatus::kAccepted) == StreetviewMatch::STATUS_ACCEPTED &&
              static_cast<int>(LocalizerStatus::kRefused) == StreetviewMatch::STATUS_REFUSED &&
              static_cast<int>(LocalizerStatus::kNoPose) == StreetviewMatch::STATUS_NO_POSE &&
              static_cast<int>(LocalizerStatus::kNoMatch) == StreetviewMatch::STATUS_NO_MATCH);

air_ground::StreetviewPoint pointMessage(const Correspondence& c, int view) {
  air_ground::StreetviewPoint point;
  point.u = static_cast<float>(c.pixel.x());
  point.v = static_cast<float>(c.pixel.y());
  point.view_id = static_cast<std::uint32_t>(view);
  point.view_u = static_cast<float>(c.view_pixel.x());
  point.view_v = static_cast<float>(c.view_pixel.y());
  point.point.x = c.p_world.x();
  point.point.y = c.p_world.y();
  point.point.z = c.p_world.z();
  return point;
}

}  // namespace

StreetviewMatch matchMessage(const LocalizerResult& r, const StreetviewDatabase& database) {
  StreetviewMatch msg;
  msg.status = static_cast<std::uint8_t>(r.status);
  msg.reason = r.reason;
  if (r.panorama >= 0) msg.panorama_id = database.panoramas[static_cast<std::size_t>(r.panorama)].id;
  if (r.view >= 0) msg.view_id = static_cast<std::uint32_t>(r.view);
  msg.score = r.acceptance.score;
  msg.features = static_cast<std::uint32_t>(r.features);
  msg.matches = static_cast<std::uint32_t>(r.matches);
  msg.used_prior = r.used_prior;
  for (const int p : r.searched) msg.searched.push_back(database.panoramas[static_cast<std::size_t>(p)].id);
  msg.time = r.total_time;
  if (!r.pose.success || !r.pose.covariance.allFinite()) return msg;
  msg.camera_pose.pose = ru::toMsg(r.pose.T_world_camera);
  ru::setCovariance(r.pose.covariance, &msg.camera_pose.covariance);
  msg.inliers = static_cast<std::uint32_t>(r.pose.inliers.size());
  msg.rms = r.pose.rms;
  msg.range = r.acceptance.evidence.range;
  for (const int i : r.pose.inliers)
    msg.points.push_back(
        pointMessage(r.correspondences[static_cast<std::size_t>(i)], r.views[static_cast<std::size_t>(i)]));
  return msg;
}

}  // namespace streetview_localizer
