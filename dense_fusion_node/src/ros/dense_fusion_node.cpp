// Dense reconstruction of the MAV's posed images: depth maps, fused maps and their clouds in the MAV's map frame.
#include <air_ground/PosedImage.h>
#include <air_ground/SaveMap.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <ros/spinner.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>

#include <cmath>
#include <thread>

#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/ros/parameters.h"
#include "dense_fusion/guarded.h"
#include "fused_map_publisher.h"
#include "map_store.h"
#include "node_parameters.h"
#include "work_queue.h"

namespace dense_fusion {
namespace {

namespace ros_utils = air_ground_common::ros_utils;

class DenseFusionNode {
 public:
  explicit DenseFusionNode(const NodeSettings& settings)
      : settings_(settings),
        health_("dense_fusion"),
        max_latency_(settings.player_waits ? 0 : settings.max_latency),
        queue_(static_cast<std::size_t>(settings.queue_size), max_latency_, health_),
        map_(settings_, health_),
        publisher_(handle_, map_, queue_, health_),
        mapper_(settings.mapper) {
    image_topic_ = handle_.resolveName("mav/posed_image");
    health_.expectInput(image_topic_, false);  // the first ones take a map
    health_.state(health_.kWarn, "waiting for posed images");
    image_subscriber_ = handle_.subscribe("mav/posed_image", 400, &DenseFusionNode::onImage, this);
    sparse_subscriber_ = handle_.subscribe("mav/sparse_cloud", 5, &DenseFusionNode::onSparseCloud, this);
    corrected_subscriber_ = handle_.subscribe<nav_msgs::Path>(
        "mav/corrected_path", 20, [this](const nav_msgs::Path::ConstPtr& msg) { queue_.add(msg); });
    // Services wait for the worker, which must not keep the inputs from being received.
    service_handle_.setCallbackQueue(&service_queue_);
    save_service_ = service_handle_.advertiseService("save_map", &DenseFusionNode::saveMap, this);
    flush_service_ = service_handle_.advertiseService("flush", &DenseFusionNode::flush, this);
    reset_service_ = service_handle_.advertiseService("reset", &DenseFusionNode::reset, this);
    if (settings_.flush_timeout > 0)
      timer_ = handle_.createWallTimer(
          ros::WallDuration(0.5), [this](const ros::WallTimerEvent&) { queue_.flushAfter(settings_.flush_timeout); });
    worker_ = std::thread(&DenseFusionNode::work, this);
    service_spinner_.start();
  }

  ~DenseFusionNode() {
    queue_.stop();
    service_spinner_.stop();
    worker_.join();
    autosave_.save("map.ply", [this](const std::string& path) { map_.write(path); });
  }

 private:
  // ---- Inputs: only queueing happens in the callbacks ---------------------------------------------------------------

  void onImage(const air_ground::PosedImage::ConstPtr& msg) {
    if (!images_come_) health_.expectInput(image_topic_);
    images_come_ = true;
    health_.received(image_topic_, msg->header.stamp);
    queue_.add(msg);
  }

  void onSparseCloud(const sensor_msgs::PointCloud2::ConstPtr& msg) {
    try {
      SparseCloud cloud{{}, msg->header.frame_id, msg->header.stamp};
      std::size_t dropped = 0;
      for (const auto& p : ros_utils::cloudFromMsg(*msg, &dropped)) cloud.points.push_back(p.position);
      queue_.add(std::move(cloud));
    } catch (const std::exception& e) {
      health_.count(std::string("sparse clouds refused: ") + e.what());
    }
  }

  // ---- Services -----------------------------------------------------------------------------------------------------

  void flushAndWait() {
    if (!queue_.flushAndWait(settings_.service_timeout))
      throw std::runtime_error("images are still waiting or being fused; try again when fewer come in");
  }

  bool flush(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    return ros_utils::answer(response, [&] {
      flushAndWait();
      return "map holds " + std::to_string(map_.size()) + " points";
    });
  }

  bool saveMap(air_ground::SaveMap::Request& request, air_ground::SaveMap::Response& response) {
    return ros_utils::answer(response, [&] {
      const std::string path = ros_utils::absolutePath(request.path);
      flushAndWait();
      response.points = map_.write(path);
      return "wrote " + std::to_string(response.points) + " points to " + path;
    });
  }

  bool reset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    response.success = queue_.resetAndWait(30);
    response.message = response.success ? "the dense map starts afresh" : "the reset waits for a fusion to end";
    return true;
  }

  // ---- Worker -------------------------------------------------------------------------------------------------------

  void work() {
    while (const auto work = queue_.next()) {
      runGuarded([&] { perform(*work); }, [this](const std::string& what) { health_.count("failed: " + what); });
      queue_.done();
    }
  }

  void perform(const Work& work) {
    mapper_.makeViews(publisher_.depthMapsWanted());
    switch (work.kind) {
      case Work::Kind::kReset:
        saveEndedMap();
        return startMap();
      case Work::Kind::kImage: {
        const air_ground::PosedImage& msg = *work.image;
        const bool sparse_fit =
            work.sparse && work.sparse->frame == msg.header.frame_id && work.sparse->stamp >= map_since_;
        mapper_.setSparsePoints(sparse_fit ? work.sparse->points : std::vector<Eigen::Vector3f>());
        return process(msg);
      }
      case Work::Kind::kCorrection:
        return correct(*work.corrected);
      case Work::Kind::kFlush:
        if (const auto fused = guarded([this] { return mapper_.flush(); })) publish(*fused);
    }
  }

  void startMap() {
    mapper_.reset();
    last_stamp_ = ros::Time();
    map_id_.reset();
    publisher_.startMap();
    map_.reset();
  }

  /// The map has ended, and with it what save_map writes.
  void keepEndedMap() {
    if (const auto fused = guarded([this] { return mapper_.flush(); })) map_.add(fused->depth_map.stamp, fused->points);
    saveEndedMap();
  }

  void saveEndedMap() {
    map_.thin();
    if (map_.size() == 0) return;
    autosave_.save("map_map" + std::to_string(++ended_maps_) + ".ply",
                   [this](const std::string& path) { map_.write(path); });
  }

  void correct(const nav_msgs::Path& msg) {
    if (!map_id_ || msg.header.frame_id != frame_id_ || msg.header.stamp < map_since_) return;  // of another map
    map_.correct(mapper_.correct(ros_utils::fromMsg(msg)));
    queue_.unlessReset([&] { publisher_.publish(mapper_.corrections(), msg.header, *map_id_); });
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
    const ros::WallTime start = ros::WallTime::now();
    health_.value("lag [s]", queue_.lag(msg.header.stamp));
    // A map in the visual frame has no scale and keeps its unit; any other that is not metric will change it.
    const bool own_unit = !msg.metric && msg.header.frame_id == settings_.visual_map_frame;
    if (!msg.metric && !own_unit) {
      // What there is stays for save_map, but is no part of the map that others know by now.
      if (map_id_ != msg.map_id || map_revision_ != msg.map_revision) publisher_.startMap();
      health_.state(health_.kWarn, "waiting: the images' poses have no metric scale yet");
      ++without_scale_;
      return;
    }
    const bool other = map_id_ != msg.map_id || frame_id_ != msg.header.frame_id;
    if (other || map_revision_ != msg.map_revision) {
      if (map_id_) {
        ROS_WARN("the MAV's %s: the dense map starts afresh", other ? "map is another" : "calibration has changed");
        keepEndedMap();
      }
      startMap();
      map_id_ = msg.map_id;
      map_revision_ = msg.map_revision;
      frame_id_ = msg.header.frame_id;
      map_since_ = msg.header.stamp;
    }
    if (!followDistance(msg, own_unit)) return;
    if (!last_stamp_.isZero() && msg.header.stamp <= last_stamp_) {
      health_.count("images refused: repeated or out of order");
      return;
    }
    last_stamp_ = msg.header.stamp;
    camera_frame_ = msg.camera_info.header.frame_id;
    const auto fused = guarded([&] {
      const auto camera = ros_utils::fromMsg(msg.camera_info);
      return mapper_.add(ros_utils::greyFromMsg(msg), camera, static_cast<std::int64_t>(msg.header.stamp.toNSec()),
                         ros_utils::fromMsg(msg.pose.pose), msg.depth_min, msg.depth_max, msg.readout_time);
    });
    health_.timing(fused ? "image that completes a fused map [s]" : "image [s]",
                   (ros::WallTime::now() - start).toSec());
    sayState(msg);
    if (fused) publish(*fused);
  }

  void sayState(const air_ground::PosedImage& msg) {
    constexpr std::size_t kPoorInARow = 5;
    const double most_lag = max_latency_ > 0 ? 0.8 * max_latency_ : 10;  // [s]
    const MapperCounters& c = mapper_.counters();
    if (c.depth_maps != good_depth_maps_) {
      good_depth_maps_ = c.depth_maps;
      poor_before_ = c.poor_depth_maps;
    }
    const std::size_t poor = c.poor_depth_maps - poor_before_;
    const double lag = queue_.lag(msg.header.stamp);
    const bool bad = poor >= kPoorInARow, late = lag > most_lag;
    std::ostringstream state;
    if (bad) {
      state << "no depth: the last " << poor << " depth maps are too poor, "
            << mapper_.whyPoor(msg.metric ? " m" : " of the map's units");
      ROS_WARN_STREAM_THROTTLE(60, "dense fusion has " << state.str());
      state << "; ";
    }
    if (late)
      state << "too slow: " << std::lround(lag) << " s behind the newest image; lower image/scale, or raise threads; ";
    state << c.images << " images (" << c.redundant << " hardly moved), " << c.depth_maps << " depth maps ("
          << c.poor_depth_maps << " too poor), " << c.fused << " fused maps (" << c.small_groups
          << " groups too small, map corrected " << c.corrections << " times, " << c.given_up
          << " given up since it has bent there), " << queue_.imagesWaiting() << " images waiting, " << without_scale_
          << " without scale ignored";
    health_.state(bad || late ? health_.kWarn : health_.kOk, state.str());
  }

  static double sceneDistance(const air_ground::PosedImage& msg) {
    return std::sqrt(static_cast<double>(msg.depth_min) * msg.depth_max);
  }

  /// False while the unit rests on the scene's distance, and that is not known.
  bool followDistance(const air_ground::PosedImage& msg, bool own_unit) {
    const double distance = sceneDistance(msg);
    if (!(distance > 0) || !std::isfinite(distance)) {
      if (!own_unit || mapper_.unit() != 1) return true;  // the last one known
      health_.state(health_.kWarn, "waiting: the images have no scale, and do not tell the scene's distance either");
      ++without_scale_;
      return false;
    }
    const double before = mapper_.unit();
    const auto fused =
        guarded([&] { return own_unit ? mapper_.followDistance(distance) : mapper_.followMetricDistance(distance); });
    if (fused) publish(*fused);
    if (own_unit && mapper_.unit() != before) map_.followUnit(mapper_.unit());
    return true;
  }

  void publish(const FusedMap& fused) {
    map_.add(fused.depth_map.stamp, fused.points);  // before anybody can ask for what was published
    const bool valid = queue_.unlessReset([&] { publisher_.publish(fused, frame_id_, camera_frame_, *map_id_); });
    map_.thin();
    if (!valid) return health_.count("fused maps of the time before a jump or reset dropped");
    health_.timing("fusion: votes [s]", fused.timings.votes);
    health_.timing("fusion: minimisation [s]", fused.timings.minimisation);
    health_.timing("fusion: surface [s]", fused.timings.surface);
    ROS_INFO_STREAM("fused map " << mapper_.counters().fused << ": " << fused.depth_maps << " depth maps, "
                                 << fused.points.size() << " points, "
                                 << fused.timings.votes + fused.timings.minimisation + fused.timings.surface << " s");
  }

  const NodeSettings settings_;
  const ros_utils::Autosave autosave_{settings_.autosave};
  ros::CallbackQueue service_queue_;
  ros::NodeHandle handle_, service_handle_{"~"};
  ros_utils::NodeHealth health_;
  ros::AsyncSpinner service_spinner_{1, &service_queue_};
  const double max_latency_;  ///< [s]; 0: any
  WorkQueue queue_;
  ros::Subscriber image_subscriber_, sparse_subscriber_, corrected_subscriber_;
  ros::ServiceServer save_service_, flush_service_, reset_service_;
  ros::WallTimer timer_;
  std::string image_topic_;
  bool images_come_ = false;

  MapStore map_;
  // Touched by the worker only.
  FusedMapPublisher publisher_;
  DenseMapper mapper_;
  std::optional<std::uint32_t> map_id_;
  std::uint32_t map_revision_ = 0;
  std::string frame_id_, camera_frame_;
  ros::Time last_stamp_, map_since_;
  std::size_t without_scale_ = 0;
  int ended_maps_ = 0;                                 // kept
  std::size_t good_depth_maps_ = 0, poor_before_ = 0;  // when the last good depth map came

  std::thread worker_;
};

}  // namespace
}  // namespace dense_fusion

int main(int argc, char** argv) {
  using namespace dense_fusion;
  return air_ground_common::ros_utils::runNode<NodeSettings, DenseFusionNode>(argc, argv, "dense_fusion");
}
