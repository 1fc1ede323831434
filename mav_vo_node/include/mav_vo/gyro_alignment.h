// Gyro bias, camera-IMU time offset, the readout time of a rolling shutter and how the IMU is turned against the
// camera, from feature tracks alone, in any motion: the gyro's rotation between two images must satisfy the epipolar
// constraint with some translation (the idea of Kneip and Lynen 2013 and He et al. 2023, with the translations
// eliminated by the Schur complement instead of eigenvalue derivatives). A row that is read later shows a track where
// it has moved to since. Needs neither map nor scale. An IMU that is mounted otherwise than told sees each turn about
// another axis: turns about two axes tell how.
#pragma once

#include <Eigen/Core>
#include <array>
#include <deque>
#include <memory>
#include <optional>
#include <unordered_map>
#include <vector>

#include "mav_vo/imu_preintegration.h"
#include "mav_vo/track_flows.h"
#include "visual_frontend/types.h"

namespace visual_frontend {
struct Feature;
}

namespace mav_vo {

struct GyroAlignmentSettings {
  double bias_stddev = 0.15;  ///< of the gyro bias before the first image, per axis, at most: most are small [rad/s]
  double time_offset = 0;     ///< t_imu = t_image + time_offset: of the same instant on both clocks [s]
  double time_offset_stddev = 0.03;  ///< of that figure before the first image [s]; 0 = exact, it is not estimated
  double max_time_offset = 0.12;     ///< estimates farther from the given one are refused [s]
  double readout_time = 0;           ///< row r of h is exposed at stamp + (r / h - 0.5) readout_time [s]
  double readout_time_stddev = 0;    ///< of that figure before the first image [s]; 0 = exact, it is not estimated
  double max_readout_time = 0.06;    ///< estimates beyond are refused [s]
  double mounting_stddev = 0;      ///< of the IMU's rotation as mounted, per axis [rad]; 0 = exact, it is not estimated
  double max_mounting = 0.2;       ///< estimates that turn it farther are refused [rad]
  double time_offset_walk = 1e-4;  ///< random walk of the offset [s/sqrt(s)]
  double window = 3.0;             ///< image pairs older than this are frozen [s]
  double view_interval = 0.09;     ///< between images that are used [s]
  int min_tracks = 25;             ///< that both images of a pair share
  int max_tracks = 80;             ///< of a pair that are used
  std::array<double, 3> spans{
      {0.2, 0.4, 0.8}};  ///< of the image pairs; long ones weigh rotation, short ones survive [s]
};

class GyroAlignment {
 public:
  /// `sigma`: of a normalised image coordinate; `rows`: of the images.
  GyroAlignment(const GyroAlignmentSettings& settings, const ImuNoise& noise, const Eigen::Matrix3d& R_camera_imu,
                double sigma, int rows);

  /// Next image's tracks, as recorded: nothing done for their rows. `imu` should reach to stamp + timeOffset(). True
  /// when the estimate changed.
  bool add(double stamp, const std::vector<visual_frontend::Feature>& features, const ImuBuffer& imu);

  /// A bias from elsewhere, a rest for example; images before are not compared with later ones: what is seen at rest
  /// tells nothing but the bias, however often [rad/s].
  void setBias(const Eigen::Vector3d& bias, double stddev);

  /// One from elsewhere, where it is not estimated [s].
  void setReadoutTime(double readout_time);

  /// Likewise [rad].
  void setMounting(const Eigen::Vector3d& mounting);

  /// Begins anew with the clocks so far apart, and what is in use of readout time and mounting [s].
  void restartAt(double time_offset);

  Eigen::Vector3d bias() const { return x_.head<3>(); }  ///< [rad/s]
  double biasStddev() const;                             ///< of the least certain axis [rad/s]
  Eigen::Matrix3d biasCovariance() const { return covariance_.topLeftCorner<3, 3>(); }  ///< [rad^2/s^2]
  double givenTimeOffset() const { return settings_.time_offset; }  ///< about which it is estimated [s]
  double timeOffset() const { return x_(3); }                       ///< t_imu - t_image of the same instant [s]
  double timeOffsetStddev() const;                                  ///< [s]
  double readoutTime() const { return x_(4); }                      ///< [s]
  double readoutTimeStddev() const;                                 ///< [s]
  /// Rotation vector of R_given_imu: what the IMU reads, turned by it, is in the axes that `R_camera_imu` was given for
  /// [rad].
  Eigen::Vector3d mounting() const { return x_.tail<3>(); }
  Eigen::Matrix3d mountingCovariance() const { return covariance_.bottomRightCorner<3, 3>(); }  ///< [rad^2]
  /// Median epipolar error over that of pure feature noise: about 1 when gyro and images agree; 0 before any pair.
  double misfit() const { return misfit_; }
  /// R_given_imu by right angles with which they would agree, where no other does nearly as well. Takes as long as 24
  /// images.
  std::optional<Eigen::Matrix3d> rightAngles(const ImuBuffer& imu) const;

 private:
  friend class ClockSearch;
  static constexpr double kOtherMinimum = 9;  ///< in cost over the window, by which another minimum must be better
  static constexpr double kAgreement = 2;     ///< misfit of gyro and images that are of one mounting and time
  static constexpr int kStates = 8;           ///< gyro bias, time offset, readout time, mounting
  using Vector = Eigen::Matrix<double, kStates, 1, Eigen::DontAlign>;
  using Matrix = Eigen::Matrix<double, kStates, kStates, Eigen::DontAlign>;
  /// Where a track is seen, and how far it moves by the readout time of 1 s until its row is read, as (x, y, 1).
  struct RayObservation {
    Eigen::Vector2d ray = Eigen::Vector2d::Zero(), by_readout = Eigen::Vector2d::Zero();
    Eigen::Vector3d atMiddleRow(double readout_time) const { return (ray - readout_time * by_readout).homogeneous(); }
    Eigen::Vector3d derivative() const { return {-by_readout.x(), -by_readout.y(), 0}; }
  };
  struct View {
    double stamp = 0;
    std::unordered_map<visual_frontend::TrackId, RayObservation> observations;
  };
  struct Pair {
    double begin = 0, end = 0;         ///< stamps of the images [s]
    std::vector<RayObservation> a, b;  ///< in the earlier and in the later camera
  };
  struct Normal {
    Matrix H = Matrix::Zero();
    Vector g = Vector::Zero();
    double cost = 0;
  };
  void reset();
  /// Where the bias may be anything; the cost.
  double solveFromAfar(const Vector& start, const ImuBuffer& imu, Vector* solution) const;
  /// Solves for what the pairs alone tell; the cost.
  double beginAnew(const ImuBuffer& imu);
  void growOld(double elapsed);
  void addPairs(const std::shared_ptr<const View>& view);
  std::optional<Normal> linearize(const Pair& pair, const Vector& x, const ImuBuffer& imu, double width,
                                  std::vector<double>* errors) const;
  double solveFrom(Vector x, int iterations, double first_width, const ImuBuffer& imu, Vector* solution) const;
  double costAt(const Vector& x, const ImuBuffer& imu) const;
  /// Minus twice the logarithm of a bias' Cauchy distribution in three dimensions, and that of a Gaussian with the same
  /// slope as a weight of |bias|^2; zero where the bias is known from elsewhere.
  struct UnusualBias {
    double cost = 0, weight = 0;
  };
  UnusualBias unusualBias(const Vector& x) const;
  void leaveWrongMinimum(int times, const ImuBuffer& imu, Vector* best);
  void retire(double before, const ImuBuffer& imu);
  void summarize(const ImuBuffer& imu);
  Matrix shareOfTracks(const Matrix& information) const;

  GyroAlignmentSettings settings_;
  ImuNoise noise_;
  Eigen::Matrix3d R_camera_imu_;
  double sigma_;

  std::array<std::shared_ptr<const View>, 3> chain_end_;  ///< by span: where the next pair begins
  std::deque<Pair> pairs_;
  double first_view_ = -1, last_view_ = -1, last_search_ = -1, last_restart_ = -1;  ///< [s]
  int refuted_ = 0;          ///< times in a row that another minimum was better
  bool bias_given_ = false;  ///< from elsewhere
  TrackFlows flows_;
  int rows_;
  Vector x_ = Vector::Zero();
  Vector prior_mean_ = Vector::Zero();
  Matrix prior_ = Matrix::Zero();  ///< information, without the tracks'
  Matrix old_H_ = Matrix::Zero();  ///< information of pairs that have left the window, fading
  Vector old_h_ = Vector::Zero();  ///< times their estimate
  Matrix covariance_ = Matrix::Zero();
  double misfit_ = 0;
  double inflation_ = 1;  ///< of the variances, by what the pairs disagree
};

}  // namespace mav_vo
