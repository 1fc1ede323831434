// Global localization of the MAV in the ground robot's map (Forster 2013, VI): dense clouds and the ground map in,
// coarse alignment with its verdict out.
#include <ros/ros.h>
#include <std_srvs/Trigger.h>

#include <thread>

#include "air_ground_common/ros/alignment_broadcaster.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/renewable_subscriber.h"
#include "air_ground_common/text.h"
#include "compass_input.h"
#include "heightmap_mcl/earlier_clouds.h"
#include "inbox.h"
#include "messages.h"

namespace heightmap_mcl {
namespace {

namespace ros_utils = air_ground_common::ros_utils;

std::optional<std::vector<Eigen::Vector3f>> positionsOf(const sensor_msgs::PointCloud2& msg, const std::string& what,
                                                        ros_utils::NodeHealth& health) {
  const auto points = ros_utils::readCloud(msg, what, health);
  if (!points) return std::nullopt;
  std::vector<Eigen::Vector3f> result;
  result.reserve(points->size());
  for (const auto& p : *points) result.push_back(p.position);
  return result;
}

std::optional<std::vector<Eigen::Vector3f>> groundPositions(const sensor_msgs::PointCloud2& msg, double resolution,
                                                            ros_utils::NodeHealth& health) {
  const auto points = ros_utils::readCloud(msg, "ground clouds", health);
  if (!points) return std::nullopt;
  std::vector<Eigen::Vector3f> positions;
  std::vector<float> hidden_from;
  for (const auto& p : *points) {
    positions.push_back(p.position);
    hidden_from.push_back(p.hidden_from);
  }
  auto result = withoutHiddenTops(positions, hidden_from, resolution);
  health.value("ground points below what hides the space above them",
               static_cast<double>(positions.size() - result.size()));
  return result;
}

/// What of a cloud is searched where it is larger than its map may be. Empty: all of it, but for a few points far away.
std::string cropping(const std::string& robot, const std::vector<Eigen::Vector3f>& points, std::size_t cropped,
                     double scale, double max_extent, const std::string& part) {
  constexpr double kOutliers = 0.01;
  if (static_cast<double>(cropped) <= kOutliers * static_cast<double>(points.size())) return "";
  Eigen::AlignedBox2f box;
  for (const auto& p : points) box.extend(p.head<2>());
  const std::string parameter = (robot == "ground" ? "ground" : "air") + std::string("/max_extent");
  return air_ground_common::formatted(
      "the %s cloud of %.0f x %.0f m is larger than %s (%.0f m): only %s is searched, %zu of %zu points are left out. "
      "Raise %s in heightmap_mcl_config to search all of it; time and memory grow with its square "
      "(docs/heightmap_mcl.md, Limits)",
      robot.c_str(), scale * box.sizes().x(), scale * box.sizes().y(), parameter.c_str(), max_extent, part.c_str(),
      cropped, points.size(), parameter.c_str());
}

}  // namespace

class HeightmapMclNode {
 public:
  explicit HeightmapMclNode(const NodeSettings& settings)
      : private_handle_("~"),
        settings_(settings),
        health_("heightmap_mcl"),
        inbox_(settings_, health_, [this] { ground_sub_->renew(); }),
        localizer_(settings_.localizerSettings()),
        earlier_(settings_.localizerSettings()) {
    setPrior(settings_.prior);
    height_map_air_ = handle_.advertise<air_ground::HeightMap>("alignment/height_map_air", 5);
    height_map_ground_ = handle_.advertise<air_ground::HeightMap>("alignment/height_map_ground", 1, true);
    costmap_ = handle_.advertise<nav_msgs::OccupancyGrid>("alignment/costmap", 1, true);
    particles_ = handle_.advertise<geometry_msgs::PoseArray>("alignment/particles", 5);
    coarse_ = handle_.advertise<air_ground::AlignmentEstimate>("alignment/coarse", 20, true);

    cloud_sub_ = handle_.subscribe<sensor_msgs::PointCloud2>("mav/dense_cloud", 50, [this](const Cloud& msg) {
      health_.received(cloud_topic_, msg->header.stamp);
      inbox_.addAerial(msg);
    });
    ground_sub_.emplace([this] {
      return handle_.subscribe<sensor_msgs::PointCloud2>("ground/map_cloud", 5, [this](const Cloud& msg) {
        health_.received(ground_topic_, msg->header.stamp);
        inbox_.addGround(msg);
      });
    });
    ground_status_sub_ = handle_.subscribe("ground/slam_status", 100, &Inbox::addGroundStatus, &inbox_);
    corrections_sub_ = handle_.subscribe("mav/cloud_corrections", 20, &Inbox::addCorrections, &inbox_);
    odometry_sub_ = handle_.subscribe("mav/odometry", 500, &Inbox::addOdometry, &inbox_);
    status_sub_ = handle_.subscribe("mav/vo_status", 500, &Inbox::addMavStatus, &inbox_);
    guess_sub_ = handle_.subscribe("initialpose", 1, &Inbox::setInitialPose, &inbox_);
    if (settings_.compass) compass_.emplace(handle_, health_, settings_.prior.yaw_sigma);
    health_.expectInput(cloud_topic_, false);
    health_.expectInput(ground_topic_, false);
    reset_ = private_handle_.advertiseService("reset", &HeightmapMclNode::onReset, this);
    relocalize_ = private_handle_.advertiseService("relocalize", &HeightmapMclNode::onRelocalize, this);
    if (settings_.publish_tf) broadcaster_.emplace(settings_.tf_rate, [this] { return inbox_.alignment(); });
    worker_ = std::thread([this] { work(); });
  }

  ~HeightmapMclNode() {
    inbox_.stop();
    worker_.join();
  }

 private:
  using Cloud = sensor_msgs::PointCloud2ConstPtr;

  bool onReset(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    inbox_.reset();
    response.success = true;
    response.message = "both maps forgotten; waiting for new clouds";
    return true;
  }

  bool onRelocalize(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    inbox_.relocalize();
    response.success = true;
    response.message = "searching again on the maps at hand";
    return true;
  }

  void work() {
    // Before clouds that were left behind are searched [s]; and between two of them, times as long as one takes:
    // odometry needs the processor, but for a MAV that has sent nothing for so long [s].
    constexpr double kQuiet = 1, kRest = 4, kRestLanded = 1, kLanded = 5;
    std::optional<double> patience;
    ros::WallTime last_cloud = ros::WallTime::now();
    const auto converged = [this] { return localizer_.estimate().status == Status::kConverged; };
    while (const auto work = inbox_.next(patience, converged())) {
      const ros::WallTime start = ros::WallTime::now();
      try {
        applyCommand(work->command);
        useCompass();
        localizer_.setOwnUnit(work->own_unit);
        earlier_.setOwnUnit(work->own_unit);
        localizer_.setVertical(work->vertical);
        earlier_.setVertical(work->vertical);
        if (work->corrections) {
          localizer_.correct(*work->corrections);
          earlier_.correct(*work->corrections);
        }
        const bool searched_with_cloud = work->aerial.cloud && !work->ground_corrected && converged();
        if (work->ground) useGround(work->ground, work->ground_corrected, searched_with_cloud);
        for (const AerialMessage& msg : work->passed_by) keepForLater(msg, work->own_unit);
        for (const AerialMessage& msg : work->before) useAerial(msg, work->own_unit, false);
        if (work->aerial.cloud) {
          last_cloud = start;
          useAerial(work->aerial, work->own_unit, true);
        }
        work->idle ? searchEarlier(*work) : publish(*work);
      } catch (const std::exception& e) {
        health_.count(std::string("maps not usable: ") + e.what());
      }
      patience.reset();
      const double rest = (start - last_cloud).toSec() > kLanded ? kRestLanded : kRest;
      if (!converged() && earlier_.pending())
        patience = work->idle ? rest * (ros::WallTime::now() - start).toSec() : kQuiet;
    }
  }

  void setPrior(const Prior& prior) {
    localizer_.setPrior(prior);
    earlier_.setPrior(prior);
  }

  void applyCommand(const Command& command) {
    if (command.forgets()) setPrior(settings_.prior);
    if (command.prior) setPrior(*command.prior);
    if (command.forgets() || command.prior) heading_known_ = false;
    guessed_ = command.prior ? command.prior->position.has_value() : guessed_ && !command.forgets();
    if (compass_ && (command.reset || command.forget_aerial)) compass_->forgetMav();
    if (compass_ && (command.reset || command.forget_ground)) compass_->forgetGround();
    if (command.reset || command.forget_ground) {
      localizer_.forgetGround();
      earlier_.forgetGround();
    }
    if (command.reset || command.forget_aerial || command.relocalize)
      localizer_.restart(command.reset || command.forget_aerial);
    if (command.reset || command.forget_aerial) {
      aerial_stamp_ = ros::Time();
      earlier_.forgetAerial();
    }
  }

  /// A person's guess of the pose comes before the compass.
  void useCompass() {
    const auto prior = compass_ && !guessed_ ? compass_->prior() : std::nullopt;
    if (!prior) return;
    heading_known_ ? localizer_.setPrior(*prior) : setPrior(*prior);
    if (!heading_known_) localizer_.restart(false);
    heading_known_ = true;
  }

  void useGround(const Cloud& msg, bool corrected, bool searched_with_cloud) {
    const ros::WallTime start = ros::WallTime::now();
    auto points = groundPositions(*msg, settings_.localizer.ground_map.resolution, health_);
    if (!points) return;
    std::size_t cropped = 0;
    const bool usable = searched_with_cloud ? localizer_.keepGround(*points, &cropped)
                                            : localizer_.setGround(*points, &cropped, corrected);
    if (!usable) health_.count("ground clouds that define no cell");
    health_.value("ground points beyond ground/max_extent", static_cast<double>(cropped));
    const HeightMap& map = localizer_.groundMap();
    const Eigen::Vector2d low(map.origin_x, map.origin_y), size(map.width, map.height);
    const Eigen::Vector2d high = low + map.resolution * size;
    const std::string said =
        cropping("ground", *points, cropped, 1, settings_.localizer.ground_map.max_extent,
                 air_ground_common::formatted("where it is densest, x %.0f to %.0f and y %.0f to %.0f m,", low.x(),
                                              high.x(), low.y(), high.y()));
    if (!said.empty()) ROS_WARN_STREAM_THROTTLE(60, said);
    earlier_.setGround(std::move(*points), map.defined(), corrected);
    ground_stamp_ = msg->header.stamp;
    health_.timing("ground map", (ros::WallTime::now() - start).toSec());
  }

  std::optional<AerialCloud> aerialCloud(const AerialMessage& msg, bool own_unit) {
    auto points = positionsOf(*msg.cloud, "aerial clouds", health_);
    if (!points) return std::nullopt;
    AerialCloud cloud;
    cloud.points = std::move(*points);
    cloud.stamp = static_cast<std::int64_t>(msg.cloud->header.stamp.toNSec());
    if (msg.reference) {
      cloud.reference = msg.reference->T_map_body.translation();
      return cloud;
    }
    // Any point known in mav_map can carry the particles; only what "the MAV's position" means is lost.
    if (!own_unit)
      health_.count("aerial clouds without odometry at their stamp: the cloud's middle stands for the MAV");
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const auto& p : cloud.points) sum += p.cast<double>();
    cloud.reference = sum / static_cast<double>(cloud.points.size());
    return cloud;
  }

  void keepForLater(const AerialMessage& msg, bool own_unit) {
    auto cloud = aerialCloud(msg, own_unit);
    if (cloud) earlier_.add(std::move(*cloud), false);
  }

  void useAerial(const AerialMessage& msg, bool own_unit, bool search) {
    const ros::WallTime start = ros::WallTime::now();
    auto usable = aerialCloud(msg, own_unit);
    if (!usable) return;
    AerialCloud& cloud = *usable;
    heading_ = msg.reference ? air_ground_common::yawOf(msg.reference->T_map_body.rotation()) : 0;
    std::size_t cropped = 0;
    const std::size_t far = localizer_.farMapsDropped();
    const bool added = search ? localizer_.addAerial(cloud, &cropped) : localizer_.keepAerial(cloud, &cropped);
    // At a scale that is not known yet the size says nothing.
    const CoarseEstimate& e = localizer_.estimate();
    if (own_unit && e.status != Status::kConverged) cropped = 0;
    health_.value("aerial points beyond air/max_extent", static_cast<double>(cropped));
    const std::string said = cropping("aerial", cloud.points, cropped, own_unit ? e.scale : 1,
                                      settings_.localizer.air_map.max_extent, "its densest part of that edge");
    if (!said.empty()) ROS_WARN_STREAM_THROTTLE(60, said);
    health_.count("aerial maps dropped: farther than air/max_extent from the newest",
                  localizer_.farMapsDropped() - far);
    if (!added) {
      health_.count("aerial clouds that define no cell");
      return;
    }
    aerial_stamp_ = msg.cloud->header.stamp;
    earlier_.add(std::move(cloud));
    health_.timing("aerial map", (ros::WallTime::now() - start).toSec());
  }

  /// The MAV has flown on, or landed; the ground robot may have come to where it was before.
  void searchEarlier(const Work& work) {
    const ros::WallTime start = ros::WallTime::now();
    const auto found = earlier_.step();
    health_.timing("clouds left behind", (ros::WallTime::now() - start).toSec());
    if (!found || work.ground_frame.empty() || work.mav_frame.empty()) return;
    ROS_INFO("Coarse alignment %s on clouds that the MAV has left behind: %s", toString(found->estimate.status),
             found->estimate.reason.c_str());
    std_msgs::Header header;
    header.frame_id = work.ground_frame;
    header.stamp.fromNSec(static_cast<std::uint64_t>(found->stamp));
    publishCoarse(found->estimate, header, work);
  }

  /// False where it is about a map that has ended meanwhile.
  bool publishCoarse(const CoarseEstimate& e, const std_msgs::Header& header, const Work& work) {
    // tf has no scale.
    const bool for_tf = e.status == Status::kConverged && !work.own_unit;
    if (!inbox_.conclude(for_tf ? std::make_optional(e.similarityPose()) : std::nullopt)) return false;
    air_ground::AlignmentEstimate coarse = toMsg(e, header, work.mav_frame, work.map_id);
    coarse.ground_map_id = work.ground_map_id;
    coarse_.publish(coarse);
    return true;
  }

  void publish(const Work& work) {
    const CoarseEstimate& e = localizer_.estimate();
    std_msgs::Header header;
    header.frame_id = work.ground_frame;
    header.stamp = aerial_stamp_;
    if (work.ground && localizer_.hasGround()) {
      std_msgs::Header ground = header;
      ground.stamp = ground_stamp_;
      height_map_ground_.publish(toMsg(localizer_.groundMap(), ground, 0));
    }
    if (work.aerial.cloud && localizer_.hasAerial()) {
      std_msgs::Header air = header;
      air.frame_id = work.mav_frame;
      height_map_air_.publish(toMsg(localizer_.aerialMap(), air, work.map_id));
    }
    health_.state(e.status == Status::kConverged ? health_.kOk : health_.kWarn,
                  std::string(toString(e.status)) + ": " + e.reason);
    if (e.status != last_status_) {
      ROS_INFO("Coarse alignment %s: %s", toString(e.status), e.reason.c_str());
      last_status_ = e.status;
    }
    // Without both frames there is nothing that a pose could refer to.
    if (work.ground_frame.empty() || work.mav_frame.empty()) return;
    if (!publishCoarse(e, header, work) || !e.has_pose) return;

    const Eigen::Vector3d reference = e.scale * (e.R_level * localizer_.reference());
    const double z = reference.z() + e.T_ground_mav.translation().z();
    particles_.publish(toMsg(localizer_.filter().particles(), z, heading_, header));
    if (costmap_.getNumSubscribers() > 0) {
      Eigen::Vector2d pivot;
      const CostMap cost = localizer_.costMap(&pivot);
      // Cells stand for the MAV's position, as the particles do.
      const PlanarPose shift = changeReference({0, 0, cost.yaw}, pivot, reference.head<2>());
      if (!cost.cost.empty()) costmap_.publish(toMsg(cost, {shift.x, shift.y}, header));
    }
  }

  ros::NodeHandle handle_, private_handle_;
  const NodeSettings settings_;
  const std::string cloud_topic_ = handle_.resolveName("mav/dense_cloud"),
                    ground_topic_ = handle_.resolveName("ground/map_cloud");
  ros_utils::NodeHealth health_;
  Inbox inbox_;
  ros::Publisher height_map_air_, height_map_ground_, costmap_, particles_, coarse_;
  ros::Subscriber cloud_sub_, corrections_sub_, ground_status_sub_, odometry_sub_, status_sub_, guess_sub_;
  std::optional<ros_utils::RenewableSubscriber> ground_sub_;
  ros::ServiceServer reset_, relocalize_;
  std::optional<ros_utils::AlignmentBroadcaster> broadcaster_;

  std::optional<CompassInput> compass_;

  // The worker's own.
  HeightMapLocalizer localizer_;
  EarlierClouds earlier_;
  bool heading_known_ = false;  // by the compass
  bool guessed_ = false;        // initialpose is in force
  ros::Time aerial_stamp_, ground_stamp_;
  double heading_ = 0;
  std::optional<Status> last_status_;
  std::thread worker_;
};

}  // namespace heightmap_mcl

int main(int argc, char** argv) {
  using namespace heightmap_mcl;
  return air_ground_common::ros_utils::runNode<NodeSettings, HeightmapMclNode>(argc, argv, "heightmap_mcl");
}
