// RGB-D SLAM of the ground robot: colour, depth and IMU in; odometry, tf and the dense ground map out.
#include <air_ground/SaveMap.h>
#include <air_ground/SaveTrajectory.h>
#include <air_ground/VoStatus.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/pose_publisher.h"
#include "air_ground_common/ros/sensor_input.h"
#include "node_parameters.h"
#include "rgbd_slam/frame_pairer.h"

namespace rgbd_slam {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using visual_frontend::ImuSample;

constexpr int kOk = 0, kWarn = 1;

std::uint8_t stateOf(State state) {
  switch (state) {
    case State::kWaiting:
      return air_ground::VoStatus::STATE_WAITING;
    case State::kInitializing:
      return air_ground::VoStatus::STATE_INITIALIZING;
    case State::kTracking:
      return air_ground::VoStatus::STATE_TRACKING;
    case State::kLost:
      return air_ground::VoStatus::STATE_LOST;
  }
  return air_ground::VoStatus::STATE_LOST;
}

/// Of a clock that never stands still or leaps [s].
double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

std::vector<ros_utils::CloudPoint> messagePoints(const std::vector<CloudPoint>& cloud) {
  std::vector<ros_utils::CloudPoint> points(cloud.size());
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    points[i].position = cloud[i].position;
    points[i].rgb = {cloud[i].bgr[2], cloud[i].bgr[1], cloud[i].bgr[0]};
  }
  return points;
}

class RgbdSlamNode {
 public:
  explicit RgbdSlamNode(const NodeSettings& settings)
      : settings_(settings),
        health_("rgbd_slam"),
        pose_publisher_(handle_, {settings.map_frame, settings.odom_frame, settings.base_frame, "ground/odometry",
                                  "ground/path", settings.publish_tf}),
        pairer_(settings.sync_tolerance, 1.0, ros_utils::kTopicsInStep, settings.queue_size) {
    cloud_publisher_ = handle_.advertise<sensor_msgs::PointCloud2>("ground/map_cloud", 2, true);
    status_publisher_ = handle_.advertise<air_ground::VoStatus>("ground/slam_status", 200);
    keyframe_publisher_ = handle_.advertise<sensor_msgs::Image>("ground/keyframe_image", 5);
    colour_topic_ = handle_.resolveName("ground/rgb/image_raw");
    depth_topic_ = handle_.resolveName("ground/depth/image_raw");
    info_topic_ = handle_.resolveName("ground/rgb/camera_info");
    imu_topic_ = handle_.resolveName("ground/imu/data");
    for (const std::string& topic : {colour_topic_, depth_topic_, info_topic_}) health_.expectInput(topic);
    if (settings_.use_imu) health_.expectInput(imu_topic_);
    health_.state(kWarn, "waiting for images");
    info_subscriber_ = handle_.subscribe("ground/rgb/camera_info", 20, &RgbdSlamNode::onInfo, this);
    if (settings_.use_imu)
      imu_subscriber_ =
          handle_.subscribe("ground/imu/data", 5000, &RgbdSlamNode::onImu, this, ros::TransportHints().tcpNoDelay());
    colour_subscriber_ = handle_.subscribe("ground/rgb/image_raw", settings_.queue_size, &RgbdSlamNode::onColour, this);
    depth_subscriber_ = handle_.subscribe("ground/depth/image_raw", settings_.queue_size, &RgbdSlamNode::onDepth, this);
    map_service_ = private_handle_.advertiseService("save_map", &RgbdSlamNode::saveMap, this);
    trajectory_service_ = private_handle_.advertiseService("save_trajectory", &RgbdSlamNode::saveTrajectory, this);
    reset_service_ = private_handle_.advertiseService("reset", &RgbdSlamNode::reset, this);
    worker_ = std::thread(&RgbdSlamNode::work, this);
    cloud_worker_ = std::thread(&RgbdSlamNode::buildClouds, this);
  }

  ~RgbdSlamNode() {
    {
      const std::scoped_lock lock(queue_mutex_, cloud_mutex_);
      stop_ = true;
    }
    queue_changed_.notify_all();
    cloud_changed_.notify_all();
    worker_.join();
    cloud_worker_.join();
  }

 private:
  enum Stream { kColour, kDepth, kImu, kStreams };

  // ---- Inputs: only checks and queueing happen in the callbacks
  // -------------------------------------------------------

  void onInfo(const sensor_msgs::CameraInfo::ConstPtr& msg) {
    health_.received(info_topic_, msg->header.stamp);
    try {
      const CameraModel camera = ros_utils::fromMsg(*msg);
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      calibration_ = ros_utils::Calibration{camera, *msg};
    } catch (const std::exception& e) {
      health_.count(std::string("camera calibrations refused: ") + e.what());
    }
    queue_changed_.notify_all();
  }

  void onImu(const sensor_msgs::Imu::ConstPtr& msg) {
    health_.received(imu_topic_, msg->header.stamp);
    const auto sample = imu_input_.read(*msg);
    if (!sample) return;
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      if (!gate_.admit(kImu, msg->header.stamp)) return;
      imu_queue_.push_back({sample->stamp, sample->angular_velocity, sample->specific_force});
      if (imu_queue_.size() > 40000) imu_queue_.pop_front();
      newest_imu_ = std::max(newest_imu_, sample->stamp);
      imu_frame_ = msg->header.frame_id;
    }
    queue_changed_.notify_all();
  }

  void onColour(const sensor_msgs::Image::ConstPtr& msg) { onImage(msg, colour_topic_, true); }
  void onDepth(const sensor_msgs::Image::ConstPtr& msg) { onImage(msg, depth_topic_, false); }

  void onImage(const sensor_msgs::Image::ConstPtr& msg, const std::string& topic, bool colour) {
    health_.received(topic, msg->header.stamp);
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      if (!gate_.admit(colour ? kColour : kDepth, msg->header.stamp)) return;
      const double stamp = msg->header.stamp.toSec();
      const std::size_t lost = pairer_.overflow();
      if (colour)
        pairer_.addColour(stamp, msg, now());
      else
        pairer_.addDepth(stamp, msg, now());
      if (pairer_.overflow() > lost) health_.count("images dropped: the queue was full, or out of order");
    }
    queue_changed_.notify_all();
  }

  /// Called with the queue locked.
  void onTimeJump() {
    ROS_WARN("time jumped back: SLAM starts afresh");
    clearQueues();
    reset_requested_ = true;
  }

  void clearQueues() {
    pairer_.clear();
    imu_queue_.clear();
    newest_imu_ = 0;
    reported_unmatched_ = 0;
  }

  // ---- Worker
  // ---------------------------------------------------------------------------------------------------------

  void work() {
    while (true) {
      std::optional<FramePairer<sensor_msgs::Image::ConstPtr>::Pair> pair;
      std::deque<ImuSample> imu;
      bool restart = false;
      {
        std::unique_lock<std::mutex> lock(queue_mutex_);
        queue_changed_.wait_for(lock, std::chrono::milliseconds(300),
                                [&] { return stop_ || reset_requested_ || pairReady(); });
        if (stop_) return;
        restart = reset_requested_;
        reset_requested_ = false;
        reportUnmatched();
        if (!restart && pairReady()) {
          pair = pairer_.take();
          // One sample beyond the image lets the rotation be interpolated up to its stamp.
          while (!imu_queue_.empty() && (imu.empty() || imu.back().stamp < pair->stamp)) {
            imu.push_back(imu_queue_.front());
            imu_queue_.pop_front();
          }
        }
      }
      if (restart) {
        startAfresh(false);
      } else if (pair) {
        try {
          step(*pair, imu);
        } catch (const std::exception& e) {
          health_.count(std::string("images refused: ") + e.what());
        }
      } else {
        const std::lock_guard<std::mutex> lock(slam_mutex_);
        if (cloud_outdated_ && slam_) requestCloud();  // no more images come: show what there is
      }
    }
  }

  /// Called with the queue locked: the oldest pair has its calibration and its IMU samples, or has waited long enough.
  bool pairReady() {
    const auto* pair = pairer_.front(now());
    if (!pair || !calibration_) return false;
    if (!settings_.use_imu || newest_imu_ >= pair->stamp) return true;
    return pairer_.overtaken(pair->stamp, settings_.imu_wait, now());
  }

  /// Called with the queue locked.
  void reportUnmatched() {
    if (pairer_.unmatchedColour() == reported_unmatched_) return;
    health_.count("colour images without a depth image in time", pairer_.unmatchedColour() - reported_unmatched_);
    reported_unmatched_ = pairer_.unmatchedColour();
    if (pairs_ == 0 && reported_unmatched_ >= 30) {
      ROS_WARN_STREAM_THROTTLE(10, "no colour image of "
                                       << colour_topic_ << " has a depth image of " << depth_topic_ << " within "
                                       << settings_.sync_tolerance << " s; the last one missed by "
                                       << pairer_.closestMiss()
                                       << " s: are the drivers synchronised? Parameter sync_tolerance");
    }
  }

  /// `anew`: calibration and mountings are read again, too.
  void startAfresh(bool anew) {
    const std::lock_guard<std::mutex> lock(slam_mutex_);
    if (slam_ && anew)
      dropSlam();
    else if (slam_)
      slam_->reset();
    imu_input_.reset();
    imu_unplaced_ = false;
    if (anew) imu_ever_ = false;
    forgetMap(0);
    last_stamp_ = last_cloud_ = ros::Time();
    health_.state(kWarn, "started afresh: waiting for images");
  }

  /// With slam locked. Map ids go on counting.
  void dropSlam() {
    map_id_offset_ += slam_->mapId();
    slam_.reset();
  }

  /// With slam locked: nothing of another map than `map_id` is published any more, and no cloud of one stays latched.
  void forgetMap(int map_id) {
    pose_publisher_.reset();
    cloud_outdated_ = false;
    const std::lock_guard<std::mutex> lock(cloud_mutex_);
    cloud_map_id_ = map_id;
    cloud_request_.reset();
    if (!cloud_latched_) return;
    cloud_latched_ = false;
    std_msgs::Header header;
    header.stamp = last_stamp_;
    header.frame_id = settings_.map_frame;
    cloud_publisher_.publish(
        ros_utils::toMsg(std::vector<ros_utils::CloudPoint>(), ros_utils::CloudFields::kXyzRgb, header));
  }

  /// Builds SLAM once calibration and mounting are known, and anew when the calibration changes or an IMU turns up.
  /// False, with the reason in diagnostics, while there is none. Waits for tf with nothing locked.
  bool prepare(const sensor_msgs::Image& image, bool imu_seen) {
    ros_utils::Calibration calibration;
    std::string imu_frame = settings_.imu_frame;
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      calibration = *calibration_;
      if (imu_frame.empty()) imu_frame = imu_frame_;
    }
    const bool imu_wanted = settings_.use_imu && imu_seen && !imu_unplaced_;
    bool recalibrated = false;
    {
      const std::lock_guard<std::mutex> lock(slam_mutex_);
      recalibrated = slam_ && ros_utils::recalibrated(built_, calibration, image);
      if (slam_ && !recalibrated && (with_imu_ || !imu_wanted)) return true;
    }
    const std::string camera_frame = ros_utils::cameraFrame(settings_.camera_frame, calibration, image);
    const auto mounted = [&](const std::optional<Pose>& given, const std::string& frame, const char* sensor) {
      return ros_utils::lookupMounting(given, settings_.base_frame, frame, sensor, settings_.transform_timeout,
                                       health_);
    };
    Mounting mounting;
    const auto T_base_camera = mounted(settings_.T_base_camera, camera_frame, "camera");
    if (!T_base_camera) return false;
    mounting.T_base_camera = *T_base_camera;
    if (imu_wanted) {
      const auto T_base_imu = mounted(settings_.T_base_imu, imu_frame, "imu");
      if (T_base_imu) mounting.R_base_imu = T_base_imu->linear();
    }
    const std::lock_guard<std::mutex> lock(slam_mutex_);
    if (imu_wanted && !mounting.R_base_imu) {
      if (!slam_) return false;
      imu_unplaced_ = true;  // the map goes on without it; ~reset asks again
      if (!recalibrated) return true;
    }
    if (slam_) {
      ROS_WARN_STREAM((recalibrated ? "the camera's calibration has changed" : "an IMU has turned up")
                      << ": a new map begins");
      dropSlam();
      forgetMap(0);
    }
    if (settings_.use_imu && !mounting.R_base_imu) {
      ROS_WARN_STREAM(
          "no IMU on " << imu_topic_
                       << ": SLAM runs without rotation prior and takes the robot's base for level at the start");
    }
    slam_ = std::make_unique<Slam>(calibration.camera, mounting, settings_.slam);
    with_imu_ = mounting.R_base_imu.has_value();
    built_ = calibration;
    camera_frame_ = camera_frame;
    return true;
  }

  void step(const FramePairer<sensor_msgs::Image::ConstPtr>::Pair& pair, const std::deque<ImuSample>& imu) {
    const ros::Time stamp = pair.colour->header.stamp;
    ++pairs_;
    imu_ever_ = imu_ever_ || !imu.empty();
    if (!prepare(*pair.colour, imu_ever_)) return;
    const std::lock_guard<std::mutex> lock(slam_mutex_);
    if (!slam_) return;  // reset meanwhile
    if (stamp <= last_stamp_) {
      health_.count("images refused: stamp not later than the last one's");
      return;
    }
    for (const ImuSample& sample : imu)
      if (with_imu_ && !slam_->addImu(sample))
        health_.count("IMU samples refused: stamp not later than the last one's");
    last_stamp_ = stamp;
    const auto begin = std::chrono::steady_clock::now();
    const cv::Mat grey = ros_utils::greyFromMsg(*pair.colour);
    const FrameResult r =
        slam_->process(stamp.toSec(), grey, ros_utils::bgrFromMsg(*pair.colour), ros_utils::depthFromMsg(*pair.depth));
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    health_.timing("frame", seconds);
    if (r.keyframe) health_.timing("keyframe", seconds);
    health_.state(r.state == State::kTracking ? kOk : kWarn,
                  std::string(toString(r.state)) + (r.reason.empty() ? "" : ": " + r.reason) + ", " +
                      std::to_string(r.inliers) + " landmarks in view" +
                      (settings_.use_imu && !with_imu_ ? ", without IMU" : ""));
    if (r.relocalized) ROS_INFO("found the way back into the map");
    if (r.map_corrected) ROS_INFO("the map was corrected as a whole (loop closed, or levelled)");
    publish(stamp, grey, r, seconds);
  }

  // ---- Outputs
  // --------------------------------------------------------------------------------------------------------

  void publish(const ros::Time& stamp, const cv::Mat& grey, const FrameResult& r, double seconds) {
    air_ground::VoStatus status;
    status.header.stamp = stamp;
    status.header.frame_id = settings_.map_frame;
    status.state = stateOf(r.state);
    status.tracked_features = static_cast<std::uint32_t>(r.tracked);
    status.inliers = static_cast<std::uint32_t>(r.inliers);
    status.keyframes = static_cast<std::uint32_t>(slam_->map().keyframeCount());
    status.map_points = static_cast<std::uint32_t>(slam_->map().landmarkCount());
    status.scale = 1.0;
    status.processing_time = seconds;
    status.reason = r.reason;
    status.map_id = static_cast<std::uint32_t>(mapId());
    status_publisher_.publish(status);
    if (r.state != State::kTracking || !r.T_map_base.matrix().allFinite() || !r.covariance.allFinite()) return;

    if (r.new_map) forgetMap(mapId());
    pose_publisher_.publish(stamp, r.T_map_base, {r.T_previous_current_base, r.increment_covariance}, r.covariance);
    if (r.keyframe) {
      cloud_outdated_ = true;
      if (keyframe_publisher_.getNumSubscribers() > 0) {
        std_msgs::Header header;
        header.stamp = stamp;
        header.frame_id = camera_frame_;
        keyframe_publisher_.publish(
            ros_utils::toMsg(visual_frontend::drawTracks(grey, slam_->features(), slam_->mapped()), "bgr8", header));
      }
    }
    if ((cloud_outdated_ && (stamp - last_cloud_).toSec() >= settings_.cloud_interval) || r.map_corrected)
      requestCloud();
  }

  /// With slam locked.
  int mapId() const { return map_id_offset_ + slam_->mapId(); }

  /// With slam locked: hands the points as they stand to the cloud's thread; a request not yet begun is replaced.
  void requestCloud() {
    cloud_outdated_ = false;
    last_cloud_ = last_stamp_;
    {
      const std::lock_guard<std::mutex> lock(cloud_mutex_);
      cloud_request_ = CloudRequest{last_stamp_, mapId(), slam_->posedPoints()};
    }
    cloud_changed_.notify_one();
  }

  void buildClouds() {
    while (true) {
      CloudRequest request;
      {
        std::unique_lock<std::mutex> lock(cloud_mutex_);
        cloud_changed_.wait(lock, [&] { return stop_ || cloud_request_; });
        if (stop_) return;
        request = std::move(*cloud_request_);
        cloud_request_.reset();
      }
      const auto begin = std::chrono::steady_clock::now();
      const std::vector<CloudPoint> cloud = fusePoints(request.points, settings_.slam.cloud);
      std_msgs::Header header;
      header.stamp = request.stamp;
      header.frame_id = settings_.map_frame;
      const auto message = ros_utils::toMsg(messagePoints(cloud), ros_utils::CloudFields::kXyzRgb, header);
      {
        const std::lock_guard<std::mutex> lock(cloud_mutex_);
        if (request.map_id != cloud_map_id_) continue;  // its map was given up meanwhile
        cloud_publisher_.publish(message);
        cloud_latched_ = true;
      }
      health_.timing("ground cloud", std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    }
  }

  // ---- Services
  // -------------------------------------------------------------------------------------------------------

  bool saveMap(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
    return ros_utils::answer(response, [&] {
      std::vector<PosedPoints> points;
      {
        const std::lock_guard<std::mutex> lock(slam_mutex_);
        if (!slam_ || slam_->map().keyframeCount() == 0) throw std::runtime_error("there is no map yet");
        points = slam_->posedPoints();
      }
      const auto cloud = messagePoints(fusePoints(points, settings_.slam.cloud));
      ros_utils::writeCloud(request.path, cloud);
      response.points = cloud.size();
      return std::to_string(cloud.size()) + " points in " + settings_.map_frame + " written to " + request.path;
    });
  }

  bool saveTrajectory(air_ground::SaveTrajectory::Request& request, air_ground::SaveTrajectory::Response& response) {
    return ros_utils::answer(response, [&] {
      air_ground_common::Trajectory trajectory;
      {
        const std::lock_guard<std::mutex> lock(slam_mutex_);
        if (!slam_ || slam_->map().keyframeCount() == 0) throw std::runtime_error("there is no trajectory yet");
        trajectory = slam_->trajectory();
      }
      air_ground_common::writeTum(request.path, trajectory);
      response.poses = trajectory.size();
      return std::to_string(trajectory.size()) + " camera poses in " + settings_.map_frame + " written to " +
             request.path;
    });
  }

  bool reset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      clearQueues();
    }
    startAfresh(true);
    response.success = true;
    response.message = "SLAM starts afresh";
    return true;
  }

  struct CloudRequest {
    ros::Time stamp;
    int map_id;
    std::vector<PosedPoints> points;
  };

  const NodeSettings settings_;
  ros::NodeHandle handle_, private_handle_{"~"};
  ros_utils::NodeHealth health_;
  ros_utils::ImuInput imu_input_{health_};
  ros_utils::PosePublisher pose_publisher_;
  ros::Publisher cloud_publisher_, status_publisher_, keyframe_publisher_;
  ros::Subscriber info_subscriber_, imu_subscriber_, colour_subscriber_, depth_subscriber_;
  ros::ServiceServer map_service_, trajectory_service_, reset_service_;
  std::string colour_topic_, depth_topic_, info_topic_, imu_topic_;

  // Shared with the worker.
  std::mutex queue_mutex_;
  std::condition_variable queue_changed_;
  ros_utils::StreamGate gate_{kStreams, health_, [this] { onTimeJump(); }};
  FramePairer<sensor_msgs::Image::ConstPtr> pairer_;
  std::deque<ImuSample> imu_queue_;
  double newest_imu_ = 0;
  std::size_t reported_unmatched_ = 0;
  std::optional<ros_utils::Calibration> calibration_;
  std::string imu_frame_;
  bool stop_ = false, reset_requested_ = false;

  // Worker and services, one at a time.
  std::mutex slam_mutex_;
  std::unique_ptr<Slam> slam_;
  ros_utils::Calibration built_;  ///< what SLAM was built with
  bool with_imu_ = false;
  int map_id_offset_ = 0;
  std::string camera_frame_;
  ros::Time last_stamp_, last_cloud_;
  bool cloud_outdated_ = false;
  std::atomic<bool> imu_unplaced_{false};  ///< its mounting is not known: the present map does without it
  std::atomic<bool> imu_ever_{false};
  std::size_t pairs_ = 0;  ///< the worker's own

  // Shared with the cloud's thread.
  std::mutex cloud_mutex_;
  std::condition_variable cloud_changed_;
  std::optional<CloudRequest> cloud_request_;
  int cloud_map_id_ = 0;        ///< clouds of another map are dropped; 0: of any
  bool cloud_latched_ = false;  ///< the last one published has points

  std::thread worker_, cloud_worker_;
};

}  // namespace
}  // namespace rgbd_slam

int main(int argc, char** argv) {
  ros::init(argc, argv, "rgbd_slam");
  try {
    const rgbd_slam::NodeSettings settings = rgbd_slam::readParameters(ros::NodeHandle("~"));
    rgbd_slam::RgbdSlamNode node(settings);
    ros::MultiThreadedSpinner(2).spin();  // a service that writes a file does not hold the inputs up
  } catch (const std::exception& e) {
    ROS_FATAL_STREAM(e.what());
    return 1;
  }
  return 0;
}
