// Gyro bias and camera-IMU time offset from feature tracks alone, in any motion: the gyro's rotation between two images
// must satisfy the epipolar constraint with some translation (the idea of Kneip and Lynen 2013 and He et al. 2023, with
// the translations eliminated by the Schur complement instead of eigenvalue derivatives). Needs neither map nor scale.
#pragma once

#include <Eigen/Core>
#include <array>
#include <deque>
#include <memory>
#include <optional>
#include <unordered_map>
#include <vector>

#include "mav_vo/imu_preintegration.h"
#include "visual_frontend/types.h"

namespace visual_frontend {
struct Feature;
}

namespace mav_vo {

struct GyroAlignmentSettings {
  double bias_stddev = 0.15;         ///< of the gyro bias before the first image, per axis [rad/s]
  double time_offset = 0;            ///< t_imu = t_image + time_offset: of the same instant on both clocks [s]
  double time_offset_stddev = 0.03;  ///< of that figure before the first image [s]; 0 = exact, it is not estimated
  double max_time_offset = 0.12;     ///< estimates farther from the given one are refused [s]
  double time_offset_walk = 1e-4;    ///< random walk of the offset [s/sqrt(s)]
  double window = 3.0;               ///< image pairs older than this are frozen [s]
  double view_interval = 0.09;       ///< between images that are used [s]
  int min_tracks = 25;               ///< that both images of a pair share
  int max_tracks = 80;               ///< of a pair that are used
  std::array<double, 3> spans{
      {0.2, 0.4, 0.8}};  ///< of the image pairs; long ones weigh rotation, short ones survive [s]
};

class GyroAlignment {
 public:
  /// `sigma`: of a normalised image coordinate.
  GyroAlignment(const GyroAlignmentSettings& settings, const ImuNoise& noise, const Eigen::Matrix3d& R_camera_imu,
                double sigma);

  /// Next image's tracks; `imu` should reach to stamp + timeOffset(). True when the estimate changed.
  bool add(double stamp, const std::vector<visual_frontend::Feature>& features, const ImuBuffer& imu);

  /// A bias from elsewhere, a rest for example [rad/s].
  void setBias(const Eigen::Vector3d& bias, double stddev);

  void reset();

  Eigen::Vector3d bias() const { return x_.head<3>(); }  ///< [rad/s]
  double biasStddev() const;                             ///< of the least certain axis [rad/s]
  double timeOffset() const { return x_(3); }            ///< t_imu - t_image of the same instant [s]
  double timeOffsetStddev() const;                       ///< [s]
  /// Median epipolar error over that of pure feature noise: about 1 when gyro and images agree; 0 before any pair.
  double misfit() const { return misfit_; }

 private:
  using Vector4 = Eigen::Matrix<double, 4, 1, Eigen::DontAlign>;
  using Matrix4 = Eigen::Matrix<double, 4, 4, Eigen::DontAlign>;
  struct View {
    double stamp = 0;
    std::unordered_map<visual_frontend::TrackId, Eigen::Vector2d> rays;  ///< normalised coordinates
  };
  struct Pair {
    double begin = 0, end = 0;          ///< stamps of the images [s]
    std::vector<Eigen::Vector3d> a, b;  ///< (x, y, 1) in the earlier and in the later camera
  };
  struct Normal {
    Matrix4 H = Matrix4::Zero();
    Vector4 g = Vector4::Zero();
    double cost = 0;
  };
  void addPairs(const std::shared_ptr<const View>& view);
  std::optional<Normal> linearize(const Pair& pair, const Vector4& x, const ImuBuffer& imu, double width,
                                  std::vector<double>* errors) const;
  double solveFrom(Vector4 x, int iterations, double first_width, const ImuBuffer& imu, Vector4* solution) const;
  void retire(double before, const ImuBuffer& imu);
  void summarize(const ImuBuffer& imu);
  Matrix4 shareOfTracks(const Matrix4& information) const;

  GyroAlignmentSettings settings_;
  ImuNoise noise_;
  Eigen::Matrix3d R_camera_imu_;
  double sigma_;

  std::array<std::shared_ptr<const View>, 3> chain_end_;  ///< by span: where the next pair begins
  std::deque<Pair> pairs_;
  double last_view_ = -1, last_search_ = -1;  ///< [s]
  Vector4 x_ = Vector4::Zero();               ///< gyro bias, time offset
  Vector4 prior_mean_ = Vector4::Zero();
  Matrix4 prior_ = Matrix4::Zero();  ///< information, without the tracks'
  Matrix4 old_H_ = Matrix4::Zero();  ///< information of pairs that have left the window, fading
  Vector4 old_h_ = Vector4::Zero();  ///< times their estimate
  Matrix4 covariance_ = Matrix4::Zero();
  double misfit_ = 0;
  double inflation_ = 1;  ///< of the variances, by what the pairs disagree
};

}  // namespace mav_vo
