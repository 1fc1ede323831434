#include "image_queue.h"

#include <Eigen/Cholesky>
#include <chrono>
#include <cmath>
#include <string>
#include <utility>

#include "air_ground_common/covariance.h"
#include "air_ground_common/text.h"

namespace streetview_localizer {

namespace ru = air_ground_common::ros_utils;

namespace {

constexpr double kInertialAge = 2;  // [s]

}  // namespace

void ImageQueue::setCamera(const ru::Calibration& calibration) {
  const std::lock_guard<std::mutex> lock(mutex_);
  calibration_ = calibration;
}

void ImageQueue::add(const ru::ImageMessage& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!calibration_) return health_.count("images without calibration");
  const ros::Time stamp = message.header().stamp;
  if (!last_started_.isZero() && stamp.toSec() - last_started_.toSec() < settings_.min_period) return;
  if (waiting_) ++skipped_;
  waiting_ = Arrival{message, *calibration_, pass_};
  wake_.notify_all();
}

/// Not before its turn: to decompress an image takes tens of milliseconds, which those that are skipped need not cost,
/// nor the callbacks.
std::optional<Job> ImageQueue::jobOf(const Arrival& arrival) const {
  sensor_msgs::Image::ConstPtr msg;
  try {
    msg = arrival.message.pixels();
  } catch (const std::exception& e) {
    health_.count(std::string("images that could not be used: ") + e.what());
    return std::nullopt;
  }
  const CameraModel& camera = arrival.calibration.camera;
  if (static_cast<int>(msg->width) != camera.width || static_cast<int>(msg->height) != camera.height) {
    health_.count("images of another size than their calibration (" + std::to_string(msg->width) + " x " +
                  std::to_string(msg->height) + " against " + std::to_string(camera.width) + " x " +
                  std::to_string(camera.height) + ")");
    return std::nullopt;
  }
  const std::string frame = ru::cameraFrame(settings_.camera_frame, arrival.calibration, *msg);
  return Job{msg, camera, air_ground_common::withoutSlash(frame), arrival.pass};
}

void ImageQueue::addPrediction(const TimedPose& T_world_base) {
  const std::lock_guard<std::mutex> lock(mutex_);
  predictions_.add(T_world_base.stamp, T_world_base);
}

void ImageQueue::addAttitude(const TimedPose& T_map_base) {
  const std::lock_guard<std::mutex> lock(mutex_);
  attitudes_.add(T_map_base.stamp, T_map_base);
  wake_.notify_all();
}

// Images that something flips turn otherwise than the gyro, and their odometry never becomes metric.
void ImageQueue::addStatus(const air_ground::VoStatus& odometry) {
  if (odometry.state != odometry.STATE_TRACKING || !(odometry.tilt_stddev > 0)) return;
  const std::lock_guard<std::mutex> lock(mutex_);
  inertial_ = odometry.header.stamp.toSec();
}

void ImageQueue::reset() {
  const std::lock_guard<std::mutex> lock(mutex_);
  ++pass_;
  waiting_.reset();
  predictions_.clear();
  attitudes_.clear();
  inertial_.reset();
  last_started_ = ros::Time();
}

void ImageQueue::stop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
}

std::optional<Job> ImageQueue::next(const std::function<bool()>& attitudes_come) {
  std::unique_lock<std::mutex> lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return stop_ || waiting_; });
    if (stop_) return std::nullopt;
    const Arrival arrival = *std::exchange(waiting_, std::nullopt);
    last_started_ = arrival.message.header().stamp;
    const std::size_t skipped = std::exchange(skipped_, 0);
    lock.unlock();
    if (skipped) health_.count("images skipped for newer ones while one was worked on", skipped);
    std::optional<Job> job = jobOf(arrival);
    lock.lock();
    if (!job || job->pass != pass_) continue;
    // The attitude of the image's time may come a little later than the image.
    if (attitudes_come())
      wake_.wait_for(lock, std::chrono::duration<double>(settings_.gravity_wait),
                     [&] { return stop_ || attitudes_.newest() >= job->image->header.stamp.toSec(); });
    if (stop_) return std::nullopt;
    return job;
  }
}

bool ImageQueue::isCurrent(const Job& job) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return job.pass == pass_;
}

PosePrior ImageQueue::priorFor(const Job& job, const Pose& T_base_camera, bool use_prediction) {
  PosePrior prior;
  std::optional<TimedPose> predicted, attitude;
  const double stamp = job.image->header.stamp.toSec();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (const TimedPose* pose = predictions_.nearest(stamp, settings_.prior_max_age)) predicted = *pose;
    if (const TimedPose* pose = attitudes_.nearest(stamp, settings_.gravity_max_age)) attitude = *pose;
    prior.not_mirrored = inertial_ && std::abs(stamp - *inertial_) < kInertialAge;
  }
  if (predicted && !use_prediction) {
    // A tracker that is sure of a wrong place would keep the search away from the right one for ever.
    health_.count("predictions set aside: no image near them was located, the whole database is searched");
  } else if (predicted) {
    prior.T_world_camera = predicted->pose * T_base_camera;
    const Eigen::Vector3d lever = predicted->pose.linear() * T_base_camera.translation();
    prior.covariance = air_ground_common::covarianceAt(predicted->covariance, lever);
    const double moved = settings_.prior_speed * std::abs(predicted->stamp - stamp);
    prior.covariance.topLeftCorner<3, 3>() += moved * moved * Eigen::Matrix3d::Identity();
    if (Eigen::LLT<Matrix6d>(prior.covariance).info() != Eigen::Success) {
      prior.T_world_camera.reset();
      health_.count("tracked poses ignored: covariance not positive definite");
    }
  }
  if (attitude) {
    prior.up_camera = (attitude->pose.linear() * T_base_camera.linear()).transpose() * Eigen::Vector3d::UnitZ();
    prior.up_stddev = settings_.gravity_stddev;
  }
  return prior;
}

}  // namespace streetview_localizer
