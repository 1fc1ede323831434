#include "recorder.h"

#include <geometry_msgs/PoseStamped.h>
#include <omp.h>
#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <cstring>

#include "air_ground_common/ros/conversions.h"
#include "frame_stream.h"

namespace air_ground_sim {
namespace {

namespace encodings = sensor_msgs::image_encodings;
using air_ground_common::Pose;

ros::Time stampOf(double time) { return ros::Time(kRecordingStart + time); }

// The calibration as it is published.
sensor_msgs::CameraInfo infoOf(air_ground_common::CameraModel camera, const FaultsConfig& faults,
                               const std::string& frame) {
  std_msgs::Header header;
  header.frame_id = frame;
  camera.fx *= 1 + faults.focal_error;
  camera.fy *= 1 + faults.focal_error;
  sensor_msgs::CameraInfo info = air_ground_common::ros_utils::toMsg(camera, header);
  info.D.at(0) += faults.radial_error;
  return info;
}

}  // namespace

// What has memory while the recording runs.
struct BagRecorder::Sensors {
  Sensors(Recording* sim, const RecorderOptions& o, std::size_t frames)
      : mav_imu(sim->makeMavImu()),
        ground_imu(sim->makeGroundImu()),
        mav_mag(sim->config().imu, mix(sim->seed(), 33), mix(sim->seed(), 36)),
        ground_mag(sim->config().imu, mix(sim->seed(), 37), mix(sim->seed(), 36)),
        gps(sim->config().gps, mix(sim->seed(), 34)),
        barometer(sim->config().barometer, mix(sim->seed(), 35)),
        progress(frames, o.quiet),
        threads(std::max(1, (o.threads > 0 ? o.threads : omp_get_max_threads()) / std::max(1, o.mav + o.ground))),
        mav_images(o.mav ? sim->frameCount(sim->config().mav_camera) : 0, threads,
                   [sim](int i, std::vector<std::uint8_t>* image) { sim->mavImage(i, image); }),
        ground_images(o.ground ? sim->frameCount(sim->config().ground_camera) : 0, threads,
                      [sim](int i, RgbdFrame* frame) { sim->groundImage(i, frame); }) {}

  Imu mav_imu, ground_imu;
  Magnetometer mav_mag, ground_mag;
  GpsReceiver gps;
  Barometer barometer;
  Progress progress;
  int threads;  // of each camera
  FrameStream<std::vector<std::uint8_t>> mav_images;
  FrameStream<RgbdFrame> ground_images;
};

BagRecorder::BagRecorder(Recording* recording, const RecorderOptions& options, const std::string& path)
    : sim_(*recording), options_(options) {
  const SimConfig& c = sim_.config();
  options_.ground = options.ground && c.hasGroundRobot();
  bag_.open(path, rosbag::bagmode::Write);
  if (options.lz4) bag_.setCompression(rosbag::compression::LZ4);
  if (c.hasCity()) frame_ = std::make_unique<air_ground_common::LocalFrame>(c.street.crs, c.street.origin);
  mav_info_ = infoOf(c.mav_camera.camera, c.faults, "mav_camera_optical_frame");
  lost_mav_images_ = lostImages(c.faults.lost_images, sim_.frameCount(c.mav_camera), mix(sim_.seed(), 38));
  lost_ground_images_ = lostImages(c.faults.lost_images, sim_.frameCount(c.ground_camera), mix(sim_.seed(), 39));
  ground_info_ = infoOf(c.ground_camera.camera, c.faults, "ground_camera_optical_frame");
}

void BagRecorder::run() {
  writeStaticTransforms();
  const std::vector<Event> events = schedule();
  Sensors sensors(&sim_, options_, std::count_if(events.begin(), events.end(), [](const Event& e) {
    return e.kind == kMavImage || e.kind == kGroundImage;
  }));
  for (const Event& event : events) writeEvent(event, &sensors);
  bag_.close();
}

void BagRecorder::scheduleRate(Kind kind, double first, double rate, double lateness,
                               std::vector<Event>* events) const {
  for (int i = 0; first + i / rate <= sim_.duration(); ++i) {
    const double time = first + i / rate;
    events->push_back({time, kind, i, time + lateness});
  }
}

void BagRecorder::scheduleFrames(Kind kind, const ImagerConfig& camera, std::vector<Event>* events) const {
  for (int i = 0; i < sim_.frameCount(camera); ++i) {
    const double time = Recording::frameTime(camera, i);
    events->push_back({time, kind, i, time});
  }
}

std::vector<BagRecorder::Event> BagRecorder::schedule() const {
  const SimConfig& c = sim_.config();
  const double late = c.faults.time_offset;
  std::vector<Event> events;
  scheduleRate(kTruth, 0, 100, 0, &events);
  if (options_.mav) {
    scheduleRate(kMavImu, 0, c.imu.rate, late, &events);
    scheduleRate(kMavMag, 0, c.imu.mag_rate, late, &events);
    scheduleFrames(kMavImage, c.mav_camera, &events);
    if (frame_ && c.gps.rate > 0) scheduleRate(kGps, 0.1, c.gps.rate, 0, &events);
    if (frame_ && c.barometer.rate > 0) scheduleRate(kPressure, 0, c.barometer.rate, 0, &events);
  }
  if (options_.ground) {
    scheduleRate(kGroundImu, 0, c.imu.rate, late, &events);
    if (c.imu.ground_magnetometer) scheduleRate(kGroundMag, 0, c.imu.mag_rate, late, &events);
    scheduleFrames(kGroundImage, c.ground_camera, &events);
  }
  std::stable_sort(events.begin(), events.end(),
                   [](const Event& a, const Event& b) { return a.recorded < b.recorded; });
  return events;
}

void BagRecorder::writeEvent(const Event& e, Sensors* s) {
  switch (e.kind) {
    case kTruth:
      if (options_.mav) writeTruth(kMav, e.time);
      if (options_.ground) writeTruth(kGround, e.time);
      return;
    case kMavImu:
      return writeImu(kMav, e.time, s->mav_imu.measure(sim_.mav().state(e.time)));
    case kGroundImu:
      return writeImu(kGround, e.time, s->ground_imu.measure(sim_.ground().state(e.time)));
    case kMavMag:
      return writeMag(kMav, e.time, &s->mav_mag);
    case kGroundMag:
      return writeMag(kGround, e.time, &s->ground_mag);
    case kGps:
      return writeGps(e.time, s->gps.measure(sim_.mav().pose(e.time).translation()));
    case kPressure:
      return writePressure(
          e.time, s->barometer.measure(sim_.config().street.origin.z() + sim_.mav().pose(e.time).translation().z()));
    case kMavImage:
      writeMavImage(e.time, e.index, s->mav_images.next());
      return s->progress.step();
    case kGroundImage:
      writeGroundImage(e.time, e.index, s->ground_images.next());
      return s->progress.step();
  }
}

// Stamped by the robot's own clock; the bag's is the MAV's.
std_msgs::Header BagRecorder::headerOf(Robot robot, const std::string& frame, double time) const {
  std_msgs::Header h;
  h.stamp = stampOf(robot == kGround ? time + sim_.config().faults.clock_offset : time);
  h.frame_id = frame;
  return h;
}

void BagRecorder::writeStaticTransforms() {
  const SimConfig& c = sim_.config();
  const auto mounted = [](const std::string& robot, const std::string& child, const Pose& T) {
    std_msgs::Header h;
    h.stamp = stampOf(0);
    h.frame_id = robot + "_base_link";
    return transformMessage(h, robot + child, T);
  };
  tf2_msgs::TFMessage all;
  all.transforms = {mounted("mav", "_camera_optical_frame", c.T_mav_base_camera),
                    mounted("mav", "_imu_link", c.T_mav_base_imu)};
  if (c.hasGroundRobot()) {
    all.transforms.push_back(mounted("ground", "_camera_optical_frame", c.T_ground_base_camera));
    all.transforms.push_back(mounted("ground", "_imu_link", c.T_ground_base_imu));
  }
  if (c.faults.tf_static == StaticTransforms::kLatched) return writeStaticTransforms(all, true, "/simulate");
  int count = 0;
  for (const auto& transform : all.transforms) {
    tf2_msgs::TFMessage one;
    one.transforms = {transform};
    if (c.faults.tf_static == StaticTransforms::kSplit)
      writeStaticTransforms(one, false, "/simulate");
    else
      writeStaticTransforms(one, true, "/static_publisher_" + std::to_string(++count));
  }
}

void BagRecorder::writeStaticTransforms(const tf2_msgs::TFMessage& m, bool latching, const std::string& publisher) {
  auto header = boost::make_shared<ros::M_string>();
  if (latching) (*header)["latching"] = "1";
  (*header)["callerid"] = publisher;
  (*header)["type"] = ros::message_traits::datatype(m);
  (*header)["md5sum"] = ros::message_traits::md5sum(m);
  (*header)["message_definition"] = ros::message_traits::definition(m);
  bag_.write("/tf_static", stampOf(0), m, header);
}

void BagRecorder::writeTruth(Robot robot, double time) {
  const BodyTrajectory& body = robot == kMav ? sim_.mav() : sim_.ground();
  geometry_msgs::PoseStamped m;
  m.header = headerOf(robot, "world", time);
  m.pose = air_ground_common::ros_utils::toMsg(body.pose(time));
  bag_.write(robot == kMav ? "/ground_truth/mav" : "/ground_truth/ground", stampOf(time), m);
}

void BagRecorder::writeImu(Robot robot, double time, const ImuReading& reading) {
  const double stamp = time + sim_.config().faults.time_offset;
  const std::string name = robot == kMav ? "mav" : "ground";
  bag_.write("/" + name + "/imu/data", stampOf(stamp),
             imuMessage(headerOf(robot, name + "_imu_link", stamp), reading, sim_.config().imu));
}

void BagRecorder::writeMag(Robot robot, double time, Magnetometer* magnetometer) {
  const SimConfig& c = sim_.config();
  const double stamp = time + c.faults.time_offset;
  const std::string name = robot == kMav ? "mav" : "ground";
  const Pose T_world_imu =
      robot == kMav ? sim_.mav().pose(time) * c.T_mav_base_imu : sim_.ground().pose(time) * c.T_ground_base_imu;
  bag_.write(
      "/" + name + "/imu/mag", stampOf(stamp),
      magneticMessage(headerOf(robot, name + "_imu_link", stamp), magnetometer->measure(T_world_imu), c.imu.mag_noise));
}

void BagRecorder::writeGps(double time, const Eigen::Vector3d& position) {
  const SimConfig& c = sim_.config();
  bag_.write("/gps/fix", stampOf(time),
             fixMessage(headerOf(kMav, "mav_base_link", time), frame_->toGeodetic(position), c.street.geoid_undulation,
                        c.gps.stated_stddev));
}

void BagRecorder::writePressure(double time, double pressure) {
  bag_.write("/barometer", stampOf(time),
             pressureMessage(headerOf(kMav, "mav_base_link", time), pressure, sim_.config().barometer.noise));
}

// As it is, or as a driver with image_transport's compressed plugin publishes it.
void BagRecorder::writeImage(const std::string& topic, double time, const sensor_msgs::Image& image) {
  const int quality = sim_.config().faults.jpeg_quality;
  if (quality > 0)
    bag_.write(topic + "/compressed", stampOf(time), jpegMessage(image, quality));
  else
    bag_.write(topic, stampOf(time), image);
}

void BagRecorder::writeMavImage(double time, int index, std::vector<std::uint8_t> pixels) {
  if (lost_mav_images_[index]) return;
  mav_info_.header = headerOf(kMav, mav_info_.header.frame_id, time);
  mav_info_.header.seq = index;
  writeImage("/mav/camera/image_raw", time, imageMessage(mav_info_, encodings::MONO8, 1, std::move(pixels)));
  bag_.write("/mav/camera/camera_info", stampOf(time), mav_info_);
}

void BagRecorder::writeGroundImage(double time, int index, RgbdFrame frame) {
  if (lost_ground_images_[index]) return;
  ground_info_.header = headerOf(kGround, ground_info_.header.frame_id, time);
  ground_info_.header.seq = index;
  std::vector<std::uint8_t> depth(2 * frame.depth_mm.size());
  std::memcpy(depth.data(), frame.depth_mm.data(), depth.size());
  writeImage("/ground/rgb/image_raw", time, imageMessage(ground_info_, encodings::RGB8, 3, std::move(frame.rgb)));
  bag_.write("/ground/rgb/camera_info", stampOf(time), ground_info_);
  const double depth_time = time + sim_.config().faults.depth_delay;
  ground_info_.header.stamp = headerOf(kGround, "", depth_time).stamp;
  bag_.write("/ground/depth/image_raw", stampOf(depth_time),
             imageMessage(ground_info_, encodings::TYPE_16UC1, 2, std::move(depth)));
}

}  // namespace air_ground_sim
