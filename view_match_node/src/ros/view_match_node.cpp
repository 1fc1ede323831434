// The MAV's images recognised among the ground robot's keyframes: posed images and keyframes in, an alignment of both
// maps with its verdict out. All work is done in the callbacks of one thread; what comes meanwhile is dropped.
#include <air_ground/PosedImage.h>
#include <air_ground/VoStatus.h>
#include <ros/ros.h>
#include <std_srvs/Trigger.h>

#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/robot_map_input.h"
#include "messages.h"
#include "node_parameters.h"

namespace view_match {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;
using air_ground_common::RobotMapSession;

class ViewMatchNode {
 public:
  explicit ViewMatchNode(const NodeSettings& settings)
      : settings_(settings),
        health_("view_match"),
        matcher_(settings.matcher),
        mav_(
            "MAV", kMavStreams, RobotMapSession(settings.mav_map_frame, settings.visual_map_frame), health_,
            [this] { forgetAerial(); }, [this] { forgetAerial(); }),
        ground_("ground robot", kGroundStreams, RobotMapSession(settings.ground_map_frame), health_,
                [this] { matcher_.forgetGround(); }) {
    publisher_ = handle_.advertise<AlignmentEstimate>("alignment/views", 20, true);
    image_subscriber_ = handle_.subscribe("mav/posed_image", 5, &ViewMatchNode::onImage, this);
    sparse_subscriber_ = handle_.subscribe("mav/sparse_cloud", 5, &ViewMatchNode::onSparseCloud, this);
    corrected_subscriber_ = handle_.subscribe("mav/corrected_path", 20, &ViewMatchNode::onCorrection, this);
    status_subscriber_ = handle_.subscribe("mav/vo_status", 100, &ViewMatchNode::onMavStatus, this);
    keyframes_subscriber_ = handle_.subscribe("ground/map_keyframes", 20, &ViewMatchNode::onKeyframes, this);
    reset_service_ = ros::NodeHandle("~").advertiseService("reset", &ViewMatchNode::onReset, this);
    for (const auto* s : {&image_subscriber_, &keyframes_subscriber_}) health_.expectInput(s->getTopic(), false);
  }

 private:
  enum MavStream { kImages, kLandmarks, kCorrections, kStatus, kMavStreams };
  enum GroundStream { kKeyframes, kGroundStreams };

  void forgetAerial() {
    matcher_.forgetAerial();
    landmarks_.clear();
    last_image_ = ros::Time();
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    mav_.restart();
    return ros_utils::answer(response, [] { return "forgot the MAV's images"; });
  }

  void onMavStatus(const air_ground::VoStatus::ConstPtr& msg) { mav_.admitStatus(kStatus, *msg); }

  void onSparseCloud(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    if (!mav_.admitMap(kLandmarks, msg->header, "sparse clouds")) return;
    const auto points = ros_utils::readCloud(*msg, "sparse clouds", health_);
    if (!points) return;
    landmarks_.clear();
    for (const auto& p : *points) landmarks_.push_back(p.position);
  }

  void onCorrection(const nav_msgs::Path::ConstPtr& msg) {
    if (!mav_.admitMap(kCorrections, msg->header, "corrections of the map")) return;
    try {
      matcher_.correctAerial(ros_utils::fromMsg(*msg));
    } catch (const std::exception& e) {
      return health_.count(std::string("corrections of the map not usable: ") + e.what());
    }
    publish();
  }

  void onKeyframes(const air_ground::MapKeyframes::ConstPtr& msg) {
    health_.received(keyframes_subscriber_.getTopic(), msg->header.stamp);
    ground_.observe(msg->map_id, msg->header.stamp, false);
    if (!ground_.admitMap(kKeyframes, msg->header, "keyframes")) return;
    try {
      const auto poses = posesOf(*msg);
      for (const auto& features : msg->features) {
        if (features.points.empty() || poses.count(features.id) == 0) continue;
        matcher_.addKeyframe(viewOf(features, poses.at(features.id)));
      }
      matcher_.setPoses(poses);
      const ros::WallTime start = ros::WallTime::now();
      matcher_.matchWaiting();
      health_.timing("waiting images", (ros::WallTime::now() - start).toSec());
    } catch (const std::exception& e) {
      return health_.count(std::string("keyframes not usable: ") + e.what());
    }
    publish();
  }

  void onImage(const air_ground::PosedImage::ConstPtr& msg) {
    health_.received(image_subscriber_.getTopic(), msg->header.stamp);
    const double interval = status_ == MatchStatus::kConverged ? settings_.converged_interval : settings_.interval;
    if (!last_image_.isZero() && std::abs(msg->header.stamp.toSec() - last_image_.toSec()) < interval) return;
    if (!msg->metric && msg->header.frame_id != settings_.visual_map_frame) return;  // the poses will change
    if (!mav_.admitMap(kImages, msg->header, "posed images")) return;
    mav_.observe(msg->map_id, msg->header.stamp, true);
    last_image_ = msg->header.stamp;
    try {
      const ros::WallTime start = ros::WallTime::now();
      matcher_.setOwnUnit(mav_.map().ownUnit());
      matcher_.addImage(static_cast<std::int64_t>(msg->header.stamp.toNSec()), ros_utils::greyFromMsg(*msg),
                        ros_utils::fromMsg(msg->camera_info), ros_utils::fromMsg(msg->pose.pose), landmarks_);
      health_.timing("image", (ros::WallTime::now() - start).toSec());
    } catch (const std::exception& e) {
      return health_.count(std::string("posed images not usable: ") + e.what());
    }
    publish();
  }

  void publish() {
    const MatchEstimate e = matcher_.estimate();
    health_.state(health_.kOk, std::string(toString(e.status)) + ": " + e.reason);
    if (e.status != status_) ROS_INFO("Alignment by views %s: %s", toString(e.status), e.reason.c_str());
    status_ = e.status;
    AlignmentEstimate msg = toMsg(e);
    msg.header.stamp.fromNSec(static_cast<std::uint64_t>(e.stamp));
    msg.header.frame_id = settings_.ground_map_frame;
    msg.child_frame_id = mav_.map().expectedFrame();
    msg.map_id = mav_.map().id().value_or(0);
    msg.ground_map_id = ground_.map().id().value_or(0);
    publisher_.publish(msg);
  }

  ros::NodeHandle handle_;
  const NodeSettings settings_;
  ros_utils::NodeHealth health_;
  ViewMatcher matcher_;
  std::vector<Eigen::Vector3f> landmarks_;  // in the MAV's map, as of its last sparse cloud
  ros::Time last_image_;                    // that was looked up
  std::optional<MatchStatus> status_;
  ros_utils::RobotMapInput mav_, ground_;
  ros::Publisher publisher_;
  ros::ServiceServer reset_service_;
  ros::Subscriber image_subscriber_, sparse_subscriber_, corrected_subscriber_, status_subscriber_,
      keyframes_subscriber_;
};

}  // namespace
}  // namespace view_match

int main(int argc, char** argv) {
  using namespace view_match;
  return air_ground_common::ros_utils::runNode<NodeSettings, ViewMatchNode>(argc, argv, "view_match");
}
