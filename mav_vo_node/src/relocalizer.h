// The way back into the map for a camera that was lost.
#pragma once

#include <optional>
#include <string>

#include "pose_tracker.h"
#include "visual_frontend/place_recognition.h"

namespace mav_vo {

class Relocalizer {
 public:
  Relocalizer(const CameraModel& camera, const OdometrySettings& settings) : camera_(camera), settings_(settings) {}

  void setCamera(const CameraModel& camera) { camera_ = camera; }
  void begin(double stamp);                         ///< lost at this image [s]
  void reset() { reason_.clear(); }                 ///< for another map
  double lostSince() const { return lost_since_; }  ///< [s]
  /// Of the time since then, that of images that showed enough to be recognised, or to begin a map: a lens in the grass
  /// of the landing place sees no other place [s].
  double strangeFor() const { return strange_for_; }
  /// Tries the image: near the last pose by the landmarks' patches, elsewhere by its ORB features where `gate` allows.
  /// True: `pose` has found it.
  bool find(double stamp, const cv::Mat& gray, const visual_frontend::Map& map,
            const visual_frontend::RelocalizationGate& gate, const std::optional<double>& turn_sigma,
            PoseTracker& pose);
  /// Why the last search for a known place found none; empty: none was sought since begin(), or the camera was found.
  const std::string& reason() const { return reason_; }

 private:
  visual_frontend::ReobservationSettings within(double search_radius) const;  // [px]
  double nearRadius(double stamp, const PoseTracker& pose) const;

  CameraModel camera_;
  OdometrySettings settings_;
  double lost_since_ = 0, last_ = 0, last_image_ = 0, last_search_ = 0;  // images [s]
  double strange_for_ = 0, unsearched_ = 0, could_begin_for_ = 0;        // [s]
  int frames_lost_ = 0;
  std::string reason_;
};

}  // namespace mav_vo
