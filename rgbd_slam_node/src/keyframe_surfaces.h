// Surfaces of the keyframes, and where these stand to each other by them.
#pragma once

#include <map>
#include <vector>

#include "rgbd_slam/depth_surface.h"
#include "rgbd_slam/slam.h"
#include "rgbd_slam/surface_vertical.h"
#include "visual_frontend/bundle_job.h"

namespace rgbd_slam {

class KeyframeSurfaces {
 public:
  KeyframeSurfaces(const CameraModel& camera, const SlamSettings& settings) : camera_(camera), depth_(settings.depth) {}

  void clear();
  DepthSurface surfaceOf(const cv::Mat& depth, const visual_frontend::RollingShutter& rows) const;
  void add(KeyframeId id, DepthSurface surface);
  /// Before keyframe `from` leaves the map: its links go on from `to`, where that has none of its own to the other.
  void replace(KeyframeId from, KeyframeId to, const visual_frontend::Map& map);
  void setCamera(const CameraModel& better_known);  ///< before `relink`
  /// Before `relink`: the keyframe's surface as of another readout time.
  void moveRows(KeyframeId id, const visual_frontend::RollingShutter& shift);
  /// Links anew what stands in the map, the newest keyframes; older links go.
  void relink(const visual_frontend::Map& map);
  bool has(KeyframeId id) const { return surfaces_.count(id) > 0; }

  /// Where a camera stands to a keyframe, from `T_keyframe_camera`. Throws std::out_of_range for one without a surface.
  SurfaceAlignment align(KeyframeId id, const DepthSurface& surface, const Pose& T_keyframe_camera) const;
  /// Links a keyframe to others by where they stand in the map, where their surfaces lie upon each other.
  void link(KeyframeId id, const std::vector<KeyframeId>& others, const visual_frontend::Map& map);
  /// Links a keyframe to the one by which depth gave its pose: with `covariance` of that, about the map's axes.
  void tie(KeyframeId id, KeyframeId reference, const Matrix6d& covariance, const visual_frontend::Map& map);
  std::vector<KeyframeId> linkedTo(KeyframeId id) const;
  std::vector<visual_frontend::KeyframeLink> links() const;
  std::vector<SurfacePatch> patches(const visual_frontend::Map& map) const;  ///< of all keyframes, or evenly taken

 private:
  CameraModel camera_;
  DepthModel depth_;
  std::map<KeyframeId, DepthSurface> surfaces_;
  std::vector<visual_frontend::KeyframeLink> links_, ties_;  // by the surfaces alone, and by all that gave a pose
};

}  // namespace rgbd_slam
