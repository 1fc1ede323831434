// Wires the localizer to ROS: the newest image in, pose in the city or a refusal with its reason out. Callbacks only
// store; one thread works.
#include <air_ground/StreetviewMatch.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/image_input.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/stamped_buffer.h"
#include "air_ground_common/text.h"
#include "city_display.h"
#include "match_message.h"
#include "node_parameters.h"
#include "streetview_localizer/localizer.h"

namespace streetview_localizer {
namespace {

namespace ru = air_ground_common::ros_utils;
using air_ground::StreetviewMatch;
using air_ground_common::formatted;

enum Stream : std::size_t { kImages, kPriors, kAttitudes, kStreams };

constexpr double kPosesKept = 10;  // [s]

struct TimedPose {
  double stamp = 0;  ///< [s]
  Pose pose = Pose::Identity();
  Matrix6d covariance = Matrix6d::Identity();
};

class StreetviewLocalizerNode {
 public:
  StreetviewLocalizerNode(ros::NodeHandle handle, ros::NodeHandle private_handle, const NodeSettings& settings)
      : handle_(handle),
        private_handle_(private_handle),
        settings_(settings),
        info_topic_(handle.resolveName("mav/camera/camera_info")),
        health_("streetview_localizer"),
        listener_(tf_) {
    health_.state(1, "reading the database " + settings_.database);
    worker_ = std::thread([this] { run(); });
  }

  ~StreetviewLocalizerNode() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    worker_.join();
  }

  /// The database could not be used; said on the console.
  bool failed() const { return failed_; }

 private:
  struct Job {
    sensor_msgs::Image::ConstPtr image;
    CameraModel camera;
    unsigned pass = 0;
  };

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
    health_.state(1, "preparing the search index over " + std::to_string(database->views.size()) + " views" +
                         (std::filesystem::exists(index) ? ", from " + index
                                                         : ": building it, which takes minutes for a large city"));
    localizer_ = std::make_unique<Localizer>(database, settings_.localizer);
    ROS_INFO("%s", localizer_->indexRemark().c_str());
  }

  // Subscribes last: who waits for the node waits for its subscriptions.
  void listen() {
    match_ = handle_.advertise<StreetviewMatch>("streetview/match", 20);
    pose_ = handle_.advertise<geometry_msgs::PoseWithCovarianceStamped>("streetview/pose", 20);
    match_image_ = handle_.advertise<sensor_msgs::Image>("streetview/match_image", 2);
    synthesized_view_ = handle_.advertise<sensor_msgs::Image>("streetview/synthesized_view", 2);
    display_.advertise(&handle_);
    reset_ = private_handle_.advertiseService("reset", &StreetviewLocalizerNode::onReset, this);
    health_.expectInput(info_topic_);
    health_.state(1, "waiting for images");
    if (settings_.use_prior)
      prior_ = handle_.subscribe("tracked/odometry", 200, &StreetviewLocalizerNode::onPrior, this);
    if (settings_.use_gravity)
      attitude_ = handle_.subscribe("mav/odometry", 400, &StreetviewLocalizerNode::onAttitude, this);
    camera_info_ = handle_.subscribe("mav/camera/camera_info", 20, &StreetviewLocalizerNode::onCameraInfo, this);
    image_.emplace(handle_, "mav/camera/image_raw", settings_.image_transport, false, 3, health_,
                   "the parameter image_transport, or the launch argument mav_image_transport,",
                   [this](const ru::ImageMessage& message) { onImage(message); });
  }

  // ---- Inputs -------------------------------------------------------------------------------------------------------

  void onCameraInfo(const sensor_msgs::CameraInfo::ConstPtr& msg) {
    health_.received(info_topic_, msg->header.stamp);
    try {
      const CameraModel camera = ru::fromMsg(*msg);
      const std::lock_guard<std::mutex> lock(mutex_);
      camera_ = camera;
    } catch (const std::invalid_argument& e) {
      health_.count(std::string("calibration ignored: ") + e.what());
    }
  }

  void onImage(const ru::ImageMessage& message) {
    const ros::Time stamp = message.header().stamp;
    if (!gate_.admit(kImages, stamp)) return;
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!camera_) return health_.count("images without calibration");
    if (!last_started_.isZero() && stamp.toSec() - last_started_.toSec() < settings_.min_period) return;
    sensor_msgs::Image::ConstPtr msg;
    try {
      msg = message.pixels();
    } catch (const std::exception& e) {
      return health_.count(std::string("images that could not be used: ") + e.what());
    }
    if (static_cast<int>(msg->width) != camera_->width || static_cast<int>(msg->height) != camera_->height)
      return health_.count("images of another size than their calibration (" + std::to_string(msg->width) + " x " +
                           std::to_string(msg->height) + " against " + std::to_string(camera_->width) + " x " +
                           std::to_string(camera_->height) + ")");
    if (job_) ++skipped_;
    job_ = Job{msg, *camera_, pass_};
    wake_.notify_all();
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
    if (pose && gate_.admit(kPriors, msg->header.stamp)) {
      const std::lock_guard<std::mutex> lock(mutex_);
      priors_.add(pose->stamp, *pose);
    }
  }

  void onAttitude(const nav_msgs::Odometry::ConstPtr& msg) {
    const auto pose = read(*msg, "attitude");
    if (pose && gate_.admit(kAttitudes, msg->header.stamp)) {
      const std::lock_guard<std::mutex> lock(mutex_);
      attitudes_.add(pose->stamp, *pose);
      wake_.notify_all();
    }
  }

  std::optional<Pose> baseFromCamera(const std::string& frame) {
    if (frame == settings_.base_frame) return Pose::Identity();
    try {
      return ru::fromMsg(tf_.lookupTransform(settings_.base_frame, frame, ros::Time(0)).transform);
    } catch (const std::exception&) {
      return std::nullopt;
    }
  }

  // ---- Work ---------------------------------------------------------------------------------------------------------

  void work() {
    bool display = settings_.display;
    try {
      if (display) {
        display_.prepare(*localizer_, settings_.model_spacing, static_cast<std::size_t>(settings_.model_max_points),
                         settings_.cameras_shown);
        display_.publishCity(settings_.world_frame);
      }
    } catch (const std::exception& e) {
      health_.count(std::string("no display of the city: ") + e.what());
      display = false;
    }
    while (true) {
      std::optional<Job> job;
      std::size_t skipped = 0;
      {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [this] { return stop_ || job_; });
        if (stop_) return;
        job.swap(job_);
        last_started_ = job->image->header.stamp;
        std::swap(skipped, skipped_);
        // The attitude of the image's time may come a little later than the image.
        if (settings_.use_gravity && attitude_.getNumPublishers() > 0)
          wake_.wait_for(lock, std::chrono::duration<double>(settings_.gravity_wait),
                         [&] { return stop_ || attitudes_.newest() >= job->image->header.stamp.toSec(); });
        if (stop_) return;
      }
      if (skipped) health_.count("images skipped for newer ones while one was worked on", skipped);
      try {
        process(*job, display);
      } catch (const std::exception& e) {
        health_.count(std::string("images that could not be used: ") + e.what());
      }
    }
  }

  PosePrior priorOf(const Job& job, const std::optional<Pose>& T_base_camera) {
    PosePrior prior;
    std::optional<TimedPose> predicted, attitude;
    const double stamp = job.image->header.stamp.toSec();
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (const TimedPose* pose = priors_.nearest(stamp, settings_.prior_max_age)) predicted = *pose;
      if (const TimedPose* pose = attitudes_.nearest(stamp, settings_.gravity_max_age)) attitude = *pose;
    }
    if (!T_base_camera) return prior;
    if (predicted && prior_misses_ >= settings_.prior_misses) {
      // A tracker that is sure of a wrong place would keep the search away from the right one for ever.
      health_.count("predictions set aside: no image near them was located, the whole database is searched");
    } else if (predicted) {
      prior.T_world_camera = predicted->pose * *T_base_camera;
      const Eigen::Vector3d lever = predicted->pose.linear() * T_base_camera->translation();
      prior.covariance = covarianceAt(predicted->covariance, lever);
      const double moved = settings_.prior_speed * std::abs(predicted->stamp - stamp);
      prior.covariance.topLeftCorner<3, 3>() += moved * moved * Eigen::Matrix3d::Identity();
      if (Eigen::LLT<Matrix6d>(prior.covariance).info() != Eigen::Success) {
        prior.T_world_camera.reset();
        health_.count("tracked poses ignored: covariance not positive definite");
      }
    }
    if (attitude) {
      prior.up_camera = (attitude->pose.linear() * T_base_camera->linear()).transpose() * Eigen::Vector3d::UnitZ();
      prior.up_stddev = settings_.gravity_stddev;
    }
    return prior;
  }

  void process(const Job& job, bool display) {
    const std::string frame = settings_.camera_frame.empty() ? job.image->header.frame_id : settings_.camera_frame;
    const std::optional<Pose> T_base_camera = baseFromCamera(frame);
    if (!T_base_camera)
      health_.count("images without a transform from " + frame + " to " + settings_.base_frame + ": no prior, no fix");
    const cv::Mat image = ru::bgrFromMsg(*job.image);
    const LocalizerResult result = localizer_->localize(image, job.camera, priorOf(job, T_base_camera));
    prior_misses_ = result.used_prior && !result.accepted() ? prior_misses_ + 1 : 0;
    {
      // Time jumped back meanwhile: this image belongs to the past.
      const std::lock_guard<std::mutex> lock(mutex_);
      if (job.pass != pass_) return;
    }
    health_.timing("image", result.total_time);
    for (int i = 0; i < kSteps; ++i)
      health_.timing(nameOf(static_cast<Step>(i)), result.times[static_cast<std::size_t>(i)]);
    ++(result.accepted() ? accepted_ : refused_);
    publishMatch(job, frame, result);
    if (result.accepted() && T_base_camera) publishFix(job, result, *T_base_camera);
    tell(job, result);
    if (!display) return;
    if (match_image_.getNumSubscribers() > 0)
      match_image_.publish(
          ru::toMsg(display_.matchImage(image, result, settings_.display_width), "bgr8", job.image->header));
    if (result.accepted() && synthesized_view_.getNumSubscribers() > 0)
      synthesized_view_.publish(ru::toMsg(display_.besideModel(image, job.camera, result, settings_.display_width),
                                          "bgr8", job.image->header));
    if (result.accepted())
      display_.addCamera(job.camera, result.pose.T_world_camera, job.image->header.stamp, settings_.world_frame);
  }

  void publishMatch(const Job& job, const std::string& frame, const LocalizerResult& r) {
    StreetviewMatch msg = matchMessage(r, localizer_->database());
    msg.header.stamp = job.image->header.stamp;
    msg.header.frame_id = settings_.world_frame;
    msg.camera_frame = frame;
    match_.publish(msg);
  }

  void publishFix(const Job& job, const LocalizerResult& r, const Pose& T_base_camera) {
    const Pose T_world_base = r.pose.T_world_camera * T_base_camera.inverse();
    const Matrix6d covariance =
        covarianceAt(r.pose.covariance, T_world_base.translation() - r.pose.T_world_camera.translation());
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

  void tell(const Job& job, const LocalizerResult& r) {
    const std::string tally =
        "; " + std::to_string(accepted_) + " images located, " + std::to_string(refused_) + " not";
    if (r.accepted()) {
      const Eigen::Vector3d stddev = r.pose.covariance.diagonal().head<3>().cwiseSqrt();
      health_.state(
          0, formatted("located from %s: %zu inliers, score %.3f, %.2f %.2f %.2f m (1 sigma), in %.2f s",
                       localizer_->database().panoramas[static_cast<std::size_t>(r.panorama)].id.c_str(),
                       r.pose.inliers.size(), r.acceptance.score, stddev.x(), stddev.y(), stddev.z(), r.total_time) +
                 tally);
      return;
    }
    std::string state = formatted("last image %s: %s", nameOf(r.status), r.reason.c_str()) + tally;
    if (!last_fix_.isZero())
      state +=
          "; last fix " + std::to_string(std::lround(job.image->header.stamp.toSec() - last_fix_.toSec())) + " s ago";
    health_.state(1, state);
  }

  void reset() {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++pass_;
    job_.reset();
    priors_.clear();
    attitudes_.clear();
    last_started_ = ros::Time();
    tf_.clear();  // of moving edges; fixed ones stay
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
  tf2_ros::Buffer tf_;
  tf2_ros::TransformListener listener_;
  std::unique_ptr<Localizer> localizer_;
  CityDisplay display_;
  ros::Publisher match_, pose_, match_image_, synthesized_view_;
  std::optional<ru::ImageInput> image_;
  ros::Subscriber camera_info_, prior_, attitude_;
  ros::ServiceServer reset_;
  ros::Time last_fix_;  // of the worker, as are the tallies
  std::size_t accepted_ = 0, refused_ = 0;
  int prior_misses_ = 0;  // images in a row without a pose near the prediction

  std::mutex mutex_;  // guards what follows
  std::condition_variable wake_;
  bool stop_ = false;
  std::atomic<bool> failed_{false};
  unsigned pass_ = 0;
  std::size_t skipped_ = 0;
  std::optional<CameraModel> camera_;
  std::optional<Job> job_;
  ros::Time last_started_;
  air_ground_common::StampedBuffer<TimedPose> priors_{kPosesKept}, attitudes_{kPosesKept};
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
