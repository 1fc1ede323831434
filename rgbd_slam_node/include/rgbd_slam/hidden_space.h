// What the ground robot could not see above what it saw: under a table it sees the floor, and not the table's top. Who
// looks from above sees that, and contradicts nothing.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "rgbd_slam/depth_model.h"
#include "rgbd_slam/ground_cloud.h"
#include "rgbd_slam/seen_keyframes.h"
#include "rgbd_slam/tile_grid.h"

namespace rgbd_slam {

/// How far one sees in a depth image, by blocks of pixels.
struct DepthRays {
  struct Ray {
    float x, y;      ///< normalised, of the block's middle
    float free;      ///< depth up to which there is nothing in any of its pixels [m]; 0: some pixels tell nothing
    float occupied;  ///< depth of the nearest surface in them [m]
  };
  std::vector<Ray> rays;

  DepthRays() = default;
  /// `depth`: CV_32F [m], NaN or <= 0 where unknown.
  DepthRays(const air_ground_common::CameraModel& camera, const cv::Mat& depth, const DepthModel& model);
};

/// Columns of 5 cm in layers of 2 cm, and by how many rays each of these was seen to be free, or was not since a
/// surface was in the way. One thread uses it.
class HiddenSpace {
 public:
  /// The rays of all keyframes as they stand now, each with its number. Those that are new are added, those that are
  /// missing taken out, and those that have moved by some centimetres both: some 10 ms each time.
  void update(const std::vector<PosedPoints>& keyframes);

  /// Height in the map from which on a surface hides what is above the point, which has free space above it up to there
  /// [m]. NaN: nothing hides, or nobody looked, within 1.3 m.
  float hiddenFrom(const Eigen::Vector3f& point) const;

  void clear();

 private:
  static constexpr int kSideBits = 4, kSide = 1 << kSideBits;      // columns along the edge of a tile
  static constexpr int kLayerBits = 6, kLayers = 1 << kLayerBits;  // of a tile
  enum class Seen { kNot, kFree, kHidden };
  /// What is taken out again has to be counted without end: the rest of counts that two bytes do not hold is apart.
  struct Tile {
    std::uint16_t free[kSide * kSide][kLayers] = {};
    std::uint16_t hidden[kSide * kSide][kLayers] = {};
    std::unordered_map<const std::uint16_t*, int> rounds;  // of 2^16 rays, by the counter
    void count(std::uint16_t* rays, int sign);
    int countOf(const std::uint16_t* rays) const;
    Seen seen(int column, int layer) const;
  };
  struct Place {
    std::int64_t tile;
    int column, layer;
  };
  static Place placeOf(int x, int y, int layer);
  /// `sign` -1: takes out again what was cast with 1.
  void cast(const air_ground_common::Pose& T_map_camera, const DepthRays& rays, int sign);
  void mark(const Eigen::Vector3f& from, const Eigen::Vector3f& to, float highest, bool free, int sign);

  TileGrid<Tile> tiles_;
  SeenKeyframes seen_;
};

}  // namespace rgbd_slam
