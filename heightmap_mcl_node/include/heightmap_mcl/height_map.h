// Gravity-aligned height maps of point clouds (Forster 2013, VI-A): the highest point of each cell, holes as NaN.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <vector>

namespace heightmap_mcl {

constexpr float kHole = std::numeric_limits<float>::quiet_NaN();

/// Cell (row r, column c) covers x in [origin_x + c*resolution, + resolution), y likewise with r. Row-major.
struct HeightMap {
  double resolution = 0.02;    ///< edge of a cell [m]
  double origin_x = 0;         ///< lower corner of cell (0, 0) [m], in a frame with z up
  double origin_y = 0;         ///< [m]
  int width = 0;               ///< columns, along x
  int height = 0;              ///< rows, along y
  std::vector<float> heights;  ///< z [m]; NaN marks a hole

  bool empty() const { return heights.empty(); }
  float at(int row, int column) const { return heights[static_cast<std::size_t>(row) * width + column]; }
  float& at(int row, int column) { return heights[static_cast<std::size_t>(row) * width + column]; }
  /// Centre of a cell [m].
  Eigen::Vector2d center(int row, int column) const {
    return {origin_x + (column + 0.5) * resolution, origin_y + (row + 0.5) * resolution};
  }
  /// Number of cells with a height.
  std::size_t defined() const;
};

/// The 3x3 maximum of the paper, on all cells or only where a height is missing.
enum class Dilation { kNone, kHoles, kAll };

struct HeightMapSettings {
  double resolution = 0.02;  ///< [m]; the paper's 50 cells per metre
  Dilation dilation = Dilation::kAll;
  double height_quantile =
      1.0;                   ///< of the points of a cell, in (0, 1]; 1 = highest point (paper), less suppresses spikes
  int min_points = 1;        ///< a cell with fewer points stays a hole
  double max_spike = 0;      ///< drop cells higher than all their neighbours by more than this [m]; 0 = off
  double max_extent = 40.0;  ///< edge of the largest map [m]; of a larger cloud the densest region stays
};

/// Checks ranges; throws std::invalid_argument naming the field.
void validate(const HeightMapSettings& settings);

/// Height map of `points` (z up). Points with a coordinate that is not finite are ignored. The grid's lines lie at
/// whole multiples of the resolution, so that maps of one frame can be merged cell by cell. Empty map when no cell gets
/// a height. `cropped` takes the number of points left out because the cloud is larger than max_extent.
HeightMap buildHeightMap(const std::vector<Eigen::Vector3f>& points, const HeightMapSettings& settings,
                         std::size_t* cropped = nullptr);

/// 3x3 maximum over the defined neighbours.
HeightMap dilate(const HeightMap& map, Dilation mode);

/// Edge of the square that holds all the maps' grids [m]; 0 without a map that is not empty.
double unionExtent(const std::vector<const HeightMap*>& maps);

enum class Merge { kHighest, kMean };

/// Union of maps of the same frame and resolution. kHighest: the highest of a cell's heights; kMean: their mean.
/// Throws std::invalid_argument when resolutions differ.
HeightMap merge(const std::vector<const HeightMap*>& maps, Merge mode);

/// Map of `factor` times larger cells with the highest height of each; the grid again at whole multiples.
HeightMap downsample(const HeightMap& map, int factor);

/// The map turned by `yaw` [rad] about `pivot` (in the map's frame) and shifted so that the pivot is the origin of the
/// result: a square grid of side `cells` (even) centred on the pivot. Nearest cell; NaN outside.
HeightMap rotateAbout(const HeightMap& map, const Eigen::Vector2d& pivot, double yaw, int cells);

/// Relief of a map: standard deviation of its heights [m]; 0 for fewer than two.
double heightDeviation(const HeightMap& map);

}  // namespace heightmap_mcl
