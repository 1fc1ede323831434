// Runs the odometry over a bag, synchronously and as fast as it goes, or as the node does at the bag's own rate: writes
// the trajectory (TUM) and, where the bag holds ground truth, prints the absolute trajectory error and the scale error.
#include <geometry_msgs/PoseStamped.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <deque>
#include <filesystem>
#include <functional>
#include <iostream>
#include <limits>
#include <memory>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "air_ground_common/packet_spreader.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/image_input.h"
#include "air_ground_common/ros/pixel_range.h"
#include "air_ground_common/trajectory.h"
#include "air_ground_common/units.h"
#include "euroc_folder.h"
#include "mav_vo/odometry.h"

namespace {

using air_ground_common::Alignment;
using air_ground_common::kDegree;
using air_ground_common::Pose;
namespace ros_utils = air_ground_common::ros_utils;

void printError(const char* name, const air_ground_common::Trajectory& truth,
                const air_ground_common::Trajectory& estimate) {
  if (estimate.size() < 10) return;
  const auto yaw = air_ground_common::absoluteTrajectoryError(truth, estimate, Alignment::kYawTranslation);
  const auto rigid = air_ground_common::absoluteTrajectoryError(truth, estimate, Alignment::kRigid);
  const auto similar = air_ground_common::absoluteTrajectoryError(truth, estimate, Alignment::kSimilarity);
  std::printf(
      "%s: %zu poses over %.2f m; ATE RMSE yaw-aligned %.4f m (%.3f %% of path), rigid %.4f m (%.3f %%), max %.4f m; "
      "similarity %.4f m, scale error %+.3f %%\n",
      name, yaw.pairs, yaw.path_length, yaw.rmse, 100 * yaw.rmse / yaw.path_length, rigid.rmse,
      100 * rigid.rmse / rigid.path_length, rigid.max, similar.rmse,
      100 * (1 / similar.reference_from_estimate.scale - 1));
}

/// Of a map that never became metric, whose lengths are in a unit of its own.
void printShapeError(const air_ground_common::Trajectory& truth, const air_ground_common::Trajectory& estimate) {
  if (estimate.size() < 10) return;
  const auto similar = air_ground_common::absoluteTrajectoryError(truth, estimate, Alignment::kSimilarity);
  std::printf("last map, not metric: %zu poses over %.2f m; ATE RMSE after similarity alignment %.4f m\n",
              similar.pairs, similar.path_length, similar.rmse);
}

/// What a recording holds beside its data.
struct Setup {
  std::optional<air_ground_common::CameraModel> camera;
  Pose T_base_camera = Pose::Identity(), T_base_imu = Pose::Identity();
};

/// Feeds the odometry, each image once the IMU reaches to it, and keeps what came out.
class OfflineRun {
 public:
  OfflineRun(const Setup& setup, const mav_vo::OdometrySettings& settings, double imu_shift, bool verbose)
      : odometry_(*setup.camera, setup.T_base_camera, setup.T_base_imu, settings),
        T_base_camera_(setup.T_base_camera),
        use_imu_(settings.use_imu),
        imu_shift_(imu_shift),
        verbose_(verbose) {}

  void addImu(mav_vo::ImuSample arrived) {
    arrived.stamp += imu_shift_;
    for (const mav_vo::ImuSample& sample : spreader_.add(arrived)) {
      newest_imu_ = sample.stamp;
      odometry_.addImu(sample);
    }
    drain(false);
  }
  void addImage(double stamp, std::function<cv::Mat()> load) {
    images_.push_back({stamp, std::move(load)});
    drain(false);
  }
  void addTruth(double stamp, const Pose& T_world_base) { truth_.push_back({stamp, T_world_base}); }

  void finish() {
    drain(true);
    odometry_.finish();
    std::sort(times_.begin(), times_.end());
    const std::size_t frames = times_.size();
    std::printf(
        "%zu images, %zu localised (the first after %.2f s), map %u, %zu keyframes, metric after %.2f s, corrected as "
        "a "
        "whole %u times; %.2f ms a frame (median %.2f, 95 %% %.2f, worst %.1f)\n",
        frames, located_, located_at_, odometry_.mapId(), odometry_.map().keyframeCount(), metric_at_,
        last_.map_corrections,
        1e3 * std::accumulate(times_.begin(), times_.end(), 0.0) /
            static_cast<double>(std::max<std::size_t>(1, frames)),
        frames ? 1e3 * times_[frames / 2] : 0, frames ? 1e3 * times_[frames * 95 / 100] : 0,
        frames ? 1e3 * times_.back() : 0);
    if (use_imu_) printInertial();
    printCalibration();
    if (truth_.empty()) return;
    auto final_poses = odometry_.trajectory();
    for (auto& p : final_poses) p.T_map_body = p.T_map_body * T_base_camera_.inverse();
    printError("as published", truth_, online_);
    if (odometry_.metric())
      printError("final       ", truth_, final_poses);
    else
      printShapeError(truth_, final_poses);
  }
  air_ground_common::Trajectory trajectory() const { return odometry_.trajectory(); }
  /// The camera's metric poses, each as it was published.
  air_ground_common::Trajectory published() const {
    auto poses = online_;
    for (auto& p : poses) p.T_map_body = p.T_map_body * T_base_camera_;
    return poses;
  }
  std::string unit() const { return odometry_.metric() ? "" : air_ground_common::kOwnUnit; }

 private:
  struct Image {
    double stamp;
    std::function<cv::Mat()> load;
  };

  void drain(bool all) {
    while (!images_.empty() && (all || !use_imu_ || newest_imu_ >= odometry_.imuNeededAt(images_.front().stamp))) {
      const Image image = std::move(images_.front());
      images_.pop_front();
      process(image.stamp, image.load());
    }
  }

  void process(double stamp, const cv::Mat& gray) {
    if (first_stamp_ < 0) first_stamp_ = stamp;
    const auto r = odometry_.process(stamp, gray);
    last_ = r;
    located_ += r.pose_valid;
    times_.push_back(r.seconds);
    if (r.pose_valid && located_at_ < 0) located_at_ = stamp - first_stamp_;
    if (r.metric && metric_at_ < 0) metric_at_ = stamp - first_stamp_;
    if (r.metric && r.pose_valid) online_.push_back({stamp, r.T_map_base});
    if (!verbose_ || stamp < next_line_) return;
    next_line_ = stamp + 1.0;
    std::printf(
        "%6.2f %-12s map %u tracked %3d inliers %3d keyframes %3zu landmarks %4zu scale %.4f +- %.4f  %.1f ms  %s\n",
        stamp - first_stamp_, mav_vo::toString(r.state), r.map_id, r.tracked, r.inliers, r.keyframes, r.landmarks,
        r.scale, r.scale_stddev, 1e3 * r.seconds, r.reason.c_str());
    if (use_imu_) printInertial();
    printCalibration();
  }

  void printCalibration() const {
    const auto& c = odometry_.camera();
    std::printf("       calibration: f %.1f %.1f px, centre %.1f %.1f px, k1 %.4f, readout time %.1f ms\n", c.fx, c.fy,
                c.cx, c.cy, c.k1, 1e3 * last_.readout_time);
  }

  void printInertial() const {
    const auto& b = last_.imu_bias;
    std::printf(
        "       gyro bias %.4f %.4f %.4f +- %.4f rad/s, accelerometer bias %.3f %.3f %.3f m/s^2, time offset %.2f +- "
        "%.2f "
        "ms, readout time %.2f +- %.2f ms\n",
        b.gyro.x(), b.gyro.y(), b.gyro.z(), last_.gyro_bias_stddev, b.accel.x(), b.accel.y(), b.accel.z(),
        1e3 * last_.time_offset, 1e3 * last_.time_offset_stddev, 1e3 * last_.readout_time,
        1e3 * last_.readout_time_stddev);
    if (last_.imu_rotation_stddev == 0) return;
    const Eigen::AngleAxisd turn(last_.R_given_imu);
    const Eigen::Vector3d v = turn.angle() / kDegree * turn.axis();
    std::printf("       IMU turned from its mounting by %.2f %.2f %.2f degrees (+- %.2f)\n", v.x(), v.y(), v.z(),
                last_.imu_rotation_stddev / kDegree);
  }

  mav_vo::Odometry odometry_;
  Pose T_base_camera_;
  bool use_imu_;
  double imu_shift_;
  bool verbose_;
  std::deque<Image> images_;
  air_ground_common::PacketSpreader<mav_vo::ImuSample> spreader_;
  air_ground_common::Trajectory truth_, online_;
  mav_vo::VoResult last_;
  std::vector<double> times_;
  double newest_imu_ = -1, first_stamp_ = -1, located_at_ = -1, metric_at_ = -1, next_line_ = 0;
  std::size_t located_ = 0;
};

struct Topics {
  std::string image = "/mav/camera/image_raw", info = "/mav/camera/camera_info", imu = "/mav/imu/data",
              truth = "/ground_truth/mav", base = "mav_base_link";
};

/// Calibration and mountings of a bag; no camera when something is missing.
Setup readSetup(const rosbag::Bag& bag, const Topics& topics) {
  Setup setup;
  tf2::BufferCore fixed;
  std::string camera_frame, imu_frame;
  const auto known = [&](const std::string& frame) {
    return !frame.empty() && fixed.canTransform(topics.base, frame, ros::Time(0));
  };
  const auto mounting = [&](const std::string& frame) {
    return ros_utils::fromMsg(fixed.lookupTransform(topics.base, frame, ros::Time(0)).transform);
  };
  for (const rosbag::MessageInstance& m :
       rosbag::View(bag, rosbag::TopicQuery({"/tf_static", topics.info, topics.imu}))) {
    if (const auto tf = m.instantiate<tf2_msgs::TFMessage>())
      for (const auto& t : tf->transforms) fixed.setTransform(t, "bag", true);
    if (const auto info = m.instantiate<sensor_msgs::CameraInfo>(); info && !setup.camera) {
      setup.camera = ros_utils::fromMsg(ros_utils::infoOfImages(*info, topics.image));
      camera_frame = info->header.frame_id;
    }
    if (const auto imu = m.instantiate<sensor_msgs::Imu>(); imu && imu_frame.empty()) imu_frame = imu->header.frame_id;
    if (setup.camera && known(camera_frame) && known(imu_frame)) break;
  }
  if (!known(camera_frame)) {
    std::cerr << "no calibration on " << topics.info << " or no static transform " << topics.base << " <- '"
              << camera_frame << "'\n";
    setup.camera.reset();
    return setup;
  }
  setup.T_base_camera = mounting(camera_frame);
  if (known(imu_frame)) setup.T_base_imu = mounting(imu_frame);
  return setup;
}

/// The images' topic; where the bag holds only compressed ones, theirs.
std::string imageTopic(const rosbag::Bag& bag, const std::string& image) {
  const std::string compressed = image + "/compressed";
  return rosbag::View(bag, rosbag::TopicQuery(image)).size() == 0 &&
                 rosbag::View(bag, rosbag::TopicQuery(compressed)).size() > 0
             ? compressed
             : image;
}

/// One message, its stamp later by `shift` [s].
void runMessage(const rosbag::MessageInstance& m, double shift, const std::shared_ptr<ros_utils::PixelRange>& range,
                OfflineRun& run) {
  if (const auto image = m.instantiate<sensor_msgs::Image>())
    run.addImage(image->header.stamp.toSec() + shift,
                 [image, range] { return ros_utils::greyFromMsg(*range->full(image)); });
  if (const auto image = m.instantiate<sensor_msgs::CompressedImage>())
    run.addImage(image->header.stamp.toSec() + shift,
                 [image, range] { return ros_utils::greyFromMsg(*range->full(ros_utils::decompressed(*image))); });
  if (const auto imu = m.instantiate<sensor_msgs::Imu>()) {
    mav_vo::ImuSample sample;
    sample.stamp = imu->header.stamp.toSec() + shift;
    sample.angular_velocity = {imu->angular_velocity.x, imu->angular_velocity.y, imu->angular_velocity.z};
    sample.specific_force = {imu->linear_acceleration.x, imu->linear_acceleration.y, imu->linear_acceleration.z};
    run.addImu(sample);
  }
  if (const auto pose = m.instantiate<geometry_msgs::PoseStamped>())
    run.addTruth(pose->header.stamp.toSec() + shift, ros_utils::fromMsg(pose->pose));
}

/// `live`: at the rate of the bag, as far as the machine keeps up.
void runBag(const rosbag::Bag& bag, const Topics& topics, double start, double duration, bool live, int rounds,
            OfflineRun& run) {
  constexpr double kBetweenRounds = 0.05;  // [s]
  rosbag::View all(bag);
  const ros::Time begin = all.getBeginTime() + ros::Duration(start);
  const ros::Time end = duration > 0 ? begin + ros::Duration(duration) : all.getEndTime();
  const auto played = std::chrono::steady_clock::now();
  const auto range = std::make_shared<ros_utils::PixelRange>();
  double late = 0;
  for (int round = 0; round < rounds; ++round) {
    const double shift = round * ((end - begin).toSec() + kBetweenRounds);
    for (const rosbag::MessageInstance& m :
         rosbag::View(bag, rosbag::TopicQuery({imageTopic(bag, topics.image), topics.imu, topics.truth}), begin, end)) {
      if (live) {
        const auto due = played + std::chrono::duration<double>((m.getTime() - begin).toSec() + shift);
        const std::chrono::duration<double> behind = std::chrono::steady_clock::now() - due;
        late = std::max(late, behind.count());
        std::this_thread::sleep_for(-behind);
      }
      runMessage(m, shift, range, run);
    }
  }
  if (live) std::printf("live: at most %.2f s behind the bag\n", late);
}

void runFolder(const mav_vo::EurocFolder& folder, double start, double duration, OfflineRun& run) {
  const double begin = folder.images.front().stamp + start;
  const double end = duration > 0 ? begin + duration : std::numeric_limits<double>::infinity();
  if (folder.truth.empty())
    std::printf("no errors below: there is no truth in mav0/state_groundtruth_estimate0 or mav0/mocap0\n");
  for (const auto& pose : folder.truth) run.addTruth(pose.stamp, pose.T_map_body);
  auto imu = folder.imu.begin();
  for (const auto& image : folder.images) {
    if (image.stamp < begin || image.stamp > end) continue;
    for (; imu != folder.imu.end() && imu->stamp <= image.stamp; ++imu) run.addImu(*imu);
    run.addImage(image.stamp, [path = image.path] { return cv::imread(path, cv::IMREAD_GRAYSCALE); });
  }
  for (; imu != folder.imu.end() && imu->stamp <= end + 0.2; ++imu) run.addImu(*imu);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Visual odometry over a bag, or over a folder in the EuRoC layout"};
  std::string path, out, published;
  Topics topics;
  double duration = 0, start = 0, imu_shift = 0;
  bool verbose = false, live = false, replay = false;
  int rounds = 1;
  std::vector<double> calibration;
  mav_vo::OdometrySettings settings;
  app.add_option("recording", path, "bag file, or folder that holds mav0")->required();
  app.add_option("--out", out, "TUM file for the camera's trajectory");
  app.add_option("--published", published, "TUM file for the camera's metric poses, each as it was published");
  app.add_option("--image", topics.image, "image topic");
  app.add_option("--info", topics.info, "calibration topic");
  app.add_option("--imu", topics.imu, "IMU topic");
  app.add_option("--truth", topics.truth, "ground truth topic (pose of base_link)");
  app.add_option("--base", topics.base, "base frame");
  app.add_option("--start", start, "skip so much of the bag [s]");
  app.add_option("--duration", duration, "stop after so much of the bag [s]; 0 = all");
  app.add_option("--rounds", rounds, "so many times over the bag, time going on")->check(CLI::PositiveNumber);
  app.add_option("--calibration", calibration, "fx fy cx cy k1 k2 p1 p2 k3 instead of the bag's")->expected(9);
  app.add_flag("--verbose", verbose, "a line a second");
  app.add_flag("--live", live,
               "at the bag's rate, with the bundle adjustment on a thread of its own, as the node runs");
  app.add_flag("--replay", replay, "with what the node gives in a replay, whose player waits for it")
      ->excludes("--live");
  app.add_option("--seed", settings.seed, "seed");
  app.add_option("--metric-stddev", settings.metric_stddev, "relative scale deviation at which the map becomes metric");
  app.add_option("--reobserve", settings.reobserve_matches, "old landmarks looked for in an image");
  app.add_option("--features", settings.tracker.max_features, "features");
  app.add_option("--fast-threshold", settings.tracker.fast_threshold, "corner threshold [grey levels]");
  app.add_flag("--clahe", settings.tracker.clahe, "local contrast equalisation");
  app.add_option("--min-inliers", settings.min_inliers, "landmarks that must agree on a pose");
  app.add_option("--pixel-sigma", settings.pixel_sigma, "of a feature [px]");
  app.add_option("--keyframe-distance", settings.keyframe_distance, "over the scene's distance");
  app.add_option("--full-interval", settings.full_interval, "between adjustments of the whole map [s]");
  app.add_option("--window", settings.window, "keyframes in the local adjustment");
  app.add_option("--window-duration", settings.window_duration, "that they span [s]");
  app.add_option("--gyro-noise", settings.imu_noise.gyro_density, "[rad/s/sqrt(Hz)]");
  app.add_option("--accel-noise", settings.imu_noise.accel_density, "[m/s^2/sqrt(Hz)]");
  app.add_option("--position-drift", settings.scale.position_drift, "of the visual position [m/sqrt(s)]");
  app.add_option("--start-stddev", settings.scale.start_relative_stddev,
                 "relative scale deviation at which the scale filter starts");
  app.add_flag("--imu-off{false}", settings.use_imu, "without IMU");
  app.add_option("--accel-bias-stddev", settings.scale.accel_bias_stddev, "before the flight [m/s^2]");
  app.add_option("--time-offset", settings.gyro_alignment.time_offset, "t_imu - t_image of the same instant [s]");
  app.add_option("--time-offset-stddev", settings.gyro_alignment.time_offset_stddev, "of that; 0 = exact [s]");
  app.add_option("--readout-time", settings.readout_time, "of a rolling shutter [s]");
  app.add_option("--radial-stddev", settings.radial_stddev, "of the calibration's k1; 0 = exact");
  app.add_option("--readout-time-stddev", settings.readout_time_stddev, "of that; 0 = exact [s]");
  app.add_option("--imu-shift", imu_shift, "added to the IMU's stamps, to try out a time offset [s]");
  CLI11_PARSE(app, argc, argv);
  settings.synchronous = !live && !replay;
  settings.reproducible = replay;

  std::unique_ptr<rosbag::Bag> bag;
  mav_vo::EurocFolder folder;
  Setup setup;
  try {
    if (std::filesystem::is_directory(path)) {
      folder = mav_vo::readEurocFolder(path);
      setup = {folder.camera, folder.T_base_camera, folder.T_base_imu};
    } else {
      bag = std::make_unique<rosbag::Bag>(path, rosbag::bagmode::Read);
      setup = readSetup(*bag, topics);
    }
  } catch (const std::exception& e) {
    std::cerr << path << ": " << e.what() << "\n";
    return 1;
  }
  if (!setup.camera) return 1;
  if (!calibration.empty()) {
    const auto& c = calibration;
    setup.camera = air_ground_common::CameraModel{
        setup.camera->width, setup.camera->height, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]};
  }
  OfflineRun run(setup, settings, imu_shift, verbose);
  if (bag)
    runBag(*bag, topics, start, duration, live, rounds, run);
  else
    runFolder(folder, start, duration, run);
  run.finish();
  if (!out.empty()) air_ground_common::writeTum(out, run.trajectory(), run.unit());
  if (!published.empty()) air_ground_common::writeTum(published, run.published());
  return 0;
}
