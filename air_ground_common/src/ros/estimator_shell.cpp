#include "air_ground_common/ros/estimator_shell.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "frame_rivals.h"
#include "map_ids.h"

namespace air_ground_common::ros_utils {
namespace {

/// Of a colour image for its depth image [s of data]; of a status without estimator [s].
constexpr double kPatience = 1.0;

constexpr double kAssembledShare = 0.75;  // of the queue's memory: for pairs; the rest for what waits for its partner

/// Of a clock that never stands still or leaps [s].
double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

std::string nameOf(std::uint8_t state) {
  using Status = air_ground::VoStatus;
  switch (state) {
    case Status::STATE_WAITING:
      return "waiting";
    case Status::STATE_INITIALIZING:
      return "initializing";
    case Status::STATE_SCALING:
      return "scaling";
    case Status::STATE_TRACKING:
      return "tracking";
    default:
      return "lost";
  }
}

/// With `share` of the memory.
QueueLimits queueLimits(const EstimatorSettings& settings, double share) {
  return {static_cast<std::size_t>(settings.queue_size), static_cast<std::size_t>(share * 1e6 * settings.queue_memory)};
}

FrameAssemblerSettings assemblerSettings(const EstimatorSettings& settings, const EstimatorNames& names) {
  FrameAssemblerSettings a;
  a.use_imu = settings.use_imu;
  a.imu_wait = settings.imu_wait;
  a.settle = kTopicsInStep;
  a.images = queueLimits(settings, names.depth.empty() ? 1 : kAssembledShare);
  a.max_latency = settings.player_waits ? 0 : settings.max_latency;
  return a;
}

}  // namespace

EstimatorShell::EstimatorShell(ros::NodeHandle handle, const EstimatorSettings& settings, const EstimatorNames& names,
                               Estimator& estimator)
    : settings_(settings),
      names_(names),
      autosave_(settings.autosave),
      estimator_(estimator),
      health_(names.node),
      mountings_(settings.base_frame, countRivals(settings, health_)),
      imu_input_(health_, !settings.accel_topic.empty()),
      handle_(handle),
      info_topic_(handle.resolveName(names.camera_info)),
      imu_topic_(handle.resolveName(names.imu)),
      assembler_(assemblerSettings(settings, names)) {
  map_id_offset_ = mapIdOffset(private_handle_);
  status_publisher_ = handle_.advertise<air_ground::VoStatus>(names.status, 200);
  health_.state(health_.kWarn, "waiting for images");
  health_.expectInput(info_topic_);
  if (settings.use_imu) health_.expectInput(imu_topic_);
  info_subscriber_ = handle_.subscribe(names.camera_info, 20, &EstimatorShell::onInfo, this);
  if (settings.use_imu)
    imu_subscriber_ =
        handle_.subscribe(names.imu, 5000, &EstimatorShell::onImu, this, ros::TransportHints().tcpNoDelay());
  if (settings.use_imu && !settings.accel_topic.empty()) {
    accel_topic_ = handle_.resolveName(settings.accel_topic);
    health_.expectInput(accel_topic_);
    accel_subscriber_ = handle_.subscribe(accel_topic_, 5000, &EstimatorShell::onAccelerometer, this,
                                          ros::TransportHints().tcpNoDelay());
  }
  const auto listen = [&](const std::string& topic, bool depth, void (EstimatorShell::*callback)(const ImageMessage&)) {
    const std::string argument = std::string("the parameter ") + (depth ? "depth_transport" : "image_transport") +
                                 ", or the launch argument " +
                                 (depth ? names.depth_transport_argument : names.transport_argument) + ",";
    images_.emplace_back(handle_, topic, depth ? settings.depth_transport : settings.image_transport, depth,
                         settings.queue_size, health_, argument,
                         [this, callback](const ImageMessage& message) { (this->*callback)(message); });
    return images_.back().topic();
  };
  if (!names.depth.empty()) {
    pairer_.emplace(settings.sync_tolerance, kPatience, kTopicsInStep,
                    queueLimits(settings, 0.5 * (1 - kAssembledShare)));
    depth_topic_ = listen(names.depth, true, &EstimatorShell::onDepth);
  }
  image_topic_ = listen(names.image, false, &EstimatorShell::onImage);
  advertiseServices();
}

// ---- Inputs

void EstimatorShell::onInfo(const sensor_msgs::CameraInfo::ConstPtr& msg) {
  health_.received(info_topic_, msg->header.stamp);
  std::string problem;
  try {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    const sensor_msgs::CameraInfo info = infoOfImages(*msg, image_topic_);
    calibration_ = Calibration{fromMsg(info), info};
  } catch (const std::exception& e) {
    problem = e.what();
    health_.count("camera calibrations refused: " + problem);
  }
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    calibration_problem_ = problem;
  }
  queue_changed_.notify_all();
}

// Locked while they are read: gyro and accelerometer may come on two threads, and their samples are one sequence.
void EstimatorShell::onImu(const sensor_msgs::Imu::ConstPtr& msg) {
  health_.received(imu_topic_, msg->header.stamp);
  const std::lock_guard<std::mutex> lock(queue_mutex_);
  imu_frame_ = msg->header.frame_id;
  addImu(imu_input_.read(*msg));
}

void EstimatorShell::onAccelerometer(const sensor_msgs::Imu::ConstPtr& msg) {
  health_.received(accel_topic_, msg->header.stamp);
  const std::lock_guard<std::mutex> lock(queue_mutex_);
  addImu(imu_input_.readAccelerometer(*msg));
}

void EstimatorShell::addImu(const std::vector<ImuInput::Sample>& samples) {
  for (const ImuInput::Sample& sample : samples)
    if (gate_.admit(kImu, sample.stamp)) assembler_.addImu(sample);
  if (!samples.empty()) queue_changed_.notify_all();
}

void EstimatorShell::onImage(const ImageMessage& message) {
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    if (!gate_.admit(kImage, message.header().stamp)) return;
    newest_image_ = message.header().stamp;
    if (pairer_)
      addToPairs(message, true);
    else
      assembler_.addImage(message.header().stamp.toSec(), {message, {}}, now(), message.bytes());
    reportDropped();
  }
  queue_changed_.notify_all();
}

void EstimatorShell::onDepth(const ImageMessage& message) {
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    if (!gate_.admit(kDepth, message.header().stamp)) return;
    depth_arrival_ = now();
    addToPairs(message, false);
  }
  queue_changed_.notify_all();
}

void EstimatorShell::addToPairs(const ImageMessage& message, bool colour) {
  const double stamp = message.header().stamp.toSec();
  const std::size_t before = pairer_->outOfOrder();
  if (colour)
    pairer_->addColour(stamp, message, now(), message.bytes());
  else
    pairer_->addDepth(stamp, message, now(), message.bytes());
  health_.count("images dropped: out of order", pairer_->outOfOrder() - before);
  movePairs();
}

void EstimatorShell::onTimeJump() {
  ROS_WARN_STREAM("time jumped back (a looped bag?): " << names_.subject << " starts afresh");
  mountings_.forgetMoving();
  clearQueues();
  reset_requested_ = true;
}

void EstimatorShell::clearQueues() {
  assembler_.clear();
  if (pairer_) pairer_->clear();
  reported_unmatched_ = 0;
}

void EstimatorShell::movePairs() {
  if (!pairer_) return;
  while (pairer_->front(now())) {
    auto pair = pairer_->pop();
    assembler_.addImage(pair.stamp, {std::move(pair.colour), std::move(pair.depth)}, now(), pair.bytes);
  }
  reportDropped();
}

void EstimatorShell::reportDropped() {
  QueueOverflow dropped = assembler_.overflow();
  if (pairer_) {
    const QueueOverflow unpaired = pairer_->overflow();
    dropped.by_count += unpaired.by_count;
    dropped.by_bytes += unpaired.by_bytes;
  }
  health_.count("images dropped: the queue was full", dropped.by_count - reported_dropped_.by_count);
  health_.count("images dropped: the queue held queue_memory", dropped.by_bytes - reported_dropped_.by_bytes);
  reported_dropped_ = dropped;
}

void EstimatorShell::reportUnmatched() {
  if (!pairer_ || pairer_->unmatchedColour() == reported_unmatched_) return;
  health_.count("colour images without a depth image in time", pairer_->unmatchedColour() - reported_unmatched_);
  reported_unmatched_ = pairer_->unmatchedColour();
}

bool EstimatorShell::frameReady() {
  movePairs();
  assembler_.setImuLead(imu_lead_);
  const std::size_t late = assembler_.dropLate();
  health_.count("images dropped: further behind than max_latency", late);
  if (!calibration_) return false;
  if (late > 0)
    ROS_WARN_STREAM_THROTTLE(10, names_.subject << " is slower than the images come: those more than "
                                                << settings_.max_latency
                                                << " s behind are dropped (parameter max_latency)");
  return assembler_.ready(now());
}

EstimatorShell::Obstacle EstimatorShell::whyNotReady() const {
  const bool waits = assembler_.waiting() > 0;
  if (!waits && pairer_ && (pairer_->waiting() > 0 || pairer_->unmatchedColour() > reported_unmatched_)) {
    if (!pairer_->closestMiss())
      return {
          "no depth image has come on " + depth_topic_,
          "see whether the camera's driver sends depth, and whether the launch argument ground_depth names its topic"};
    const double silence = now() - depth_arrival_;
    if (*pairer_->closestMiss() < -kPatience && silence > kPatience)
      return {"no depth image has come on " + depth_topic_ + " for " + std::to_string(std::lround(silence)) + " s",
              "see whether the camera's driver still sends depth"};
    return {"no image on " + image_topic_ + " has a depth image on " + depth_topic_ + " within " +
                std::to_string(settings_.sync_tolerance) + " s; the last one missed by " +
                std::to_string(*pairer_->closestMiss()) + " s",
            "synchronise the drivers, or raise the parameter sync_tolerance"};
  }
  if (waits && !calibration_ && !calibration_problem_.empty())
    return {"the calibration on " + info_topic_ + " cannot be used: " + calibration_problem_,
            "calibrate the camera and have its driver publish the result"};
  if (waits && !calibration_)
    return {"no calibration has come on " + info_topic_,
            "publish sensor_msgs/CameraInfo there, or remap the topic to where it is"};
  if (waits && assembler_.hasImu())
    return {"images wait for the IMU's samples on " + imu_topic_,
            "see whether its stamps and the images' are of one clock, or set use_imu to false"};
  return {};
}

// ---- Worker

void EstimatorShell::work() {
  using namespace std::chrono_literals;
  while (true) {
    bool restart = false;
    Obstacle obstacle;
    ros::Time newest;
    {
      std::unique_lock<std::mutex> lock(queue_mutex_);
      queue_changed_.wait_for(lock, frame_ ? 20ms : 300ms,
                              [&] { return stop_ || reset_requested_ || (!frame_ && frameReady()); });
      if (stop_) return;
      restart = std::exchange(reset_requested_, false);
      newest = newest_image_;
      if (!restart && !frame_ && frameReady()) {
        health_.value("lag [s]", assembler_.lag());
        health_.value("images waiting [MB]", 1e-6 * static_cast<double>(assembler_.waitingBytes()));
        frame_ = assembler_.pop();
      } else if (!frame_) {
        obstacle = whyNotReady();
      }
      reportUnmatched();
    }
    const bool image = !restart && frame_;
    try {
      if (restart) {
        frame_.reset();
        resetEstimator(false);
      } else if (image) {
        attemptFrame();
      } else if (!obstacle.reason.empty()) {
        reportObstacle(obstacle, newest);
      } else {
        idle();
      }
    } catch (const std::exception& e) {
      health_.count(std::string(image ? "images refused: " : "between images: ") + e.what());
      if (image) health_.withheld(std::string("images are refused: ") + e.what());
      frame_.reset();
    }
  }
}

void EstimatorShell::idle() {
  const std::lock_guard<std::mutex> lock(estimator_mutex_);
  if (estimator_.exists()) estimator_.idle();
}

/// Leaves `frame_` only while its image waits for its mounting.
void EstimatorShell::attemptFrame() {
  EstimatorFrame frame;
  ImagePair& pair = frame_->image;
  frame.image = pair.image.pixels();
  pair.image = {frame.image, nullptr};  // once
  frame.stamp = frame.image->header.stamp;
  const Obstacle obstacle = prepare(*frame.image, frame_->imu);
  if (!obstacle.reason.empty()) {
    reportObstacle(obstacle, frame.stamp);
    if (now() - frame_->arrival < settings_.transform_timeout) return;
    health_.count("images without " + obstacle.lacking);
    frame_.reset();
    return;
  }
  frame.image = pixel_range_.full(frame.image);
  if (pairer_) frame.depth = pair.depth.pixels();
  const std::deque<ImuInput::Sample> imu = std::move(frame_->imu);
  frame_.reset();
  obstructed_since_ = -1;
  step(frame, imu);
}

/// Makes the estimator once calibration and mountings are known, and anew when the calibration changes or an IMU turns
/// up. Returns what is lacking while there is none.
EstimatorShell::Obstacle EstimatorShell::prepare(const sensor_msgs::Image& image,
                                                 const std::deque<ImuInput::Sample>& imu) {
  Calibration calibration;
  std::string imu_frame = settings_.imu_frame;
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    calibration = *calibration_;
    if (imu_frame.empty()) imu_frame = imu_frame_;
  }
  const std::string image_frame = withoutSlash(image.header.frame_id),
                    info_frame = withoutSlash(calibration.info.header.frame_id);
  if (!image_frame.empty() && !info_frame.empty() && image_frame != info_frame)
    health_.count("images of the frame '" + image_frame + "' with a calibration of '" + info_frame +
                  "': are two cameras swapped?");
  const std::lock_guard<std::mutex> lock(estimator_mutex_);
  // One that begins late has nothing to say about the images before it, which may still be waiting.
  imu_seen_ = imu_seen_ || (!imu.empty() && (!estimator_.exists() || imu.front().stamp <= image.header.stamp.toSec()));
  const bool imu_wanted = settings_.use_imu && imu_seen_;
  const bool changed = estimator_.exists() && recalibrated(built_, calibration, image);
  if (estimator_.exists() && !changed && (with_imu_ || !imu_wanted)) return {};
  std::string why;
  const std::string camera_frame = ros_utils::cameraFrame(settings_.camera_frame, calibration, image);
  const auto T_base_camera = mountings_.lookup(settings_.T_base_camera, camera_frame, "camera", &why);
  if (!T_base_camera) return {why, "", "the mounting of the camera (tf, or parameter base_camera)"};
  std::optional<Pose> T_base_imu;
  if (imu_wanted) T_base_imu = mountings_.lookup(settings_.T_base_imu, imu_frame, "imu", &why);
  if (imu_wanted && !T_base_imu) {
    const std::string lacking = "the mounting of the imu (tf, or parameter base_imu)";
    if (!estimator_.exists()) return {why + ", or use_imu to false", "", lacking};
    health_.count("images without " + lacking);  // the map goes on without it until it is known
    if (!changed) return {};
  }
  if (estimator_.exists()) {
    ROS_WARN_STREAM((changed ? "the camera's calibration has changed" : "an IMU has turned up")
                    << ": a new map begins");
    dropEstimator();
    estimator_.forgetMap();
  }
  if (settings_.use_imu && !T_base_imu)
    ROS_WARN_STREAM("no IMU on " << imu_topic_ << ": " << names_.subject << " " << names_.without_imu);
  forgetImages();
  built_ = calibration;
  camera_frame_ = camera_frame;
  with_imu_ = T_base_imu.has_value();
  estimator_.make(calibration.camera, *T_base_camera, T_base_imu);
  return {};
}

void EstimatorShell::step(const EstimatorFrame& frame, const std::deque<ImuInput::Sample>& imu) {
  const std::lock_guard<std::mutex> lock(estimator_mutex_);
  if (!estimator_.exists()) return;  // reset meanwhile
  if (frame.stamp <= last_stamp_) {
    health_.count("images refused: stamp not later than the last one's");
    return;
  }
  for (const ImuInput::Sample& sample : imu)
    if (with_imu_ && !estimator_.addImu(sample))
      health_.count("IMU samples refused: stamp not later than the last one's, or a reading that leaps and comes back");
  last_stamp_ = frame.stamp;
  if (frozen_images_.repeats(*frame.image, imu)) return leaveOut(frame);
  EstimatorResult result = estimator_.process(frame);
  if (const std::string why = mountings_.moved(); result.pose_published && !why.empty()) result.withhold(why);
  imu_lead_ = estimator_.imuLead();
  air_ground::VoStatus& status = result.status;
  status.header.stamp = frame.stamp;
  status.header.frame_id = settings_.map_frame;
  status.map_id = mapId();
  tell(status);
  if (result.pose_published)
    health_.published();
  else
    health_.withheld(status.reason.empty() ? nameOf(status.state) : status.reason, result.advice);
  result.publish();
}

void EstimatorShell::tell(const air_ground::VoStatus& status) {
  const bool well = status.state == air_ground::VoStatus::STATE_TRACKING && status.reason.empty();
  health_.state(well ? health_.kOk : health_.kWarn, nameOf(status.state) +
                                                        (status.reason.empty() ? "" : ": " + status.reason) + ", " +
                                                        std::to_string(status.inliers) + " landmarks in view" +
                                                        (settings_.use_imu && !with_imu_ ? ", without IMU" : ""));
  told_ = status;
  status_publisher_.publish(status);
}

/// A status says so, too, unless there are others or it is only a matter of time: topics have no order between them.
void EstimatorShell::reportObstacle(const Obstacle& obstacle, const ros::Time& stamp) {
  health_.withheld(obstacle.reason, obstacle.advice);
  const std::lock_guard<std::mutex> lock(estimator_mutex_);
  if (estimator_.exists()) return;
  health_.state(health_.kWarn, "waiting: " + obstacle.reason);
  const double t = now();
  if (obstructed_since_ < 0) obstructed_since_ = t;
  if (t - obstructed_since_ < kPatience || t - obstacle_told_ < kPatience) return;
  obstacle_told_ = t;
  air_ground::VoStatus status;
  status.header.stamp = stamp;
  status.header.frame_id = settings_.map_frame;
  status.state = air_ground::VoStatus::STATE_WAITING;
  status.reason = obstacle.reason;
  status.map_id = mapId();
  status_publisher_.publish(status);
}

}  // namespace air_ground_common::ros_utils
