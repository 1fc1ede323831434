// RGB-D SLAM of the ground robot: colour, depth and IMU in; odometry, tf and the dense ground map out.
#include <air_ground/VoStatus.h>
#include <ros/ros.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <limits>
#include <memory>
#include <stdexcept>

#include "../map_pacer.h"
#include "air_ground_common/ros/calibration_report.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/estimator_shell.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/pose_publisher.h"
#include "air_ground_common/ros/vertical_message.h"
#include "air_ground_common/text.h"
#include "cloud_publisher.h"
#include "depth_input.h"
#include "ended_maps.h"
#include "keyframe_publisher.h"
#include "node_parameters.h"

namespace rgbd_slam {
namespace {

namespace ros_utils = air_ground_common::ros_utils;

constexpr double kEnded = 1.0;  // without images, after which a recording is over, or is held [s, wall clock]

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

/// What a user can do about SLAM that is in this state.
std::string adviceFor(State state) {
  switch (state) {
    case State::kWaiting:
    case State::kInitializing:
      return "let the camera see textured surfaces within the range of its depth";
    case State::kLost:
      return "drive back to where the robot has been; among other places a new map begins after restart_after";
    default:
      return "";
  }
}

ros_utils::EstimatorNames names() {
  ros_utils::EstimatorNames names;
  names.image = "ground/rgb/image_raw";
  names.camera_info = "ground/rgb/camera_info";
  names.imu = "ground/imu/data";
  names.status = "ground/slam_status";
  names.depth = "ground/depth/image_raw";
  names.node = "rgbd_slam";
  names.subject = "SLAM";
  names.transport_argument = "ground_image_transport";
  names.depth_transport_argument = "ground_depth_transport";
  names.without_imu = "runs without rotation prior, and levels the map by what lies flat in it";
  return names;
}

class RgbdSlamNode : private ros_utils::Estimator {
 public:
  explicit RgbdSlamNode(const NodeSettings& settings)
      : settings_(settings),
        frames_(settings_.estimator),
        shell_(handle_, settings.estimator, names(), *this),
        pose_publisher_(handle_, ros_utils::poseOutput(frames_, "ground/odometry", "ground/path"), shell_.health()),
        depth_(handle_, "ground/depth/image_raw", "ground/depth/camera_info", settings_.depth, shell_.mountings(),
               shell_.health()),
        clouds_(handle_, "ground/map_cloud", frames_.map_frame, settings_.slam.cloud, shell_.health()),
        keyframes_(handle_, "ground/map_keyframes", frames_.map_frame) {
    keyframe_publisher_ = handle_.advertise<sensor_msgs::Image>("ground/keyframe_image", 5);
    shell_.start();
  }
  ~RgbdSlamNode() override {
    ends_ = true;
    shell_.stop();
  }

 private:
  bool exists() const override { return slam_ != nullptr; }

  void make(const CameraModel& camera, const Pose& T_base_camera, const std::optional<Pose>& T_base_imu) override {
    Mounting mounting;
    mounting.T_base_camera = T_base_camera;
    if (T_base_imu) {
      mounting.R_base_imu = T_base_imu->linear();
      mounting.p_base_imu = T_base_imu->translation();
    }
    SlamSettings settings = settings_.slam;
    settings.reproducible = settings_.estimator.player_waits;
    slam_ = std::make_unique<Slam>(camera, mounting, settings);
    depth_.setColourCamera(camera, T_base_camera);
    calibration_.setGiven(camera.k1);
  }

  void forgetMap() override {
    beginMap(0);
    last_stamp_ = ros::Time();
  }

  /// A user wants to begin afresh, or a recording begins again.
  void forgetOdometry() override {
    pose_publisher_.reset();
    ended_.forget();
  }

  void keep() override {
    slam_->finish();
    ended_.add(shell_.mapId(), slam_->asEnded());
  }

  void drop() override { slam_.reset(); }
  void reset() override { slam_->reset(); }

  std::uint32_t mapId() const override { return slam_ ? static_cast<std::uint32_t>(slam_->mapId()) : 0; }

  bool addImu(const ros_utils::ImuInput::Sample& sample) override {
    return slam_->addImu({sample.stamp, sample.angular_velocity, sample.specific_force});
  }

  double imuLead() const override {
    const double readout_time = slam_ ? slam_->readoutTime() : settings_.slam.readout_time;
    return settings_.slam.time_offset + 0.5 * std::abs(readout_time);
  }

  /// Nothing of another map than `map_id` is published any more, and no cloud of one stays latched.
  void beginMap(std::uint32_t map_id) {
    map_id_ = map_id;
    pose_publisher_.beginMap();
    cloud_pacer_.restart();
    keyframe_pacer_.restart();
    clouds_.beginMap(map_id, last_stamp_);
  }

  ros_utils::EstimatorResult process(const ros_utils::EstimatorFrame& frame) override {
    serveKeyframes();
    const auto begin = last_frame_ = std::chrono::steady_clock::now();
    last_stamp_ = frame.stamp;
    ros_utils::EstimatorResult result;
    air_ground::VoStatus& status = result.status;
    status.map_revision = map_revision_;  // of a refused frame, too: another figure tells of a correction
    const auto depth = depth_.read(*frame.depth, shell_.cameraFrame(), &status.reason);
    if (!depth) {
      status.state = air_ground::VoStatus::STATE_WAITING;
      return result;
    }
    const cv::Mat grey = ros_utils::greyFromMsg(*frame.image);
    noteDelay(frame);
    const SlamResult r =
        slam_->process(frame.stamp.toSec(), grey, ros_utils::bgrFromMsg(*frame.image), *depth, depth_delay_);
    shell_.health().value("depth images carried to their colour image's time", slam_->counters().depth_carried);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    shell_.health().timing("frame", seconds);
    if (r.keyframe) shell_.health().timing("keyframe", seconds);
    if (r.relocalized) ROS_INFO_THROTTLE(10, "found the way back into the map");
    if (r.map_corrected)
      ROS_INFO("the map was corrected as a whole (loop closed, adjusted, levelled, readout time or distortion found)");
    tellReadoutTime();
    calibration_.update(slam_->camera().k1);
    if (r.recalibrated) keyframes_.resendAll();
    if (r.ended) ended_.add(shell_.mapId(), *r.ended);
    status.state = stateOf(r.state);
    status.tracked_features = static_cast<std::uint32_t>(r.tracked);
    status.inliers = static_cast<std::uint32_t>(r.inliers);
    status.keyframes = static_cast<std::uint32_t>(slam_->map().keyframeCount());
    status.map_points = static_cast<std::uint32_t>(slam_->map().landmarkCount());
    noteMap(r);
    map_revision_ += r.map_corrected;
    status.map_revision = map_revision_;
    status.scale = 1.0;
    if (slam_->gravityKnown() || slam_->levelBySurfaces()) ros_utils::setVertical(slam_->vertical(), &status);
    status.processing_time = seconds;
    status.reason = r.reason;
    if (r.by_depth) tellByDepth(r.inliers, status.reason);
    if (!r.imu_problem.empty()) tellImuProblem(r.imu_problem, status.reason);
    result.advice = adviceFor(r.state);
    result.pose_published =
        r.state == State::kTracking && r.T_map_base.matrix().allFinite() && r.covariance.allFinite();
    result.publish = [this, stamp = frame.stamp, grey, r, pose = result.pose_published] {
      if (pose) publish(stamp, grey, r);
      publishMapWhenDue(stamp.toSec());
    };
    return result;
  }

  /// Of frames whose poses are not published, too.
  void noteMap(const SlamResult& r) {
    if (slam_->map().keyframeCount() > 0 && shell_.mapId() != map_id_) beginMap(shell_.mapId());
    if (r.keyframe || r.map_corrected || r.points_gone) cloud_pacer_.changed(r.map_corrected);
    if (r.keyframe || r.map_corrected) keyframe_pacer_.changed(r.map_corrected);
  }

  void noteDelay(const ros_utils::EstimatorFrame& frame) {
    const double delay = frame.depth->header.stamp.toSec() - frame.stamp.toSec();
    shell_.health().value("depth images after their colour images by [ms]", 1e3 * delay);
    if (std::abs(delay) >= kLongestDepthDelay)
      shell_.health().count("depth images stamped far from their colour images (sync_tolerance): taken as they are");
    depth_delay_ = settings_.use_depth_stamps && std::abs(delay) < kLongestDepthDelay ? delay : 0;
  }

  void tellReadoutTime() {
    if (std::abs(slam_->readoutTime() - told_readout_time_) < 1e-6) return;
    told_readout_time_ = slam_->readoutTime();
    ROS_INFO("rolling shutter: an image is read in %.1f ms; what each row saw is moved accordingly",
             1e3 * told_readout_time_);
  }

  void tellByDepth(int landmarks, std::string& reason) {
    reason = air_ground_common::formatted(
        "by depth alone: only %d landmarks agree (dark or without texture); the surfaces in view give the pose",
        landmarks);
    shell_.health().count("frames by depth alone");
    ROS_WARN_STREAM_THROTTLE(30, "SLAM goes on " << reason);
  }

  void tellImuProblem(const std::string& problem, std::string& reason) {
    if (!imu_problem_told_) ROS_WARN_STREAM(problem << ". The map goes on without it for as long as that lasts");
    imu_problem_told_ = true;
    shell_.health().count(problem);
    if (reason.empty()) reason = problem;
  }

  void publish(const ros::Time& stamp, const cv::Mat& grey, const SlamResult& r) {
    pose_publisher_.publish(stamp, r.T_map_base, {r.T_previous_current_base, r.increment_covariance}, r.covariance);
    if (r.keyframe && keyframe_publisher_.getNumSubscribers() > 0) {
      std_msgs::Header header;
      header.stamp = stamp;
      header.frame_id = shell_.cameraFrame();
      keyframe_publisher_.publish(
          ros_utils::toMsg(visual_frontend::drawTracks(grey, slam_->features(), slam_->mapped()), "bgr8", header));
    }
  }

  /// No images come: time goes on all the same, but that of a recording has ended.
  void idle() override {
    serveKeyframes();
    if (ros::Time::isSimTime() && silence() > kEnded) cloud_pacer_.hurry();
    publishMapWhenDue(last_stamp_.toSec() + silence());
  }

  /// Since the last image [s, wall clock].
  double silence() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - last_frame_).count();
  }

  void publishMapWhenDue(double now) {
    if (slam_->map().keyframeCount() == 0) return;
    if (keyframe_pacer_.due(now, 0)) {
      keyframe_pacer_.sent(now, 0);
      keyframes_.publish(shell_.mapId(), last_stamp_, slam_->map());
    }
    const auto bytes = static_cast<double>(clouds_.bytes());  // of the last one: a map does not grow by much
    if (!cloud_pacer_.due(now, bytes)) return;
    cloud_pacer_.sent(now, bytes);
    clouds_.request(shell_.mapId(), last_stamp_, slam_->posedPoints());
  }

  /// Who has come late waits for no new keyframe: the robot may stand.
  void serveKeyframes() {
    if (keyframes_.awaited() && slam_->map().keyframeCount() > 0)
      keyframes_.publish(shell_.mapId(), last_stamp_, slam_->map());
  }

  /// What is saved is the map with its adjustment, and receivers get the same; but no image waits for one that runs.
  void finishMap() {
    const bool nobody_waits = ends_ || settings_.estimator.player_waits || silence() > kEnded;
    const bool moved = nobody_waits ? slam_->finish() : slam_->adoptFinished();
    if (slam_->adjusting())
      ROS_WARN("the whole map is being adjusted: what is saved now is without; save again in some seconds to have it");
    if (!moved) return;
    ++map_revision_;
    cloud_pacer_.changed(true);
    keyframe_pacer_.changed(true);
  }

  std::function<std::vector<ros_utils::CloudPoint>()> mapForFile() override {
    if (slam_->map().keyframeCount() == 0) throw std::runtime_error("there is no map yet");
    finishMap();
    return [points = slam_->posedPoints(), how = settings_.slam.cloud] { return cloudForFile(points, how); };
  }

  std::vector<ros_utils::MapTrajectory> trajectories() override {
    std::vector<ros_utils::MapTrajectory> maps;
    if (slam_->map().keyframeCount() > 0) {
      finishMap();
      maps.push_back({slam_->trajectory(), "", shell_.mapId()});
    }
    ended_.appendTo(&maps);
    if (maps.empty()) throw std::runtime_error("there is no trajectory yet");
    return maps;
  }

  const NodeSettings settings_;
  const ros_utils::EstimatorSettings& frames_;
  ros::NodeHandle handle_;
  ros::Publisher keyframe_publisher_;
  std::unique_ptr<Slam> slam_;
  ros::Time last_stamp_;
  std::chrono::steady_clock::time_point last_frame_;
  bool imu_problem_told_ = false;
  std::atomic<bool> ends_{false};                   ///< the node: what is saved then is the last
  double told_readout_time_ = 0, depth_delay_ = 0;  ///< [s]
  std::uint32_t map_id_ = 0, map_revision_ = 0;     ///< of what is published; id 0: none is

  ros_utils::EstimatorShell shell_;
  ros_utils::PosePublisher pose_publisher_;
  ros_utils::CalibrationReport calibration_{shell_.health(), "colour camera"};
  DepthInput depth_;
  CloudPublisher clouds_;
  MapPacer cloud_pacer_{settings_.cloud_interval, 1e6 * settings_.cloud_bandwidth};
  MapPacer keyframe_pacer_{settings_.cloud_interval, std::numeric_limits<double>::infinity()};
  KeyframePublisher keyframes_;
  EndedMaps ended_{settings_.slam.cloud, shell_.autosave()};
};

}  // namespace
}  // namespace rgbd_slam

int main(int argc, char** argv) {
  return air_ground_common::ros_utils::runNode<rgbd_slam::NodeSettings>(argc, argv, "rgbd_slam",
                                                                        [](const auto& settings) {
                                                                          rgbd_slam::RgbdSlamNode node(settings);
                                                                          ros::spin();
                                                                        });
}
