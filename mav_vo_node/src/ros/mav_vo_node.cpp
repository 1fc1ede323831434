// Visual odometry of the MAV: images and IMU in, metric poses, posed images, increments and the sparse map out.
#include <air_ground/AlignmentEstimate.h>
#include <ros/ros.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "../posed_image_selection.h"
#include "air_ground_common/ros/calibration_report.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/estimator_shell.h"
#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/pose_publisher.h"
#include "mav_vo/external_scale.h"
#include "messages.h"
#include "node_parameters.h"
#include "visual_frontend/accel_noise.h"
#include "visual_frontend/feature_tracker.h"

namespace mav_vo {
namespace {

namespace ros_utils = air_ground_common::ros_utils;

ros_utils::EstimatorNames names() {
  ros_utils::EstimatorNames names;
  names.image = "mav/camera/image_raw";
  names.camera_info = "mav/camera/camera_info";
  names.imu = "mav/imu/data";
  names.status = "mav/vo_status";
  names.node = "mav_vo";
  names.subject = "visual odometry";
  names.transport_argument = "mav_image_transport";
  names.without_imu = "runs without gyro prior and stays without metric scale";
  return names;
}

class MavVoNode : private ros_utils::Estimator {
 public:
  explicit MavVoNode(const NodeSettings& settings)
      : settings_(settings),
        frames_(settings_.estimator),
        shell_(handle_, settings.estimator, names(), *this),
        pose_publisher_(handle_, ros_utils::poseOutput(frames_, "mav/odometry", "mav/path"), shell_.health()) {
    cloud_publisher_ = handle_.advertise<sensor_msgs::PointCloud2>("mav/sparse_cloud", 5);
    posed_publisher_ = handle_.advertise<air_ground::PosedImage>("mav/posed_image", 100);
    corrected_publisher_ = handle_.advertise<nav_msgs::Path>("mav/corrected_path", 20);
    increment_publisher_ = handle_.advertise<air_ground::VoIncrement>("mav/vo_increment", 100);
    track_publisher_ = handle_.advertise<sensor_msgs::Image>("mav/track_image", 5);
    scale_publisher_ = handle_.advertise<air_ground::AlignmentEstimate>("mav/map_scale", 5, true);
    alignment_subscriber_ = handle_.subscribe("alignment/refined", 20, &MavVoNode::onAlignment, this);
    shell_.start();
  }
  ~MavVoNode() override { shell_.stop(); }

 private:
  bool exists() const override { return odometry_ != nullptr; }

  void make(const CameraModel& camera, const Pose& T_base_camera, const std::optional<Pose>& T_base_imu) override {
    OdometrySettings settings = settings_.odometry;
    settings.use_imu = T_base_imu.has_value();
    settings.reproducible = settings_.estimator.player_waits;
    visual_ = !settings.use_imu;
    external_scale_.emplace(T_base_camera);
    calibration_.setGiven(camera.k1);
    if (T_base_imu) mounting_.setGiven(T_base_imu->linear());
    clocks_apart_ = settings.gyro_alignment.time_offset;
    odometry_ = std::make_unique<Odometry>(camera, T_base_camera, T_base_imu.value_or(Pose::Identity()), settings);
  }

  void forgetMap() override {
    last_lost_.reset();
    pose_publisher_.beginMap();
    last_cloud_ = ros::Time();
  }

  /// A user wants to begin afresh, or a recording begins again.
  void forgetOdometry() override {
    pose_publisher_.reset();
    ended_.clear();
  }

  void keep() override {
    odometry_->finish();
    ros_utils::MapTrajectory present = presentTrajectory();
    if (isWorthIt(present)) addEnded(std::move(present));
  }

  void drop() override { odometry_.reset(); }
  void reset() override { odometry_->reset(); }
  std::uint32_t mapId() const override { return odometry_ ? odometry_->mapId() : 1; }

  bool addImu(const ros_utils::ImuInput::Sample& sample) override {
    return odometry_->addImu({sample.stamp, sample.angular_velocity, sample.specific_force});
  }

  double imuLead() const override { return odometry_->imuNeededAt(0); }

  ros_utils::EstimatorResult process(const ros_utils::EstimatorFrame& frame) override {
    odometry_->setImuProblem(shell_.imuProblem());
    const cv::Mat grey = ros_utils::greyFromMsg(*frame.image);
    VoResult visual = odometry_->process(frame.stamp.toSec(), grey);
    visual.map_id = shell_.mapId();
    keepEnded(std::exchange(state_, visual.state), visual.state);
    last_stamp_ = frame.stamp;
    calibration_.update(odometry_->camera().k1);
    warnOfNoise(visual.accel_noise);
    warnOfClocks(visual.time_offset);
    if (visual_)
      useAlignment(frame.stamp, visual.map_id);
    else
      mounting_.update(last_stamp_.toSec(), visual.R_given_imu);
    const VoResult r = visual_ ? external_scale_->metric(visual) : visual;
    shell_.health().timing("image [s]", r.seconds);
    const bool usable = r.pose_valid && r.T_map_base.matrix().allFinite() && r.covariance.allFinite();
    ros_utils::EstimatorResult result;
    result.status = statusMessage(r);
    if (!r.imu_at_fault) result.advice = adviceFor(r.state, !visual_);
    if (r.imu_at_fault && r.state == OdometryState::kTracking)
      shell_.health().count("images tracked while the IMU contradicts them or is silent; vo_status.reason says which");
    result.pose_published = usable && r.metric;
    result.publish = [this, image = frame.image, grey, visual, r, usable] { publish(image, grey, visual, r, usable); };
    return result;
  }

  void warnOfClocks(double time_offset) {
    constexpr double kFar = 0.1;  // [s]
    if (std::abs(time_offset - clocks_apart_) < kFar) return;
    clocks_apart_ = time_offset;
    ROS_WARN(
        "the IMU's stamps are %.2f s %s the images', as both turn: a new map starts with that. Set time_offset: %.2f, "
        "or have both drivers stamp when they measure",
        std::abs(time_offset), time_offset > 0 ? "ahead of" : "behind", time_offset);
  }

  void warnOfNoise(double density) {
    shell_.health().value("accelerometer's noise [m/s^2/sqrt(Hz)]", density);
    if (noise_warned_ ||
        density < std::max(visual_frontend::AccelNoise::kFolded, 1.01 * settings_.odometry.imu_noise.accel_density))
      return;
    noise_warned_ = true;
    ROS_WARN(
        "the accelerometer reads %.2f m/s^2/sqrt(Hz) where there is no motion: vibration faster than it is sampled. "
        "The "
        "scale comes late and is less certain: record it at a higher rate, let it filter (low pass), or damp its mount",
        density);
  }

  /// Only kept: process() uses it, on the worker's thread.
  void onAlignment(const air_ground::AlignmentEstimate::ConstPtr& msg) {
    if (msg->status != air_ground::AlignmentEstimate::STATUS_CONVERGED || msg->child_frame_id != settings_.visual_frame)
      return;
    const std::lock_guard<std::mutex> lock(alignment_mutex_);
    alignment_ = msg;
  }

  /// No more images come: what the alignment tells still makes the trajectory metric.
  void idle() override {
    if (visual_) useAlignment(last_stamp_, shell_.mapId());
  }

  /// The map's scale and vertical are those of its last alignment with the ground map, if it is of this map.
  void useAlignment(const ros::Time& stamp, std::uint32_t map_id) {
    air_ground::AlignmentEstimate::ConstPtr msg;
    {
      const std::lock_guard<std::mutex> lock(alignment_mutex_);
      std::swap(msg, alignment_);
    }
    if (!msg || msg->map_id != map_id || odometry_->map().keyframeCount() == 0) return;
    try {
      AlignedScale aligned;
      aligned.map_id = map_id;
      const Pose T = ros_utils::fromMsg(msg->pose.pose);
      aligned.T_ground_visual = {msg->scale, T.linear(), T.translation()};
      aligned.scale_stddev = msg->scale_stddev / msg->scale;
      const Matrix6d C = ros_utils::covarianceFromMsg(msg->pose.covariance);
      aligned.tilt_stddev = std::sqrt(std::max(C(3, 3), C(4, 4)));
      aligned.T_visual_camera_first = odometry_->map().keyframes().begin()->second.T_map_camera;
      if (!external_scale_->update(aligned)) return;
    } catch (const std::exception& e) {
      shell_.health().count(std::string("alignments unreadable: ") + e.what());
      return;
    }
    const auto S = *external_scale_->T_map_visual(map_id);
    ROS_INFO("Scale from the ground map: %.4f m a unit of the visual map (+- %.1f %%)", S.scale,
             100 * external_scale_->relativeStddev());
    air_ground::AlignmentEstimate scale;
    scale.header.stamp = stamp;
    scale.header.frame_id = frames_.map_frame;
    scale.child_frame_id = settings_.visual_frame;
    Pose T_map_visual = Pose::Identity();
    T_map_visual.linear() = S.R;
    T_map_visual.translation() = S.t;
    scale.pose.pose = ros_utils::toMsg(T_map_visual);
    scale.scale = S.scale;
    scale.scale_stddev = S.scale * external_scale_->relativeStddev();
    scale.status = air_ground::AlignmentEstimate::STATUS_CONVERGED;
    scale.stage = air_ground::AlignmentEstimate::STAGE_REFINED;
    scale.reason = "scale and vertical of the visual map as its alignment tells them";
    scale.map_id = map_id;
    scale_publisher_.publish(scale);
  }

  /// `visual`: in the odometry's own map, whose unit never changes where there is no IMU; `r`: the same in the metric
  /// map, as far as that is known.
  void publish(const sensor_msgs::Image::ConstPtr& image, const cv::Mat& grey, const VoResult& visual,
               const VoResult& r, bool usable) {
    std_msgs::Header header;
    header.stamp = image->header.stamp;
    header.frame_id = frames_.map_frame;
    std_msgs::Header camera_header = header;
    camera_header.frame_id = shell_.cameraFrame();
    if (track_publisher_.getNumSubscribers() > 0 && frame_count_++ % settings_.track_image_every == 0) {
      track_publisher_.publish(
          ros_utils::toMsg(visual_frontend::drawTracks(grey, odometry_->features(), odometry_->mappedFeatures()),
                           "bgr8", camera_header));
    }
    if (!usable) return;
    if (r.map_id != map_id_) {
      pose_publisher_.beginMap();
      map_id_ = r.map_id;
    }
    // Odometry and tf have no flag that says "not metric": they begin with the metric map.
    if (r.metric) pose_publisher_.publish(header.stamp, r.T_map_base, motionOf(r), r.covariance);
    // What is reconstructed from them, and aligned, stays in one unit as long as the map lives.
    std_msgs::Header map_header = header;
    if (visual_) map_header.frame_id = settings_.visual_frame;
    // Before the image that is posed in the corrected map.
    if (std::exchange(corrections_, visual.map_corrections) != visual.map_corrections && (visual_ || r.metric) &&
        corrected_publisher_.getNumSubscribers() > 0)
      corrected_publisher_.publish(ros_utils::toMsg(posed_selection_.selected(odometry_->trajectory()), map_header));
    if (posed_publisher_.getNumSubscribers() > 0 && posed_selection_.selects(visual)) {
      air_ground::PosedImage posed = posedImage(grey, visual, settings_.posed_image_quality);
      posed.header = map_header;
      posed.camera_info = ros_utils::toMsg(odometry_->camera(), camera_header);
      posed_publisher_.publish(posed);
    }
    if (r.increment) increment_publisher_.publish(incrementMessage(header, r));
    if ((visual_ || r.metric) && r.keyframe &&
        header.stamp.toSec() - last_cloud_.toSec() >= settings_.sparse_cloud_interval) {
      last_cloud_ = header.stamp;
      cloud_publisher_.publish(ros_utils::toMsg(sparsePoints(), ros_utils::CloudFields::kXyz, map_header));
    }
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

  bool metric() const { return odometry_->metric() || external_scale_->T_map_visual(shell_.mapId()); }

  std::function<std::vector<ros_utils::CloudPoint>()> mapForFile() override {
    if (!metric()) throw std::runtime_error("there is no metric map yet");
    odometry_->finish();
    auto points = sparsePoints();
    const auto S = external_scale_->T_map_visual(shell_.mapId());
    for (auto& p : points) {
      if (S) p.position = (*S * p.position.cast<double>()).cast<float>();
      p.rgb.setConstant(200);
    }
    return [points = std::move(points)] { return points; };
  }

  static bool isWorthIt(const ros_utils::MapTrajectory& map) {
    constexpr std::size_t kLeast = 20;  // poses
    return map.poses.size() >= kLeast;
  }

  void addEnded(ros_utils::MapTrajectory map) {
    constexpr std::size_t kMost = 20;  // maps
    ended_.push_back(std::move(map));
    if (ended_.size() > kMost) ended_.erase(ended_.begin());
  }

  /// A map that is lost for too long ends, and its trajectory with it.
  void keepEnded(OdometryState before, OdometryState now) {
    const std::uint32_t id = shell_.mapId();
    if (last_lost_ && last_lost_->first != id) {
      addEnded(std::move(last_lost_->second));
      last_lost_.reset();
    }
    if (now != OdometryState::kLost || before == now) return;
    ros_utils::MapTrajectory lost = presentTrajectory();
    if (isWorthIt(lost)) last_lost_.emplace(id, std::move(lost));
  }

  ros_utils::MapTrajectory presentTrajectory() const {
    return {external_scale_->metric(odometry_->trajectory(), shell_.mapId()),
            metric() ? "" : air_ground_common::kOwnUnit};
  }

  /// The present map's; a metric one before it where it is not.
  std::vector<ros_utils::MapTrajectory> trajectories() override {
    std::vector<ros_utils::MapTrajectory> maps;
    if (odometry_->map().keyframeCount() > 0) {
      odometry_->finish();
      maps.push_back(presentTrajectory());
    }
    maps.insert(maps.end(), ended_.rbegin(), ended_.rend());
    if (maps.empty()) throw std::runtime_error("there is no trajectory yet: no map has begun");
    const auto metric =
        std::find_if(maps.begin(), maps.end(), [](const ros_utils::MapTrajectory& map) { return map.unit.empty(); });
    if (metric != maps.end()) std::rotate(maps.begin(), metric, std::next(metric));
    return maps;
  }

  const NodeSettings settings_;
  const ros_utils::EstimatorSettings& frames_;
  ros::NodeHandle handle_;
  ros::Publisher cloud_publisher_, posed_publisher_, corrected_publisher_, increment_publisher_, track_publisher_,
      scale_publisher_;
  ros::Subscriber alignment_subscriber_;
  std::unique_ptr<Odometry> odometry_;
  PosedImageSelection posed_selection_{settings_.posed_image_spacing};
  bool visual_ = false;  // no IMU: the map keeps its own unit
  std::optional<ExternalScale> external_scale_;
  std::mutex alignment_mutex_;
  air_ground::AlignmentEstimate::ConstPtr alignment_;  // the newest that has not been used yet
  ros::Time last_stamp_, last_cloud_;
  OdometryState state_ = OdometryState::kWaiting;
  std::vector<ros_utils::MapTrajectory> ended_;                                  // of earlier maps
  std::optional<std::pair<std::uint32_t, ros_utils::MapTrajectory>> last_lost_;  // of the map of this id, when it was
  std::uint32_t map_id_ = 0, corrections_ = 0;
  std::size_t frame_count_ = 0;
  bool noise_warned_ = false;
  double clocks_apart_ = 0;  // as last told [s]
  ros_utils::EstimatorShell shell_;
  ros_utils::PosePublisher pose_publisher_;
  ros_utils::CalibrationReport calibration_{shell_.health(), "camera"};
  ros_utils::MountingReport mounting_{shell_.health(), frames_.base_frame};
};

}  // namespace
}  // namespace mav_vo

int main(int argc, char** argv) {
  return air_ground_common::ros_utils::runNode<mav_vo::NodeSettings>(argc, argv, "mav_vo", [](const auto& settings) {
    mav_vo::MavVoNode node(settings);
    ros::spin();
  });
}
