// The thread that refines: callbacks hand it what has come and go on.
#pragma once

#include <ros/ros.h>

#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "air_ground_common/followed_clouds.h"
#include "air_ground_common/ros/conversions.h"
#include "alignment_input.h"
#include "alignment_output.h"
#include "map_thread.h"
#include "refine_pace.h"

namespace icp_refine {

using air_ground_common::CloudCorrections;
using air_ground_common::ros_utils::CloudPoint;

struct AerialCloud {
  ros::Time stamp;
  std::vector<CloudPoint> points;
};

/// What has come since the worker looked last.
struct Inbox {
  bool aerial_revised = false;       ///< see reviseMap()
  std::optional<bool> ground_moved;  ///< see reviseGround(): whether the newest ground map shows it
  bool reset = false, new_map = false, new_ground = false, refine = false;
  std::optional<std::vector<CloudPoint>> ground;
  std::optional<double> ground_camera;  ///< greatest z of the ground robot's camera in its map [m]
  std::deque<AerialCloud> aerial;
  std::optional<CloudCorrections> corrections;  ///< of the clouds, since each was published
  std::optional<CoarseAlignment> coarse;
  std::optional<KnownAlignment> views;
  bool views_withdrawn = false, coarse_withdrawn = false;  ///< before `views`, `coarse` came, if they did
  std::optional<Pose> manual;
  bool own_unit = false;                  ///< the clouds are in the visual map's unit
  std::optional<double> scale_deviation;  ///< relative, as the odometry states it
  std::optional<Vertical> aerial_vertical, ground_vertical;
  bool any() const {
    return forgets() || aerial_revised || ground_moved || views_withdrawn || coarse_withdrawn || refine || ground ||
           !aerial.empty() || corrections || coarse || views || manual;
  }
  void startMap(bool in_own_unit);
  /// The MAV's calibration has changed: what relates both maps stays about right, the clouds so far do not.
  void reviseMap();
  void startGround();
  /// The ground map was corrected as a whole. `at_hand`: the last one that has come shows it.
  void reviseGround(bool at_hand);
  void setGround(std::vector<CloudPoint> points);
  void withdrawViews();
  void withdrawCoarse();
  bool forgets() const { return reset || new_map || new_ground; }
};

class RefineWorker {
 public:
  RefineWorker(const NodeSettings& settings, IcpChain chain, AlignmentOutput& output,
               air_ground_common::ros_utils::NodeHealth& health);
  ~RefineWorker();

  /// Runs `change` on the inbox, and wakes the worker. No outcome of what `change` makes it forget is published after.
  void post(const std::function<void(Inbox&)>& change);
  /// The same where a map has ended: what was published of it is withdrawn at once, with the reason `why`.
  void forget(const std::string& why, const std::function<void(Inbox&)>& change);
  /// The MAV's map that outcomes are of from now on.
  void setMapId(std::uint32_t map_id);
  /// The same of the ground robot's.
  void setGroundMapId(std::uint32_t map_id);
  /// Of what has come and been worked on so far: see MapThread::points().
  std::pair<std::vector<CloudPoint>, bool> map() { return map_.points(); }

 private:
  using Clock = std::chrono::steady_clock;

  void work();
  bool use(Inbox& inbox);
  void addAerial(std::int64_t stamp, std::vector<CloudPoint> points);
  void correct(const CloudCorrections& corrections);
  /// T_ground_map_mav_map of the last believed pose, in the unit of the MAV's map.
  std::optional<Similarity> trackedInMavMap() const;
  /// Of a map without scale: what makes it about metric and level. A start afresh where that differs from before.
  void makeMetric(const Similarity& T_ground_visual);
  void useCoarse(CoarseAlignment coarse);
  void useViews(KnownAlignment views);
  void refine();
  void dropMapPose();

  const NodeSettings& settings_;
  AlignmentOutput& output_;
  air_ground_common::ros_utils::NodeHealth& health_;
  AlignmentRefiner refiner_;  // worker alone, as the next three
  // Without IMU the refiner works in a map that is made about metric and level by the coarse alignment.
  bool own_unit_ = false;
  air_ground_common::FollowedClouds<CloudPoint> own_clouds_;  // in the visual map, for when that alignment changes
  std::optional<Similarity> T_metric_visual_;
  CloudCorrections corrections_;  // so far: a cloud may come after what it has gone through

  std::mutex mutex_;
  std::condition_variable wake_;
  Inbox inbox_;
  bool stop_ = false;
  MapIds maps_;

  MapThread map_;
  std::thread thread_;
};

}  // namespace icp_refine
