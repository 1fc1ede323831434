// Readout time of a rolling shutter from points with depth: two images that share points are those of one rigid motion
// only when each row is moved by what the camera did until it was read. What a calibration that is a little wrong looks
// like is estimated beside it, for the two are alike in many motions. Needs neither gyro nor map.
#pragma once

#include <Eigen/Core>
#include <deque>
#include <optional>
#include <unordered_map>
#include <vector>

#include "air_ground_common/geometry.h"
#include "visual_frontend/types.h"

namespace rgbd_slam {

/// A tracked point with measured depth, as the sensor recorded it: nothing done for its row.
struct RowPoint {
  visual_frontend::TrackId track = visual_frontend::kNoTrack;
  Eigen::Vector3d p_camera = Eigen::Vector3d::Zero();  ///< in the camera when its row was read [m]
  double depth_sigma = 0.01;                           ///< [m]
  double row = 0;                                      ///< from the middle row, over the image's height
};

class ReadoutEstimator {
 public:
  /// `readout_time` and its standard deviation before the first image [s]; `ray_sigma`: of a normalised image
  /// coordinate. Throws std::invalid_argument.
  ReadoutEstimator(double readout_time, double stddev, double ray_sigma);

  /// Next image's points, and where the camera was when its middle row was read, as far as known: its motion is taken
  /// from the poses before and after. True when the estimate changed.
  bool add(double stamp, const air_ground_common::Pose& T_map_camera, const std::vector<RowPoint>& points);

  double readoutTime() const { return x_(0); }  ///< row r of h is exposed at stamp + (r / h - 0.5) readout_time [s]
  double stddev() const { return stddev_; }     ///< [s]

  /// The poses were found with another readout time, which bends the motions: what they showed counts a tenth.
  void distrust();
  /// The next pose does not go on from the last one: the camera was lost, or the map was moved.
  void interrupt();
  void reset();

 private:
  /// Readout time [s], and how far rays are off: focal length [1], principal point x and y, and the first radial
  /// coefficient, of normalised coordinates.
  static constexpr int kStates = 5;
  using Vector = Eigen::Matrix<double, kStates, 1, Eigen::DontAlign>;
  using Matrix = Eigen::Matrix<double, kStates, kStates, Eigen::DontAlign>;
  struct RowObservation {
    RowPoint point;
    Eigen::Matrix<double, 3, kStates> by_state;  ///< of the point in the camera at the middle row [m]
  };
  struct View {
    View(double image_stamp, const air_ground_common::Pose& pose) : stamp(image_stamp), T_map_camera(pose) {}
    double stamp;
    air_ground_common::Pose T_map_camera;
    std::unordered_map<visual_frontend::TrackId, RowObservation> observations;
  };
  struct Pair;
  /// Knows the last image's motion now, and compares it with earlier ones.
  bool conclude(const air_ground_common::Pose& T_map_after, double after);
  bool compare(const View& a, const View& b);
  void solve();

  double given_, given_stddev_, ray_sigma_;
  std::optional<View> before_, last_;  ///< the last two images; the motion of the last one is not known yet
  std::deque<View> views_;
  Vector prior_;                    ///< information before the first image, without correlations
  Matrix H_ = Matrix::Zero();       ///< information of the pairs
  Vector h_ = Vector::Zero();       ///< times their estimate
  double scatter_ = 0, pairs_ = 0;  ///< squared disagreement with the pairs before, in variances; their number
  Vector x_ = Vector::Zero();
  double stddev_ = 0;
};

}  // namespace rgbd_slam
