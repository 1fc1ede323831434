// Plays a Recording's sensors into a rosbag.
#pragma once

#include <rosbag/bag.h>
#include <tf2_msgs/TFMessage.h>

#include <memory>
#include <string>
#include <vector>

#include "air_ground_common/geodesy.h"
#include "air_ground_sim/positioning.h"
#include "air_ground_sim/recording.h"
#include "progress.h"
#include "sensor_messages.h"

namespace air_ground_sim {

constexpr double kRecordingStart = 1384300000.0;  ///< stamp of the recording's time 0 [s]

struct RecorderOptions {
  bool mav = true, ground = true;
  bool lz4 = true;
  int threads = 0;  ///< 0: all cores
  bool quiet = false;
};

class BagRecorder {
 public:
  BagRecorder(Recording* recording, const RecorderOptions& options, const std::string& path);
  void run();

 private:
  // In the order in which events of one time are written.
  enum Kind { kTruth, kMavImu, kGroundImu, kMavMag, kMavImage, kGroundImage, kGps, kPressure, kGroundMag };
  enum Robot { kMav, kGround };
  struct Event {
    double time;  // true [s]
    Kind kind;
    int index;
    double recorded;  // time in the bag [s]
  };
  struct Sensors;

  std::vector<Event> schedule() const;
  void scheduleRate(Kind kind, double first, double rate, double lateness, std::vector<Event>* events) const;
  void scheduleFrames(Kind kind, const ImagerConfig& camera, std::vector<Event>* events) const;
  void writeEvent(const Event& event, Sensors* sensors);

  std_msgs::Header headerOf(Robot robot, const std::string& frame, double time) const;
  void writeStaticTransforms();
  void writeStaticTransforms(const tf2_msgs::TFMessage& message, bool latching, const std::string& publisher);
  void writeTruth(Robot robot, double time);
  void writeImu(Robot robot, double time, const ImuReading& reading);
  void writeMag(Robot robot, double time, Magnetometer* magnetometer);
  void writeGps(double time, const Eigen::Vector3d& position);
  void writePressure(double time, double pressure);
  void writeImage(const std::string& topic, double time, const sensor_msgs::Image& image);
  void writeMavImage(double time, int index, std::vector<std::uint8_t> pixels);
  void writeGroundImage(double time, int index, RgbdFrame frame);

  Recording& sim_;
  RecorderOptions options_;
  rosbag::Bag bag_;
  std::unique_ptr<air_ground_common::LocalFrame> frame_;  // of street worlds
  std::vector<bool> lost_mav_images_, lost_ground_images_;
  sensor_msgs::CameraInfo mav_info_, ground_info_;
};

}  // namespace air_ground_sim
