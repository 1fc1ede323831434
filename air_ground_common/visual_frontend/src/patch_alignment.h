// Small patches around landmarks, as they look from elsewhere, and where they are in an image. For search and
// realignment.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <optional>

#include "visual_frontend/types.h"

namespace visual_frontend {

constexpr int kMaxHalfPatch = 8;  // of a rimmed one

/// Square patch of (2 half)^2 grey values with its statistics.
struct Patch {
  int half = 4;
  float values[4 * kMaxHalfPatch * kMaxHalfPatch];
  float mean = 0, deviation = 0;  ///< deviation: root of the sum of squares about the mean
  int area() const { return 4 * half * half; }
  void statistics();
};

/// A patch of the reference as the current image should show it, with a rim of one pixel for its gradients.
struct PatchTemplate {
  Patch patch;
  float rimmed[4 * kMaxHalfPatch * kMaxHalfPatch];
};

/// Bilinear value, or false outside the image.
bool sampleBilinear(const cv::Mat& image, float x, float y, float* value);

/// Mean absolute difference of two 9x9 windows after removing their means; large near the edge.
float patchDifference(const cv::Mat& a, const cv::Point2f& pa, const cv::Mat& b, const cv::Point2f& pb);

float zncc(const Patch& a, const Patch& b);  ///< zero-mean normalised cross correlation

/// Columns: movement in the current image for one pixel right and down in the reference image [px], where a plane of
/// depth z = `depth` faces the reference camera at `pixel`. None where either camera does not see it.
std::optional<Eigen::Matrix2d> patchWarp(const CameraModel& camera, const Eigen::Vector2d& pixel, double depth,
                                         const Pose& T_current_reference);

/// From `image` around `centre` with steps of B [pixels of the reference by pixels of the patch]; `half` below
/// kMaxHalfPatch. False where the image ends.
bool makeTemplate(const cv::Mat& image, const Eigen::Vector2d& centre, const Eigen::Matrix2d& B, int half,
                  PatchTemplate* result);

/// Inverse compositional alignment (Baker, Matthews 2004) of the template in `image` from `centre`; the window is
/// brought to the template's mean and contrast first. Returns the correlation there, or -1: no texture, outside the
/// image or further than 3 pixels away.
float alignPatch(const cv::Mat& image, const PatchTemplate& reference, int max_iterations, Eigen::Vector2f* centre);

}  // namespace visual_frontend
