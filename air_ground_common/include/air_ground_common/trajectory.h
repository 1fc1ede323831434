// Stamped pose sequences, the TUM file format, and the errors of trajectory estimates (Sturm 2012, Zhang 2018).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"

namespace air_ground_common {

struct StampedPose {
  double stamp = 0;  ///< [s]
  Pose T_map_body = Pose::Identity();
};

/// Ordered by strictly increasing stamp.
using Trajectory = std::vector<StampedPose>;

/// Reads "stamp tx ty tz qx qy qz qw" lines; '#' starts a comment. Throws std::runtime_error with file and line.
Trajectory readTum(const std::string& path);

/// Writes the TUM format with 9 digits; through a temporary file, so a failed write leaves no half file. `unit` of the
/// lengths, unless it is metres: the first line says so, a comment that begins with "# unit: ".
/// Throws std::runtime_error when the file cannot be written.
void writeTum(const std::string& path, const Trajectory& trajectory, const std::string& unit = "");
/// Such a unit: of a map whose scale nobody knows.
constexpr const char* kOwnUnit = "the map's own (scale unknown): lengths are right among each other, but not in metres";

/// Pose at `stamp` by interpolation; empty outside the trajectory or across gaps longer than `max_gap` [s].
std::optional<Pose> poseAt(const Trajectory& trajectory, double stamp, double max_gap = 0.5);

/// Sum of the distances between consecutive poses [m].
double pathLength(const Trajectory& trajectory);

enum class Alignment { kNone, kYawTranslation, kRigid, kSimilarity };

/// Least-squares transform from `estimate` to `reference` points (Umeyama 1991). kYawTranslation: rotation about z
/// only. Throws std::invalid_argument when sizes differ or fewer than 3 points are given (2 for kYawTranslation).
Similarity alignPoints(const std::vector<Eigen::Vector3d>& reference, const std::vector<Eigen::Vector3d>& estimate,
                       Alignment alignment);

struct TrajectoryError {
  std::size_t pairs = 0;   ///< poses compared
  double rmse = 0;         ///< absolute trajectory error, RMS [m]
  double mean = 0;         ///< [m]
  double median = 0;       ///< [m]
  double max = 0;          ///< [m]
  double path_length = 0;  ///< of the reference over the compared poses [m]
  Similarity reference_from_estimate;
};

/// Absolute trajectory error: positions of `estimate` against `reference` interpolated at their stamps, after
/// alignment. Throws std::invalid_argument when fewer than 3 poses overlap in time.
TrajectoryError absoluteTrajectoryError(const Trajectory& reference, const Trajectory& estimate, Alignment alignment);

}  // namespace air_ground_common
