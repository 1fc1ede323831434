// Maps of a textured plane with exact truth, for tests of what looks at images.
#pragma once

#include "synthetic.h"
#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/map.h"
#include "visual_frontend/place_recognition.h"

namespace visual_frontend::synthetic {

inline const cv::Mat& planeTexture() {
  static const cv::Mat plane = texture(1600, 7);
  return plane;
}
constexpr double kPlane = 6.0;  // [m]

/// Point of the plane z = 0 seen at a pixel.
inline Eigen::Vector3d onPlane(const CameraModel& camera, const Pose& T, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d d = T.linear() * camera.unproject(pixel).homogeneous();
  return T.translation() - T.translation().z() / d.z() * d;
}

/// A map of one keyframe whose landmarks are corners of the plane.
inline Map planeMap(const CameraModel& camera, const Pose& T, int levels = 4) {
  Map map;
  Keyframe k;
  cv::Mat depth;
  const cv::Mat image = renderPlane(camera, T, planeTexture(), kPlane, &depth);
  FeatureTracker tracker(camera, {});
  tracker.track(image);
  tracker.replenish();
  for (const Feature& f : tracker.features()) {
    Observation o;
    o.landmark = map.addLandmark(onPlane(camera, T, f.pixel));
    o.pixel = f.pixel;
    o.normalized = f.normalized;
    k.observations.push_back(o);
  }
  k.pyramid = buildPyramid(image, levels);
  k.T_map_camera = T;
  describeKeyframe(image, camera, {}, k);
  for (const Eigen::Vector2d& p : k.orb_pixels) k.orb_depth.push_back(depth.at<float>(cvRound(p.y()), cvRound(p.x())));
  map.addKeyframe(k);
  return map;
}

/// Starts tracks in the tracker's image where a camera at T sees the map's landmarks; their pixels, in the order of the
/// tracker's features.
inline std::vector<Eigen::Vector2d> trackLandmarks(const Map& map, const Pose& T, FeatureTracker* tracker,
                                                   LandmarkTracks* tracks) {
  std::vector<Eigen::Vector2d> pixels;
  for (const LandmarkId id : map.landmarkIds()) {
    const auto pixel = tracker->camera().project(T.inverse() * map.landmark(id).position);
    const TrackId track = pixel ? tracker->addFeature(*pixel) : kNoTrack;
    if (track == kNoTrack) continue;
    tracks->assign(track, id);
    pixels.push_back(*pixel);
  }
  return pixels;
}

}  // namespace visual_frontend::synthetic
