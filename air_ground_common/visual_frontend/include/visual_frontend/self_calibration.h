// What a calibration is off by, as the images themselves tell: a bundle adjustment estimates it beside poses and
// points. Radial distortion and readout time bend a map where nothing else explains it. Focal length and principal
// point are left out: where a camera mostly looks one way, motion and depth make up for them, and small errors of
// tracks look like them.
#pragma once

#include "visual_frontend/types.h"

namespace visual_frontend {

constexpr int kCalibrationStates = 2;  ///< first radial coefficient [1], readout time [s]
using CalibrationVector = Eigen::Matrix<double, kCalibrationStates, 1, Eigen::DontAlign>;
using CalibrationMatrix = Eigen::Matrix<double, kCalibrationStates, kCalibrationStates, Eigen::DontAlign>;
/// d normalised coordinates of a pixel / d states: where the calibrated camera, at its middle row, has its ray. Taken
/// where a point should be seen, not where it was: its noise would be in both, which biases the states.
using RayByCalibration = Eigen::Matrix<double, 2, kCalibrationStates, Eigen::DontAlign>;

struct CalibrationEstimate {
  CalibrationVector mean = CalibrationVector::Zero();   ///< true less assumed calibration, before the images
  CalibrationVector sigma = CalibrationVector::Ones();  ///< standard deviations of that; tiny: held
  CalibrationVector error = CalibrationVector::Zero();  ///< true less assumed calibration, with the images
  CalibrationMatrix covariance = CalibrationMatrix::Zero();
};

/// The camera with a first radial coefficient that is larger by `change`.
CameraModel withRadial(CameraModel camera, double change);

}  // namespace visual_frontend
