// Gravity-aligned height maps of point clouds (Forster 2013, VI-A): the highest point of each cell, holes as NaN.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace heightmap_mcl {

constexpr float kHole = std::numeric_limits<float>::quiet_NaN();

/// How many cells hold a point at each level, in bins of kLevelBin.
struct LevelHistogram {
  long first = 0;            ///< level of bin 0: first * kLevelBin [m]
  std::vector<float> cells;  ///< cells with a point in the bin

  void add(const LevelHistogram& other);
};
constexpr double kLevelBin = 0.02;  // [m]

/// Height of the floor [m]: the lowest horizontal surface of at least a quarter of the largest one's area. NaN for an
/// empty histogram.
double findFloor(const LevelHistogram& levels);

/// Where the ground map's floor may lie in the aerial map [m], at most `most`: the aerial map's own floor first; but it
/// may have seen tables alone, so that any of its horizontal surfaces may be any of the ground map's up to `cap`.
std::vector<double> floorCandidates(const LevelHistogram& air, const LevelHistogram& ground, double cap,
                                    std::size_t most);

/// Cell (row r, column c) covers x in [origin_x + c*resolution, + resolution), y likewise with r. Row-major.
struct HeightMap {
  double resolution = 0.02;    ///< edge of a cell [m]
  double origin_x = 0;         ///< lower corner of cell (0, 0) [m], in a frame with z up
  double origin_y = 0;         ///< [m]
  int width = 0;               ///< columns, along x
  int height = 0;              ///< rows, along y
  std::vector<float> heights;  ///< z [m]; NaN marks a hole
  /// 1 where the surface is at least so high, 0 where it is so high; empty: 0 throughout.
  std::vector<std::uint8_t> bounds;
  double floor = std::numeric_limits<double>::quiet_NaN();  ///< z of the floor [m]; NaN: not looked for
  double cap = 0;                                           ///< no height is more above the floor [m]; 0: no limit
  LevelHistogram levels;                                    ///< of the points, where a floor was looked for

  bool isBound(std::size_t cell) const { return !bounds.empty() && bounds[cell] != 0; }
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

/// What stands for the top of a cell: the highest point whatever it is (the paper), that point but not above the cap,
/// or as far as it was seen: see buildHeightMap.
enum class Tops { kHighest, kClipped, kBounded };

struct HeightMapSettings {
  double resolution = 0.02;  ///< [m]; the paper's 50 cells per metre
  Dilation dilation = Dilation::kAll;
  double height_quantile =
      1.0;               ///< of the points of a cell, in (0, 1]; 1 = highest point (paper), less suppresses spikes
  int min_points = 1;    ///< a cell with fewer points stays a hole
  double max_spike = 0;  ///< drop cells higher than all their neighbours by more than this [m]; 0 = off
  Tops tops = Tops::kHighest;
  double cap = 1.0;           ///< above the floor [m]; not for kHighest
  bool drop_hanging = false;  ///< kBounded: what begins above the cap over nothing seen is a ceiling, not a top
  double max_extent = 40.0;   ///< edge of the largest map [m]; of a larger cloud the densest region stays
};

/// Checks ranges; throws std::invalid_argument naming the field.
void validate(const HeightMapSettings& settings);

/// Height map of `points` (z up). With kBounded a cell is a column that is walked up from its lowest point: what begins
/// above the cap after a gap (a lamp, the ceiling, a lintel) is no part of it; what reaches the cap is a bound at the
/// cap; what begins below it after a gap (a table seen from below), and a face that ends without a horizontal surface
/// (a wall where the view ended, a box whose top was not seen) is a bound where it ends. The floor is that of the
/// points and of `earlier`, if given. Points with a coordinate that is not finite are ignored. The grid's lines lie at
/// whole multiples of the resolution, so that maps of one frame can be merged cell by cell. Empty map when no cell gets
/// a height. `cropped` takes the number of points left out because the cloud is larger than max_extent.
HeightMap buildHeightMap(const std::vector<Eigen::Vector3f>& points, const HeightMapSettings& settings,
                         std::size_t* cropped = nullptr, const LevelHistogram* earlier = nullptr);

/// The points but for those above which something was hidden (the floor below a table): who looks from above sees that,
/// and its height is not known. They stay where their cell has a point there, about the height `hidden_from` which
/// each has: NaN where nothing hides.
std::vector<Eigen::Vector3f> withoutHiddenTops(const std::vector<Eigen::Vector3f>& points,
                                               const std::vector<float>& hidden_from, double resolution);

/// 3x3 maximum over the defined neighbours.
HeightMap dilate(const HeightMap& map, Dilation mode);

/// Edge of the square that holds all the maps' grids [m]; 0 without a map that is not empty.
double unionExtent(const std::vector<const HeightMap*>& maps);

enum class Merge { kHighest, kMean };

/// Union of maps of the same frame and resolution. kHighest: the highest of a cell's heights; kMean: their mean. The
/// highest of a cell's bounds counts where no height was seen, or one that is lower by more than 0.2 m. The floor is
/// found anew from what all have seen.
/// Throws std::invalid_argument when resolutions differ.
HeightMap merge(const std::vector<const HeightMap*>& maps, Merge mode);

/// The map with its floor there [m]; heights above the cap become bounds. `map`: with bounds.
HeightMap withFloor(HeightMap map, double floor);

/// Map of `factor` times larger cells with the highest height (or bound) of each; the grid again at whole multiples.
HeightMap downsample(const HeightMap& map, int factor);

/// The map of the same scene `scale` times as large, about the frame's origin; heights scale too. Nearest cell.
HeightMap scaled(const HeightMap& map, double scale);

/// The map turned by `yaw` [rad] about `pivot` (in the map's frame) and shifted so that the pivot is the origin of the
/// result: a square grid of side `cells` (even) centred on the pivot. Nearest cell; NaN outside.
HeightMap rotateAbout(const HeightMap& map, const Eigen::Vector2d& pivot, double yaw, int cells);

/// Levels between floor and cap to which bounds are rounded down when maps are compared. A few are enough, and each
/// costs the search transforms of its own.
constexpr int kBoundLevels = 4;

/// Level of a cell's bound, 1 to kBoundLevels; 0 for a height, a hole and a bound too low to say anything.
int boundLevel(const HeightMap& map, std::size_t cell);

/// What heights are compared relative to: the floor; the mean height where none was looked for.
double baseHeight(const HeightMap& map);

/// Relief of a map: standard deviation of its heights [m]; 0 for fewer than two.
double heightDeviation(const HeightMap& map);

/// Share of the defined cells that stand higher than `height` [m] above baseHeight, bounds included.
double raisedShare(const HeightMap& map, double height);

}  // namespace heightmap_mcl
