// rosrun air_ground simulate --world indoor_boxes_a --seed 1 --out scene.bag
// Renders both robots' sensors into a bag and writes the true mesh beside it.
#include <geometry_msgs/PoseStamped.h>
#include <omp.h>
#include <ros/package.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/FluidPressure.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/MagneticField.h>
#include <sensor_msgs/NavSatFix.h>
#include <sensor_msgs/image_encodings.h>
#include <tf2_msgs/TFMessage.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <deque>
#include <exception>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <set>
#include <sstream>
#include <thread>

#include "air_ground_common/camera_file.h"
#include "air_ground_sim/city.h"
#include "air_ground_sim/positioning.h"
#include "air_ground_sim/recording.h"

namespace {

namespace fs = std::filesystem;
using air_ground_common::Pose;
using namespace air_ground_sim;

constexpr double kStart = 1384300000.0;  // stamp of the recording's time 0 [s]

// Faults of the command line; what is not given there is the world file's.
struct FaultOptions {
  bool all = false, start_in_motion = false;
  std::optional<double> time_offset, readout_time, vibration, clock_offset;
  std::vector<double> gyro_bias, accel_bias;
  std::optional<int> jpeg_quality;
  std::optional<StaticTransforms> tf_static;

  void apply(FaultsConfig* f) const {
    if (all) *f = FaultsConfig::all();
    f->time_offset = time_offset.value_or(f->time_offset);
    f->readout_time = readout_time.value_or(f->readout_time);
    f->vibration = vibration.value_or(f->vibration);
    f->clock_offset = clock_offset.value_or(f->clock_offset);
    if (!gyro_bias.empty()) f->gyro_bias = gyro_bias;
    if (!accel_bias.empty()) f->accel_bias = accel_bias;
    f->start_in_motion = f->start_in_motion || start_in_motion;
    f->jpeg_quality = jpeg_quality.value_or(f->jpeg_quality);
    f->tf_static = tf_static.value_or(f->tf_static);
    f->validate();
  }
};

struct Options {
  std::string world = "indoor_boxes_a", out, cache, compression = "lz4", mav_camera;
  std::uint64_t seed = 1;
  double duration = 0;
  int samples = 0, threads = 0;
  int queries = 0;
  bool no_mav = false, no_ground = false, quiet = false, city_only = false, no_city = false, ground_mag = false;
  FaultOptions faults;
};

ros::Time stampOf(double time) { return ros::Time(kStart + time); }

geometry_msgs::Quaternion toMsg(const Eigen::Matrix3d& R) {
  const Eigen::Quaterniond q(R);
  geometry_msgs::Quaternion m;
  m.x = q.x();
  m.y = q.y();
  m.z = q.z();
  m.w = q.w();
  return m;
}

sensor_msgs::CameraInfo infoOf(const air_ground_common::CameraModel& c, const std::string& frame) {
  sensor_msgs::CameraInfo m;
  m.header.frame_id = frame;
  m.width = c.width;
  m.height = c.height;
  m.distortion_model = c.distortionName();
  m.D = c.distortionCoefficients();
  m.K = {c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1};
  m.R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  m.P = {c.fx, 0, c.cx, 0, 0, c.fy, c.cy, 0, 0, 0, 1, 0};
  return m;
}

geometry_msgs::TransformStamped transform(const std::string& parent, const std::string& child, const Pose& T) {
  geometry_msgs::TransformStamped m;
  m.header.stamp = stampOf(0);
  m.header.frame_id = parent;
  m.child_frame_id = child;
  m.transform.translation.x = T.translation().x();
  m.transform.translation.y = T.translation().y();
  m.transform.translation.z = T.translation().z();
  m.transform.rotation = toMsg(T.linear());
  return m;
}

class Progress {
 public:
  Progress(std::size_t total, bool quiet) : total_(total), quiet_(quiet), begin_(std::chrono::steady_clock::now()) {}
  void step() {
    ++done_;
    if (quiet_ || (done_ % 10 && done_ != total_)) return;
    const double elapsed = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
    const double share = static_cast<double>(done_) / static_cast<double>(total_);
    std::string bar(static_cast<std::size_t>(40 * share), '#');
    bar.resize(40, '.');
    std::fprintf(stderr, "\r[%s] %3.0f %%  %zu of %zu frames  %.0f s, %.0f s to go   %s", bar.c_str(), 100 * share,
                 done_, total_, elapsed, elapsed * (1 / share - 1), done_ == total_ ? "\n" : "");
  }

 private:
  std::size_t total_, done_ = 0;
  bool quiet_;
  std::chrono::steady_clock::time_point begin_;
};

// One camera's frames, rendered ahead on a thread of its own. The two cameras run side by side: on two cores that beats
// sharing each image between them, above all when other programs want the cores too.
template <class Frame>
class FrameStream {
 public:
  FrameStream(int count, int threads, std::function<void(int, Frame*)> render) {
    worker_ = std::thread([this, count, threads, render = std::move(render)] {
      omp_set_num_threads(threads);
      try {
        for (int i = 0; i < count; ++i) {
          Frame frame;
          render(i, &frame);
          std::unique_lock<std::mutex> lock(mutex_);
          changed_.wait(lock, [this] { return stop_ || ready_.size() < kAhead; });
          if (stop_) return;
          ready_.push_back(std::move(frame));
          changed_.notify_all();
        }
      } catch (...) {
        std::lock_guard<std::mutex> lock(mutex_);
        error_ = std::current_exception();
        changed_.notify_all();
      }
    });
  }
  ~FrameStream() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
      changed_.notify_all();
    }
    worker_.join();
  }
  Frame next() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return error_ || !ready_.empty(); });
    if (error_) std::rethrow_exception(error_);
    Frame frame = std::move(ready_.front());
    ready_.pop_front();
    changed_.notify_all();
    return frame;
  }

 private:
  static constexpr std::size_t kAhead = 24;
  std::deque<Frame> ready_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::exception_ptr error_;
  bool stop_ = false;
  std::thread worker_;
};

class BagRecorder {
 public:
  BagRecorder(Recording* recording, const Options& options, const std::string& path)
      : sim_(*recording), options_(options) {
    bag_.open(path, rosbag::bagmode::Write);
    if (options.compression == "lz4") bag_.setCompression(rosbag::compression::LZ4);
    mav_info_ = infoOf(sim_.config().mav_camera.camera, "mav_camera_optical_frame");
    const StreetConfig& street = sim_.config().street;
    if (sim_.config().hasCity()) frame_ = std::make_unique<air_ground_common::LocalFrame>(street.crs, street.origin);
    ground_info_ = infoOf(sim_.config().ground_camera.camera, "ground_camera_optical_frame");
  }

  void run() {
    writeStaticTransforms();
    struct Event {
      double time;      // true
      int kind, index;  // kinds in the order in which events of one time are written
      double recorded;  // time in the bag
    };
    std::vector<Event> events;
    const auto schedule = [&](int kind, double first, double rate, double lateness = 0) {
      for (int i = 0; first + i / rate <= sim_.duration(); ++i) {
        const double time = first + i / rate;
        events.push_back({time, kind, i, time + lateness});
      }
    };
    const SimConfig& c = sim_.config();
    const double late = c.faults.time_offset;
    schedule(kTruth, 0, 100);
    std::size_t frames = 0;
    const auto cameraEvents = [&](int kind, const ImagerConfig& camera) {
      for (int i = 0; i < sim_.frameCount(camera); ++i, ++frames)
        events.push_back({Recording::frameTime(camera, i), kind, i, Recording::frameTime(camera, i)});
    };
    if (!options_.no_mav) {
      schedule(kMavImu, 0, c.imu.rate, late);
      schedule(kMavMag, 0, c.imu.mag_rate, late);
      cameraEvents(kMavImage, c.mav_camera);
      if (frame_ && c.gps.rate > 0) schedule(kGps, 0.1, c.gps.rate);
      if (frame_ && c.barometer.rate > 0) schedule(kPressure, 0, c.barometer.rate);
    }
    if (!options_.no_ground) {
      schedule(kGroundImu, 0, c.imu.rate, late);
      if (c.imu.ground_magnetometer) schedule(kGroundMag, 0, c.imu.mag_rate, late);
      cameraEvents(kGroundImage, c.ground_camera);
    }
    std::stable_sort(events.begin(), events.end(),
                     [](const Event& a, const Event& b) { return a.recorded < b.recorded; });

    const int cameras = (options_.no_mav ? 0 : 1) + (options_.no_ground ? 0 : 1);
    const int threads =
        std::max(1, (options_.threads > 0 ? options_.threads : omp_get_max_threads()) / std::max(1, cameras));
    FrameStream<std::vector<std::uint8_t>> mav(
        options_.no_mav ? 0 : sim_.frameCount(c.mav_camera), threads,
        [this](int i, std::vector<std::uint8_t>* image) { sim_.mavImage(i, image); });
    FrameStream<RgbdFrame> ground(options_.no_ground ? 0 : sim_.frameCount(c.ground_camera), threads,
                                  [this](int i, RgbdFrame* frame) { sim_.groundImage(i, frame); });

    Imu mav_imu = sim_.makeMavImu(), ground_imu = sim_.makeGroundImu();
    Rng mav_mag_noise(mix(options_.seed, 33)), ground_mag_noise(mix(options_.seed, 37));
    GpsReceiver gps(c.gps, mix(options_.seed, 34));
    Barometer barometer(c.barometer, mix(options_.seed, 35));
    Progress progress(frames, options_.quiet);
    for (const Event& e : events) {
      switch (e.kind) {
        case kTruth:
          writeTruth(e.time);
          break;
        case kMavImu:
          writeImu(kMav, e.time, mav_imu.measure(sim_.mav().state(e.time)));
          break;
        case kGroundImu:
          writeImu(kGround, e.time, ground_imu.measure(sim_.ground().state(e.time)));
          break;
        case kMavMag:
          writeMag(kMav, e.time, sim_.mav().pose(e.time) * c.T_mav_base_imu, &mav_mag_noise);
          break;
        case kGroundMag:
          writeMag(kGround, e.time, sim_.ground().pose(e.time) * c.T_ground_base_imu, &ground_mag_noise);
          break;
        case kGps:
          writeGps(e.time, gps.measure(sim_.mav().pose(e.time).translation()));
          break;
        case kPressure:
          writePressure(e.time, barometer.measure(c.street.origin.z() + sim_.mav().pose(e.time).translation().z()));
          break;
        case kMavImage:
          writeMavImage(e.time, e.index, mav.next());
          progress.step();
          break;
        case kGroundImage:
          writeGroundImage(e.time, e.index, ground.next());
          progress.step();
          break;
      }
    }
    bag_.close();
  }

 private:
  enum Kind { kTruth, kMavImu, kGroundImu, kMavMag, kMavImage, kGroundImage, kGps, kPressure, kGroundMag };
  enum Robot { kMav, kGround };

  // A stamp of the robot's own clock; the bag's is the MAV's.
  ros::Time stampOf(Robot robot, double time) const {
    return ::stampOf(robot == kGround ? time + sim_.config().faults.clock_offset : time);
  }
  static std::string nameOf(Robot robot) { return robot == kMav ? "mav" : "ground"; }

  void writeStaticTransforms() {
    const SimConfig& c = sim_.config();
    tf2_msgs::TFMessage m;
    const StaticTransforms mode = c.faults.tf_static;
    m.transforms = {transform("mav_base_link", "mav_camera_optical_frame", c.T_mav_base_camera),
                    transform("mav_base_link", "mav_imu_link", c.T_mav_base_imu)};
    if (c.hasGroundRobot()) {
      m.transforms.push_back(transform("ground_base_link", "ground_camera_optical_frame", c.T_ground_base_camera));
      m.transforms.push_back(transform("ground_base_link", "ground_imu_link", c.T_ground_base_imu));
    }
    if (mode == StaticTransforms::kLatched) return writeStaticTransforms(m, true, "/simulate");
    int count = 0;
    for (const auto& transform : m.transforms) {
      tf2_msgs::TFMessage one;
      one.transforms = {transform};
      if (mode == StaticTransforms::kSplit)
        writeStaticTransforms(one, false, "/simulate");
      else
        writeStaticTransforms(one, true, "/static_publisher_" + std::to_string(++count));
    }
  }

  void writeStaticTransforms(const tf2_msgs::TFMessage& m, bool latching, const std::string& publisher) {
    auto header = boost::make_shared<ros::M_string>();
    if (latching) (*header)["latching"] = "1";
    (*header)["callerid"] = publisher;
    (*header)["type"] = ros::message_traits::datatype(m);
    (*header)["md5sum"] = ros::message_traits::md5sum(m);
    (*header)["message_definition"] = ros::message_traits::definition(m);
    bag_.write("/tf_static", ::stampOf(0), m, header);
  }

  void writeTruth(double time) {
    const auto write = [&](Robot robot, const BodyTrajectory& body) {
      geometry_msgs::PoseStamped m;
      m.header.stamp = stampOf(robot, time);
      m.header.frame_id = "world";
      const Pose T = body.pose(time);
      m.pose.position.x = T.translation().x();
      m.pose.position.y = T.translation().y();
      m.pose.position.z = T.translation().z();
      m.pose.orientation = toMsg(T.linear());
      bag_.write("/ground_truth/" + nameOf(robot), ::stampOf(time), m);
    };
    if (!options_.no_mav) write(kMav, sim_.mav());
    if (!options_.no_ground) write(kGround, sim_.ground());
  }

  void writeImu(Robot robot, double time, const ImuReading& reading) {
    const ImuConfig& c = sim_.config().imu;
    const double late = time + sim_.config().faults.time_offset;
    sensor_msgs::Imu m;
    m.header.stamp = stampOf(robot, late);
    m.header.frame_id = nameOf(robot) + "_imu_link";
    m.orientation_covariance[0] = -1;  // no orientation estimate
    m.angular_velocity.x = reading.angular_velocity.x();
    m.angular_velocity.y = reading.angular_velocity.y();
    m.angular_velocity.z = reading.angular_velocity.z();
    m.linear_acceleration.x = reading.specific_force.x();
    m.linear_acceleration.y = reading.specific_force.y();
    m.linear_acceleration.z = reading.specific_force.z();
    for (int i = 0; i < 3; ++i) {
      m.angular_velocity_covariance[4 * i] = c.gyro_noise * c.gyro_noise * c.rate;
      m.linear_acceleration_covariance[4 * i] = c.accel_noise * c.accel_noise * c.rate;
    }
    bag_.write("/" + nameOf(robot) + "/imu/data", ::stampOf(late), m);
  }

  void writeMag(Robot robot, double time, const Pose& T_world_imu, Rng* noise) {
    const SimConfig& c = sim_.config();
    const double late = time + c.faults.time_offset;
    Eigen::Vector3d field = earthMagneticField();
    if (c.imu.mag_disturbance > 0)
      field += magneticDisturbance(T_world_imu.translation(), c.imu.mag_disturbance, mix(options_.seed, 36));
    field = T_world_imu.linear().transpose() * field;
    sensor_msgs::MagneticField m;
    m.header.stamp = stampOf(robot, late);
    m.header.frame_id = nameOf(robot) + "_imu_link";
    for (int i = 0; i < 3; ++i) {
      field[i] += c.imu.mag_noise * noise->gaussian();
      m.magnetic_field_covariance[4 * i] = c.imu.mag_noise * c.imu.mag_noise;
    }
    m.magnetic_field.x = field.x();
    m.magnetic_field.y = field.y();
    m.magnetic_field.z = field.z();
    bag_.write("/" + nameOf(robot) + "/imu/mag", ::stampOf(late), m);
  }

  void writeGps(double time, const Eigen::Vector3d& position) {
    const air_ground_common::Geodetic place = frame_->toGeodetic(position);
    const GpsConfig& c = sim_.config().gps;
    sensor_msgs::NavSatFix m;
    m.header.stamp = ::stampOf(time);
    m.header.frame_id = "mav_base_link";
    m.status.status = sensor_msgs::NavSatStatus::STATUS_FIX;
    m.status.service = sensor_msgs::NavSatStatus::SERVICE_GPS;
    m.latitude = place.latitude;
    m.longitude = place.longitude;
    m.altitude = place.height + sim_.config().street.geoid_undulation;  // above the ellipsoid
    m.position_covariance = {c.stated_stddev * c.stated_stddev,    0, 0, 0, c.stated_stddev * c.stated_stddev, 0, 0, 0,
                             4 * c.stated_stddev * c.stated_stddev};
    m.position_covariance_type = sensor_msgs::NavSatFix::COVARIANCE_TYPE_APPROXIMATED;
    bag_.write("/gps/fix", m.header.stamp, m);
  }

  void writePressure(double time, double pressure) {
    sensor_msgs::FluidPressure m;
    m.header.stamp = ::stampOf(time);
    m.header.frame_id = "mav_base_link";
    m.fluid_pressure = pressure;
    m.variance = std::pow(sim_.config().barometer.noise, 2);
    bag_.write("/barometer", m.header.stamp, m);
  }

  sensor_msgs::Image image(const sensor_msgs::CameraInfo& info, const std::string& encoding,
                           int bytes_per_pixel) const {
    sensor_msgs::Image m;
    m.header = info.header;
    m.width = info.width;
    m.height = info.height;
    m.encoding = encoding;
    m.step = info.width * bytes_per_pixel;
    return m;
  }

  // As it is, or as a driver with image_transport's compressed plugin publishes it.
  void writeImage(const std::string& topic, double time, const sensor_msgs::Image& m) {
    const int quality = sim_.config().faults.jpeg_quality;
    if (quality == 0) return bag_.write(topic, ::stampOf(time), m);
    const bool grey = m.encoding == sensor_msgs::image_encodings::MONO8;
    cv::Mat pixels(static_cast<int>(m.height), static_cast<int>(m.width), grey ? CV_8UC1 : CV_8UC3,
                   const_cast<std::uint8_t*>(m.data.data()), m.step);
    cv::Mat bgr;
    if (!grey) cv::cvtColor(pixels, bgr, cv::COLOR_RGB2BGR);
    sensor_msgs::CompressedImage jpeg;
    jpeg.header = m.header;
    jpeg.format = m.encoding + "; jpeg compressed " + (grey ? "" : "bgr8");
    cv::imencode(".jpg", grey ? pixels : bgr, jpeg.data, {cv::IMWRITE_JPEG_QUALITY, quality});
    bag_.write(topic + "/compressed", ::stampOf(time), jpeg);
  }

  void writeMavImage(double time, int index, std::vector<std::uint8_t> pixels) {
    mav_info_.header.stamp = stampOf(kMav, time);
    mav_info_.header.seq = index;
    sensor_msgs::Image m = image(mav_info_, sensor_msgs::image_encodings::MONO8, 1);
    m.data.swap(pixels);
    writeImage("/mav/camera/image_raw", time, m);
    bag_.write("/mav/camera/camera_info", ::stampOf(time), mav_info_);
  }

  void writeGroundImage(double time, int index, RgbdFrame frame) {
    ground_info_.header.stamp = stampOf(kGround, time);
    ground_info_.header.seq = index;
    sensor_msgs::Image rgb = image(ground_info_, sensor_msgs::image_encodings::RGB8, 3);
    rgb.data.swap(frame.rgb);
    sensor_msgs::Image depth = image(ground_info_, sensor_msgs::image_encodings::TYPE_16UC1, 2);
    depth.data.resize(2 * frame.depth_mm.size());
    std::memcpy(depth.data.data(), frame.depth_mm.data(), depth.data.size());
    writeImage("/ground/rgb/image_raw", time, rgb);
    bag_.write("/ground/rgb/camera_info", ::stampOf(time), ground_info_);
    bag_.write("/ground/depth/image_raw", ::stampOf(time), depth);
  }

  Recording& sim_;
  const Options& options_;
  rosbag::Bag bag_;
  std::unique_ptr<air_ground_common::LocalFrame> frame_;  // of street worlds
  sensor_msgs::CameraInfo mav_info_, ground_info_;
};

std::string worldFile(const std::string& world) {
  if (world.size() > 5 && world.substr(world.size() - 5) == ".yaml") {
    if (!fs::exists(world)) throw std::invalid_argument("no world file '" + world + "'");
    return world;
  }
  const std::string package = ros::package::getPath("air_ground");
  if (package.empty())
    throw std::runtime_error(
        "the package air_ground is not found: source the workspace's setup.bash, or give --world a .yaml file");
  const fs::path folder = fs::path(package) / "config" / "worlds";
  const fs::path file = folder / (world + ".yaml");
  if (fs::exists(file)) return file.string();
  std::string names;
  if (fs::exists(folder))
    for (const auto& entry : fs::directory_iterator(folder))
      if (entry.path().extension() == ".yaml") names += " " + entry.path().stem().string();
  throw std::invalid_argument("no world '" + world + "' in " + folder.string() + "; there are:" + names);
}

// Hash of everything that decides the recording's content: the world's parameters, the options, the simulator's own
// sources.
std::string contentKey(const std::string& world_file, const SimConfig& config, const Options& o) {
  std::ifstream in(world_file);
  std::stringstream text;
  text << in.rdbuf() << '|' << AIR_GROUND_SIM_SOURCES;
  if (!config.street.facade_images.empty()) {
    std::set<fs::path> images;
    for (const auto& entry : fs::directory_iterator(config.street.facade_images)) images.insert(entry.path());
    for (const fs::path& image : images)
      if (fs::is_regular_file(image)) text << '|' << image.filename() << std::ifstream(image, std::ios::binary).rdbuf();
  }
  text << '|' << o.seed << '|' << o.duration << '|' << o.samples << '|' << o.no_mav << '|' << o.no_ground << '|'
       << config.imu.ground_magnetometer << '|' << config.faults.describe() << '|'
       << air_ground_common::cameraFileText(config.mav_camera.camera, "");
  std::uint64_t h = 0;
  for (const char c : text.str()) h = mix(h ^ static_cast<unsigned char>(c));
  char hex[17];
  std::snprintf(hex, sizeof hex, "%016llx", static_cast<unsigned long long>(h));
  return hex;
}

// What is wrong with the recording, for whoever compares estimates with it.
void writeFaults(const Recording& recording, const std::string& path) {
  std::ofstream out(path);
  const Eigen::IOFormat list(Eigen::StreamPrecision, Eigen::DontAlignCols, ", ", ", ", "", "", "[", "]");
  out << "# What is wrong with the recording, in metres, seconds, radians. docs/air_ground_sim.md says what each "
         "means.\n"
      << recording.config().faults.describe() << "# At time 0, in the inertial units' frames.\n";
  const auto write = [&](const char* robot, const Imu& imu) {
    out << robot << "_gyro_bias: " << imu.gyroBias().format(list) << '\n'
        << robot << "_accel_bias: " << imu.accelBias().format(list) << '\n';
  };
  write("mav", recording.makeMavImu());
  if (recording.config().hasGroundRobot()) write("ground", recording.makeGroundImu());
  if (!out.flush()) throw std::runtime_error("cannot write " + path);
}

void renderCity(const SimConfig& config, const Options& o, const std::string& folder) {
  const Street street = planStreet(config.street, o.seed);
  if (!o.quiet)
    std::cerr << "city: " << street.buildings.size() << " buildings, " << street.panoramas.size() << " panoramas ..."
              << std::endl;
  std::unique_ptr<Progress> progress;
  writeCity(config, street, folder, [&](int, int all) {
    if (!progress) progress = std::make_unique<Progress>(all, o.quiet);
    progress->step();
  });
}

int simulate(Options o) {
  const std::string file = worldFile(o.world);
  SimConfig config = loadSimConfig(file);
  if (o.duration > 0) config.flight.duration = o.duration;
  if (config.flight.duration < 6)
    throw std::invalid_argument("--duration must be at least 6 s: standing still and take-off need them");
  o.faults.apply(&config.faults);
  config.imu.ground_magnetometer = config.imu.ground_magnetometer || o.ground_mag;
  if (o.samples > 0) config.mav_camera.samples = config.ground_camera.samples = o.samples;
  if (!o.mav_camera.empty()) config.mav_camera.camera = air_ground_common::readCameraFile(o.mav_camera);
  if (!o.cache.empty()) {
    fs::create_directories(o.cache);
    o.out =
        (fs::path(o.cache) / (config.name + "_" + std::to_string(o.seed) + "_" + contentKey(file, config, o) + ".bag"))
            .string();
  }
  if (o.out.empty()) throw std::invalid_argument("give --out FILE.bag or --cache DIR");
  if (fs::path(o.out).extension() != ".bag") throw std::invalid_argument("--out must end in .bag");
  if (o.threads > 0) omp_set_num_threads(o.threads);

  const std::string stem = o.out.substr(0, o.out.size() - 4), city = stem + ".city";
  const auto isWanted = [&](bool asked, const std::string& file) {
    return asked && (o.cache.empty() || !fs::exists(file));
  };
  if (!config.hasCity() && (o.city_only || o.queries > 0))
    throw std::invalid_argument("--city-only and --queries need a street world");
  o.no_ground = o.no_ground || !config.hasGroundRobot();
  if (isWanted(config.hasCity() && !o.no_city, city + "/city.yaml")) renderCity(config, o, city);
  const bool queries = isWanted(o.queries > 0, city + "/queries_truth.csv"), bag = isWanted(!o.city_only, o.out);
  if (!queries && !bag) {
    std::cout << (o.city_only ? city : o.out) << std::endl;
    return 0;
  }

  if (!o.quiet) std::cerr << "building world " << config.name << ", seed " << o.seed << " ..." << std::endl;
  Recording recording(config, o.seed);
  if (!o.quiet)
    std::cerr << recording.scene().mesh().triangles.size() << " triangles, " << recording.scene().texelCount() / 1000000
              << " million texels; flight " << recording.mav().pathLength(0, recording.duration()) << " m, drive "
              << (config.hasGroundRobot() ? recording.ground().pathLength(0, recording.duration()) : 0.0) << " m in "
              << recording.duration() << " s" << std::endl;
  if (queries) writeQueries(&recording, o.queries, city);
  if (!bag) {
    std::cout << (o.city_only ? city : o.out) << std::endl;
    return 0;
  }

  // Under a temporary name until complete: nobody reads half a bag.
  const std::string part = o.out + "." + std::to_string(getpid()) + ".part";
  const std::string mesh = stem + ".world.ply";
  try {
    air_ground_common::writePly(mesh, recording.scene().mesh());
    if (config.faults.any()) writeFaults(recording, stem + ".faults.yaml");
    BagRecorder(&recording, o, part).run();
    fs::rename(part, o.out);
  } catch (...) {
    std::error_code ignored;
    fs::remove(part, ignored);
    throw;
  }
  std::cout << o.out << std::endl;
  return 0;
}

}  // namespace

void addFaultOptions(CLI::App* app, FaultOptions* f) {
  const std::map<std::string, StaticTransforms> modes = {{"latched", StaticTransforms::kLatched},
                                                         {"split", StaticTransforms::kSplit},
                                                         {"publishers", StaticTransforms::kPublishers}};
  const std::string group = "Faults (section `faults` of a world file; what is used is written to x.faults.yaml)";
  app->add_option_function<std::string>(
         "--faults", [f](const std::string&) { f->all = true; },
         "all: time offset 0.02 s, readout 0.02 s, vibration 1 m/s^2, biases of 0.08 rad/s and 0.3 m/s^2, start in\n"
         "motion, JPEG 80 at once; an option beside it replaces its value")
      ->check(CLI::IsMember({"all"}))
      ->group(group);
  app->add_option(
         "--time-offset", f->time_offset,
         "stamps of the IMUs (and magnetometers) are late by this against the images': stamp = true time + S [s]")
      ->group(group);
  app->add_option("--readout-time", f->readout_time,
                  "rolling shutters of all cameras: row r is seen at stamp + (r / height - 1/2) S [s]")
      ->group(group);
  app->add_option("--vibration", f->vibration,
                  "of the IMUs, 30 to 120 Hz: root mean square of each accelerometer's axis [m/s^2]")
      ->group(group);
  app->add_option("--gyro-bias", f->gyro_bias,
                  "at time 0: its norm, in a direction drawn by the seed, or three numbers [rad/s]")
      ->expected(1, 3)
      ->group(group);
  app->add_option("--accel-bias", f->accel_bias, "likewise [m/s^2]")->expected(1, 3)->group(group);
  app->add_flag("--start-in-motion", f->start_in_motion, "begins after take-off and the ground robot's setting off")
      ->group(group);
  app->add_option(
         "--jpeg", f->jpeg_quality,
         "quality 1 to 100: sensor_msgs/CompressedImage on <topic>/compressed in place of raw images (depth stays)")
      ->group(group);
  app->add_option("--tf-static", f->tf_static,
                  "latched: one message; split: a message a transform, not latched; publishers: each by a latching\n"
                  "publisher of its own")
      ->transform(CLI::CheckedTransformer(modes))
      ->group(group);
  app->add_option("--clock-offset", f->clock_offset, "the ground robot's clock is ahead of the MAV's by this [s]")
      ->group(group);
}

int main(int argc, char** argv) {
  Options o;
  CLI::App app{
      "Renders a simulated air-ground recording into a rosbag, with the true mesh beside it (x.world.ply).\n"
      "Same world, seed and options give the same messages."};
  app.add_option("--world", o.world, "name of a file in config/worlds, or a path to a .yaml file")
      ->capture_default_str();
  app.add_option("--seed", o.seed, "varies layout, textures, light, ways and noise")->capture_default_str();
  app.add_option("--out", o.out, "bag to write");
  app.add_option("--cache", o.cache,
                 "instead of --out: folder of bags named by a hash of their parameters; renders only what is missing, "
                 "prints the path");
  app.add_option("--duration", o.duration, "length of the recording [s]; default: the world file's");
  app.add_option("--spp", o.samples, "rays a pixel; default: the world file's")->check(CLI::Range(1, 64));
  app.add_option("--mav-camera", o.mav_camera,
                 "calibration of the MAV's camera (camera_info YAML), for example config/cameras/fisheye_150.yaml");
  app.add_option("--threads", o.threads, "default: all cores")->check(CLI::Range(1, 1024));
  app.add_option("--compression", o.compression, "lz4 or none")
      ->check(CLI::IsMember({"lz4", "none"}))
      ->capture_default_str();
  app.add_flag("--no-mav", o.no_mav, "leave out the MAV");
  app.add_flag("--no-ground", o.no_ground, "leave out the ground robot");
  app.add_flag("--city-only", o.city_only,
               "street worlds: only the folder x.city of panoramas, geotags, model and truth, no bag");
  app.add_flag("--no-city", o.no_city, "street worlds: no such folder");
  app.add_option("--queries", o.queries,
                 "street worlds: so many pictures of the flight in x.city/queries, with their truth")
      ->check(CLI::Range(0, 100000));
  app.add_flag("--ground-mag", o.ground_mag, "a magnetometer on the ground robot, too: /ground/imu/mag");
  addFaultOptions(&app, &o.faults);
  app.add_flag("--quiet", o.quiet, "no progress bar");
  CLI11_PARSE(app, argc, argv);
  try {
    return simulate(o);
  } catch (const std::exception& e) {
    std::cerr << "simulate: " << e.what() << std::endl;
    return 1;
  }
}
