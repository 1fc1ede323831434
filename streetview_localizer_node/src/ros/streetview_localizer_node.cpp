// Wires the localizer to ROS: the newest image in, pose in the city or a refusal with its reason out. Callbacks only
// store; one thread works.
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/pixel_range.h"
#include "camera_mounting.h"
#include "outcome_publisher.h"

namespace streetview_localizer {
namespace {

namespace ru = air_ground_common::ros_utils;

enum Stream : std::size_t { kImages, kPriors, kAttitudes, kStatuses, kStreams };

class StreetviewLocalizerNode {
 public:
  StreetviewLocalizerNode(ros::NodeHandle handle, ros::NodeHandle private_handle, const NodeSettings& settings)
      : handle_(handle),
        private_handle_(private_handle),
        settings_(settings),
        info_topic_(handle.resolveName("mav/camera/camera_info")),
        health_("streetview_localizer") {
    health_.state(health_.kWarn, "reading the database " + settings_.database);
    worker_ = std::thread([this] { run(); });
  }

  ~StreetviewLocalizerNode() {
    queue_.stop();
    worker_.join();
  }

  /// The database could not be used; said on the console.
  bool failed() const { return failed_; }

 private:
  // ---- Start --------------------------------------------------------------------------------------------------------

  // A large city takes minutes to read and to index: meanwhile diagnostics come, and say so.
  void run() {
    try {
      load();
    } catch (const std::exception& e) {
      ROS_FATAL("%s", e.what());
      failed_ = true;
      ros::requestShutdown();
      return;
    }
    listen();
    work();
  }

  void load() {
    const auto database = std::make_shared<const StreetviewDatabase>(loadDatabase(settings_.database, settings_.load));
    ROS_INFO(
        "%s: %zu panoramas, %zu views, world %s", settings_.database.c_str(), database->panoramas.size(),
        database->views.size(),
        database->crs.empty() ? "local, without coordinate system" : ("at the origin in " + database->crs).c_str());
    const std::string& index = settings_.localizer.index_file;
    health_.state(health_.kWarn,
                  "preparing the search index over " + std::to_string(database->views.size()) + " views" +
                      (std::filesystem::exists(index) ? ", from " + index
                                                      : ": building it, which takes minutes for a large city"));
    localizer_ = std::make_unique<StreetviewLocalizer>(database, settings_.localizer);
    ROS_INFO("%s", localizer_->indexRemark().c_str());
  }

  // Subscribes last: who waits for the node waits for its subscriptions.
  void listen() {
    output_.advertise(&handle_);
    reset_ = private_handle_.advertiseService("reset", &StreetviewLocalizerNode::onReset, this);
    health_.expectInput(info_topic_);
    health_.state(health_.kWarn, "waiting for images");
    if (settings_.use_prior)
      prior_ = handle_.subscribe("tracked/odometry", 200, &StreetviewLocalizerNode::onPrior, this);
    if (settings_.use_gravity)
      attitude_ = handle_.subscribe("mav/odometry", 400, &StreetviewLocalizerNode::onAttitude, this);
    status_ = handle_.subscribe("mav/vo_status", 20, &StreetviewLocalizerNode::onStatus, this);
    camera_info_ = handle_.subscribe("mav/camera/camera_info", 20, &StreetviewLocalizerNode::onCameraInfo, this);
    image_.emplace(handle_, "mav/camera/image_raw", settings_.image_transport, false, 3, health_,
                   "the parameter image_transport, or the launch argument mav_image_transport,",
                   [this](const ru::ImageMessage& message) { onImage(message); });
  }

  // ---- Inputs -------------------------------------------------------------------------------------------------------

  void onCameraInfo(const sensor_msgs::CameraInfo::ConstPtr& msg) {
    health_.received(info_topic_, msg->header.stamp);
    try {
      const sensor_msgs::CameraInfo info = ru::infoOfImages(*msg, handle_.resolveName("mav/camera/image_raw"));
      queue_.setCamera({ru::fromMsg(info), info});
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("calibration ignored: ") + e.what());
    }
  }

  void onImage(const ru::ImageMessage& message) {
    if (gate_.admit(kImages, message.header().stamp)) queue_.add(message);
  }

  // A looped bag starts the node afresh, whichever input comes round first.
  void onTimeJump() {
    ROS_WARN("time jumped back (a looped bag?): starting afresh");
    health_.count("time jumped back: started afresh");
    reset();
  }

  std::optional<TimedPose> read(const nav_msgs::Odometry& msg, const std::string& topic) {
    if (msg.child_frame_id != settings_.base_frame) {
      health_.count(topic + " ignored: of frame '" + msg.child_frame_id + "', expected '" + settings_.base_frame + "'");
      return std::nullopt;
    }
    try {
      TimedPose out;
      out.stamp = msg.header.stamp.toSec();
      out.pose = ru::fromMsg(msg.pose.pose);
      out.covariance = ru::covarianceFromMsg(msg.pose.covariance);
      if (!out.covariance.allFinite()) throw std::invalid_argument("covariance is not finite");
      return out;
    } catch (const std::invalid_argument& e) {
      health_.count(topic + " ignored: " + e.what());
      return std::nullopt;
    }
  }

  void onPrior(const nav_msgs::Odometry::ConstPtr& msg) {
    if (msg->header.frame_id != settings_.world_frame)
      return health_.count("tracked poses ignored: in frame '" + msg->header.frame_id + "', expected '" +
                           settings_.world_frame + "'");
    const auto pose = read(*msg, "tracked pose");
    if (pose && gate_.admit(kPriors, msg->header.stamp)) queue_.addPrediction(*pose);
  }

  void onAttitude(const nav_msgs::Odometry::ConstPtr& msg) {
    const auto pose = read(*msg, "attitude");
    if (pose && gate_.admit(kAttitudes, msg->header.stamp)) queue_.addAttitude(*pose);
  }

  void onStatus(const air_ground::VoStatus::ConstPtr& msg) {
    if (gate_.admit(kStatuses, msg->header.stamp)) queue_.addStatus(*msg);
  }

  // ---- Work ---------------------------------------------------------------------------------------------------------

  void work() {
    if (settings_.display) {
      output_.prepareDisplay(*localizer_);
      health_.state(health_.kWarn, "waiting for images");
    }
    const auto attitudesCome = [this] { return settings_.use_gravity && attitude_.getNumPublishers() > 0; };
    while (const std::optional<Job> job = queue_.next(attitudesCome)) {
      try {
        process(*job);
      } catch (const std::exception& e) {
        health_.count(std::string("images that could not be used: ") + e.what());
      }
    }
  }

  void process(const Job& job) {
    std::string lacking;
    const std::optional<Pose> T_base_camera = mounting_.at(job.image->header.stamp, job.camera_frame, &lacking);
    if (!T_base_camera) health_.count("images without prior and fix: " + lacking);
    PosePrior prior;
    if (T_base_camera) prior = queue_.priorFor(job, *T_base_camera, prior_misses_ < settings_.prior_misses);
    if (std::exchange(pixel_pass_, job.pass) != job.pass) pixel_range_ = ru::PixelRange();  // another camera, maybe
    const cv::Mat image = ru::bgrFromMsg(*pixel_range_.full(job.image));
    const LocalizerResult result = localizer_->localize(image, job.camera, prior);
    prior_misses_ = result.used_prior && !result.accepted() ? prior_misses_ + 1 : 0;
    if (!queue_.isCurrent(job)) return;  // time jumped back meanwhile: this image belongs to the past
    health_.timing("image", result.total_time);
    for (int i = 0; i < kSteps; ++i)
      health_.timing(nameOf(static_cast<Step>(i)), result.times[static_cast<std::size_t>(i)]);
    output_.publish(job, image, T_base_camera, lacking, result, localizer_->database());
  }

  void reset() {
    queue_.reset();
    mounting_.clear();
  }

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    reset();
    response.success = true;
    response.message = "forgot the predicted poses; the database stays";
    return true;
  }

  ros::NodeHandle handle_, private_handle_;
  const NodeSettings settings_;
  const std::string info_topic_;
  ru::NodeHealth health_;
  ru::StreamGate gate_{kStreams, health_, [this] { onTimeJump(); }};  // of the callbacks, which share one thread
  CameraMounting mounting_{settings_};
  ImageQueue queue_{settings_, health_};
  std::unique_ptr<StreetviewLocalizer> localizer_;  // of the worker, as the next four
  OutcomePublisher output_{settings_, health_};
  int prior_misses_ = 0;  // images in a row without a pose near the prediction
  ru::PixelRange pixel_range_;
  unsigned pixel_pass_ = 0;  // of the images that pixel_range_ has seen
  std::optional<ru::ImageInput> image_;
  ros::Subscriber camera_info_, prior_, attitude_, status_;
  ros::ServiceServer reset_;
  std::atomic<bool> failed_{false};
  std::thread worker_;
};

}  // namespace
}  // namespace streetview_localizer

int main(int argc, char** argv) {
  bool failed = false;
  const int status = air_ground_common::ros_utils::runNode<streetview_localizer::NodeSettings>(
      argc, argv, "streetview_localizer", [&](const auto& settings) {
        streetview_localizer::StreetviewLocalizerNode node{ros::NodeHandle(), ros::NodeHandle("~"), settings};
        ros::spin();
        failed = node.failed();
      });
  return failed ? 1 : status;
}
