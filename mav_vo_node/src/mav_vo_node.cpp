// Visual odometry of the MAV: images and IMU in, metric poses, posed images, increments and the sparse map out.
#include <air_ground/PosedImage.h>
#include <air_ground/SaveMap.h>
#include <air_ground/SaveTrajectory.h>
#include <air_ground/VoIncrement.h>
#include <air_ground/VoStatus.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <std_srvs/Trigger.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/pose_publisher.h"
#include "air_ground_common/ros/sensor_input.h"
#include "node_parameters.h"
#include "visual_frontend/feature_tracker.h"

namespace mav_vo {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using Clock = std::chrono::steady_clock;

constexpr int kOk = 0, kWarn = 1;

std::uint8_t stateOf(OdometryState state) {
  switch (state) {
    case OdometryState::kWaiting:
      return air_ground::VoStatus::STATE_WAITING;
    case OdometryState::kInitializing:
      return air_ground::VoStatus::STATE_INITIALIZING;
    case OdometryState::kScaling:
      return air_ground::VoStatus::STATE_SCALING;
    case OdometryState::kTracking:
      return air_ground::VoStatus::STATE_TRACKING;
    case OdometryState::kLost:
      return air_ground::VoStatus::STATE_LOST;
  }
  return air_ground::VoStatus::STATE_LOST;
}

/// The increment's image noise; roll and pitch, which its covariance leaves out, taken like the heading.
ros_utils::Motion motionOf(const FrameResult& r) {
  ros_utils::Motion motion;
  if (!r.increment) return motion;
  motion.T_previous_current = r.increment->T_previous_current;
  const Eigen::Matrix4d& c = r.increment->pose_covariance;
  Matrix6d& covariance = motion.covariance.emplace(Matrix6d::Zero());
  covariance.topLeftCorner<3, 3>() = c.topLeftCorner<3, 3>();
  covariance.block<3, 1>(0, 5) = c.topRightCorner<3, 1>();
  covariance.block<1, 3>(5, 0) = c.bottomLeftCorner<1, 3>();
  covariance.diagonal().tail<3>().setConstant(c(3, 3));
  return motion;
}

class MavVoNode {
 public:
  explicit MavVoNode(const NodeSettings& settings)
      : settings_(settings),
        health_("mav_vo"),
        pose_publisher_(handle_, {settings.map_frame, settings.odom_frame, settings.base_frame, "mav/odometry",
                                  "mav/path", settings.publish_tf}) {
    cloud_publisher_ = handle_.advertise<sensor_msgs::PointCloud2>("mav/sparse_cloud", 5);
    posed_publisher_ = handle_.advertise<air_ground::PosedImage>("mav/posed_image", 100);
    increment_publisher_ = handle_.advertise<air_ground::VoIncrement>("mav/vo_increment", 100);
    status_publisher_ = handle_.advertise<air_ground::VoStatus>("mav/vo_status", 100);
    track_publisher_ = handle_.advertise<sensor_msgs::Image>("mav/track_image", 5);
    image_topic_ = handle_.resolveName("mav/camera/image_raw");
    info_topic_ = handle_.resolveName("mav/camera/camera_info");
    imu_topic_ = handle_.resolveName("mav/imu/data");
    health_.expectInput(image_topic_);
    health_.expectInput(info_topic_);
    if (settings_.odometry.use_imu) health_.expectInput(imu_topic_);
    health_.state(kWarn, "waiting for images");
    info_subscriber_ = handle_.subscribe("mav/camera/camera_info", 20, &MavVoNode::onInfo, this);
    if (settings_.odometry.use_imu)
      imu_subscriber_ =
          handle_.subscribe("mav/imu/data", 5000, &MavVoNode::onImu, this, ros::TransportHints().tcpNoDelay());
    image_subscriber_ = handle_.subscribe("mav/camera/image_raw", settings_.queue_size, &MavVoNode::onImage, this);
    map_service_ = private_handle_.advertiseService("save_map", &MavVoNode::saveMap, this);
    trajectory_service_ = private_handle_.advertiseService("save_trajectory", &MavVoNode::saveTrajectory, this);
    reset_service_ = private_handle_.advertiseService("reset", &MavVoNode::reset, this);
    worker_ = std::thread(&MavVoNode::work, this);
  }

  ~MavVoNode() {
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      stop_ = true;
    }
    queue_changed_.notify_all();
    worker_.join();
  }

 private:
  enum Stream { kImage, kImu, kStreams };
  struct WaitingImage {
    sensor_msgs::Image::ConstPtr image;
    Clock::time_point arrival;
  };

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
      if (imu_queue_.size() > 20000) imu_queue_.pop_front();
      newest_imu_ = std::max(newest_imu_, sample->stamp);
      imu_frame_ = msg->header.frame_id;
    }
    queue_changed_.notify_all();
  }

  void onImage(const sensor_msgs::Image::ConstPtr& msg) {
    health_.received(image_topic_, msg->header.stamp);
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      if (!gate_.admit(kImage, msg->header.stamp)) return;
      if (image_queue_.size() >= static_cast<std::size_t>(settings_.queue_size)) {
        image_queue_.pop_front();
        health_.count("images dropped: the queue was full");
      }
      image_queue_.push_back({msg, Clock::now()});
    }
    queue_changed_.notify_all();
  }

  /// Called with the queue locked.
  void onTimeJump() {
    ROS_WARN("time jumped back: visual odometry starts afresh");
    newest_imu_ = 0;
    image_queue_.clear();
    imu_queue_.clear();
    reset_requested_ = true;
  }

  // ---- Worker
  // ---------------------------------------------------------------------------------------------------------

  void work() {
    while (true) {
      sensor_msgs::Image::ConstPtr image;
      std::deque<ImuSample> imu;
      {
        std::unique_lock<std::mutex> lock(queue_mutex_);
        queue_changed_.wait_for(lock, std::chrono::milliseconds(200),
                                [&] { return stop_ || reset_requested_ || imageReady(); });
        if (stop_) return;
        if (reset_requested_) {
          reset_requested_ = false;
          lock.unlock();
          startAfresh(false);
          continue;
        }
        if (!imageReady()) continue;
        image = image_queue_.front().image;
        image_queue_.pop_front();
        const double stamp = image->header.stamp.toSec();
        // One sample beyond the image lets the motion be interpolated up to its stamp.
        while (!imu_queue_.empty() && (imu.empty() || imu.back().stamp < stamp)) {
          imu.push_back(imu_queue_.front());
          imu_queue_.pop_front();
        }
      }
      try {
        step(image, imu);
      } catch (const std::exception& e) {
        health_.count(std::string("images refused: ") + e.what());
      }
    }
  }

  /// Called with the queue locked: the oldest image has its calibration and its IMU samples, or has waited long enough
  /// for them.
  bool imageReady() const {
    if (image_queue_.empty() || !calibration_) return false;
    if (!settings_.odometry.use_imu) return true;
    const double stamp = image_queue_.front().image->header.stamp.toSec();
    if (newest_imu_ >= stamp) return true;
    const auto newer = std::find_if(image_queue_.begin(), image_queue_.end(), [&](const WaitingImage& waiting) {
      return waiting.image->header.stamp.toSec() - stamp > settings_.imu_wait;
    });
    return newer != image_queue_.end() &&
           Clock::now() - newer->arrival > std::chrono::duration<double>(ros_utils::kTopicsInStep);
  }

  /// `anew`: calibration and mountings are read again, too.
  void startAfresh(bool anew) {
    const std::lock_guard<std::mutex> lock(odometry_mutex_);
    if (odometry_ && anew)
      dropOdometry();
    else if (odometry_)
      odometry_->reset();
    imu_input_.reset();
    imu_unplaced_ = false;
    if (anew) imu_ever_ = false;
    pose_publisher_.reset();
    last_stamp_ = ros::Time();
    last_cloud_ = ros::Time();
    health_.state(kWarn, "started afresh: waiting for images");
  }

  /// With the odometry locked. Map ids go on counting.
  void dropOdometry() {
    map_id_offset_ += odometry_->mapId();
    odometry_.reset();
  }

  /// Builds the odometry once calibration and mounting are known, and anew when the calibration changes or an IMU turns
  /// up. False, with the reason in diagnostics, while there is none. Waits for tf with nothing locked.
  bool prepare(const sensor_msgs::Image& image, bool imu_seen) {
    ros_utils::Calibration calibration;
    std::string imu_frame = settings_.imu_frame;
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      calibration = *calibration_;
      if (imu_frame.empty()) imu_frame = imu_frame_;
    }
    const bool imu_wanted = settings_.odometry.use_imu && imu_seen && !imu_unplaced_;
    bool recalibrated = false;
    {
      const std::lock_guard<std::mutex> lock(odometry_mutex_);
      recalibrated = odometry_ && ros_utils::recalibrated(built_, calibration, image);
      if (odometry_ && !recalibrated && (with_imu_ || !imu_wanted)) return true;
    }
    const std::string camera_frame = ros_utils::cameraFrame(settings_.camera_frame, calibration, image);
    const auto mounted = [&](const std::optional<Pose>& given, const std::string& frame, const char* sensor) {
      return ros_utils::lookupMounting(given, settings_.base_frame, frame, sensor, settings_.transform_timeout,
                                       health_);
    };
    const auto T_base_camera = mounted(settings_.T_base_camera, camera_frame, "camera");
    if (!T_base_camera) return false;
    std::optional<Pose> T_base_imu;
    if (imu_wanted) T_base_imu = mounted(settings_.T_base_imu, imu_frame, "imu");
    const std::lock_guard<std::mutex> lock(odometry_mutex_);
    if (imu_wanted && !T_base_imu) {
      if (!odometry_) return false;
      imu_unplaced_ = true;  // the map goes on without it; ~reset asks again
      if (!recalibrated) return true;
    }
    if (odometry_) {
      ROS_WARN_STREAM((recalibrated ? "the camera's calibration has changed" : "an IMU has turned up")
                      << ": a new map begins");
      dropOdometry();
    }
    OdometrySettings settings = settings_.odometry;
    settings.use_imu = T_base_imu.has_value();
    if (settings_.odometry.use_imu && !settings.use_imu) {
      ROS_WARN_STREAM("no IMU on " << imu_topic_
                                   << ": visual odometry runs without gyro prior and stays without metric scale");
    }
    odometry_ =
        std::make_unique<Odometry>(calibration.camera, *T_base_camera, T_base_imu.value_or(Pose::Identity()), settings);
    with_imu_ = settings.use_imu;
    built_ = calibration;
    camera_frame_ = camera_frame;
    return true;
  }

  void step(const sensor_msgs::Image::ConstPtr& image, const std::deque<ImuSample>& imu) {
    const ros::Time stamp = image->header.stamp;
    imu_ever_ = imu_ever_ || !imu.empty();
    if (!prepare(*image, imu_ever_)) return;
    const std::lock_guard<std::mutex> lock(odometry_mutex_);
    if (!odometry_) return;  // reset meanwhile
    if (stamp <= last_stamp_) {
      health_.count("images refused: stamp not later than the last one's");
      return;
    }
    for (const ImuSample& sample : imu)
      if (with_imu_ && !odometry_->addImu(sample))
        health_.count("IMU samples refused: stamp not later than the last one's");
    odometry_->setImuProblem(imu_input_.problem());
    last_stamp_ = stamp;
    const cv::Mat grey = ros_utils::greyFromMsg(*image);
    FrameResult r = odometry_->process(stamp.toSec(), grey);
    r.map_id += map_id_offset_;
    health_.timing("image [s]", r.seconds);
    health_.state(r.state == OdometryState::kTracking ? kOk : kWarn,
                  std::string(toString(r.state)) + (r.reason.empty() ? "" : ": " + r.reason) + ", " +
                      std::to_string(r.inliers) + " landmarks in view" +
                      (settings_.odometry.use_imu && !with_imu_ ? ", without IMU" : ""));
    publish(image, grey, r);
  }

  // ---- Outputs
  // --------------------------------------------------------------------------------------------------------

  void publish(const sensor_msgs::Image::ConstPtr& image, const cv::Mat& grey, const FrameResult& r) {
    std_msgs::Header header;
    header.stamp = image->header.stamp;
    header.frame_id = settings_.map_frame;
    publishStatus(header, r);
    if (track_publisher_.getNumSubscribers() > 0 && frame_count_++ % settings_.track_image_every == 0) {
      std_msgs::Header camera_header = header;
      camera_header.frame_id = camera_frame_;
      track_publisher_.publish(
          ros_utils::toMsg(visual_frontend::drawTracks(grey, odometry_->features(), odometry_->mappedFeatures()),
                           "bgr8", camera_header));
    }
    if (!r.pose_valid || !r.T_map_base.matrix().allFinite() || !r.covariance.allFinite()) return;
    if (r.map_id != map_id_) {
      if (map_id_ != 0) pose_publisher_.reset();
      map_id_ = r.map_id;
    }
    // Odometry and tf have no flag that says "not metric": they begin with the metric map.
    if (r.metric) pose_publisher_.publish(header.stamp, r.T_map_base, motionOf(r), r.covariance);
    air_ground::PosedImage posed;
    posed.header = header;
    posed.image = *image;
    posed.camera_info = built_.info;
    posed.camera_info.header.stamp = header.stamp;
    posed.camera_info.header.frame_id = camera_frame_;
    posed.pose.pose = ros_utils::toMsg(r.T_map_camera);
    ros_utils::setCovariance(r.camera_covariance, &posed.pose.covariance);
    posed.depth_min = static_cast<float>(r.depth_min);
    posed.depth_max = static_cast<float>(r.depth_max);
    posed.keyframe = r.keyframe;
    posed.metric = r.metric;
    posed.map_id = r.map_id;
    posed_publisher_.publish(posed);
    if (r.increment) publishIncrement(header, r);
    if (r.metric && r.keyframe && (header.stamp - last_cloud_).toSec() >= settings_.sparse_cloud_interval) {
      last_cloud_ = header.stamp;
      cloud_publisher_.publish(ros_utils::toMsg(sparsePoints(), ros_utils::CloudFields::kXyz, header));
    }
  }

  void publishStatus(const std_msgs::Header& header, const FrameResult& r) {
    air_ground::VoStatus status;
    status.header = header;
    status.state = stateOf(r.state);
    status.tracked_features = static_cast<std::uint32_t>(r.tracked);
    status.inliers = static_cast<std::uint32_t>(r.inliers);
    status.keyframes = static_cast<std::uint32_t>(r.keyframes);
    status.map_points = static_cast<std::uint32_t>(r.landmarks);
    status.scale = r.scale;
    status.scale_stddev = r.scale_stddev;
    status.processing_time = r.seconds;
    status.reason = r.reason;
    status.map_id = r.map_id;
    status_publisher_.publish(status);
  }

  void publishIncrement(const std_msgs::Header& header, const FrameResult& r) {
    air_ground::VoIncrement increment;
    increment.header = header;
    increment.previous_stamp = ros::Time(r.increment->previous_stamp);
    increment.relative_pose = ros_utils::toMsg(r.increment->T_previous_current);
    for (int row = 0; row < 4; ++row)
      for (int column = 0; column < 4; ++column)
        increment.covariance[4 * row + column] = r.increment->covariance(row, column);
    increment.metric = r.metric;
    increment.scale_variance = r.metric ? r.scale_stddev * r.scale_stddev : 0.0;
    increment.inliers = static_cast<std::uint32_t>(r.inliers);
    increment.map_id = r.map_id;
    increment_publisher_.publish(increment);
  }

  std::vector<ros_utils::CloudPoint> sparsePoints() const {
    std::vector<ros_utils::CloudPoint> points;
    for (const auto id : odometry_->map().landmarkIds()) {
      ros_utils::CloudPoint point;
      point.position = odometry_->map().landmark(id).position.cast<float>();
      point.source = 1;
      if (point.position.allFinite()) points.push_back(point);
    }
    return points;
  }

  // ---- Services
  // -------------------------------------------------------------------------------------------------------

  bool saveMap(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
    return ros_utils::answer(response, [&] {
      std::vector<ros_utils::CloudPoint> points;
      {
        const std::lock_guard<std::mutex> lock(odometry_mutex_);
        if (!odometry_ || !odometry_->metric()) throw std::runtime_error("there is no metric map yet");
        odometry_->finish();
        points = sparsePoints();
      }
      for (auto& p : points) p.rgb.setConstant(200);
      ros_utils::writeCloud(request.path, points);
      response.points = points.size();
      return std::to_string(points.size()) + " landmarks written to " + request.path;
    });
  }

  bool saveTrajectory(air_ground::SaveTrajectory::Request& request, air_ground::SaveTrajectory::Response& response) {
    return ros_utils::answer(response, [&] {
      air_ground_common::Trajectory trajectory;
      {
        const std::lock_guard<std::mutex> lock(odometry_mutex_);
        if (!odometry_ || !odometry_->metric()) throw std::runtime_error("there is no metric trajectory yet");
        odometry_->finish();
        trajectory = odometry_->trajectory();
      }
      air_ground_common::writeTum(request.path, trajectory);
      response.poses = trajectory.size();
      return std::to_string(trajectory.size()) + " camera poses in " + settings_.map_frame + " written to " +
             request.path;
    });
  }

  bool reset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    startAfresh(true);
    response.success = true;
    response.message = "visual odometry starts afresh";
    return true;
  }

  const NodeSettings settings_;
  ros::NodeHandle handle_, private_handle_{"~"};
  ros_utils::NodeHealth health_;
  ros_utils::ImuInput imu_input_{health_};
  ros_utils::PosePublisher pose_publisher_;
  ros::Publisher cloud_publisher_, posed_publisher_, increment_publisher_, status_publisher_, track_publisher_;
  ros::Subscriber info_subscriber_, imu_subscriber_, image_subscriber_;
  ros::ServiceServer map_service_, trajectory_service_, reset_service_;
  std::string image_topic_, info_topic_, imu_topic_;

  // Shared with the worker.
  std::mutex queue_mutex_;
  std::condition_variable queue_changed_;
  ros_utils::StreamGate gate_{kStreams, health_, [this] { onTimeJump(); }};
  std::deque<WaitingImage> image_queue_;
  std::deque<ImuSample> imu_queue_;
  double newest_imu_ = 0;
  std::optional<ros_utils::Calibration> calibration_;
  std::string imu_frame_;
  bool stop_ = false, reset_requested_ = false;

  // Worker and services, one at a time.
  std::mutex odometry_mutex_;
  std::unique_ptr<Odometry> odometry_;
  ros_utils::Calibration built_;  ///< what the odometry was built with
  bool with_imu_ = false;
  std::string camera_frame_;
  ros::Time last_stamp_, last_cloud_;
  std::uint32_t map_id_ = 0, map_id_offset_ = 0;
  std::size_t frame_count_ = 0;
  std::atomic<bool> imu_unplaced_{false};  ///< its mounting is not known: the present map does without it
  std::atomic<bool> imu_ever_{false};
  std::thread worker_;
};

}  // namespace
}  // namespace mav_vo

int main(int argc, char** argv) {
  ros::init(argc, argv, "mav_vo");
  try {
    const mav_vo::NodeSettings settings = mav_vo::readParameters(ros::NodeHandle("~"));
    mav_vo::MavVoNode node(settings);
    ros::MultiThreadedSpinner(2).spin();  // a service that writes a file does not hold the inputs up
  } catch (const std::exception& e) {
    ROS_FATAL_STREAM(e.what());
    return 1;
  }
  return 0;
}
