// How noisy an accelerometer is in flight: vibration that its sampling folds down into the band of the robot's motion.
#pragma once

#include <Eigen/Core>
#include <deque>
#include <vector>

namespace visual_frontend {

/// Noise density of a specific force in the band of motion, from the samples alone. Between 10 and 40 Hz a robot hardly
/// moves, and what an accelerometer with a filter before its sampler reads there falls with frequency. Folded vibration
/// does not. The weaker of two bands counts (means around 15 and 25 Hz, fifth differences, so motion of up to 5 Hz is
/// some thousandths of what is measured): real motion fills the lower one, vibration that is sampled well the upper
/// one. Where the density grows on towards the Nyquist frequency, by a factor, it is taken to fall by its square
/// towards zero; else it is taken to be white. Readings that a driver interpolates linearly at the stamps of a faster
/// gyro (RealSense) are noticed, and what that takes from the bands is given back.
class AccelNoise {
 public:
  /// Vibration is folded down from here on; an IMU of a multicopter that is sampled well has less [m/s^2/sqrt(Hz)].
  static constexpr double kFolded = 0.05;

  AccelNoise();

  /// In order of time; a gap of more than 0.1 s begins anew. [s], [m/s^2]
  void add(double stamp, const Eigen::Vector3d& specific_force);
  void reset();

  /// Median of the last eight half seconds, so that a bump is no noise [m/s^2/sqrt(Hz)]; 0 in the first third of a
  /// second.
  double density() const;

 private:
  /// Squared density of a band, averaged over the axes and half a second each.
  struct Power {
    void add(const Eigen::Vector3d& value, double interval);
    double typical() const;  ///< the median
    bool known() const;
    std::deque<double> parts;
    double sum = 0, seconds = 0;  ///< of the part that grows
  };
  struct Band {
    std::vector<double> kernel;  ///< over means of kStep; of white noise of density 1 it makes a mean square of 1
    int spacing = 0;             ///< means from one value to the next
    Power power;
  };
  /// Of an accelerometer whose readings a driver interpolates at the stamps of a faster gyro.
  struct Knots {
    void add(double stamp, const Eigen::Vector3d& value);
    double apart() const;  ///< [samples]; 1 where each sample is a reading
    double lines = 0;      ///< share of samples that lie on a line with their neighbours
    double ends = 0;       ///< share after which such a line ends
    bool on_line = false;
    long readings = 0;
    double last_stamp = 0;
    Eigen::Vector3d last_value = Eigen::Vector3d::Zero(), last_slope = Eigen::Vector3d::Zero();
  };
  void addMean(const Eigen::Vector3d& mean);
  void addRaw(const Eigen::Vector3d& specific_force, double interval);
  void restart(double stamp);

  std::vector<Band> bands_;
  Knots knots_;
  Power nyquist_;                                       ///< of the samples as they come
  std::deque<Eigen::Vector3d> means_, samples_;         ///< of kStep each; the last ones
  long count_ = 0;                                      ///< of means so far
  double interval_ = 0;                                 ///< between samples, running mean [s]
  long intervals_ = 0;                                  ///< so far
  double stamp_ = -1, end_ = 0;                         ///< of the last sample; of the mean that grows [s]
  Eigen::Vector3d integral_ = Eigen::Vector3d::Zero();  ///< since the last mean's end [m/s]
};

}  // namespace visual_frontend
