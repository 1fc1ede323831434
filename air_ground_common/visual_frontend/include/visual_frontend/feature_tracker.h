// Corner detection on a grid and pyramidal Lucas-Kanade tracking with track ids.
#pragma once

#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <unordered_map>
#include <vector>

#include "visual_frontend/types.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace visual_frontend {

enum class CornerDetector { kFast, kShiTomasi };

struct TrackerSettings {
  CornerDetector detector = CornerDetector::kFast;
  int max_features = 250;        ///< tracks alive at a time
  int min_distance = 18;         ///< between features [px]
  int sparse_distance = 0;       ///< where texture is so weak that half of max_features are not found; 0 = off [px]
  int fast_threshold = 12;       ///< grey levels; halved once in cells where nothing is found
  double min_shi_tomasi = 1e-4;  ///< smallest eigenvalue of the structure tensor, image in [0, 1]
  /// The same where texture is weak and sparse_distance is on: a shift that 1.5 grey levels of noise make is 0.1 px.
  double weak_shi_tomasi = 2e-5;
  int window = 17;                    ///< Lucas-Kanade window, odd [px]
  int pyramid_levels = 4;             ///< including the full resolution
  int max_iterations = 20;            ///< per level
  double convergence = 0.02;          ///< step at which an iteration ends [px]
  double max_forward_backward = 1.0;  ///< distance after tracking there and back [px]
  double max_patch_difference =
      30.0;            ///< mean absolute difference of the windows after removing their means [grey levels]
  int border = 10;     ///< features nearer to the image's edge are dropped [px]
  bool clahe = false;  ///< local contrast equalisation before detecting and tracking

  /// Throws std::invalid_argument, naming the field, when a value cannot work.
  void validate() const;
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, TrackerSettings& settings);

struct Feature {
  TrackId id = kNoTrack;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();           ///< distorted image [px]
  Eigen::Vector2d normalized = Eigen::Vector2d::Zero();      ///< undistorted x/z, y/z
  Eigen::Vector2d previous_pixel = Eigen::Vector2d::Zero();  ///< in the frame before; == pixel at age 0 [px]
  int age = 0;                                               ///< frames tracked since detection
  float response = 0;                                        ///< corner score at detection
};

/// Where the features are expected. Empty: at their last pixels.
struct TrackPrediction {
  /// Rotation from the previous to the current camera: r_current = R_current_previous * r_previous (for example from
  /// ImuBuffer::integrateRotation).
  std::optional<Eigen::Matrix3d> R_current_previous;
  /// Predicted pixels by track (for example projected landmarks); go before the rotation.
  std::unordered_map<TrackId, Eigen::Vector2d> pixels;
};

/// Greyscale pyramid, level 0 first, each half the size of the one before.
using ImagePyramid = std::vector<cv::Mat>;

/// 8-bit pyramid of a CV_8UC1 image. Throws std::invalid_argument for another type or an empty image.
ImagePyramid buildPyramid(const cv::Mat& gray, int levels);

class FeatureTracker {
 public:
  /// Throws std::invalid_argument for bad settings or camera.
  FeatureTracker(const CameraModel& camera, const TrackerSettings& settings);
  ~FeatureTracker();
  FeatureTracker(FeatureTracker&&) noexcept;
  FeatureTracker& operator=(FeatureTracker&&) noexcept;

  /// Tracks the living features into the next image (CV_8UC1 of the camera's size; throws std::invalid_argument
  /// otherwise). The first image only sets the reference. Does not detect: call replenish().
  const std::vector<Feature>& track(const cv::Mat& gray, const TrackPrediction& prediction = {});

  /// Detects new features in the current image where there are none, up to max_features; returns how many were added.
  /// `mask` (CV_8UC1, empty = everywhere): features only where it is not zero.
  int replenish(const cv::Mat& mask = cv::Mat());

  /// Starts a track at a pixel of the current image (for example of a re-observed landmark); kNoTrack when it lies too
  /// near to the edge or to a living feature.
  TrackId addFeature(const Eigen::Vector2d& pixel);

  /// Moves features() to where they have been found more exactly, in their order; those without a pixel stay. Throws
  /// std::invalid_argument for another number of pixels.
  void move(const std::vector<std::optional<Eigen::Vector2d>>& pixels);

  /// Drops tracks (for example outliers).
  void remove(const std::vector<TrackId>& ids);

  /// Forgets all features and the reference image; track ids go on counting.
  void reset();

  const std::vector<Feature>& features() const;
  const ImagePyramid& pyramid() const;  ///< of the current image (after CLAHE, if on)
  const CameraModel& camera() const;
  /// The same camera, better known: normalised coordinates follow.
  void setCamera(const CameraModel& camera);
  const TrackerSettings& settings() const;
  /// Features tracked by the last track() over those that were alive before it; 1 when there were none.
  double lastSurvival() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Draws tracks (colour by age: red new, green old) on a BGR copy of the image; `mapped` tracks get a filled dot.
cv::Mat drawTracks(const cv::Mat& gray, const std::vector<Feature>& features, const std::vector<bool>& mapped = {});

}  // namespace visual_frontend
