#include "outcome_publisher.h"

#include <air_ground/StreetviewMatch.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>

#include <cmath>

#include "air_ground_common/covariance.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/text.h"
#include "match_message.h"

namespace streetview_localizer {

namespace ru = air_ground_common::ros_utils;
using air_ground_common::formatted;

void OutcomePublisher::advertise(ros::NodeHandle* handle) {
  match_ = handle->advertise<air_ground::StreetviewMatch>("streetview/match", 20);
  pose_ = handle->advertise<geometry_msgs::PoseWithCovarianceStamped>("streetview/pose", 20);
  match_image_ = handle->advertise<sensor_msgs::Image>("streetview/match_image", 2);
  synthesized_view_ = handle->advertise<sensor_msgs::Image>("streetview/synthesized_view", 2);
  display_.advertise(handle);
}

void OutcomePublisher::prepareDisplay(const StreetviewLocalizer& localizer) {
  health_.state(health_.kWarn, "preparing the display (display: false leaves it out)");
  try {
    display_.prepare(localizer, settings_.model_spacing, static_cast<std::size_t>(settings_.model_max_points),
                     settings_.cameras_shown);
    display_.publishCity(settings_.world_frame);
    displayed_ = true;
  } catch (const std::exception& e) {
    health_.count(std::string("no display of the city: ") + e.what());
  }
}

void OutcomePublisher::publish(const Job& job, const cv::Mat& image, const std::optional<Pose>& T_base_camera,
                               const std::string& lacking, const LocalizerResult& result,
                               const StreetviewDatabase& database) {
  ++(result.accepted() ? accepted_ : refused_);
  air_ground::StreetviewMatch msg = matchMessage(result, database);
  msg.header.stamp = job.image->header.stamp;
  msg.header.frame_id = settings_.world_frame;
  msg.camera_frame = job.camera_frame;
  match_.publish(msg);
  if (result.accepted() && T_base_camera) publishFix(job, result, *T_base_camera);
  tellState(job, lacking, result, database);
  if (displayed_) show(job, image, result);
}

void OutcomePublisher::publishFix(const Job& job, const LocalizerResult& result, const Pose& T_base_camera) {
  const Pose T_world_base = result.pose.T_world_camera * T_base_camera.inverse();
  const Matrix6d covariance = air_ground_common::covarianceAt(
      result.pose.covariance, T_world_base.translation() - result.pose.T_world_camera.translation());
  if (!air_ground_common::isValid(T_world_base) || !covariance.allFinite())
    return health_.count("poses that are not finite");
  geometry_msgs::PoseWithCovarianceStamped msg;
  msg.header.stamp = job.image->header.stamp;
  msg.header.frame_id = settings_.world_frame;
  msg.pose.pose = ru::toMsg(T_world_base);
  ru::setCovariance(covariance, &msg.pose.covariance);
  pose_.publish(msg);
  last_fix_ = msg.header.stamp;
}

void OutcomePublisher::tellState(const Job& job, const std::string& lacking, const LocalizerResult& result,
                                 const StreetviewDatabase& database) {
  const std::string tally = "; " + std::to_string(accepted_) + " images located, " + std::to_string(refused_) + " not";
  if (result.accepted() && !lacking.empty())
    return health_.state(health_.kWarn, "located, but " + lacking + ": no fix" + tally);
  if (result.accepted()) {
    const Eigen::Vector3d stddev = result.pose.covariance.diagonal().head<3>().cwiseSqrt();
    const std::string& panorama = database.panoramas[static_cast<std::size_t>(result.panorama)].id;
    return health_.state(health_.kOk,
                         formatted("located from %s: %zu inliers, score %.3f, %.2f %.2f %.2f m (1 sigma), in %.2f s",
                                   panorama.c_str(), result.pose.inliers.size(), result.acceptance.score, stddev.x(),
                                   stddev.y(), stddev.z(), result.total_time) +
                             tally);
  }
  std::string state = formatted("last image %s: %s", nameOf(result.status), result.reason.c_str()) + tally;
  if (!last_fix_.isZero() && job.image->header.stamp >= last_fix_)  // else of before time jumped back
    state +=
        "; last fix " + std::to_string(std::lround(job.image->header.stamp.toSec() - last_fix_.toSec())) + " s ago";
  health_.state(health_.kWarn, state);
}

void OutcomePublisher::show(const Job& job, const cv::Mat& image, const LocalizerResult& result) {
  const auto& header = job.image->header;
  if (match_image_.getNumSubscribers() > 0)
    match_image_.publish(ru::toMsg(display_.matchImage(image, result, settings_.display_width), "bgr8", header));
  if (!result.accepted()) return;
  if (synthesized_view_.getNumSubscribers() > 0)
    synthesized_view_.publish(
        ru::toMsg(display_.besideModel(image, job.camera, result, settings_.display_width), "bgr8", header));
  display_.addCamera(job.camera, result.pose.T_world_camera, header.stamp, settings_.world_frame);
}

}  // namespace streetview_localizer
