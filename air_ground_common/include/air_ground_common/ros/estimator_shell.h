// What the nodes that estimate a robot's motion from a camera and an IMU have in common: inputs and their queue,
// calibration and mountings, the worker, one map after the other, status, silence, services. A node adds its library.
#pragma once

#include <air_ground/SaveMap.h>
#include <air_ground/SaveTrajectory.h>
#include <air_ground/VoStatus.h>
#include <ros/callback_queue.h>
#include <ros/node_handle.h>
#include <ros/spinner.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Imu.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "air_ground_common/frame_assembler.h"
#include "air_ground_common/frame_pairer.h"
#include "air_ground_common/geometry.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/frozen_images.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/image_input.h"
#include "air_ground_common/ros/mountings.h"
#include "air_ground_common/ros/pixel_range.h"
#include "air_ground_common/ros/pose_publisher.h"
#include "air_ground_common/ros/sensor_input.h"
#include "air_ground_common/trajectory.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace air_ground_common::ros_utils {

/// Parameters that such nodes share.
struct EstimatorSettings {
  std::string map_frame, odom_frame, base_frame;
  std::string camera_frame, imu_frame;            ///< empty: as the messages say
  std::optional<Pose> T_base_camera, T_base_imu;  ///< instead of tf
  bool publish_tf = true;
  bool odom_from_tf = false;  ///< another node publishes odom -> base_link; map -> odom is made to fit it
  bool use_imu = true;
  double transform_timeout = 5.0;  ///< an image waits so long for its mounting, wall clock [s]
  double imu_wait = 0.5;           ///< and for the IMU's samples up to its stamp [s of data]
  double max_latency = 1.0;        ///< images further behind the newest are dropped; 0 = none [s of data]
  bool player_waits = false;       ///< the player of a replay is held while the node lags: nothing is dropped
  double sync_tolerance = 0.02;    ///< of the stamps of an image and its depth image [s]
  int queue_size = 400;            ///< images that wait ...
  double queue_memory = 1000;      ///< ... and what they take at the most [MB]
  std::string autosave;            ///< folder for map and trajectory at the end; empty: none
  std::string image_transport = "raw", depth_transport = "raw";  ///< or "compressed"
  std::string accel_topic;  ///< of an accelerometer whose samples are not in the IMU's messages; empty: they are
};

/// All but sync_tolerance and depth_transport.
void describe(ParameterVisitor& visitor, EstimatorSettings& settings);

/// Frames and tf as these settings say.
PosePublisherSettings poseOutput(const EstimatorSettings& settings, const std::string& odometry_topic,
                                 const std::string& path_topic);

/// Names by which a node knows its topics (remapping applies), and what it calls things when it speaks to people.
struct EstimatorNames {
  std::string image, camera_info, imu, status;
  std::string depth;                                              ///< empty: none
  std::string node;                                               ///< "mav_vo", in /diagnostics
  std::string subject;                                            ///< "visual odometry"
  std::string transport_argument, depth_transport_argument = {};  ///< of the launch files: what sets the transports
  std::string without_imu;                                        ///< "runs without gyro prior"
};

struct EstimatorFrame {
  sensor_msgs::Image::ConstPtr image, depth;
  ros::Time stamp;  ///< of the image
};

/// What an estimator made of a frame.
struct EstimatorResult {
  air_ground::VoStatus status;  ///< but header and map_id
  bool pose_published = false;  ///< by `publish`: what users wait for, in metres
  std::string advice;           ///< what to do about status.reason
  std::function<void()> publish = [] {};

  /// No pose that is wrong for a reason that the estimator does not know.
  void withhold(const std::string& reason) {
    status.reason = reason;
    pose_published = false;
    advice.clear();
    publish = [] {};
  }
};

struct MapTrajectory {
  Trajectory poses;
  std::string unit;      ///< of their lengths; empty: metres
  std::uint32_t id = 0;  ///< of the map, for its file's name where that is not the one to save; 0: as they are counted
};

/// The library's side. The shell calls one function at a time; `drop` and later ones only while there is an estimator.
class Estimator {
 public:
  virtual ~Estimator() = default;

  virtual bool exists() const = 0;
  /// Makes a new one. `T_base_imu` empty: without IMU.
  virtual void make(const CameraModel& camera, const Pose& T_base_camera, const std::optional<Pose>& T_base_imu) = 0;
  /// Of the present map; without estimator, as that of a new one begins. Goes up with each map.
  virtual std::uint32_t mapId() const = 0;
  /// Nothing of the map so far is published any more: it is given up.
  virtual void forgetMap() = 0;
  /// After forgetMap at a jump of time or where a user asked for it: odom -> base_link begins anew, too.
  virtual void forgetOdometry() {}

  /// The present map has ended: keeps what is worth it for the services that save. May throw.
  virtual void keep() = 0;
  /// After keep.
  virtual void drop() = 0;
  virtual void reset() = 0;
  /// False: stamp not later than the last one's.
  virtual bool addImu(const ImuInput::Sample& sample) = 0;
  virtual EstimatorResult process(const EstimatorFrame& frame) = 0;
  /// A frame needs the IMU's samples up to its stamp plus this [s].
  virtual double imuLead() const { return 0; }
  /// No frame has come for a while.
  virtual void idle() {}
  /// Throw std::runtime_error when there is none yet. The points are made without the estimator, which goes on
  /// meanwhile.
  virtual std::function<std::vector<CloudPoint>()> mapForFile() = 0;
  /// The one to save, and those of other maps, each in a frame of its own.
  virtual std::vector<MapTrajectory> trajectories() = 0;
};

class EstimatorShell {
 public:
  EstimatorShell(ros::NodeHandle handle, const EstimatorSettings& settings, const EstimatorNames& names,
                 Estimator& estimator);
  ~EstimatorShell() { stop(); }

  /// Begins to work; call when the estimator can be called, at the end of its constructor ...
  void start();
  /// ... and this at the begin of its destructor.
  void stop();

  NodeHealth& health() { return health_; }
  const Autosave& autosave() const { return autosave_; }
  const Mountings& mountings() const { return mountings_; }
  /// What is wrong with the accelerometer; empty while nothing is known to be.
  std::string imuProblem() const { return imu_input_.problem(); }

  // For the estimator, when it is called:
  std::uint32_t mapId() const { return map_id_offset_ + estimator_.mapId(); }
  const std::string& cameraFrame() const { return camera_frame_; }

 private:
  enum Stream { kImage, kDepth, kImu, kStreams };
  struct ImagePair {
    ImageMessage image, depth;
  };
  using Assembler = FrameAssembler<ImagePair, ImuInput::Sample>;
  /// What keeps images from being processed, and what to do; none when empty.
  struct Obstacle {
    std::string reason, advice;
    std::string lacking = {};  ///< images without it are counted
  };

  // Inputs: only checks and queueing happen in the callbacks.
  void onInfo(const sensor_msgs::CameraInfo::ConstPtr& msg);
  void onImu(const sensor_msgs::Imu::ConstPtr& msg);
  void onAccelerometer(const sensor_msgs::Imu::ConstPtr& msg);
  void onImage(const ImageMessage& message);
  void onDepth(const ImageMessage& message);
  // With the queue locked:
  void addImu(const std::vector<ImuInput::Sample>& samples);
  void onTimeJump();
  void clearQueues();
  bool frameReady();
  void movePairs();
  void addToPairs(const ImageMessage& message, bool colour);
  void reportUnmatched();
  void reportDropped();
  Obstacle whyNotReady() const;

  // Worker
  void work();
  void attemptFrame();
  void idle();
  Obstacle prepare(const sensor_msgs::Image& image, const std::deque<ImuInput::Sample>& imu);
  void step(const EstimatorFrame& frame, const std::deque<ImuInput::Sample>& imu);
  void leaveOut(const EstimatorFrame& frame);
  void forgetImages();
  void tell(const air_ground::VoStatus& status);
  void resetEstimator(bool all);
  void dropEstimator();
  void keepMap();
  void reportObstacle(const Obstacle& obstacle, const ros::Time& stamp);

  void advertiseServices();
  std::size_t saveMapTo(const std::string& path);
  std::string saveTrajectoryTo(const std::string& path, bool overwrite, std::uint64_t* poses);
  bool saveMap(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response);
  bool saveTrajectory(air_ground::SaveTrajectory::Request& request, air_ground::SaveTrajectory::Response& response);
  bool reset(std_srvs::Trigger::Request& request, std_srvs::Trigger::Response& response);

  const EstimatorSettings settings_;
  const EstimatorNames names_;
  const Autosave autosave_;
  Estimator& estimator_;
  NodeHealth health_;
  Mountings mountings_;
  ImuInput imu_input_;
  ros::NodeHandle handle_, private_handle_{"~"};
  std::string image_topic_, depth_topic_, info_topic_, imu_topic_, accel_topic_;
  ros::Publisher status_publisher_;

  // Shared with the worker.
  std::mutex queue_mutex_;
  std::condition_variable queue_changed_;
  StreamGate gate_{kStreams, health_, [this] { onTimeJump(); }};
  Assembler assembler_;
  std::optional<FramePairer<ImageMessage>> pairer_;
  std::size_t reported_unmatched_ = 0;
  QueueOverflow reported_dropped_;
  std::optional<Calibration> calibration_;
  std::string calibration_problem_;  ///< of the last one that was refused
  std::string imu_frame_;
  ros::Time newest_image_;
  double depth_arrival_ = 0;  ///< of the newest depth image, by the clock of the assembler [s]
  bool stop_ = false, reset_requested_ = false;
  std::atomic<double> imu_lead_{0};  ///< of the estimator [s]

  // Worker and services, one at a time.
  std::mutex estimator_mutex_;
  Calibration built_;  ///< what the estimator was made with
  bool with_imu_ = false, imu_seen_ = false;
  std::uint32_t map_id_offset_ = 0;
  std::string camera_frame_;
  ros::Time last_stamp_;
  FrozenImages frozen_images_;
  air_ground::VoStatus told_;  ///< the last status of an image

  // The worker's own.
  std::optional<Assembler::Frame> frame_;  ///< waits for its mounting
  PixelRange pixel_range_;
  double obstructed_since_ = -1, obstacle_told_ = -1;  ///< by the clock of the assembler [s]; negative: not
  std::thread worker_;

  std::vector<ImageInput> images_;
  ros::Subscriber info_subscriber_, imu_subscriber_, accel_subscriber_;
  ros::CallbackQueue service_queue_;
  std::vector<ros::ServiceServer> services_;
  ros::AsyncSpinner service_spinner_{1, &service_queue_};
};

}  // namespace air_ground_common::ros_utils
