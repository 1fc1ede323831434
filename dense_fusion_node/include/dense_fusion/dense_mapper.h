// The whole dense reconstruction of section V: images with poses in, fused maps out (view selection of VIII-B).
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "air_ground_common/map_correction.h"
#include "dense_fusion/depth_fusion.h"
#include "dense_fusion/image_spacing.h"
#include "dense_fusion/plane_sweep.h"
#include "dense_fusion/rectifier.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace dense_fusion {

struct MapperSettings {
  RectifierSettings rectifier;
  PlaneSweepSettings sweep;
  FusionSettings fusion;
  double sweep_radius = 0.12;  ///< frames this near to the reference join its depth map (paper: 0.12) [m]
  double max_baseline = 0.15;  ///< the radius grows up to this share of the scene's distance where images are far apart
  double frame_spacing = 0.02;  ///< frames nearer than this to the one before are left out [m]
  double max_rotation = 0.5;    ///< frames turned further than this from the reference end its depth map [rad]
  double fusion_radius = 0.70;  ///< depth maps this near to the first are fused (paper: 0.70) [m]
  double overlap = 0;           ///< depth maps this near to the last one also start the next fusion [m]
  int min_depth_maps = 3;       ///< fewer are not fused
  double min_valid = 0.10;      ///< share of pixels with depth below which a depth map is dropped
  double near_margin = 2.0;     ///< the sweep starts at depth_min / near_margin: tops of things have few sparse points
  double far_margin = 1.3;      ///< and ends at depth_max * far_margin
  double default_depth_min = 0.4;  ///< [m], while the image's depth range is unknown
  double default_depth_max = 6.0;  ///< [m]
  double nominal_distance = 2.0;   ///< of the scene, for which the lengths above are meant: see followDistance [m]

  /// Throws std::invalid_argument, naming the field.
  void validate() const;
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, MapperSettings& settings);

struct MapperCounters {
  std::size_t images = 0;           ///< given to add()
  std::size_t redundant = 0;        ///< left out: hardly moved since the one before
  std::size_t swept = 0;            ///< additions to a cost volume; an image may join two
  std::size_t depth_maps = 0;       ///< computed and kept
  std::size_t poor_depth_maps = 0;  ///< dropped: too little parallax or texture
  std::size_t fused = 0;            ///< fused maps
  std::size_t small_groups = 0;     ///< dropped: fewer than min_depth_maps
  std::size_t corrections = 0;      ///< of the map, followed
  std::size_t given_up = 0;         ///< fused maps, since the map has bent where they are
};

class DenseMapper {
 public:
  /// Throws std::invalid_argument for bad settings.
  explicit DenseMapper(const MapperSettings& settings = {});

  /// Adds an image (CV_8UC1 or CV_8UC3 BGR) of time `stamp` [ns] with the pose of its camera. depth_min, depth_max:
  /// expected depths in view [m], 0 if unknown. Returns a fused map whenever one is complete, and what there is once
  /// the camera has stood for 4 s. A changed calibration
  /// starts afresh. `readout_time` of a rolling shutter [s], whose stamp is its middle row's: the camera's motion is
  /// that since the image before, so all images are to be given. Throws std::invalid_argument for an image, calibration
  /// or pose that cannot be used.
  std::optional<FusedMap> add(const cv::Mat& image, const air_ground_common::CameraModel& camera, std::int64_t stamp,
                              const Eigen::Isometry3d& T_map_camera, double depth_min, double depth_max,
                              double readout_time = 0);

  /// For poses in a unit that nobody knows: all lengths in the settings become relative to the scene's distance, in
  /// that the present `scene_distance` (in the poses' unit) counts as `nominal_distance` metres. To be called before
  /// each image; nothing happens until it is half or twice what it was when it was last taken over. Then what there is
  /// is fused, and returned, and the next image starts a new depth map. Results are in the poses' unit. Throws
  /// std::invalid_argument for a distance that is not positive.
  std::optional<FusedMap> followDistance(double scene_distance);
  /// The same for metric poses, whose lengths are as set until the scene is three times nominal_distance away: then
  /// baselines, radii and voxels grow with it, since what is seen from farther apart is all that tells its depth.
  std::optional<FusedMap> followMetricDistance(double scene_distance);
  /// Metres that a length of 1 in the poses counts as; 1 where neither was called.
  double unit() const { return unit_; }

  /// Why depth maps come out poor: how far apart the images are, of a scene how far away, where that is too much; else
  /// what it may be. `unit` of the poses: follows each length.
  std::string whyPoor(const std::string& unit) const;

  /// The odometry has corrected its map: `now` says where it has earlier images [unit of the poses]. What waits to be
  /// fused follows, and images of these stamps that come later are taken to be there. Returns what the newest fused
  /// maps so far go through, by the stamps of their reference views: they are given up where cameras nearby moved
  /// against each other by 2 % of the sweep's radius, once three newer ones are there.
  air_ground_common::CloudCorrections correct(const air_ground_common::PosesByStamp& now);
  /// The same, since each of them was returned.
  air_ground_common::CloudCorrections corrections() const;

  /// Fuses what there is; empty when that is less than min_depth_maps, which then waits for more. The next image starts
  /// a new depth map.
  std::optional<FusedMap> flush();

  /// Forgets images, depth maps and the unit, not the counters.
  void reset();

  /// Sparse points in the map frame [unit of the poses] bound the grid of the next fusions where they are in view, and
  /// tell the scale of each depth map (see sparseDepthRatio); none lift the bound.
  void setSparsePoints(std::vector<Eigen::Vector3f> points) { sparse_points_ = std::move(points); }

  /// Without it fused maps have no depth map of their reference view: see fuseDepthMaps.
  void makeViews(bool make) { views_ = make; }

  const MapperCounters& counters() const { return counters_; }
  /// Called with each kept depth map, in metres, before it is fused, e.g. to look at it.
  void onDepthMap(std::function<void(const DepthMap&)> callback) { on_depth_map_ = std::move(callback); }

 private:
  void forgetViews();
  RowMotion rowMotion(double readout_time, std::int64_t stamp, const Eigen::Isometry3d& T_map_camera, double depth_min,
                      double depth_max);
  /// Of the newest frame, when it is to start a depth map.
  void startWaitingSweep();
  void finishSweep();
  /// How far from its reference view a depth map takes images now, of a scene with these depths [m].
  void reachOut(double depth_min, double depth_max);
  /// What the reach is of that which is set: all radii go with it.
  double growth() const { return reach_.radius / settings_.sweep_radius; }
  Eigen::Isometry3d expectedNext(const Eigen::Isometry3d& T_map_camera) const;
  void keep(const Frame& frame);
  bool joinsSweep(const Eigen::Isometry3d& T_map_reference, const Eigen::Isometry3d& T_map_camera) const;
  bool endsGroup(const Eigen::Isometry3d& T_map_reference) const;
  std::optional<FusedMap> fuseGroup();
  void followHere(const air_ground_common::PosesByStamp& now, const air_ground_common::Similarity& T_now_then);
  std::optional<FusedMap> inPosesUnit(std::optional<FusedMap> fused) const;
  std::vector<Eigen::Vector3f> sparsePoints() const;  // in metres, as the next

  MapperSettings settings_;
  bool views_ = true;
  double unit_ = 1;  // see unit()
  bool followed_ = false;
  std::unique_ptr<Rectifier> rectifier_;
  std::unique_ptr<PlaneSweep> sweep_;  // keeps its memory from one reference to the next
  bool sweeping_ = false;
  std::deque<Frame> recent_;
  ImageSpacing spacing_;  // of those
  SweepReach reach_;
  double scene_distance_ = 0;                               // [m]
  std::optional<std::pair<double, double>> waiting_range_;  // depths in view of the newest frame, which starts a sweep
  struct {
    std::int64_t stamp = 0;  // [ns]
    Eigen::Isometry3d T_map_camera = Eigen::Isometry3d::Identity();
  } last_;  // pose given
  std::vector<DepthMap> group_;
  // In the poses' unit: where the images so far are in the map, where its last correction has images, and what has
  // become of fused maps.
  air_ground_common::PosesByStamp poses_, corrected_;
  struct Made {
    Eigen::Vector3d place;                                        // of the reference view
    std::optional<air_ground_common::Similarity> T_now_returned;  // empty: given up
    bool bent;                                                    // its cameras have moved against each other
    double radii;  // that it was made with, over those set; in the poses' unit
  };
  std::map<std::int64_t, Made> made_;
  std::vector<Eigen::Vector3f> sparse_points_;
  std::size_t carried_over_ = 0;  // depth maps of the group that the fusion before has used already
  MapperCounters counters_;
  std::function<void(const DepthMap&)> on_depth_map_;
};

}  // namespace dense_fusion
