// Dense reconstruction of the MAV's posed images: depth maps, fused maps and their clouds in the MAV's map frame.
#include <air_ground/PosedDepthMap.h>
#include <air_ground/PosedImage.h>
#include <air_ground/SaveMap.h>
#include <diagnostic_msgs/DiagnosticArray.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <ros/spinner.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/parameters.h"
#include "dense_fusion/guarded.h"
#include "dense_fusion/point_map.h"
#include "node_parameters.h"

namespace dense_fusion {
namespace {

namespace ros_utils = air_ground_common::ros_utils;

constexpr int kOk = 0, kWarn = 1;
constexpr std::size_t kMaxQueueBytes = 512u << 20;  // of waiting images, however large each is

double secondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

diagnostic_msgs::KeyValue entry(const std::string& key, const std::string& value) {
  diagnostic_msgs::KeyValue pair;
  pair.key = key;
  pair.value = value;
  return pair;
}

std::vector<ros_utils::CloudPoint> messagePoints(const std::vector<SurfacePoint>& points) {
  std::vector<ros_utils::CloudPoint> cloud;
  cloud.reserve(points.size());
  for (const SurfacePoint& p : points) {
    if (!p.position.allFinite()) continue;
    ros_utils::CloudPoint point;
    point.position = p.position;
    point.rgb.setConstant(p.intensity);
    point.source = 1;
    cloud.push_back(point);
  }
  return cloud;
}

class DenseFusionNode {
 public:
  explicit DenseFusionNode(const NodeSettings& settings)
      : settings_(settings),
        health_("dense_fusion"),
        mapper_(settings.mapper),
        map_(settings.map_cell, settings.map_max_points) {
    depth_map_publisher_ = handle_.advertise<air_ground::PosedDepthMap>("mav/depth_map", 20);
    cloud_publisher_ = handle_.advertise<sensor_msgs::PointCloud2>("mav/dense_cloud", 20);
    field_publisher_ = handle_.advertise<diagnostic_msgs::DiagnosticArray>("mav/distance_field", 20);
    image_topic_ = handle_.resolveName("mav/posed_image");
    health_.expectInput(image_topic_);
    health_.state(kWarn, "waiting for posed images");
    image_subscriber_ = handle_.subscribe("mav/posed_image", 400, &DenseFusionNode::onImage, this);
    sparse_subscriber_ = handle_.subscribe("mav/sparse_cloud", 5, &DenseFusionNode::onSparseCloud, this);
    // Services wait for the worker, which must not keep the inputs from being received.
    service_handle_.setCallbackQueue(&service_queue_);
    save_service_ = service_handle_.advertiseService("save_map", &DenseFusionNode::saveMap, this);
    flush_service_ = service_handle_.advertiseService("flush", &DenseFusionNode::flush, this);
    reset_service_ = service_handle_.advertiseService("reset", &DenseFusionNode::reset, this);
    last_arrival_ = ros::WallTime::now();
    timer_ = handle_.createWallTimer(ros::WallDuration(0.5), &DenseFusionNode::onTimer, this);
    worker_ = std::thread(&DenseFusionNode::work, this);
    service_spinner_.start();
  }

  ~DenseFusionNode() {
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      stop_ = true;
    }
    queue_changed_.notify_all();
    idle_.notify_all();
    service_spinner_.stop();
    worker_.join();
    autosave_.save("map.ply", [this](const std::string& path) { write(path); });
  }

 private:
  enum Stream { kImages, kSparseClouds, kStreams };

  // ---- Inputs: only queueing happens in the callbacks ---------------------------------------------------------------

  void onImage(const air_ground::PosedImage::ConstPtr& msg) {
    health_.received(image_topic_, msg->header.stamp);
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      if (!gate_.admit(kImages, msg->header.stamp)) return;
      queue_.push_back(msg);
      queue_bytes_ += msg->image.data.size();
      while (queue_.size() > static_cast<std::size_t>(settings_.queue_size) ||
             (queue_bytes_ > kMaxQueueBytes && queue_.size() > 1)) {
        queue_bytes_ -= queue_.front()->image.data.size();
        queue_.pop_front();
        health_.count("images dropped: the queue was full");
      }
      last_arrival_ = ros::WallTime::now();
      flush_due_ = true;
    }
    queue_changed_.notify_all();
  }

  void onSparseCloud(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    try {
      std::size_t dropped = 0;
      std::vector<Eigen::Vector3f> points;
      for (const auto& p : ros_utils::cloudFromMsg(*msg, &dropped)) points.push_back(p.position);
      {
        const std::lock_guard<std::mutex> lock(queue_mutex_);
        if (!gate_.admit(kSparseClouds, msg->header.stamp)) return;
        sparse_points_ = std::move(points);
        sparse_frame_ = msg->header.frame_id;
        sparse_stamp_ = msg->header.stamp;
      }
      queue_changed_.notify_all();
    } catch (const std::exception& e) {
      health_.count(std::string("sparse clouds refused: ") + e.what());
    }
  }

  // Called with the queue locked.
  void onTimeJump() {
    ROS_WARN("time jumped back: the dense map starts afresh");
    forgetInputs();
  }

  // Called with the queue locked.
  void forgetInputs() {
    queue_.clear();
    queue_bytes_ = 0;
    sparse_points_.clear();
    reset_requested_ = true;
  }

  void onTimer(const ros::WallTimerEvent&) {
    if (settings_.flush_timeout <= 0) return;
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      if (!flush_due_ || !queue_.empty() || busy_) return;
      if ((ros::WallTime::now() - last_arrival_).toSec() < settings_.flush_timeout) return;
      flush_due_ = false;
      flush_requested_ = true;
    }
    queue_changed_.notify_all();
  }

  // ---- Services -----------------------------------------------------------------------------------------------------

  // Waits until the worker has emptied the queue and fused what is left. False: it did not come to that in time.
  bool flushAndWait() {
    std::unique_lock<std::mutex> lock(queue_mutex_);
    flush_requested_ = true;
    flush_due_ = false;
    queue_changed_.notify_all();
    const std::chrono::duration<double> patience(settings_.service_timeout);
    return idle_.wait_for(lock, patience, [this] { return stop_ || (!flush_requested_ && !flushing_); }) && !stop_;
  }

  bool flush(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    return ros_utils::answer(response, [&] {
      if (!flushAndWait()) throw std::runtime_error(kNotFlushed);
      const std::lock_guard<std::mutex> lock(map_mutex_);
      return "map holds " + std::to_string(map_.size()) + " points";
    });
  }

  bool saveMap(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
    return ros_utils::answer(response, [&] {
      if (!flushAndWait()) throw std::runtime_error(kNotFlushed);
      response.points = write(request.path);
      return "wrote " + std::to_string(response.points) + " points to " + request.path;
    });
  }

  std::size_t write(const std::string& path) {
    const std::lock_guard<std::mutex> lock(map_mutex_);
    if (map_.size() == 0) throw std::runtime_error("nothing has been reconstructed yet");
    const auto points = messagePoints(map_.points());
    ros_utils::writeCloud(path, points, ros_utils::CloudFields::kXyzIntensity);
    return points.size();
  }

  bool reset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    std::unique_lock<std::mutex> lock(queue_mutex_);
    forgetInputs();
    flush_requested_ = flush_due_ = false;
    queue_changed_.notify_all();
    idle_.wait_for(lock, std::chrono::seconds(30), [this] { return stop_ || !reset_requested_; });
    response.success = !reset_requested_;
    response.message = response.success ? "the dense map starts afresh" : "the reset waits for a fusion to end";
    return true;
  }

  // ---- Worker -------------------------------------------------------------------------------------------------------

  void work() {
    std::unique_lock<std::mutex> lock(queue_mutex_);
    while (true) {
      queue_changed_.wait(lock, [this] { return stop_ || reset_requested_ || flush_requested_ || !queue_.empty(); });
      if (stop_) return;
      busy_ = true;
      runGuarded([&] { step(&lock); }, [this](const std::string& what) { health_.count("failed: " + what); });
      if (!lock.owns_lock()) lock.lock();
      flushing_ = busy_ = false;
      idle_.notify_all();
    }
  }

  // Takes what is due off the queue before it may throw: what fails is not tried for ever.
  void step(std::unique_lock<std::mutex>* lock) {
    if (reset_requested_) {
      reset_requested_ = false;
      startAfresh();
    } else if (!queue_.empty()) {
      const air_ground::PosedImage::ConstPtr msg = queue_.front();
      queue_.pop_front();
      queue_bytes_ -= msg->image.data.size();
      const bool sparse_fit = sparse_frame_ == msg->header.frame_id && sparse_stamp_ >= map_since_;
      mapper_.setSparsePoints(sparse_fit ? sparse_points_ : std::vector<Eigen::Vector3f>());
      lock->unlock();
      process(*msg);
    } else {
      flush_requested_ = false;
      flushing_ = true;
      lock->unlock();
      if (const auto fused = guarded([this] { return mapper_.flush(); })) publish(*fused);
    }
  }

  void startAfresh() {
    mapper_.reset();
    last_stamp_ = ros::Time();
    map_id_.reset();
    const std::lock_guard<std::mutex> lock(map_mutex_);
    map_ = PointMap(settings_.map_cell, settings_.map_max_points);
  }

  template <typename Function>
  std::optional<FusedMap> guarded(const Function& function) {
    try {
      return function();
    } catch (const std::exception& e) {
      health_.count(std::string("input refused: ") + e.what());
      return std::nullopt;
    }
  }

  void process(const air_ground::PosedImage& msg) {
    const auto start = std::chrono::steady_clock::now();
    // A map in the visual frame has no scale and keeps its unit; any other that is not metric will change it.
    const bool own_unit = !msg.metric && msg.header.frame_id == settings_.visual_map_frame;
    if (!msg.metric && !own_unit) {
      health_.state(kWarn, "waiting: the images' poses have no metric scale yet");
      ++without_scale_;
      return;
    }
    if (!map_id_ || *map_id_ != msg.map_id || frame_id_ != msg.header.frame_id) {
      if (map_id_)
        ROS_WARN_STREAM("the MAV's map changed from " << *map_id_ << " to " << msg.map_id
                                                      << ": the dense map starts afresh");
      startAfresh();
      map_id_ = msg.map_id;
      frame_id_ = msg.header.frame_id;
      map_since_ = msg.header.stamp;
    }
    if (own_unit && !followDistance(msg)) return;
    if (!last_stamp_.isZero() && msg.header.stamp <= last_stamp_) {
      health_.count("images refused: repeated or out of order");
      return;
    }
    last_stamp_ = msg.header.stamp;
    camera_frame_ = msg.camera_info.header.frame_id;
    const auto fused = guarded([&] {
      const auto camera = ros_utils::fromMsg(msg.camera_info);
      return mapper_.add(ros_utils::greyFromMsg(msg.image), camera,
                         static_cast<std::int64_t>(msg.header.stamp.toNSec()), ros_utils::fromMsg(msg.pose.pose),
                         msg.depth_min, msg.depth_max, msg.readout_time);
    });
    health_.timing(fused ? "image that completes a fused map [s]" : "image [s]", secondsSince(start));
    const MapperCounters& c = mapper_.counters();
    std::size_t waiting;
    {
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      waiting = queue_.size();
    }
    health_.state(kOk, std::to_string(c.images) + " images, " + std::to_string(c.depth_maps) + " depth maps (" +
                           std::to_string(c.poor_depth_maps) + " too poor), " + std::to_string(c.fused) +
                           " fused maps, " + std::to_string(waiting) + " images waiting, " +
                           std::to_string(without_scale_) + " without scale ignored");
    if (fused) publish(*fused);
  }

  /// False while the scene's distance is not known.
  bool followDistance(const air_ground::PosedImage& msg) {
    const double distance = std::sqrt(static_cast<double>(msg.depth_min) * msg.depth_max);
    if (!(distance > 0) || !std::isfinite(distance)) {
      if (mapper_.unit() != 1) return true;  // the last one known
      health_.state(kWarn, "waiting: the images have no scale, and do not tell the scene's distance either");
      ++without_scale_;
      return false;
    }
    const double before = mapper_.unit();
    if (const auto fused = guarded([&] { return mapper_.followDistance(distance); })) publish(*fused);
    if (before == 1 && mapper_.unit() != 1) {
      const std::lock_guard<std::mutex> lock(map_mutex_);
      map_ = PointMap(settings_.map_cell / mapper_.unit(), settings_.map_max_points);
    }
    return true;
  }

  void publish(const FusedMap& fused) {
    std_msgs::Header header;
    header.stamp.fromNSec(static_cast<std::uint64_t>(fused.depth_map.stamp));
    header.frame_id = frame_id_;
    std_msgs::Header optical = header;
    optical.frame_id = camera_frame_;

    air_ground::PosedDepthMap depth;
    depth.header = header;
    depth.depth = ros_utils::toMsg(fused.depth_map.depth, "32FC1", optical);
    depth.confidence = ros_utils::toMsg(fused.depth_map.confidence, "32FC1", optical);
    depth.intensity = ros_utils::toMsg(fused.depth_map.intensity, "mono8", optical);
    depth.camera_info = ros_utils::toMsg(fused.depth_map.camera, optical);
    depth.pose = ros_utils::toMsg(fused.depth_map.T_map_camera);
    depth.frames = static_cast<std::uint32_t>(fused.depth_map.frames);
    depth.map_id = *map_id_;

    const std::vector<ros_utils::CloudPoint> cloud = messagePoints(fused.points);
    const sensor_msgs::PointCloud2 cloud_msg = ros_utils::toMsg(cloud, ros_utils::CloudFields::kXyzIntensity, header);
    const diagnostic_msgs::DiagnosticArray field = fieldMessage(fused, header);
    {
      // Locked: nothing of the time before a jump or a reset goes out after it.
      const std::lock_guard<std::mutex> lock(queue_mutex_);
      if (reset_requested_) {
        health_.count("fused maps of the time before a jump or reset dropped");
        return;
      }
      depth_map_publisher_.publish(depth);
      cloud_publisher_.publish(cloud_msg);
      field_publisher_.publish(field);
    }
    {
      const std::lock_guard<std::mutex> lock(map_mutex_);
      const double cell = map_.cell();
      health_.count("points left out of the map: not finite, or too far away", map_.add(fused.points));
      if (map_.cell() > cell) health_.count("map_max_points reached: the cells of the map were doubled");
    }
    health_.timing("fusion: votes [s]", fused.timings.votes);
    health_.timing("fusion: minimisation [s]", fused.timings.minimisation);
    health_.timing("fusion: surface [s]", fused.timings.surface);
    ROS_INFO_STREAM("fused map " << mapper_.counters().fused << ": " << fused.depth_maps << " depth maps, "
                                 << cloud.size() << " points, "
                                 << fused.timings.votes + fused.timings.minimisation + fused.timings.surface << " s");
  }

  static diagnostic_msgs::DiagnosticArray fieldMessage(const FusedMap& fused, const std_msgs::Header& header) {
    diagnostic_msgs::DiagnosticArray array;
    array.header = header;
    array.status.resize(1);
    diagnostic_msgs::DiagnosticStatus& status = array.status[0];
    status.name = "dense_fusion: distance field";
    status.hardware_id = "dense_fusion";
    status.message = "fused " + std::to_string(fused.depth_maps) + " depth maps";
    const VoxelGrid& g = fused.grid;
    status.values = {entry("depth maps", std::to_string(fused.depth_maps)),
                     entry("voxels x", std::to_string(g.nx)),
                     entry("voxels y", std::to_string(g.ny)),
                     entry("voxels z", std::to_string(g.nz)),
                     entry("voxel size [m]", std::to_string(g.voxel_size)),
                     entry("origin x [m]", std::to_string(g.origin.x())),
                     entry("origin y [m]", std::to_string(g.origin.y())),
                     entry("origin z [m]", std::to_string(g.origin.z())),
                     entry("points", std::to_string(fused.points.size())),
                     entry("mean support [depth maps]", std::to_string(fused.mean_support)),
                     entry("votes [s]", std::to_string(fused.timings.votes)),
                     entry("minimisation [s]", std::to_string(fused.timings.minimisation)),
                     entry("surface [s]", std::to_string(fused.timings.surface))};
    return array;
  }

  static constexpr const char* kNotFlushed = "images are still waiting or being fused; try again when fewer come in";

  const NodeSettings settings_;
  const ros_utils::Autosave autosave_{settings_.autosave};
  ros::CallbackQueue service_queue_;
  ros::NodeHandle handle_, service_handle_{"~"};
  ros_utils::NodeHealth health_;
  ros::AsyncSpinner service_spinner_{1, &service_queue_};
  ros::Publisher depth_map_publisher_, cloud_publisher_, field_publisher_;
  ros::Subscriber image_subscriber_, sparse_subscriber_;
  ros::ServiceServer save_service_, flush_service_, reset_service_;
  ros::WallTimer timer_;
  std::string image_topic_;

  // Shared with the worker.
  std::mutex queue_mutex_;
  std::condition_variable queue_changed_, idle_;
  std::deque<air_ground::PosedImage::ConstPtr> queue_;
  std::size_t queue_bytes_ = 0;
  ros_utils::StreamGate gate_{kStreams, health_, [this] { onTimeJump(); }};
  std::vector<Eigen::Vector3f> sparse_points_;
  std::string sparse_frame_;
  ros::Time sparse_stamp_;
  ros::WallTime last_arrival_;
  bool stop_ = false, reset_requested_ = false, flush_requested_ = false, flushing_ = false, flush_due_ = false,
       busy_ = false;

  // Touched by the worker only.
  DenseMapper mapper_;
  std::optional<std::uint32_t> map_id_;
  std::string frame_id_, camera_frame_;
  ros::Time last_stamp_, map_since_;
  std::size_t without_scale_ = 0;

  std::mutex map_mutex_;
  PointMap map_;
  std::thread worker_;
};

}  // namespace
}  // namespace dense_fusion

int main(int argc, char** argv) {
  return air_ground_common::ros_utils::runNode<dense_fusion::NodeSettings>(
      argc, argv, "dense_fusion", [](const auto& settings) {
        dense_fusion::DenseFusionNode node(settings);
        ros::spin();
      });
}
